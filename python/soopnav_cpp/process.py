"""Process models: how a state moves between measurements, and how uncertain that is.

Each function makes a `Process` that filters take: ``ekf.predict(process.NearlyConstantVelocity(0.1), dt_s)``. Power
densities (`psd`) are those of white noise that drives a quantity, so that steps of any length add up; zero by default.
`clock` is for states with a clock bias and drift: the pair of power densities of the bias' random walk [m²/s] and of
the drift's [m²/s³]. `diffusion_psd` is a random walk of every component of the state on top: one number, or one for
each component [unit of the component squared, per second].
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core.process import Process

__all__ = [
    "CoordinatedTurn",
    "NearlyConstantVelocity",
    "PiecewiseConstantAcceleration",
    "PlanarMechanization",
    "PlanarOdometry",
    "Process",
    "RandomWalk",
]


def _make(kind: str, /, **parameters: npt.ArrayLike | None) -> Process:
    flat = []
    for name, value in parameters.items():
        if value is None:
            continue
        try:
            numbers = np.asarray(value, np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"{name}: expected numbers, got {value!r}") from None
        flat.append((name, numbers.ravel().tolist()))
    return Process(kind, flat)


def RandomWalk(psd: npt.ArrayLike) -> Process:
    """Every component wanders by itself; nothing else moves.

    Parameters
    ----------
    psd : float or array_like, shape (n,)
        Not negative [unit of the component squared, per second].
    """
    return _make("RandomWalk", psd=psd)


def NearlyConstantVelocity(
    acceleration_psd: npt.ArrayLike, *, clock: npt.ArrayLike | None = None, diffusion_psd: npt.ArrayLike | None = None
) -> Process:
    """Position and velocity under white acceleration; exact for any step.

    Parameters
    ----------
    acceleration_psd : float or array_like, one for each axis
        Not negative [m²/s³].
    clock : pair of float, optional
        Needed by states with a clock drift.
    diffusion_psd : float or array_like, shape (n,), optional
    """
    return _make("NearlyConstantVelocity", acceleration_psd=acceleration_psd, clock=clock, diffusion_psd=diffusion_psd)


def PiecewiseConstantAcceleration(
    acceleration_sigma_mps2: npt.ArrayLike,
    *,
    clock: npt.ArrayLike | None = None,
    diffusion_psd: npt.ArrayLike | None = None,
) -> Process:
    """Position and velocity under an acceleration that is constant during each step and new in the next.

    Parameters
    ----------
    acceleration_sigma_mps2 : float or array_like, one for each axis
        Not negative. It belongs to the step: two half steps are less noisy than a whole one.
    clock : pair of float, optional
        Needed by states with a clock drift.
    diffusion_psd : float or array_like, shape (n,), optional
    """
    return _make(
        "PiecewiseConstantAcceleration",
        acceleration_sigma_mps2=acceleration_sigma_mps2,
        clock=clock,
        diffusion_psd=diffusion_psd,
    )


def CoordinatedTurn(
    acceleration_psd: float, turn_rate_psd: float, *, diffusion_psd: npt.ArrayLike | None = None
) -> Process:
    """Planar motion along an arc, speed and turn rate nearly constant; for the state "coordinated_turn".

    Parameters
    ----------
    acceleration_psd : float
        Of each axis, not negative [m²/s³].
    turn_rate_psd : float
        Not negative [rad²/s³].
    diffusion_psd : float or array_like, shape (5,), optional
    """
    return _make(
        "CoordinatedTurn",
        acceleration_psd=acceleration_psd,
        turn_rate_psd=turn_rate_psd,
        diffusion_psd=diffusion_psd,
    )


def PlanarMechanization(
    *,
    gyro_sigma_radps: float = 0.0,
    accelerometer_sigma_mps2: float = 0.0,
    integration: Literal["zero_order_hold", "euler"] = "zero_order_hold",
    diffusion_psd: npt.ArrayLike | None = None,
) -> Process:
    """Heading, velocity and position driven by an inertial unit; for the state "planar_inertial".

    Inputs are ``[yaw rate rad/s, specific force along the body's first axis m/s², along its second]``.

    Parameters
    ----------
    gyro_sigma_radps, accelerometer_sigma_mps2 : float
        Of the white errors of each sample, not negative.
    integration : {"zero_order_hold", "euler"}
        Whether the force within a step also moves the position, ``a dt² / 2``.
    diffusion_psd : float or array_like, shape (5,), optional
    """
    if integration not in ("zero_order_hold", "euler"):
        raise ValueError(f"integration: expected 'zero_order_hold' or 'euler', got {integration!r}")
    return _make(
        "PlanarMechanization",
        gyro_sigma_radps=gyro_sigma_radps,
        accelerometer_sigma_mps2=accelerometer_sigma_mps2,
        euler=float(integration == "euler"),
        diffusion_psd=diffusion_psd,
    )


def PlanarOdometry(covariance: npt.ArrayLike, *, diffusion_psd: npt.ArrayLike | None = None) -> Process:
    """Dead reckoning: a pose moved by increments; for states with a planar position and a heading.

    Inputs are ``[forward m, left m, turn rad]`` in the body's axes at the beginning of the step.

    Parameters
    ----------
    covariance : array_like, shape (3, 3)
        Of an increment's errors, whatever the step's duration.
    diffusion_psd : float or array_like, shape (n,), optional
    """
    if np.shape(covariance) != (3, 3):
        raise ValueError(f"covariance: expected shape (3, 3), got {np.shape(covariance)}")
    return _make("PlanarOdometry", covariance=covariance, diffusion_psd=diffusion_psd)
