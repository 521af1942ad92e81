"""The world of pesyna's demonstration: one oscillator, six satellites, two basestations, three stages (section V).

The receiver stands at a known place, so that its clock and the sources' are all there is to estimate: a reduced, linear
form of the estimator, equal to the full one up to constants and a straight line, which detrending removes (shown with
the full navigator of `pesyna_full` by pesyna-9 and pesyna-10). All phases are in L1 cycles or in seconds, whatever
their carrier.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp.clock import Characterization, ClockEstimates, TwoState, characterize, estimate_clocks

__all__ = [
    "CDMA_DBHZ",
    "DT_S",
    "EPOCHS",
    "GPS_DBHZ",
    "L1_HZ",
    "OTHER",
    "RECEIVERS",
    "SATELLITES",
    "STEADY",
    "Receiver",
    "Record",
    "aided_clock_error",
    "characterize_sources",
    "detrended",
    "phase_sigma_cycles",
    "phase_sigma_s",
    "record",
    "stage_1",
    "stage_2",
    "stage_3",
    "unaided_clock_error",
]

Array = npt.NDArray[np.float64]
Receiver = Literal["tcxo", "ocxo"]
Pair = tuple[TwoState, TwoState]

L1_HZ = 1575.42e6
DT_S = 0.1
EPOCHS = 2400  # 240 s
SATELLITES = 6
GPS_DBHZ = 45.0
CDMA_DBHZ = 55.0
STEADY = TwoState.basestation()  # 3e-25, 3e-27
OTHER = TwoState(1e-23, 1e-25)  # x33 in h
RECEIVERS: dict[Receiver, TwoState] = {"tcxo": TwoState.tcxo(), "ocxo": TwoState.ocxo()}

FROM_SATELLITES = np.array([[1.0]])
FROM_BASESTATIONS = np.array([[1.0, -1.0, 0.0], [1.0, 0.0, -1.0]])
FROM_ALL = np.array([[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [1.0, 0.0, -1.0]])


def phase_sigma_cycles(cn0_dbhz: float, dt_s: float = DT_S) -> float:
    """Thermal noise of a phase averaged over `dt_s` [cycles]: sqrt(1 / (2 C/N0 dt)) / 2π."""
    return math.sqrt(1.0 / (2.0 * 10.0 ** (cn0_dbhz / 10.0) * dt_s)) / (2.0 * math.pi)


def phase_sigma_s(cn0_dbhz: float, dt_s: float = DT_S) -> float:
    """The same in seconds of the L1 carrier."""
    return phase_sigma_cycles(cn0_dbhz, dt_s) / L1_HZ


def detrended(values: npt.ArrayLike) -> Array:
    """A record less its straight line by least squares, taken once over all of it."""
    record: Array = np.array(values, np.float64)
    at = np.linspace(-1.0, 1.0, len(record))
    slope = float(at @ record) / float(at @ at)
    record -= record.mean() + slope * at
    return record


@dataclass(frozen=True)
class Record:
    """Phases of one receiver and the clocks behind them.

    Attributes
    ----------
    dt_s : float
    receiver : TwoState
        Noise of the receiver's clock, which it knows.
    sources : tuple of TwoState
        Noise of the basestations' clocks, which it does not.
    receiver_s : ndarray, shape (n,)
        The receiver's clock error [s].
    sources_s : ndarray, shape (n, 2)
        The basestations'.
    gps_s : ndarray, shape (n,)
        Mean of the satellites' phases, less ranges and ambiguities [s]: the receiver's clock and noise.
    cdma_s : ndarray, shape (n, 2)
        The basestations' phases, less ranges and ambiguities [s].
    satellites_s : ndarray, shape (n, 6)
        Each satellite's phase, less range and ambiguity [s]; `gps_s` is their mean.
    """

    dt_s: float
    receiver: TwoState
    sources: Pair
    receiver_s: Array
    sources_s: Array
    gps_s: Array
    cdma_s: Array
    satellites_s: Array

    @property
    def t_s(self) -> Array:
        """Times of the epochs [s], from 0."""
        return np.arange(len(self.receiver_s), dtype=np.float64) * self.dt_s

    @property
    def gps_sigma_s(self) -> float:
        """Standard deviation of `gps_s`' noise."""
        return phase_sigma_s(GPS_DBHZ, self.dt_s) / math.sqrt(SATELLITES)

    @property
    def cdma_sigma_s(self) -> float:
        """Standard deviation of `cdma_s`' noise."""
        return phase_sigma_s(CDMA_DBHZ, self.dt_s)


