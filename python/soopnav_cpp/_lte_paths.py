"""Closely spaced paths and snapshots of several cells; public as `soopnav_cpp.lte`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import lte as _lte
from soopnav_cpp._core.lte import Detection, ResolvedPaths, ResolveStatus, Snapshot

__all__ = ["PathResolver", "ResolveStatus", "ResolvedPaths", "Snapshot", "SnapshotRanger", "resolve_paths"]

Complex = npt.NDArray[np.complex64]
Array = npt.NDArray[np.float64]
Order = Literal["mdl", "aic"] | int
Subspace = Literal["esprit", "matrix_pencil"]
Window = Literal["rectangular", "hann"]

_ORDERS = {"mdl": _lte.OrderRule.MDL, "aic": _lte.OrderRule.AIC}
_SUBSPACES = {"esprit": _lte.SubspaceMethod.ESPRIT, "matrix_pencil": _lte.SubspaceMethod.MATRIX_PENCIL}
_WINDOWS = {"rectangular": _lte.PeakWindow.RECTANGULAR, "hann": _lte.PeakWindow.HANN}


def _options(
    order: Order,
    max_paths: int,
    subspace: str,
    window_s: float,
    min_separation: float,
    earliest_db: float,
    peak_threshold: float,
    peak_window: str,
    polish: bool,
    ignore_gap: bool,
) -> _lte.ResolverOptions:
    for name, value, known in (("subspace", subspace, _SUBSPACES), ("peak_window", peak_window, _WINDOWS)):
        if value not in known:
            raise ValueError(f"{name} = {value!r}: one of {', '.join(known)} expected")
    if isinstance(order, str):
        if order not in _ORDERS:
            raise ValueError(f"order = {order!r}: mdl, aic or a number of paths expected")
        rule = _ORDERS[order]
    else:
        rule, max_paths = _lte.OrderRule.FIXED, order
    return _lte.ResolverOptions(
        order=rule,
        max_paths=max_paths,
        subspace=_SUBSPACES[subspace],
        window_s=window_s,
        min_separation=min_separation,
        earliest_db=earliest_db,
        peak_threshold=peak_threshold,
        peak_window=_WINDOWS[peak_window],
        polish=polish,
        ignore_gap=ignore_gap,
    )


class PathResolver:
    """Tells paths apart that the bandwidth alone does not (C++ ``lte::PathResolver``).

    ``y_p(f) = sum_l a_pl exp(-2πj f τ_l) + noise``: delays common to the ports, amplitudes and phases free per path and
    port. A subspace of windows that slide in both halves of the comb at once (its gap at the carrier is exact) starts
    the fits, their order is the minimum description length's, and the delays are maximum likelihood with the amplitudes
    projected out (cpp/doc/lte_super_resolution.md).

    Parameters
    ----------
    order : "mdl", "aic" or int
        How many paths: by minimum description length, by Akaike's criterion, or so many; never more than can be told
        apart.
    max_paths : int
        At most, 1 ... 6.
    subspace : "esprit" or "matrix_pencil"
    window_s : float
        Paths are looked for so far before and after the strongest, 1e-7 ... 1e-5.
    min_separation : float
        Of a resolution cell; closer paths are one, 0.02 ... 1.
    earliest_db : float
        A first path weaker than this beside the strongest does not count as the first.
    peak_threshold : float
        Of the first-peak rule, over the largest magnitude, 0.05 ... 1.
    peak_window : "rectangular" or "hann"
    polish : bool
        False leaves the subspace's own delays.
    ignore_gap : bool
        The subspace takes the comb for uniform across the carrier, which biases it; to compare.

    Raises
    ------
    ValueError
        For an option out of range, by name.
    """

    def __init__(
        self,
        *,
        order: Order = "mdl",
        max_paths: int = 4,
        subspace: Subspace = "esprit",
        window_s: float = 2e-6,
        min_separation: float = 0.1,
        earliest_db: float = -20.0,
        peak_threshold: float = 0.35,
        peak_window: Window = "rectangular",
        polish: bool = True,
        ignore_gap: bool = False,
    ) -> None:
        self._resolver = _lte.PathResolver(
            _options(
                order,
                max_paths,
                subspace,
                window_s,
                min_separation,
                earliest_db,
                peak_threshold,
                peak_window,
                polish,
                ignore_gap,
            )
        )

    def resolve(self, channel: Complex, frequencies: npt.ArrayLike, noise_variance: float = 0.0) -> ResolvedPaths:
        """Resolve one channel.

        Parameters
        ----------
        channel : ndarray, shape (elements,) or (ports, elements), complex64
        frequencies : array_like, shape (elements,)
            In units of 15 kHz from the carrier; equal steps in each half, as many elements below the carrier as above.
        noise_variance : float
            Of one value; 0 when it is not known.

        Returns
        -------
        ResolvedPaths
            Delays count from the instant that the channel's phases refer to.

        Raises
        ------
        CellLostError
            When no path stands out of the noise.
        ValueError
            For a comb that is none, frequencies that are not whole, values that are not finite, a negative
            `noise_variance`, another dtype.
        """
        return self._resolver.resolve(np.ravel(channel), frequencies, noise_variance)

    def music(self, delays_s: npt.ArrayLike, *, order: int = 0) -> Array:
        """MUSIC pseudo-spectrum of the last channel at `delays_s`, with `order` signal vectors (0: as resolved).

        It repeats every `music_period_s`.
        """
        return self._resolver.music(delays_s, order=order)

    @property
    def music_period_s(self) -> float:
        """Delays of `music` repeat after this."""
        return self._resolver.music_period_s

    def impulse_response(self, delays_s: npt.ArrayLike) -> Array:
        """Magnitude of the last channel over delay, rectangular window; 1 for a lone path of unit gain."""
        return self._resolver.impulse_response(delays_s)


def resolve_paths(
    iq: Complex,
    sample_rate_hz: float,
    detection: Detection,
    *,
    subframe: int = 0,
    subframes: int = 1,
    start_s: float | None = None,
    cfo_hz: float | None = None,
    order: Order = "mdl",
    max_paths: int = 4,
    subspace: Subspace = "esprit",
    window_s: float = 2e-6,
    min_separation: float = 0.1,
    earliest_db: float = -20.0,
    peak_threshold: float = 0.35,
    peak_window: Window = "rectangular",
    polish: bool = True,
    ignore_gap: bool = False,
) -> ResolvedPaths:
    """Paths of one cell from the reference signals of one subframe, or of several averaged.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
        Holds the subframes wholly. Not copied; the GIL is released.
    sample_rate_hz : float
        A multiple of 1.92e6, at most 100e6.
    detection : Detection
        Identity, cyclic prefix, duplex mode, bandwidth, ports; from `search` or made by hand.
    subframe, subframes : int
        First subframe of the frame, 0 ... 9, and how many from there on are averaged, phases aligned.
    start_s : float, optional
        Where `subframe` begins, within 2 µs, from the samples' first one; otherwise by ``detection.frame_start_s``.
    cfo_hz : float, optional
        Carrier offset within 1 kHz; otherwise the detection's.
    order, max_paths, subspace, window_s, min_separation, earliest_db, peak_threshold, peak_window, polish, ignore_gap
        As `PathResolver`.

    Returns
    -------
    ResolvedPaths
        ``toa_s``: start of `subframe` by the first path, from the samples' first one, with ``toa_sigma_s``; all paths
        in ``delays_s``, ``sigmas_s``, ``powers_db``, ``gains``; ``first_peak_s`` by the early-peak rule.

    Raises
    ------
    CellLostError
        When no path stands out of the noise.
    ValueError
        For samples that do not hold the subframes or are not finite, and options out of range.
    """
    resolver = _lte.SubframePathResolver(
        sample_rate_hz,
        detection,
        _options(
            order,
            max_paths,
            subspace,
            window_s,
            min_separation,
            earliest_db,
            peak_threshold,
            peak_window,
            polish,
            ignore_gap,
        ),
    )
    return resolver.resolve(
        iq,
        subframe=subframe,
        subframes=subframes,
        start_s=detection.frame_start_s + 1e-3 * subframe if start_s is None else start_s,
        cfo_hz=detection.cfo_hz if cfo_hz is None else cfo_hz,
    )


class SnapshotRanger:
    """Ranges to several known cells from a millisecond of samples that hold all of them (C++ ``lte::SnapshotRanger``).

    For receivers that look now and then and keep their own time line. Strongest first, each cell's paths are resolved
    and its reference signals taken out of the samples before the next; a further pass resolves each among the others'
    remains. Data of other cells stays and is noise. Six cells take about 6 ms at
    50 resource blocks, 13 ms at 100.

    Parameters
    ----------
    sample_rate_hz : float
        A multiple of 1.92e6, at most 100e6.
    cells : sequence of Detection
        Identity, cyclic prefix, duplex mode, bandwidth, ports.
    subframes : int
        Averaged, 1 ... 10; `range` needs samples that hold them (and up to a millisecond more, where none begins at
        the first sample).
    passes : int
        Over all cells, 1 ... 4.
    cancel : bool
        False ranges every cell in what was received.
    search_window_s : float
        Arrivals are believed so far from the guess, 1e-7 ... 1e-5.
    order, max_paths, window_s, min_separation, earliest_db, peak_threshold, peak_window
        As `PathResolver`.

    Raises
    ------
    ValueError
        For a cell that cannot be or an option out of range, by name.
    """

    def __init__(
        self,
        sample_rate_hz: float,
        cells: Sequence[Detection],
        *,
        subframes: int = 1,
        passes: int = 2,
        cancel: bool = True,
        search_window_s: float = 2e-6,
        order: Order = "mdl",
        max_paths: int = 3,
        window_s: float = 2e-6,
        min_separation: float = 0.1,
        earliest_db: float = -20.0,
        peak_threshold: float = 0.35,
        peak_window: Window = "rectangular",
    ) -> None:
        self.cells = list(cells)
        self._ranger = _lte.SnapshotRanger(
            sample_rate_hz,
            self.cells,
            subframes=subframes,
            passes=passes,
            cancel=cancel,
            search_window_s=search_window_s,
            options=_options(
                order,
                max_paths,
                "esprit",
                window_s,
                min_separation,
                earliest_db,
                peak_threshold,
                peak_window,
                True,
                False,
            ),
        )

    def range(self, iq: Complex, frame_start_s: npt.ArrayLike, cfo_hz: npt.ArrayLike = 0.0) -> Snapshot:
        """Range every cell.

        Parameters
        ----------
        iq : ndarray, shape (n,), complex64
            Not copied; the GIL is released.
        frame_start_s : array_like, shape (cells,)
            Guess of a frame start of each cell, from the samples' first one; any whole number of frames off, so also
            long before them.
        cfo_hz : float or array_like, shape (cells,)
            Guess of each carrier offset, within 1 kHz.

        Returns
        -------
        Snapshot
            Columns ``status`` (0 is good), ``toa_s`` (that frame start, by the first path), ``sigma_s``,
            ``undetected_s`` (what a path too weak to be told apart could add to it), ``first_peak_s``, ``excess_s``,
            ``paths``, ``snr_db``, ``residual_cfo_hz``.
        """
        offsets = np.asarray(cfo_hz, dtype=np.float64)
        if offsets.shape not in ((), (1,), (len(self.cells),)):
            raise ValueError(f"cfo_hz: shape {offsets.shape}; one number, or {len(self.cells)}, one per cell, expected")
        offsets = np.broadcast_to(offsets, (len(self.cells),))
        return self._ranger.range(iq, np.asarray(frame_start_s, dtype=np.float64), np.ascontiguousarray(offsets))
