"""Detection of a signal in white noise: thresholds and probabilities of energy in coherent sums."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import clock as _clock

__all__ = [
    "cell_false_alarm",
    "detection_probability",
    "detection_threshold",
    "false_alarm_probability",
    "marcum_q",
]

_Array = npt.NDArray[np.float64]


def _finite(value: float, text: str) -> float:
    if np.isnan(value):
        raise ValueError(text)
    return value


def marcum_q(m: npt.ArrayLike, a: npt.ArrayLike, b: npt.ArrayLike, *, complement: bool = False) -> _Array:
    """Generalised Marcum Q function Q_m(a, b) = P(X > b²), X non-central chi-square of 2m dof, non-centrality a².

    Right to 1e-11 in relative terms, tails included.

    Parameters
    ----------
    m : int or array_like
        1 … 1e6.
    a, b : float or array_like
        0 … 1e5; they broadcast with each other and with `m`.
    complement : bool
        1 - Q instead, as accurate.

    Returns
    -------
    ndarray
        NaN for arguments outside their range.

    Raises
    ------
    ValueError
        For an order that is no whole number.
    """
    order, x, y = np.broadcast_arrays(np.asarray(m), np.asarray(a, np.float64), np.asarray(b, np.float64))
    if not np.issubdtype(order.dtype, np.integer):
        raise ValueError(f"m: whole numbers expected, got {order.dtype}")
    orders = np.clip(order, 0, 2**31 - 1).ravel().tolist()
    return np.reshape(_clock.marcum_q(orders, x.ravel(), y.ravel(), complement), x.shape)


def false_alarm_probability(sums: int, threshold: float) -> float:
    """Probability that noise leaves T = Σ|y_k|²/σ² of `sums` coherent sums above `threshold`: exp(-t) Σ t^k/k!.

    Parameters
    ----------
    sums : int
        1 … 1e6.
    threshold : float
        Not negative.
    """
    return _finite(
        _clock.false_alarm_probability(sums, threshold),
        f"sums = {sums}, threshold = {threshold}: 1 ... 1e6 sums and a threshold >= 0 expected",
    )


def detection_threshold(sums: int, probability: float) -> float:
    """The threshold on T = Σ|y_k|²/σ² that noise passes with `probability` in one cell.

    Parameters
    ----------
    sums : int
        1 … 1e6.
    probability : float
        In (0, 1]. A search's share for one cell is `cell_false_alarm`.
    """
    return _finite(
        _clock.detection_threshold(sums, probability),
        f"sums = {sums}, probability = {probability}: 1 ... 1e6 sums and a probability in (0, 1] expected",
    )


def detection_probability(sums: int, snr: float, threshold: float) -> float:
    """Probability that a signal lifts its cell above `threshold`: Q_M(√(2S), √(2t)).

    Parameters
    ----------
    sums : int
        1 … 1e6.
    snr : float
        S, the signal's energy over the noise's: SNR after a coherent sum as a ratio, added over the sums.
    threshold : float
    """
    return _finite(
        _clock.detection_probability(sums, snr, threshold),
        f"sums = {sums}, snr = {snr}, threshold = {threshold}: 1 ... 1e6 sums and numbers >= 0 expected",
    )


def cell_false_alarm(total: float, cells: float) -> float:
    """One cell's false alarm for `total` over `cells` of them, 1 - (1 - total)^(1/cells).

    Exact for independent cells; for correlated ones the search's false alarm is at most `total`.

    Parameters
    ----------
    total : float
        In (0, 1).
    cells : float
        At least 1.
    """
    return _finite(
        _clock.cell_false_alarm(total, cells), f"total = {total}, cells = {cells}: (0, 1) and at least 1 expected"
    )