def record(
    seed: int,
    receiver: Receiver = "tcxo",
    *,
    n: int = EPOCHS,
    dt_s: float = DT_S,
    sources: Pair = (STEADY, OTHER),
    source_seed: int | None = None,
) -> Record:
    """Phases of one receiver.

    Parameters
    ----------
    seed : int
        Of the receiver's clock and of all noise.
    receiver : {"tcxo", "ocxo"}
        Its clock.
    n : int
    dt_s : float
    sources : pair of TwoState
        Noise of the basestations' clocks.
    source_seed : int, optional
        Of the basestations' clocks; `seed` by default. Two receivers with one see the same basestations at the same
        time.
    """
    clock = RECEIVERS[receiver]
    own = clock.simulate(dt_s, n, seed=seed, stream=0).bias_s
    theirs = np.stack(
        [
            source.simulate(dt_s, n, seed=seed if source_seed is None else source_seed, stream=1 + i).bias_s
            for i, source in enumerate(sources)
        ],
        axis=1,
    )
    rng = np.random.default_rng([seed, 0x7065_7379])
    satellites = own[:, None] + rng.normal(0.0, phase_sigma_s(GPS_DBHZ, dt_s), (n, SATELLITES))
    basestations = own[:, None] - theirs + rng.normal(0.0, phase_sigma_s(CDMA_DBHZ, dt_s), (n, 2))
    return Record(dt_s, clock, sources, own, theirs, satellites.mean(axis=1), basestations, satellites)


def stage_1(found: Record) -> ClockEstimates:
    """The receiver's clock from satellites alone: the "truth" of pesyna (13), column 0."""
    return estimate_clocks(found.gps_s, found.dt_s, found.gps_sigma_s, [found.receiver], mixing=FROM_SATELLITES)


def stage_2(found: Record, sources: Pair) -> ClockEstimates:
    """The receiver's clock (column 0) and the basestations' from all signals, their noise as `sources` says."""
    sigma = [found.gps_sigma_s, found.cdma_sigma_s, found.cdma_sigma_s]
    phase = np.column_stack([found.gps_s, found.cdma_s])
    return estimate_clocks(phase, found.dt_s, sigma, [found.receiver, *sources], mixing=FROM_ALL)


def stage_3(found: Record, sources: Pair) -> ClockEstimates:
    """The receiver's clock (column 0) from basestations alone; right up to a straight line."""
    clocks = [found.receiver, *sources]
    return estimate_clocks(found.cdma_s, found.dt_s, found.cdma_sigma_s, clocks, mixing=FROM_BASESTATIONS)


def characterize_sources(found: Record, *, start: Pair | None = None) -> tuple[Characterization, Characterization]:
    """Stage 2's characterisation of both basestations by innovation likelihood: satellites' clock less each's phase.

    Parameters
    ----------
    found : Record
    start : pair of TwoState, optional
        Where the search for each starts.
    """
    sigma = math.hypot(found.gps_sigma_s, found.cdma_sigma_s)
    first, second = (
        characterize(found.gps_s - found.cdma_s[:, i], found.dt_s, sigma, start=None if start is None else [start[i]])
        for i in range(2)
    )
    return first, second


def aided_clock_error(
    seed: int,
    receiver: Receiver = "tcxo",
    *,
    characterization: Pair | Literal["own", "true"] = "own",
    n: int = EPOCHS,
    dt_s: float = DT_S,
    against: Literal["truth", "stage_1"] = "truth",
    source_seed: int | None = None,
) -> Array:
    """Error of the receiver's clock from basestations alone (pesyna (13), (14)), detrended once [L1 cycles].

    Parameters
    ----------
    seed, receiver, n, dt_s, source_seed
        As `record`.
    characterization : pair of TwoState, "own" or "true"
        Noise of the basestations as stage 3 takes it: given, from this receiver's own stage 2, or the true one.
    against : {"truth", "stage_1"}
        The true clock, or stage 1's estimate of it, as the paper has it.

    Returns
    -------
    ndarray, shape (n,)
        The phase a correlator would be left with: the receiver's clock less its estimate.
    """
    found = record(seed, receiver, n=n, dt_s=dt_s, source_seed=source_seed)
    if characterization == "own":
        own = characterize_sources(found)
        sources = (own[0].clocks[0], own[1].clocks[0])
    elif characterization == "true":
        sources = found.sources
    else:
        sources = characterization
    reference = found.receiver_s if against == "truth" else stage_1(found).bias_s[:, 0]
    return L1_HZ * detrended(reference - stage_3(found, sources).bias_s[:, 0])


def unaided_clock_error(seed: int, receiver: Receiver = "tcxo", *, n: int = EPOCHS, dt_s: float = DT_S) -> Array:
    """The receiver's clock itself, detrended once [L1 cycles], shape (n,): that of `aided_clock_error`'s record."""
    return L1_HZ * detrended(record(seed, receiver, n=n, dt_s=dt_s).receiver_s)
