"""A multiplier on the process noise, estimated from innovations."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import KalmanReport
from soopnav_cpp._core.process import Process

__all__ = ["AdaptiveProcessNoise"]


class AdaptiveProcessNoise:
    """A multiplier on the process noise (its covariance), learnt from innovations (cpp/doc/kalman_filter.md, 9).

    Each innovation moves the logarithm of the multiplier along the gradient of its likelihood, divided by the Fisher
    information gathered so far; both are forgotten exponentially. The measurement noise is taken to be right: a wrong
    R is answered by a wrong Q, and where R covers the innovations nothing moves. Step by step::

        kf.predict(noise.scaled(process), dt_s)
        noise.observe(kf.update(model, z, R), R)

    A whole run: ``kf.run(time_s, process, measurements, adaptive_noise=noise)``.

    Parameters
    ----------
    initial : float
        Multiplier at the start, within the bounds.
    lower, upper : float
        Bounds of the multiplier, 0 < lower < upper.
    memory : float
        Updates after which their weight has fallen to 1/e, at least 1.
    prior_information : float
        Weight of `initial` at the start, as Fisher information of the logarithm; positive.

    Raises
    ------
    ValueError
        Naming the option that breaks its rule.
    """

    _core: _estimation.AdaptiveProcessNoise

    def __init__(
        self,
        *,
        initial: float = 1.0,
        lower: float = 1e-4,
        upper: float = 1e4,
        memory: float = 500.0,
        prior_information: float = 5.0,
    ) -> None:
        self._core = _estimation.AdaptiveProcessNoise(
            initial=initial, lower=lower, upper=upper, memory=memory, prior_information=prior_information
        )

    @property
    def multiplier(self) -> float:
        """Factor on the covariance of the process noise."""
        return self._core.multiplier

    @property
    def information(self) -> float:
        """Fisher information about the logarithm of the multiplier in memory."""
        return self._core.information

    def scaled(self, process: Process) -> Process:
        """`process` with the covariance of its noise, clock and diffusion included, times the multiplier."""
        return self._core.scaled(process)

    def observe(self, report: KalmanReport, R: npt.ArrayLike) -> bool:
        """Learn from an innovation.

        Parameters
        ----------
        report : KalmanReport
            Of an update. A gated one counts too: a filter whose noise is far too small gates everything.
        R : number or array_like, shape (m,) or (m, m)
            What the update was given.

        Returns
        -------
        bool
            False, with nothing changed, for a report that is neither accepted nor gated, and for NaN in R.

        Raises
        ------
        ValueError
            For an R whose shape does not fit.
        """
        return self._core.observe(report, R)

    def copy(self) -> AdaptiveProcessNoise:
        """An independent one that goes on alike."""
        other = type(self).__new__(type(self))
        other._core = self._core.clone()
        return other

    def __copy__(self) -> AdaptiveProcessNoise:
        return self.copy()

    def __deepcopy__(self, memo: dict[int, Any]) -> AdaptiveProcessNoise:
        return self.copy()

    def __getstate__(self) -> _estimation.AdaptiveProcessNoise:
        return self._core.clone()

    def __setstate__(self, saved: _estimation.AdaptiveProcessNoise) -> None:
        self._core = saved.clone()

    def __repr__(self) -> str:
        return f"AdaptiveProcessNoise(multiplier {self.multiplier:.4g}, information {self.information:.4g})"
