"""Positions from one-way Dopplers: drawn skies, the recording of Iridium, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from soopnav_cpp import geometry, orbits
from soopnav_cpp.navigation import DopplerStatus, DopplerUse, doppler_fix

CAPTURE = Path(__file__).parents[2].parent / "shared" / "captures" / "iridium_doppler" / "iridium_doppler.csv"
there = pytest.mark.skipif(not CAPTURE.exists(), reason="the Dopplers in ../shared are not there")
CARRIER_HZ = 1626.270833e6
TRUTH_DEG_M = (47.4, 8.5, 450.0)
TRUTH = geometry.geodetic_to_ecef(np.radians(47.4), np.radians(8.5), 450.0)
Rows = tuple[Any, Any, Any, Any, Any]


@pytest.fixture(scope="module")
def sky() -> Rows:
    """Ten minutes of made-up Iridium over Zurich: exact Dopplers each 10 s above 10 degrees."""
    found = []
    t = np.arange(0.0, 600.0, 10.0)
    for k, orbit in enumerate(orbits.iridium_walker(600.0)):
        up = t[orbits.elevations([orbit], t, TRUTH)[1][0] > np.radians(10.0)]
        p, v = orbit.at(up)
        rate = geometry.signal_path(orbit, up, TRUTH).delay_rate
        found.append(np.column_stack([up, np.full(len(up), k), -CARRIER_HZ * rate, p, v]))
    d = np.concatenate(found)
    return d[:, 0], d[:, 1].astype(int), d[:, 2], d[:, 3:6], d[:, 6:9]


def noisy(sky: Rows, seed: int, *, sigma_hz: float = 5.0, bias_hz: float = 0.0) -> Rows:
    random = np.random.default_rng(seed)
    t, k, doppler, p, v = sky
    biases = bias_hz * random.standard_normal(66)
    return t, k, doppler + 250.0 + biases[k] + sigma_hz * random.standard_normal(len(t)), p, v


@pytest.mark.law
def test_exact_dopplers_give_the_place_and_the_frequency(sky: Rows) -> None:
    t, k, doppler, p, v = sky
    assert len(np.unique(k)) >= 3
    fix = doppler_fix(t, k, doppler + 250.0, p, v, height_m=450.0)
    assert fix.status is DopplerStatus.CONVERGED
    assert np.linalg.norm(fix.error_enu_m(TRUTH)) < 0.1
    assert fix.frequency_bias_hz == pytest.approx(250.0, abs=2e-3)
    assert np.degrees(fix.latitude_rad) == pytest.approx(TRUTH_DEG_M[0], abs=1e-5)
    assert fix.used.all()
    assert np.abs(fix.residuals_hz).max() < 5e-3
    assert not fix.position_e_m.flags.writeable
    assert "converged" in repr(fix)
    # The order of the rows and the names of the satellites do not matter.
    order = np.random.default_rng(1).permutation(len(t))
    again = doppler_fix(t[order], 1000 - k[order], doppler[order] + 250.0, p[order], v[order], height_m=450.0)
    np.testing.assert_allclose(again.position_e_m, fix.position_e_m, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(again.satellites, 1000 - fix.satellites[::-1])


@pytest.mark.law
def test_states_of_the_sending_do_as_well(sky: Rows) -> None:
    t, k, _, _, _ = sky
    walker = orbits.iridium_walker(600.0)
    velocity = np.array([40.0, -25.0, 10.0])
    rows = [geometry.signal_path(walker[one], when, TRUTH, velocity) for when, one in zip(t, k, strict=True)]
    doppler = np.array([-CARRIER_HZ * float(r.delay_rate) for r in rows])
    p, v = np.array([r.source_position_e_m for r in rows]), np.array([r.source_velocity_e_mps for r in rows])
    # The receiver stands still here all the time but has a velocity: Dopplers alone tell nothing else.
    fix = doppler_fix(t, k, doppler, p, v, height_m=450.0, state_of="sending", velocity_e_mps=velocity)
    assert np.linalg.norm(fix.error_enu_m(TRUTH)) < 1e-2


@pytest.mark.consistency
def test_nees_and_bound_over_drawn_skies(sky: Rows) -> None:
    """150 draws with biases of 2 Hz of each satellite: a right one leaves the bounds once in 10 000 times."""
    runs, nees, squares, reported, chi_square = 150, 0.0, 0.0, 0.0, 0.0
    dof = 0
    for seed in range(runs):
        fix = doppler_fix(*noisy(sky, seed, bias_hz=2.0), height_m=450.0, satellite_bias_sigma_hz=2.0)
        assert fix.status is DopplerStatus.CONVERGED
        nees += fix.mahalanobis_2d(TRUTH)
        squares += float(np.sum(fix.error_enu_m(TRUTH)[:2] ** 2))
        reported += fix.sigma_2d_m**2
        chi_square += fix.chi_square
        dof += fix.degrees_of_freedom
    assert stats.chi2.ppf(5e-5, 2 * runs) < nees < stats.chi2.isf(5e-5, 2 * runs)
    assert stats.chi2.ppf(5e-5, dof) < chi_square < stats.chi2.isf(5e-5, dof)
    assert squares / reported == pytest.approx(1.0, abs=3.9 * np.sqrt(2.0 / runs))


@pytest.mark.crosscheck
def test_covariance_is_the_bound_of_the_model(sky: Rows) -> None:
    """Fisher's information by differences of the exact paths, biases and frequency with it, inverted."""
    t, k, doppler, p, v = sky
    names = np.unique(k)
    frame = geometry.LocalFrame(np.radians(47.4), np.radians(8.5), 450.0)
    walker = orbits.iridium_walker(600.0)
    columns = []
    for unit in np.eye(3)[:2]:
        a, b = (
            np.array(
                [
                    -CARRIER_HZ
                    * float(geometry.signal_path(walker[one], when, frame.position_to_ecef(h * unit)).delay_rate)
                    for when, one in zip(t, k, strict=True)
                ]
            )
            for h in (-200.0, 200.0)
        )
        columns.append((b - a) / 400.0)
    H = np.column_stack([*columns, np.ones(len(t)), t - t.mean(), k[:, None] == names])
    information = H.T @ H / 25.0 + np.diag([0.0, 0.0, 0.0, 0.0, *np.full(len(names), 1 / 9.0)])
    bound = np.linalg.inv(information)
    fix = doppler_fix(
        t, k, doppler, p, v, height_m=450.0, satellite_bias_sigma_hz=3.0, frequency_drift_sigma_hz_per_s=np.inf
    )
    np.testing.assert_allclose(fix.covariance_enu_m2[:2, :2], bound[:2, :2], rtol=2e-3)
    assert fix.frequency_bias_sigma_hz == pytest.approx(np.sqrt(bound[2, 2]), rel=1e-3)
    assert fix.frequency_drift_sigma_hz_per_s == pytest.approx(np.sqrt(bound[3, 3]), rel=1e-3)
    np.testing.assert_allclose(fix.satellite_bias_sigma_hz, np.sqrt(np.diag(bound))[4:], rtol=1e-3)


