"""Antenna arrays: where signals come from, how well that is known, and how many there are.

Directions are unit vectors towards the source, ``[cos el cos az, cos el sin az, sin el]`` in array axes: azimuth from
axis 1 towards axis 2, elevation from plane 1-2 towards axis 3. Steering vectors are ``exp(+j 2 pi r . u / lambda)``: an
element nearer to the source is ahead in phase. Functions of a uniform line alone (`root_music`, `esprit`) use the angle
from broadside, phase ``2 pi d sin(theta)``. Radians, and covariances in rad^2.

>>> import numpy as np
>>> import soopnav_cpp as sn
>>> geometry = sn.array.ArrayGeometry.planar(2, 2, 0.2)
>>> finder = sn.array.DirectionFinder(geometry)
>>> a = sn.array.Manifold(geometry).steering(0.5, 0.9)
>>> bearings = finder.estimate_covariance(2.0 * a @ a.conj().T + np.eye(4), 2500)
>>> np.round(bearings.azimuth_rad, 6), np.round(bearings.elevation_rad, 6)
(array([0.5]), array([0.9]))
"""

from __future__ import annotations

from soopnav_cpp._array_finder import (
    AmbiguityWarning,
    BearingRun,
    Bearings,
    DirectionFinder,
    SteeringTable,
    bartlett,
    capon,
    maximum_likelihood,
    music,
    weighted_subspace_fitting,
)
from soopnav_cpp._array_manifold import Manifold, load_array
from soopnav_cpp._array_subspace import (
    FarField,
    covariance,
    crlb,
    eigenvalues,
    esprit,
    far_field,
    forward_backward,
    impedance_factor,
    polarization_factor,
    received_power_dbm,
    root_music,
    source_count,
    spatial_smoothing,
)
from soopnav_cpp._calibration import Calibration, CalibrationError, array_id, calibrate
from soopnav_cpp._core.array import ArrayGeometry, ArrayStatus
from soopnav_cpp._sigma_map import SigmaMap
from soopnav_cpp._synthetic_aperture import (
    ApertureBearings,
    ApertureStatus,
    BearingCheck,
    BlindAperture,
    SyntheticAperture,
    aperture_directions,
    aperture_spectrum,
    check_bearings,
    synthetic_aperture_crlb,
)

__all__ = [
    "AmbiguityWarning",
    "ApertureBearings",
    "ApertureStatus",
    "ArrayGeometry",
    "ArrayStatus",
    "BearingCheck",
    "BearingRun",
    "Bearings",
    "BlindAperture",
    "Calibration",
    "CalibrationError",
    "DirectionFinder",
    "FarField",
    "Manifold",
    "SigmaMap",
    "SteeringTable",
    "SyntheticAperture",
    "aperture_directions",
    "aperture_spectrum",
    "array_id",
    "bartlett",
    "calibrate",
    "capon",
    "check_bearings",
    "covariance",
    "crlb",
    "eigenvalues",
    "esprit",
    "far_field",
    "forward_backward",
    "impedance_factor",
    "load_array",
    "maximum_likelihood",
    "music",
    "polarization_factor",
    "received_power_dbm",
    "root_music",
    "source_count",
    "spatial_smoothing",
    "synthetic_aperture_crlb",
    "weighted_subspace_fitting",
]
