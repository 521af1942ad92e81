"""LTE downlink (3GPP TS 36.211 and 36.212): cell search, time of arrival, sequences, synthesis.

>>> import soopnav_cpp as sn
>>> iq, meta = sn.io.read_iq("city.sigmf-meta")  # doctest: +SKIP
>>> for cell in sn.lte.search(iq, meta.sample_rate_hz):  # doctest: +SKIP
...     print(cell, sn.lte.time_of_arrival(iq, meta.sample_rate_hz, cell))
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import lte as _lte
from soopnav_cpp._core.lte import (
    CellLostError,
    CellParameters,
    CyclicPrefix,
    Detection,
    Duplex,
    Path,
    Searcher,
    SubframeToa,
    SubframeToaEstimator,
    SyncPorts,
    Synthesizer,
    TimeOfArrival,
)
from soopnav_cpp._lte_paths import PathResolver, ResolvedPaths, ResolveStatus, Snapshot, SnapshotRanger, resolve_paths
from soopnav_cpp._lte_tracking import CrsLoop, LoopStatus, StreamEpoch, measurement_stream

__all__ = [
    "CellLostError",
    "CellParameters",
    "CrsLoop",
    "CyclicPrefix",
    "Detection",
    "Duplex",
    "LoopStatus",
    "Path",
    "PathResolver",
    "ResolveStatus",
    "ResolvedPaths",
    "Searcher",
    "Snapshot",
    "SnapshotRanger",
    "StreamEpoch",
    "SubframeToa",
    "SubframeToaEstimator",
    "SyncPorts",
    "Synthesizer",
    "TimeOfArrival",
    "arrival_at",
    "crs",
    "measurement_stream",
    "noise_variance_for_snr",
    "pss",
    "resolve_paths",
    "resource_grid",
    "search",
    "sss",
    "synthesize",
    "time_of_arrival",
]

_FRAME_S = 10e-3


def search(
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    *,
    max_cfo_hz: float = 150e3,
    decode_mib: bool = True,
    max_cells: int = 16,
) -> list[Detection]:
    """Find the cells of a capture.

    Every cell that its reference signals confirm is reported, also several of one ``N_ID_2``: those found are cancelled
    and the rest is searched again.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
        C-contiguous, at least 5.2 ms. Not copied. The GIL is released.
    sample_rate_hz : float
        1.4e6 ... 100e6.
    max_cfo_hz : float
        Carrier-frequency offsets searched: ``-max_cfo_hz ... +max_cfo_hz``, 0 ... 250e3.
    decode_mib : bool
        Decode the broadcast channel for bandwidth, ports and frame number.
    max_cells : int
        The search ends when so many are found, 1 ... 64.

    Returns
    -------
    list of Detection
        Strongest first; empty when no cell is there.

    Raises
    ------
    ValueError
        For another dtype or shape, too few samples, samples that are not finite, options out of range.
    """
    return _lte.search(iq, sample_rate_hz, max_cfo_hz=max_cfo_hz, decode_mib=decode_mib, max_cells=max_cells)


def time_of_arrival(iq: npt.NDArray[np.complex64], sample_rate_hz: float, detection: Detection) -> TimeOfArrival:
    """Measure when the first path of a cell arrives, a value per radio frame.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
        The capture that was searched. Not copied. The GIL is released.
    sample_rate_hz : float
    detection : Detection
        From `search`, or made by hand for a cell that is known.

    Returns
    -------
    TimeOfArrival
        ``toa_s``: start (cyclic prefix included) of frame i by its first path, minus i · 10 ms, counted from the
        capture's first sample; ``sigma_s``: standard deviation of each; also ``cfo_hz``, ``clock_error_ppm``,
        ``snr_db``, ``paths``, ``impulse_response``.

    Raises
    ------
    CellLostError
        (a ``ValueError``) when the cell's reference signals are not in these samples.
    ValueError
        For another dtype or shape, too few samples, samples that are not finite.
    """
    return _lte.time_of_arrival(iq, sample_rate_hz, detection)


def pss(n_id_2: int) -> npt.NDArray[np.complex64]:
    """Primary synchronisation signal (TS 36.211 6.11.1.1).

    Parameters
    ----------
    n_id_2 : int
        Identity within the group: 0, 1 or 2 (``cell_id % 3``).

    Returns
    -------
    ndarray, shape (62,), complex64
        Unit modulus, lowest subcarrier first, without the empty one at the carrier.
    """
    return _lte.pss(n_id_2)


def sss(cell_id: int, subframe: int) -> npt.NDArray[np.float32]:
    """Secondary synchronisation signal (TS 36.211 6.11.2.1).

    Parameters
    ----------
    cell_id : int
        0 ... 503.
    subframe : int
        0 or 5.

    Returns
    -------
    ndarray, shape (62,), float32
        -1 or +1, lowest subcarrier first.
    """
    return _lte.sss(cell_id, subframe)


def crs(
    cell_id: int,
    slot: int,
    symbol: int,
    *,
    port: int = 0,
    n_rb: int,
    cp: CyclicPrefix = CyclicPrefix.NORMAL,
) -> tuple[npt.NDArray[np.complex64], npt.NDArray[np.int64]]:
    """Cell-specific reference signals of one symbol (TS 36.211 6.10.1).

    Parameters
    ----------
    cell_id : int
        0 ... 503.
    slot : int
        0 ... 19.
    symbol : int
        Of the slot. Ports 0 and 1: 0 and the third from last; ports 2 and 3: 1.
    port : int
        0 ... 3.
    n_rb : int
        Bandwidth in resource blocks.
    cp : CyclicPrefix

    Returns
    -------
    values : ndarray, shape (2 * n_rb,), complex64
        Unit modulus.
    subcarriers : ndarray, shape (2 * n_rb,), int64
        0-based from the lower band edge; the empty one at the carrier is not counted.

    Raises
    ------
    ValueError
        For an argument out of range, or a symbol without reference signals of that port.
    """
    return _lte.crs(cell_id, slot, symbol, port=port, n_rb=n_rb, cp=cp)


def arrival_at(toa: TimeOfArrival, time_s: float = 0.0) -> tuple[float, float]:
    """Refer the times of arrival of a capture's frames to one instant.

    A receiver's clock that runs fast or slow makes ``toa_s`` drift over the capture (1 ppm: 1 µs, or 300 m, per
    second). A straight line through all frames, weighted by their deviations, takes that out.

    Parameters
    ----------
    toa : TimeOfArrival
    time_s : float
        Instant in the capture, from its first sample.

    Returns
    -------
    toa_s, sigma_s : float
        The line's value at `time_s`, 0 ... 10 ms, and its standard deviation. That one grows when the frames scatter
        about the line by more than their own deviations say. In multipath the frames share the error of the first
        path's place, which no averaging reduces: the part of their deviations that their scatter does not show is kept.
    """
    variances = np.square(toa.sigma_s)
    if len(toa) == 1:
        return float(toa.toa_s[0] % _FRAME_S), float(toa.sigma_s[0])
    steps = np.diff(toa.toa_s)
    delays = np.concatenate([[0.0], np.cumsum(steps - _FRAME_S * np.rint(steps / _FRAME_S))])  # no jumps at 10 ms
    times = toa.toa_s[0] + delays + _FRAME_S * toa.frame_index
    weights = 1.0 / variances
    total = weights.sum()
    mean_time, mean_delay = weights @ times / total, weights @ delays / total
    spread = weights @ np.square(times - mean_time)
    slope = weights @ ((times - mean_time) * (delays - mean_delay)) / spread
    value = toa.toa_s[0] + mean_delay + slope * (time_s - mean_time)
    # Of the line's value, for frames of unit weight ...
    variance = 1.0 / total + (time_s - mean_time) ** 2 / spread
    if len(toa) > 2:
        # ... and for frames that scatter as these do.
        residuals = delays - mean_delay - slope * (times - mean_time)
        scatter = weights @ np.square(residuals) / (len(toa) - 2)
        variance *= max(1.0, scatter)
    else:
        scatter = 0.0
    if len(toa.paths) > 1:
        variance += max(0.0, 1.0 - scatter) * variances.mean()
    return float(value % _FRAME_S), float(np.sqrt(variance))


def synthesize(
    cells: CellParameters | Sequence[CellParameters],
    sample_rate_hz: float,
    n_samples: int,
    *,
    snr_db: float | None = None,
    noise_variance: float = 0.0,
    seed: int = 0,
) -> npt.NDArray[np.complex64]:
    """Make a capture of one or several eNodeBs: PSS, SSS, CRS, PBCH with its MIB, random data elsewhere.

    Frames run from the infinite past to the infinite future; the capture begins at time 0, wherever in a frame that is.
    Delays of any fraction of a sample are exact. The scale: a resource element at 0 dB has magnitude 1 after a unitary
    transform, so the variance of a noise sample is that of a resource element.

    Parameters
    ----------
    cells : CellParameters or sequence of them
    sample_rate_hz : float
        1.4e6 ... 100e6, any number. A wider band is cut to what the rate holds.
    n_samples : int
    snr_db : float, optional
        Adds noise: per reference element of a cell at 0 dB and unit gain.
    noise_variance : float
        Adds noise of this variance per sample; instead of `snr_db`.
    seed : int
        Of data and noise: the same seed gives the same samples.

    Returns
    -------
    ndarray, shape (n_samples,), complex64

    Raises
    ------
    ValueError
        For a parameter out of range, by name.

    Examples
    --------
    >>> cell = CellParameters(cell_id=301, n_rb=50, n_ports=2, delay_s=2.5e-3)
    >>> iq = synthesize(cell, 15.36e6, 307_200, snr_db=10.0)
    >>> [found.cell_id for found in search(iq, 15.36e6)]
    [301]
    """
    if snr_db is not None:
        if noise_variance:
            raise ValueError("noise_variance: snr_db is given too; one of them sets the noise")
        noise_variance = _lte.noise_variance_for_snr(snr_db)
    if n_samples < 0:
        raise ValueError(f"n_samples: {n_samples} is below zero")
    several = [cells] if isinstance(cells, CellParameters) else list(cells)
    return _lte.synthesize(several, sample_rate_hz, n_samples, noise_variance=noise_variance, seed=seed)


def noise_variance_for_snr(snr_db: float, *, power_db: float = 0.0) -> float:
    """Noise variance per sample that gives a reference element of unit gain `snr_db`.

    Parameters
    ----------
    snr_db : float
    power_db : float
        Of the cell.
    """
    return _lte.noise_variance_for_snr(snr_db, power_db=power_db)


def resource_grid(cell: CellParameters, sfn: int, subframe: int, *, seed: int = 0) -> npt.NDArray[np.complex64]:
    """Resource elements of one subframe as sent.

    Parameters
    ----------
    cell : CellParameters
    sfn : int
        0 ... 1023.
    subframe : int
        0 ... 9.
    seed : int
        Of the random data.

    Returns
    -------
    ndarray, shape (n_ports, 14 or 12, 12 * n_rb), complex64
        Ports, symbols, subcarriers from the lowest frequency on.
    """
    return _lte.resource_grid(cell, sfn, subframe, seed=seed)