@pytest.mark.consistency
def test_scale_of_the_sigmas_is_found(sky: Rows) -> None:
    fix = doppler_fix(*noisy(sky, 3, sigma_hz=5.0), sigma_hz=1.0, estimate_sigma=True, height_m=450.0)
    rows = int(fix.used.sum())
    assert fix.sigma_scale == pytest.approx(5.0, rel=3.9 / np.sqrt(2.0 * rows))
    assert fix.chi_square == pytest.approx(fix.degrees_of_freedom, rel=1e-3)
    told = doppler_fix(*noisy(sky, 3, sigma_hz=5.0), sigma_hz=fix.sigma_scale, height_m=450.0)
    assert told.sigma_2d_m == pytest.approx(fix.sigma_2d_m, rel=1e-3)


@pytest.mark.unit
def test_height_known_constrained_and_free(sky: Rows) -> None:
    rows = noisy(sky, 5)
    known = doppler_fix(*rows, height_m=450.0)
    tied = doppler_fix(*rows, height_m=450.0, height_sigma_m=50.0)
    free = doppler_fix(*rows)
    assert known.height_m == pytest.approx(450.0, abs=1e-3)
    assert known.covariance_enu_m2[2, 2] == 0.0
    assert 0.0 < tied.covariance_enu_m2[2, 2] < min(50.0**2, free.covariance_enu_m2[2, 2])
    assert known.sigma_2d_m < tied.sigma_2d_m < free.sigma_2d_m
    error = free.error_enu_m(TRUTH)
    assert error @ np.linalg.solve(free.covariance_enu_m2, error) < stats.chi2.isf(1e-4, 3)


