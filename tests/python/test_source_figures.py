"""Figures of direction finding: they show the numbers that they are given, and refuse what does not fit."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from soopnav_cpp import plotting

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.unit

AZIMUTH = np.radians(np.arange(-180.0, 180.0, 5.0))
ELEVATION = np.radians(np.arange(0.0, 91.0, 5.0))


def test_a_spectrum_is_drawn_in_decibels_below_its_top(tmp_path):
    power = 1.0 + 99.0 * (np.arange(72) == 20)
    figure = plotting.polar_spectrum(AZIMUTH, power, bearings_rad=[AZIMUTH[20]], path=tmp_path / "x.png")
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
    (axes,) = figure.axes
    curve = axes.get_lines()[0].get_ydata()
    assert curve.max() == 0.0
    assert np.sort(curve)[-2] == pytest.approx(-20.0)
    assert len(curve) == 73  # closed
    assert axes.get_lines()[1].get_xdata()[0] == AZIMUTH[20]
    assert "−80.0°" in figure.texts[-1].get_text()


def test_a_spectrum_of_a_line_has_its_mirror_image():
    half = np.radians(np.arange(0.0, 181.0, 5.0))
    (axes,) = plotting.polar_spectrum(half, 1.0 + np.arange(37.0)).axes
    curve, mirror = axes.get_lines()
    np.testing.assert_array_equal(curve.get_xdata(), half)
    np.testing.assert_array_equal(mirror.get_xdata(), -half)
    np.testing.assert_array_equal(mirror.get_ydata(), curve.get_ydata())


def test_a_spectrum_with_elevations_is_a_map_of_the_sky():
    power = np.ones((19, 72))
    power[6, 30] = 10.0
    figure = plotting.polar_spectrum(
        AZIMUTH, power, elevation_rad=ELEVATION, bearings_rad=[[AZIMUTH[30], ELEVATION[6]]]
    )
    mesh = figure.axes[0].collections[0].get_array().reshape(19, 73)
    row, column = np.unravel_index(np.argmax(mesh), mesh.shape)
    assert (row, column) == (6, 30)
    assert mesh.min() == pytest.approx(-10.0)
    assert figure.axes[0].collections[1].get_offsets().data.tolist() == [[AZIMUTH[30], 60.0]]  # from the zenith


def test_spectra_that_do_not_fit():
    with pytest.raises(ValueError, match=r"spectrum: expected shape \(72,\), got \(3,\)"):
        plotting.polar_spectrum(AZIMUTH, np.ones(3))
    with pytest.raises(ValueError, match="spectrum: a largest value above 0 expected"):
        plotting.polar_spectrum(AZIMUTH, np.zeros(72))
    with pytest.raises(ValueError, match="floor_db = 3: less than 0 expected"):
        plotting.polar_spectrum(AZIMUTH, np.ones(72), floor_db=3.0)
    with pytest.raises(ValueError, match=r"bearings_rad: expected shape \(K,\) or \(K, 2\)"):
        plotting.polar_spectrum(AZIMUTH, np.ones(72), bearings_rad=np.zeros((1, 3)))


def test_bearings_over_time_keep_their_signs():
    figure = plotting.bearings_over_time(
        [0.0, 1.0, 2.0], np.radians([170.0, -170.0, np.nan]), elevation_rad=np.radians([1.0, 2.0, np.nan]),
        snr_db=[3.0, 4.0, np.nan], truth_rad=np.radians([171.0, -171.0, -165.0]),
    )  # fmt: skip
    assert [axes.get_ylabel() for axes in figure.axes] == ["azimuth [deg]", "elevation [deg]", "SNR [dB]"]
    np.testing.assert_allclose(figure.axes[0].get_lines()[0].get_ydata()[:2], [170.0, -170.0])
    assert np.isnan(figure.axes[0].get_lines()[1].get_ydata()[1])  # no line across the circle
    with pytest.raises(ValueError, match="azimuth_rad: expected 3 values, got 2"):
        plotting.bearings_over_time([0.0, 1.0, 2.0], [0.0, 1.0])


def test_the_map_has_rays_fixes_and_what_is_small_enlarged():
    places = np.column_stack([np.linspace(-500.0, 500.0, 30), np.full(30, -200.0)])
    bearing = np.arctan2(-places[:, 1], -places[:, 0])
    fix = SimpleNamespace(position_m=np.array([1.0, -2.0]), covariance_m2=np.diag([4.0, 9.0]))
    figure = plotting.bearings_map(
        places, bearing, sigmas_rad=np.where(np.arange(30) < 10, 1.0, 0.02), fixes={"ml": fix}, truth_m=[0.0, 0.0]
    )
    assert len(figure.axes) == 2
    large, near = figure.axes
    rays = np.array(large.collections[0].get_segments())
    assert len(rays) == 20  # bearings of more than 30 degrees are no rays
    np.testing.assert_array_equal(rays[:, 0], places[10:])
    way = rays[:, 1] - rays[:, 0]
    np.testing.assert_allclose(np.arctan2(way[:, 1], way[:, 0]), bearing[10:])
    ring = near.patches[0].get_xy()
    assert np.ptp(ring[:, 1]) / 2.0 == pytest.approx(3.0 * math.sqrt(5.991), rel=1e-3)
    assert np.ptp(ring[:, 0]) / 2.0 == pytest.approx(2.0 * math.sqrt(5.991), rel=1e-3)
    assert "ml" in [text.get_text() for text in large.get_legend().get_texts()]


def test_a_bearing_has_the_colour_of_its_emitter():
    """Also beside an emitter without a position; those of nobody have a colour that no emitter has."""
    places = np.column_stack([np.linspace(-50.0, 50.0, 4), np.zeros(4)])
    fixes = {"a": [0.0, 80.0], "lost": None, "c": [30.0, 90.0]}
    figure = plotting.bearings_map(places, np.full(4, 1.5), fixes=fixes, source=[0, 1, 2, -1])
    to_rgb = pytest.importorskip("matplotlib.colors").to_rgb
    rays = [tuple(colour[:3]) for colour in figure.axes[0].collections[0].get_colors()]
    assert len(set(rays)) == 4
    stars = {line.get_label(): to_rgb(line.get_color()) for line in figure.axes[0].get_lines()}
    assert stars["a"] == pytest.approx(rays[0])
    assert stars["c"] == pytest.approx(rays[2])
    assert max(rays[3]) - min(rays[3]) < 0.1  # grey
    with pytest.raises(ValueError, match="source: expected 4 values, got 1"):
        plotting.bearings_map(places, np.full(4, 1.5), source=[0])


def test_a_map_without_a_fix_has_the_line():
    figure = plotting.bearings_map([[5.0, 5.0]] * 3, [0.1, 0.12, 0.11], line=([5.0, 5.0], 0.11))
    labels = {line.get_label(): line for line in figure.axes[0].get_lines()}
    x, y = labels["the line it is on"].get_xdata(), labels["the line it is on"].get_ydata()
    assert math.atan2(y[1] - y[0], x[1] - x[0]) == pytest.approx(0.11)
    with pytest.raises(ValueError, match="bearings_rad: expected 1 values, got 2"):
        plotting.bearings_map([[5.0, 5.0]], [0.1, 0.2])
    with pytest.raises(ValueError, match=r"positions_m: expected shape \(n, 2\) or \(n, 3\)"):
        plotting.bearings_map([5.0, 5.0], [0.1, 0.2])


def test_a_likelihood_is_drawn_in_sigmas():
    x, y = np.linspace(-4.0, 4.0, 41), np.linspace(-2.0, 2.0, 21)
    surface = -0.5 * (x**2 + (y[:, None] / 0.5) ** 2) + 1234.0
    figure = plotting.likelihood(x, y, surface, fix=SimpleNamespace(position_m=[0.0, 0.0], covariance_m2=np.eye(2)))
    shown = figure.axes[0].collections[0].get_array().reshape(21, 41)
    assert shown[10, 20] == 0.0
    assert shown[10, 25] == pytest.approx(1.0)
    assert shown[15, 20] == pytest.approx(2.0)
    with pytest.raises(ValueError, match=r"log_likelihood: expected shape \(21, 41\)"):
        plotting.likelihood(x, y, surface.T)
    with pytest.raises(ValueError, match="log_likelihood: numbers expected"):
        plotting.likelihood(x, y, np.full((21, 41), np.nan))


def test_particles_say_how_many_count():
    cloud = np.random.default_rng(1).normal(size=(100, 2))
    figure = plotting.particles(cloud, np.where(np.arange(100) < 25, 1.0, 0.0), truth_m=[0.0, 0.0])
    assert figure.axes[0].get_title(loc="left") == "100 particles, effective 25"
    np.testing.assert_array_equal(figure.axes[0].collections[0].get_offsets(), cloud)
    with pytest.raises(ValueError, match="weights: expected 100 values, got 3"):
        plotting.particles(cloud, [1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="weights: finite numbers of 0 or more"):
        plotting.particles(cloud, np.zeros(100))
