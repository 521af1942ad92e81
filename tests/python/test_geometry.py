"""WGS 84 and local frames through the bindings, against an independent program's points."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from soopnav_cpp import geometry

VECTORS = Path(__file__).resolve().parents[2] / ".." / "shared" / "vectors" / "nav" / "wgs84.npz"


@pytest.fixture(scope="module")
def points() -> dict[str, np.ndarray]:
    if not VECTORS.is_file():
        pytest.skip("the reference vectors ../shared/vectors/nav/wgs84.npz are not here")
    with np.load(VECTORS) as archive:
        return {name: archive[name] for name in archive.files}


def wrapped(angle_rad: np.ndarray) -> np.ndarray:
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


def as_radians(points: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.deg2rad(points["lat_deg"]), np.deg2rad(points["lon_deg"]), points["h_m"]


@pytest.mark.crosscheck
def test_geodetic_to_ecef_equals_the_reference(points: dict[str, np.ndarray]) -> None:
    p_e = geometry.geodetic_to_ecef(*as_radians(points))
    assert p_e.shape == points["ecef_m"].shape
    size = np.linalg.norm(points["ecef_m"], axis=1)
    error = np.linalg.norm(p_e - points["ecef_m"], axis=1)
    assert np.all(error < 1e-9 + 4e-16 * size)


@pytest.mark.crosscheck
def test_ecef_to_geodetic_equals_the_reference(points: dict[str, np.ndarray]) -> None:
    latitude, longitude, height = as_radians(points)
    got_latitude, got_longitude, got_height = geometry.ecef_to_geodetic(points["ecef_m"])
    size = np.linalg.norm(points["ecef_m"], axis=1)
    assert np.all(np.abs(got_latitude - latitude) < 1e-15)
    assert np.all(np.abs(got_height - height) < 2e-9 + 4e-16 * size)
    off_axis = np.abs(points["lat_deg"]) < 90.0
    assert np.all(np.abs(wrapped(got_longitude - longitude))[off_axis] < 2e-15)


@pytest.mark.crosscheck
def test_enu_and_directions_equal_the_reference(points: dict[str, np.ndarray]) -> None:
    latitude_deg, longitude_deg, height = points["ref_llh"]
    frame = geometry.LocalFrame(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), height)
    enu = frame.position_from_ecef(points["ecef_m"])
    assert np.max(np.abs(enu - points["enu_m"])) < 2e-8
    azimuth, elevation, distance = frame.direction_to(points["ecef_m"])
    reference = points["azelrange"]
    assert np.max(np.abs(wrapped(azimuth - np.deg2rad(reference[:, 0])))) < 1e-13
    assert np.max(np.abs(elevation - np.deg2rad(reference[:, 1]))) < 1e-13
    assert np.max(np.abs(distance - reference[:, 2])) < 2e-8


@pytest.mark.law
@pytest.mark.parametrize("height_m", [-10e3, 0.0, 1e4, 2e7, 1e8])
def test_round_trip(height_m: float) -> None:
    generator = np.random.default_rng(7)
    latitude = np.arcsin(generator.uniform(-1.0, 1.0, 5000))
    longitude = generator.uniform(-np.pi, np.pi, 5000)
    p_e = geometry.geodetic_to_ecef(latitude, longitude, height_m)
    again = geometry.geodetic_to_ecef(*geometry.ecef_to_geodetic(p_e))
    error = np.linalg.norm(again - p_e, axis=1)
    assert np.all(error < 1e-9 + 7e-16 * np.linalg.norm(p_e, axis=1))


@pytest.mark.unit
def test_a_place_without_coordinates_is_nan() -> None:
    latitude, longitude, height = geometry.ecef_to_geodetic(np.array([[0.0, 0.0, 0.0], [7e6, np.nan, 0.0]]))
    assert np.all(np.isnan([latitude, longitude, height]))


@pytest.mark.unit
def test_one_point_is_three_numbers() -> None:
    p_e = geometry.geodetic_to_ecef(0.0, 0.0, 10.0)
    assert p_e.shape == (3,)
    assert np.allclose(p_e, [6378147.0, 0.0, 0.0], rtol=0.0, atol=1e-9)
    latitude, longitude, height = geometry.ecef_to_geodetic(p_e)
    assert (latitude, longitude) == (0.0, 0.0)
    assert height == pytest.approx(10.0, abs=2e-9)


@pytest.mark.unit
def test_a_local_frame_goes_to_another_process() -> None:
    frame = geometry.LocalFrame(0.5, -1.2, 30.0, axes=geometry.LocalAxes.NED)
    again = pickle.loads(pickle.dumps(frame))
    assert again.axes is geometry.LocalAxes.NED
    np.testing.assert_array_equal(again.position_to_ecef([1.0, 2.0, 3.0]), frame.position_to_ecef([1.0, 2.0, 3.0]))