@pytest.mark.unit
def test_old_elements_widen_the_answer(sky: Rows) -> None:
    rows = noisy(sky, 6)
    sigmas = [
        doppler_fix(*rows, height_m=450.0, along_track_sigma_m=orbits.AlongTrackError().sigma_m(age)).sigma_2d_m
        for age in (0.0, 86400.0, 5 * 86400.0)
    ]
    fresh = doppler_fix(*rows, height_m=450.0)
    assert fresh.sigma_2d_m < sigmas[0] < sigmas[1] < sigmas[2]
    assert (fresh.along_track_sigma_m == 0.0).all()
    ages = np.where(rows[1] == rows[1][0], 20.0, 1.0) * 86400.0
    some = doppler_fix(*rows, height_m=450.0, age_s=ages, max_age_s=10 * 86400.0)
    assert (some.use[rows[1] == rows[1][0]] == DopplerUse.STALE).all()
    assert rows[1][0] not in some.satellites
    assert doppler_fix(*rows, age_s=99.0, max_age_s=1.0).status is DopplerStatus.TOO_FEW_ROWS


@pytest.mark.unit
def test_rows_that_cannot_be_used_and_too_few_of_them(sky: Rows) -> None:
    t, k, doppler, p, v = (np.array(a) for a in sky)
    doppler[0], p[1, 2], t[2] = np.nan, np.inf, np.nan
    sigma = np.full(len(t), 5.0)
    sigma[3:5] = 0.0, np.nan
    fix = doppler_fix(t, k, doppler, p, v, sigma_hz=sigma, height_m=450.0)
    assert fix.status is DopplerStatus.CONVERGED
    assert [DopplerUse(int(u)).name for u in fix.use[:6]] == [
        *("NOT_FINITE",) * 3,
        "BAD_SIGMA",
        "NOT_FINITE",
        "USED",
    ]
    assert np.isnan(fix.residuals_hz[:5]).all()
    assert np.isfinite(fix.residuals_hz[5:]).all()
    assert doppler_fix(*(a[:3] for a in sky)).status is DopplerStatus.TOO_FEW_ROWS
    assert doppler_fix([], np.zeros(0, int), [], np.zeros((0, 3)), np.zeros((0, 3))).status is (
        DopplerStatus.TOO_FEW_ROWS
    )
    one = sky[1] == sky[1][0]
    alone = doppler_fix(*(a[one] for a in sky))
    assert alone.status is DopplerStatus.TOO_FEW_SATELLITES
    assert np.isnan(alone.position_e_m).all()
    assert (
        repr(alone) == f"DopplerFix(too few satellites, {np.count_nonzero(one)} of {np.count_nonzero(one)} rows usable)"
    )
    many = np.arange(len(t)) % 70
    assert doppler_fix(sky[0], many, *sky[2:]).status is DopplerStatus.TOO_MANY_SATELLITES


