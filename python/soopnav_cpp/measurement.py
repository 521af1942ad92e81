"""Measurement models: what a sensor should read, given a state.

Each function makes a `Measurement` that filters take: ``ekf.update(measurement.Range([100.0, 0.0]), z_m, R_m2)``.
Positions have two components (a plane) or three (any Cartesian frame; azimuths then count from the second axis, north,
towards the first, east). A model reads only what it names, so one serves every state that has it. Where an argument
says "None: the state's", the number is estimated by the filter instead of being known.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core.measurement import Measurement

__all__ = [
    "Azimuth",
    "AzimuthElevation",
    "CarrierPhase",
    "Doppler",
    "Elevation",
    "Fdoa",
    "Measurement",
    "PlanarIncrement",
    "Position",
    "Pseudorange",
    "Range",
    "RangeDifference",
    "RangeRate",
    "ReceivedPower",
    "Tdoa",
]


def _make(kind: str, /, **parameters: npt.ArrayLike | None) -> Measurement:
    """A model of numbers; those that are None are left to the state, or to their default."""
    flat = []
    for name, value in parameters.items():
        if value is None:
            continue
        try:
            numbers = np.asarray(value, np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"{name}: expected numbers, got {value!r}") from None
        if numbers.ndim > 1:
            raise ValueError(f"{name}: expected a number or shape (n,), got shape {numbers.shape}")
        flat.append((name, numbers.ravel().tolist()))
    return Measurement(kind, flat)


def Position(dim: int) -> Measurement:
    """The position itself, as another receiver found it.

    Parameters
    ----------
    dim : int
        Components, 1 to 3; as many rows [m].
    """
    return _make("Position", dim=dim)


def Range(source_m: npt.ArrayLike) -> Measurement:
    """Distance to a source, ``|p - q|`` [m].

    Parameters
    ----------
    source_m : array_like, shape (2,) or (3,)
    """
    return _make("Range", source_m=source_m)


def RangeDifference(source_m: npt.ArrayLike, reference_m: npt.ArrayLike) -> Measurement:
    """How much farther the receiver is from a source than a reference point is, ``|p - q| - |r - q|`` [m].

    Parameters
    ----------
    source_m, reference_m : array_like, shape (2,) or (3,)
    """
    return _make("RangeDifference", source_m=source_m, reference_m=reference_m)


def Pseudorange(source_m: npt.ArrayLike, *, source_clock_m: float = 0.0) -> Measurement:
    """Time of arrival on the receiver's clock, times the speed of light: ``|p - q| + b - b_q`` [m].

    Parameters
    ----------
    source_m : array_like, shape (2,) or (3,)
    source_clock_m : float
        b_q, speed of light times the source's clock bias; a source that is late has a negative one.
    """
    return _make("Pseudorange", source_m=source_m, source_clock_m=source_clock_m)


def Tdoa(
    source_m: npt.ArrayLike,
    reference_m: npt.ArrayLike,
    *,
    receiver_clock_m: float | None = 0.0,
    reference_clock_m: float = 0.0,
) -> Measurement:
    """Time difference of arrival at receiver and reference, times the speed of light.

    ``|p - q| + b - (|r - q| + b_r)`` [m], receiver minus reference.

    Parameters
    ----------
    source_m, reference_m : array_like, shape (2,) or (3,)
    receiver_clock_m : float, optional
        b. None: the state's clock bias.
    reference_clock_m : float
        b_r.
    """
    return _make(
        "Tdoa",
        source_m=source_m,
        reference_m=reference_m,
        receiver_clock_m=receiver_clock_m,
        reference_clock_m=reference_clock_m,
    )


def RangeRate(
    source_m: npt.ArrayLike,
    *,
    source_velocity_mps: npt.ArrayLike | None = None,
    source_drift_mps: float = 0.0,
    receiver_drift_mps: float | None = None,
) -> Measurement:
    """Rate of a pseudorange, positive when receding: ``u . (v - v_q) + d - d_q`` [m/s].

    Parameters
    ----------
    source_m : array_like, shape (2,) or (3,)
    source_velocity_mps : array_like, optional
        As many numbers as the source's position; zero without.
    source_drift_mps : float
        d_q, speed of light times the clock's rate.
    receiver_drift_mps : float, optional
        d. None: the state's clock drift; 0.0 where clocks do not matter.
    """
    return _make(
        "RangeRate",
        source_m=source_m,
        source_velocity_mps=source_velocity_mps,
        source_drift_mps=source_drift_mps,
        receiver_drift_mps=receiver_drift_mps,
    )


def Doppler(
    source_m: npt.ArrayLike,
    carrier_hz: float,
    *,
    source_velocity_mps: npt.ArrayLike | None = None,
    source_drift_mps: float = 0.0,
    receiver_drift_mps: float | None = None,
) -> Measurement:
    """Doppler shift, negative when receding: minus `RangeRate` times ``carrier_hz / c`` [Hz].

    Parameters
    ----------
    source_m : array_like, shape (2,) or (3,)
    carrier_hz : float
        Positive.
    source_velocity_mps, source_drift_mps, receiver_drift_mps
        As for `RangeRate`.
    """
    return _make(
        "Doppler",
        carrier_hz=carrier_hz,
        source_m=source_m,
        source_velocity_mps=source_velocity_mps,
        source_drift_mps=source_drift_mps,
        receiver_drift_mps=receiver_drift_mps,
    )


def Fdoa(
    source_m: npt.ArrayLike,
    reference_m: npt.ArrayLike,
    carrier_hz: float,
    *,
    source_velocity_mps: npt.ArrayLike | None = None,
    reference_velocity_mps: npt.ArrayLike | None = None,
    receiver_drift_mps: float | None = 0.0,
    reference_drift_mps: float = 0.0,
) -> Measurement:
    """Frequency difference of arrival: the Doppler shift at the receiver less that at the reference [Hz].

    Parameters
    ----------
    source_m, reference_m : array_like, shape (2,) or (3,)
    carrier_hz : float
        Positive.
    source_velocity_mps, reference_velocity_mps : array_like, optional
        As many numbers; zero without.
    receiver_drift_mps : float, optional
        Of the receiver's clock. None: the state's.
    reference_drift_mps : float
    """
    return _make(
        "Fdoa",
        carrier_hz=carrier_hz,
        source_m=source_m,
        source_velocity_mps=source_velocity_mps,
        reference_m=reference_m,
        reference_velocity_mps=reference_velocity_mps,
        receiver_drift_mps=receiver_drift_mps,
        reference_drift_mps=reference_drift_mps,
    )


def Azimuth(source_m: npt.ArrayLike, *, heading_rad: float | None = 0.0) -> Measurement:
    """Horizontal direction to a source [rad], less the receiver's heading; residuals go the short way round.

    In a plane from the first axis towards the second; in three dimensions from the second (north) towards the first
    (east).

    Parameters
    ----------
    source_m : array_like, shape (2,) or (3,)
    heading_rad : float, optional
        None: the state's heading (in a plane).
    """
    return _make("Azimuth", source_m=source_m, heading_rad=heading_rad)


def Elevation(source_m: npt.ArrayLike) -> Measurement:
    """Angle of a source above the receiver's horizontal plane [rad]; the third axis points up.

    Parameters
    ----------
    source_m : array_like, shape (3,)
    """
    return _make("Elevation", source_m=source_m)


def AzimuthElevation(source_m: npt.ArrayLike, *, heading_rad: float = 0.0) -> Measurement:
    """`Azimuth` and `Elevation` of one source: two rows [rad].

    Parameters
    ----------
    source_m : array_like, shape (3,)
    heading_rad : float
        Counted as the azimuth is.
    """
    return _make("AzimuthElevation", source_m=source_m, heading_rad=heading_rad)


def ReceivedPower(
    source_m: npt.ArrayLike, power_dbm: float, *, exponent: float = 2.0, reference_distance_m: float = 1.0
) -> Measurement:
    """Signal strength that falls with the logarithm of distance: ``P0 - 10 n log10(|p - q| / d0)`` [dBm].

    Parameters
    ----------
    source_m : array_like, shape (2,) or (3,)
    power_dbm : float
        P0, received at d0.
    exponent : float
        n; 2 in free space.
    reference_distance_m : float
        d0, positive.
    """
    return _make(
        "ReceivedPower",
        source_m=source_m,
        power_dbm=power_dbm,
        exponent=exponent,
        reference_distance_m=reference_distance_m,
    )


def CarrierPhase(
    source_m: npt.ArrayLike, wavelength_m: float, *, ambiguity_cycles: float = 0.0, source_clock_m: float = 0.0
) -> Measurement:
    """Accumulated phase of a carrier, which grows with range: ``(|p - q| + b - b_q) / wavelength + N`` [cycles].

    Parameters
    ----------
    source_m : array_like, shape (2,) or (3,)
    wavelength_m : float
        Positive.
    ambiguity_cycles : float
        N.
    source_clock_m : float
        b_q, as for `Pseudorange`.
    """
    return _make(
        "CarrierPhase",
        source_m=source_m,
        wavelength_m=wavelength_m,
        ambiguity_cycles=ambiguity_cycles,
        source_clock_m=source_clock_m,
    )


def PlanarIncrement(previous_position_m: npt.ArrayLike, previous_heading_rad: float) -> Measurement:
    """Displacement and turn since a known pose, in its axes: three rows [m, m, rad].

    Parameters
    ----------
    previous_position_m : array_like, shape (2,)
    previous_heading_rad : float
    """
    return _make("PlanarIncrement", previous_position_m=previous_position_m, previous_heading_rad=previous_heading_rad)