@pytest.mark.unit
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"carrier_hz": -1.0}, "carrier_hz"),
        ({"height_m": np.nan}, "height_m"),
        ({"height_sigma_m": -1.0}, "height_sigma_m"),
        ({"frequency_bias_sigma_hz": 0.0}, "frequency_bias_sigma_hz"),
        ({"frequency_drift_sigma_hz_per_s": -1.0}, "frequency_drift_sigma_hz_per_s"),
        ({"satellite_bias_sigma_hz": np.inf}, "satellite_bias_sigma_hz"),
        ({"max_age_s": -1.0}, "max_age_s"),
        ({"mask_rad": 3.0}, "mask_rad"),
        ({"ambiguity_gate": np.nan}, "ambiguity_gate"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"search": False}, "search: false without start"),
        ({"start_e_m": [0.0, 0.0, 0.0]}, "start_p_e"),
        ({"start_e_m": [0.0, 0.0]}, "start_e_m: three numbers"),
        ({"velocity_e_mps": [np.nan, 0.0, 0.0]}, "velocity_e"),
        ({"sigma_hz": [1.0, 2.0]}, "sigma_hz: shape"),
        ({"state_of": "leaving"}, "state_of: 'leaving'"),
    ],
)
def test_options_out_of_range_are_refused(sky: Rows, change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        doppler_fix(*sky, **change)


@pytest.mark.unit
def test_arrays_that_do_not_fit_are_refused(sky: Rows) -> None:
    t, k, doppler, p, v = sky
    for arguments, sentence in (
        ((t[None], k, doppler, p, v), "t_s"),
        ((t, k.astype(float), doppler, p, v), "satellite: whole numbers"),
        ((t, k[:-1], doppler, p, v), "satellite"),
        ((t, k + 2**40, doppler, p, v), "satellite: numbers below"),
        ((t, k, doppler[:-1], p, v), "doppler_hz"),
        ((t, k, doppler, p[:, :2], v), "satellite_position_e_m"),
        ((t, k, doppler, p, v.T), "satellite_velocity_e_mps"),
    ):
        with pytest.raises(ValueError, match=sentence):
            doppler_fix(*arguments)
    with pytest.raises(ValueError, match="true_position_e_m"):
        doppler_fix(*sky).error_enu_m([1.0])


@pytest.mark.fuzz
@settings(max_examples=80, deadline=None)
@given(st.data())
def test_any_numbers_end_in_a_status(sky: Rows, data: st.DataObject) -> None:
    rows = [np.array(a[::4]) for a in sky]
    numbers = st.floats(allow_nan=True, allow_infinity=True)
    for _ in range(data.draw(st.integers(1, 4))):
        column = rows[data.draw(st.sampled_from([0, 2, 3, 4]))].reshape(-1)
        column[data.draw(st.integers(0, len(column) - 1))] = data.draw(numbers)
    fix = doppler_fix(*rows, height_m=450.0, satellite_bias_sigma_hz=data.draw(st.sampled_from([0.0, 2.0])))
    if fix.status in (DopplerStatus.CONVERGED, DopplerStatus.AMBIGUOUS):
        assert np.isfinite(fix.position_e_m).all()
        assert np.isfinite(fix.covariance_enu_m2).all()
        assert np.isfinite(fix.residuals_hz[fix.used]).all()


# ---- the recording: its residuals are cut at 10 Hz around the truth, so Gaussian models only


@pytest.fixture(scope="module")
def capture() -> tuple[Rows, Any]:
    lines = CAPTURE.read_text(encoding="utf-8").splitlines()
    d = np.array([[float(x) for x in line.split(",")[:10]] for line in lines[1:]])
    latitude, longitude, height = (float(x) for x in lines[1].split(",")[10:13])
    truth = geometry.geodetic_to_ecef(np.radians(latitude), np.radians(longitude), height)
    return (d[:, 0], d[:, 1].astype(int), d[:, 2], d[:, 3:6], d[:, 6:9]), truth


@there
@pytest.mark.offair
def test_iridium_of_the_air_within_110_m_and_its_ellipse(capture: tuple[Rows, Any]) -> None:
    rows, truth = capture
    height = float(geometry.ecef_to_geodetic(truth)[2])
    fix = doppler_fix(
        *rows,
        sigma_hz=1.0,
        estimate_sigma=True,
        height_m=height,
        satellite_bias_sigma_hz=2.0,
        frequency_drift_sigma_hz_per_s=np.inf,
    )
    assert fix.status is DopplerStatus.CONVERGED
    assert float(np.hypot(*fix.error_enu_m(truth)[:2])) <= 110.0
    assert fix.mahalanobis_2d(truth) < 9.21
    assert 55.0 <= fix.sigma_2d_m <= 90.0
    assert fix.sigma_scale == pytest.approx(5.2, abs=0.2)
    # What can be shown without the truth: constants of the satellites of 1 to 2 Hz belong.
    assert fix.bias_degrees_of_freedom == 8
    assert 20.0 < fix.bias_chi_square < 28.0
    assert fix.bias_probability < 5e-3
    assert 1.0 < np.abs(fix.satellite_bias_hz).max() < 2.5
    # Plain least squares is further off than its own 95 % ellipse.
    plain = doppler_fix(*rows, sigma_hz=5.35, height_m=height, frequency_drift_sigma_hz_per_s=np.inf)
    assert float(np.hypot(*plain.error_enu_m(truth)[:2])) == pytest.approx(108.0, abs=2.0)
    assert plain.mahalanobis_2d(truth) > 5.99
    assert plain.mahalanobis_2d(truth) > fix.mahalanobis_2d(truth)
    # Every prior of a sensible width says the same.
    for bias_hz in (0.3, 1.0, 5.0):
        for drift in (0.001, 1.0, np.inf):
            other = doppler_fix(
                *rows,
                sigma_hz=5.35,
                height_m=height,
                satellite_bias_sigma_hz=bias_hz,
                frequency_drift_sigma_hz_per_s=drift,
            )
            assert float(np.hypot(*other.error_enu_m(truth)[:2])) <= 110.0
            assert other.mahalanobis_2d(truth) < 9.21
            assert 55.0 <= other.sigma_2d_m <= 90.0


@there
@pytest.mark.offair
def test_iridium_of_the_air_from_200_starts(capture: tuple[Rows, Any]) -> None:
    """Anywhere on the Earth, up to 20 km high: one answer."""
    rows, truth = capture
    height = float(geometry.ecef_to_geodetic(truth)[2])
    random = np.random.default_rng(1)
    reference = doppler_fix(*rows, sigma_hz=5.2, height_m=height, satellite_bias_sigma_hz=2.0)
    for _ in range(200):
        start = geometry.geodetic_to_ecef(
            np.arcsin(random.uniform(-1, 1)), random.uniform(-np.pi, np.pi), random.uniform(0.0, 2e4)
        )
        fix = doppler_fix(*rows, sigma_hz=5.2, height_m=height, satellite_bias_sigma_hz=2.0, start_e_m=start)
        assert fix.status is DopplerStatus.CONVERGED
        assert np.linalg.norm(fix.position_e_m - reference.position_e_m) < 0.1
    # Without the grid, from within 500 km.
    frame = geometry.LocalFrame(*(float(x) for x in geometry.ecef_to_geodetic(truth)))
    for _ in range(50):
        away = 5e5 * np.sqrt(random.uniform()) * np.exp(1j * random.uniform(0, 2 * np.pi))
        fix = doppler_fix(
            *rows,
            sigma_hz=5.2,
            height_m=height,
            satellite_bias_sigma_hz=2.0,
            search=False,
            start_e_m=frame.position_to_ecef([away.real, away.imag, 0.0]),
        )
        assert np.linalg.norm(fix.position_e_m - reference.position_e_m) < 0.5
