"""Integers, baselines and attitude from Python: published numbers, the recorded compass, statuses, refusals."""

import dataclasses
import itertools
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from soopnav_cpp import gnss
from soopnav_cpp.experiments import carter_attitude
from soopnav_cpp.experiments.registry import REGISTRY, perform

CAPTURE = Path(__file__).resolve().parents[2].parent / "shared" / "captures" / "gnss_baseline_1m"
HEADING_RAD, PITCH_RAD, LENGTH_M = np.deg2rad(193.028), np.deg2rad(0.556), 0.990  # of the surveyed antennas
BASELINE_ENU_M = LENGTH_M * np.array(
    [np.cos(PITCH_RAD) * np.sin(HEADING_RAD), np.cos(PITCH_RAD) * np.cos(HEADING_RAD), np.sin(PITCH_RAD)]
)

recorded = [
    pytest.mark.offair,
    pytest.mark.skipif(not CAPTURE.exists(), reason="the recording ../shared/captures/gnss_baseline_1m is not here"),
    pytest.mark.skipif(find_spec("georinex") is None, reason="georinex is not installed: the extra gnss brings it"),
]

# Float ambiguities and covariance of de Jonge and Tiberius (Delft 1996, section 3.4), printed there with the answers.
A = np.array([5.45, 3.10, 2.97])
Q = np.array([[6.290, 5.978, 0.544], [5.978, 6.292, 2.340], [0.544, 2.340, 6.288]])


@pytest.mark.crosscheck
def test_published_integers():
    fixed, norms = gnss.lambda_ils(A, Q, 2)
    assert fixed.dtype == np.int64
    np.testing.assert_array_equal(fixed, [[5, 3, 4], [6, 4, 4]])
    np.testing.assert_allclose(norms, [0.2183, 0.3073], atol=5e-5)


@pytest.mark.crosscheck
@pytest.mark.parametrize("seed", range(8))
def test_integers_by_trying_all(seed):
    rng = np.random.default_rng(seed)
    n = 2 + seed % 3
    B = rng.normal(size=(n, n))
    cov = 0.3 * B @ B.T + 0.02 * np.eye(n)
    a = rng.uniform(-5.0, 5.0, n)
    box = np.array(list(itertools.product(range(-7, 8), repeat=n))) + np.round(a)
    d = box - a
    norms = np.einsum("ij,ij->i", d, np.linalg.solve(cov, d.T).T)
    order = np.argsort(norms)[:5]
    fixed, found = gnss.lambda_ils(a, cov, 5)
    np.testing.assert_allclose(found, norms[order], rtol=1e-9)
    np.testing.assert_array_equal(fixed, box[order])


@pytest.mark.crosscheck
def test_success_rate_of_independent_integers():
    sigmas = np.array([0.2, 0.3, 0.4])
    expected = np.prod(2.0 * norm.cdf(0.5 / sigmas) - 1.0)
    assert gnss.success_rate(np.diag(sigmas**2)) == pytest.approx(expected, rel=1e-12)
    assert gnss.success_rate(1e-6 * np.eye(3)) == pytest.approx(1.0)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("a", "cov", "count", "sentence"),
    [
        ([0.1, 0.2], [[1.0, 1.0], [1.0, 1.0]], 2, "Q: not positive definite"),
        ([0.1, 0.2], [[1.0, 0.5], [0.4, 1.0]], 2, "Q: a symmetric matrix expected"),
        ([0.1, 0.2], [[1.0, 0.5, 0.1], [0.4, 1.0, 0.1]], 2, r"Q: a square matrix expected, got shape \(2, 3\)"),
        ([0.1], [[1.0, 0.0], [0.0, 1.0]], 2, "a: 2 numbers expected, as Q has rows, got 1"),
        ([0.1, np.nan], [[1.0, 0.0], [0.0, 1.0]], 2, "finite numbers expected"),
        ([0.1, 1e17], [[1.0, 0.0], [0.0, 1.0]], 2, r"a, Q: integers of at most 2\^52 expected"),
        ([1e300, 0.2], [[1.0, 0.0], [0.0, 1.0]], 2, r"a, Q: integers of at most 2\^52 expected"),
        ([0.1, 0.2], [[1.0, 0.0], [0.0, 1.0]], 0, "candidates = 0: 1 ... 10 000 expected"),
        (np.zeros(49), np.eye(49), 2, "Q: 1 ... 48 integers expected, got 49"),
    ],
)
def test_integers_refuse(a, cov, count, sentence):
    with pytest.raises(ValueError, match=sentence):
        gnss.lambda_ils(a, cov, count)


@pytest.mark.fuzz
@settings(max_examples=60, deadline=None)
@given(
    hnp.arrays(np.float64, st.integers(0, 4), elements=st.floats(allow_nan=True, width=64)),
    hnp.arrays(np.float64, st.tuples(st.integers(0, 4), st.integers(0, 4)), elements=st.floats(allow_nan=True)),
)
def test_integers_take_any_array(a, cov):
    try:
        fixed, norms = gnss.lambda_ils(a, cov, 2)
    except ValueError:
        return
    assert fixed.shape == (2, len(a))
    assert norms[0] <= norms[1]


# --- The recorded compass ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compass():
    """Every fifth epoch of two antennas 0.99 m apart, and their orbits."""
    read = (gnss.read_observations(CAPTURE / name, interval_s=5.0) for name in ("rover.obs", "base.obs"))
    return (*read, gnss.read_navigation(CAPTURE / "base.nav"))


def judged(run):
    """Share of right integers, share fixed, number wrong among these, rms heading and pitch error in degrees."""
    right = np.linalg.norm(run.best_enu_m - BASELINE_ENU_M, axis=1) < 0.06
    heading = np.rad2deg(run.heading_rad - HEADING_RAD)[run.fixed]
    pitch = np.rad2deg(run.pitch_rad - PITCH_RAD)[run.fixed]
    rms = [float(np.sqrt(np.mean(x**2))) for x in (heading, pitch)]
    return right.mean(), run.fixed.mean(), int(np.count_nonzero(run.fixed & ~right)), *rms


class TestRecorded:
    pytestmark = recorded

    def test_single_epochs(self, compass):
        run = gnss.solve_baseline(*compass)
        right, fixed, wrong, heading, pitch = judged(run)
        assert right == 1.0
        assert fixed >= 0.98  # of 61 epochs; of all of them see below
        assert wrong == 0
        assert heading <= 0.095  # 0.087 on these, 0.079 on all
        assert pitch <= 0.26
        assert run.satellites.min() >= 8
        # As stated: the errors stay within their deviations.
        off = (run.heading_rad - HEADING_RAD)[run.fixed] / run.heading_sigma_rad[run.fixed]
        assert np.sqrt(np.mean(off**2)) < 1.5

    def test_code_weight_decides(self, compass):
        assert judged(gnss.solve_baseline(*compass, code_phase_ratio=50.0))[1] < 0.95
        assert judged(gnss.solve_baseline(*compass, code_phase_ratio=200.0))[1] == 1.0

    def test_known_length(self, compass):
        run = gnss.solve_baseline(*compass, length_m=LENGTH_M)
        right, fixed, wrong, heading, pitch = judged(run)
        assert (right, fixed, wrong) == (1.0, 1.0, 0)
        assert heading <= 0.095
        assert pitch <= 0.20
        np.testing.assert_allclose(np.linalg.norm(run.baseline_enu_m, axis=1), LENGTH_M, rtol=1e-9)

    def test_five_satellites(self, compass):
        free = judged(gnss.solve_baseline(*compass, max_satellites=5))
        sphere = judged(gnss.solve_baseline(*compass, max_satellites=5, length_m=LENGTH_M, ratio=2.0))
        assert sphere[0] >= 0.97
        assert sphere[0] >= 2.5 * free[0]
        assert sphere[1] >= 0.88
        assert sphere[2] == 0

    def test_wrong_length_is_not_fixed(self, compass):
        for length_m in (0.9, 1.1, 1.5):
            assert gnss.solve_baseline(*compass, length_m=length_m).fixed.mean() < 0.05

    def test_cycle_slips_are_found_and_repaired(self, compass):
        rover, base, orbits = compass
        clean = gnss.solve_baseline(rover, base, orbits, track=True)
        assert clean.fixed.all()
        assert not clean.slips.any()
        assert (clean.status[1:] == gnss.BaselineStatus.TRACKED).all()
        names = gnss.receiver_differences(rover, base, orbits, base.approximate_position_ecef_m).satellites
        for name, cycles in (("G13", 1.0), ("G24", -40.0)):
            phase = np.array(rover.phase_cycles)
            phase[30:, rover.satellites.index(name)] += cycles
            broken = dataclasses.replace(rover, phase_cycles=phase)
            run = gnss.solve_baseline(broken, base, orbits, track=True)
            np.testing.assert_array_equal(np.argwhere(run.slips), [[30, names.index(name)]])
            assert judged(run)[1:3] == (1.0, 0)
            # Single epochs do not notice.
            np.testing.assert_allclose(
                gnss.solve_baseline(broken, base, orbits).baseline_enu_m,
                gnss.solve_baseline(rover, base, orbits).baseline_enu_m,
                atol=1e-6,
            )

    def test_position_of_the_base_may_be_rough(self, compass):
        rover, base, orbits = compass
        near = gnss.solve_baseline(rover, base, orbits)
        far = gnss.solve_baseline(rover, base, orbits, base.approximate_position_ecef_m + np.array([5.0, -5.0, 5.0]))
        both = near.fixed & far.fixed
        assert both.mean() > 0.95
        assert np.abs(near.baseline_enu_m - far.baseline_enu_m)[both].max() < 1e-3

    @pytest.mark.slow
    def test_every_epoch(self):
        rover, base = (gnss.read_observations(CAPTURE / name) for name in ("rover.obs", "base.obs"))
        orbits = gnss.read_navigation(CAPTURE / "base.nav")
        right, fixed, wrong, heading, pitch = judged(gnss.solve_baseline(rover, base, orbits))
        assert right == 1.0
        assert fixed >= 0.99
        assert wrong == 0
        assert heading <= 0.085
        assert pitch <= 0.26
        assert judged(gnss.solve_baseline(rover, base, orbits, length_m=LENGTH_M))[:3] == (1.0, 1.0, 0)
        right, fixed, wrong, *_ = judged(
            gnss.solve_baseline(rover, base, orbits, length_m=LENGTH_M, max_satellites=5, ratio=2.0)
        )
        assert right >= 0.97
        assert fixed >= 0.88
        assert wrong == 0

    def test_refusals(self, compass):
        rover, base, orbits = compass
        with pytest.raises(ValueError, match=r"length_m = 0\.0"):
            gnss.solve_baseline(rover, base, orbits, length_m=0.0)
        with pytest.raises(ValueError, match="base_position"):
            gnss.solve_baseline(rover, base, orbits, [np.nan, 0.0, 0.0])
        with pytest.raises(ValueError, match="base_position"):
            gnss.solve_baseline(rover, base, orbits, [1.0, 0.0, 0.0])
        later = dataclasses.replace(rover, time_of_week_s=rover.time_of_week_s + 5000.0)
        with pytest.raises(ValueError, match="no epoch in common"):
            gnss.solve_baseline(later, base, orbits)
        other = dataclasses.replace(rover, satellites=tuple(name.replace("G", "E") for name in rover.satellites))
        with pytest.raises(ValueError, match="no GPS satellite in common"):
            gnss.solve_baseline(other, base, orbits)


@pytest.mark.unit
def test_baseline_of_too_few_or_no_satellites():
    run = gnss.baseline_fix(np.tile([0.0, 0.6, 0.8], (3, 1)), np.zeros(3), np.zeros(3))
    assert run.status == gnss.BaselineStatus.TOO_FEW_SATELLITES
    assert np.isnan(run.baseline_enu_m).all()
    assert "too few satellites" in repr(run)
    empty = gnss.baseline_fix(np.empty((0, 3)), [], [])
    assert empty.status == gnss.BaselineStatus.TOO_FEW_SATELLITES
    nothing = gnss.baseline_fix(
        np.full((4, 8, 3), np.nan), np.full((4, 8), np.nan), np.full((4, 8), np.nan), track=True
    )
    assert (nothing.status == gnss.BaselineStatus.TOO_FEW_SATELLITES).all()
    assert "4 epochs, 0 fixed" in repr(nothing)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"mask_deg": 95.0}, "mask_rad = 1.65"),
        ({"ratio": 0.5}, "ratio = 0.5"),
        ({"length_m": 20.0}, "length_m = 20.0"),
        ({"search": "both"}, "search: expected one of 'sphere', 'candidates', got 'both'"),
        ({"max_satellites": 2}, "max_satellites = 2"),
        ({"phase_sigma_m": np.nan}, "phase_sigma_m = nan"),
        ({"lost_lock": np.zeros(3)}, "lost_lock: shape"),
    ],
)
def test_baseline_refuses(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        gnss.baseline_fix(np.tile([0.0, 0.6, 0.8], (8, 1)), np.zeros(8), np.zeros(8), **options)


# --- Attitude ---------------------------------------------------------------------------------------------------------

BODY = 0.9 * gnss.L1_M * np.eye(3)[:2]


@pytest.fixture
def sky():
    return carter_attitude.sky(np.random.default_rng(7))


def paths(rotation, u):
    """Path differences under a scipy rotation, body to reference."""
    return np.einsum("ij,kj,mi->km", rotation.as_matrix(), BODY, u)


@pytest.mark.crosscheck
def test_attitude_against_another_library(sky):
    rotations = Rotation.random(40, random_state=3)
    epochs = np.stack([paths(r, sky) for r in rotations])
    fixes = gnss.attitude_fix(epochs, BODY, sky)
    assert (fixes.status == gnss.AttitudeStatus.SOLVED).all()
    np.testing.assert_allclose(
        Rotation.from_quat(fixes.quaternion[:, [1, 2, 3, 0]]).as_matrix(), rotations.as_matrix(), atol=1e-7
    )
    np.testing.assert_allclose(fixes.euler_rad, rotations.as_euler("ZYX"), atol=1e-6)
    one = gnss.attitude_fix(epochs[5], BODY, sky)
    assert one.quaternion.shape == (4,)
    np.testing.assert_array_equal(one.quaternion, fixes.quaternion[5])
    assert "solved" in repr(one)
    assert "40 epochs, 40 solved" in repr(fixes)
    moving = gnss.attitude_fix(epochs, BODY, np.broadcast_to(sky, (40, 8, 3)))
    np.testing.assert_array_equal(moving.quaternion, fixes.quaternion)


@pytest.mark.unit
def test_attitude_statuses(sky):
    status = gnss.AttitudeStatus
    y = paths(Rotation.identity(), sky)
    assert gnss.attitude_fix(y[:, :1], BODY, sky[:1]).status == status.TOO_FEW_SATELLITES
    assert gnss.attitude_fix(y * np.nan, BODY, sky).status == status.TOO_FEW_SATELLITES
    turn = np.linspace(0.1, 3.0, 6)
    plane = np.stack([np.cos(turn), np.zeros(6), -np.sin(turn)], axis=1)
    assert gnss.attitude_fix(paths(Rotation.identity(), plane), BODY, plane).status == status.SATELLITES_IN_PLANE
    single = gnss.attitude_fix(y[:1], BODY[:1], sky)
    assert single.status == status.UNOBSERVABLE
    assert abs(single.unobservable[0]) == pytest.approx(1.0, abs=1e-6)
    assert gnss.attitude_fix(y, BODY, sky, start=[1.0, 0.0, 0.0, 0.0]).status == status.SOLVED


@pytest.mark.unit
def test_attitude_refuses(sky):
    y = paths(Rotation.identity(), sky)
    for call, sentence in (
        (lambda: gnss.attitude_fix(y, BODY[:1], sky), "1 baselines expected, got 2"),
        (lambda: gnss.attitude_fix(y, BODY, sky[:5]), r"directions: shape \(8, 3\) expected"),
        (lambda: gnss.attitude_fix(y[0], BODY, sky), r"path_differences_m: shape \(k, m\) or \(n, k, m\) expected"),
        (lambda: gnss.attitude_fix(y, 0.0 * BODY, sky), r"baselines_m\[0\]: longer than"),
        (lambda: gnss.attitude_fix(y, BODY, sky, -1.0), "sigma_m = -1"),
        (lambda: gnss.attitude_fix(y, BODY, sky, start=[2.0, 0.0, 0.0, 0.0]), "start: a unit quaternion expected"),
        (
            lambda: gnss.attitude_fix(y, BODY, sky, shared_reference=True, common_clock=False),
            "shared_reference = true: only with common_clock",
        ),
        (lambda: gnss.acquire_attitude(y, BODY, sky, wavelength_m=0.0), "wavelength_m = 0.0"),
        (lambda: gnss.resolve_cycles(y[0], BODY, sky, [1.0, 0.0, 0.0, 0.0]), "phase_cycles: shape"),
        (lambda: gnss.AttitudeFilter(BODY, [1, 0, 0, 0], np.eye(2)), r"covariance_rad2: shape \(3, 3\) expected"),
        (lambda: gnss.AttitudeFilter(BODY, [1, 0, 0, 0], -np.eye(3)), "positive semi-definite"),
        (lambda: gnss.AttitudeFilter(BODY, [1, 0, 0, 0], np.eye(3), parameters="mrp"), "parameters: expected one of"),
        (lambda: gnss.AttitudeFilter(BODY, [1, 0, 0, 0], np.eye(3), rate_noise_rad_rts=-1.0), "rate_noise_rad_rts"),
        (lambda: gnss.arrival_angle(0.1, 0.0), "baseline_m = 0.0"),
        (lambda: gnss.arrival_angle_sigma(0.1, 1.0, -1.0), "path_sigma_m = -1.0"),
        (lambda: gnss.heading_error(-1.0, 1.0), "baseline_m = -1.0"),
        (lambda: gnss.heading_error(1.0, 0.0), "position_sigma_m = 0.0"),
        (lambda: gnss.heading_error(np.inf, 1.0), "baseline_m = inf"),
        (lambda: gnss.heading_error(1.0, np.inf), "position_sigma_m = inf"),
        (lambda: gnss.heading_error_density(0.1, np.inf, 1.0), "baseline_m = inf"),
        (lambda: gnss.heading_error_density(0.1, 1e300, 1e-300), "baseline_m / position_sigma_m = inf"),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()


@pytest.mark.law
def test_filter_steps_are_a_run(sky):
    rng = np.random.default_rng(5)
    way = carter_attitude.manoeuvre()
    true_path = np.stack([paths(Rotation.from_euler("ZYX", e), sky) for e in way.euler_rad[90:190]])
    noisy = true_path + 0.002 * rng.standard_normal(true_path.shape)
    start, P = np.array([1.0, 0.0, 0.0, 0.0]), 1e-3 * np.eye(3)

    def fresh(walk=0.05, **options):
        return gnss.AttitudeFilter(BODY, start, P, sigma_m=0.002, rate_noise_rad_rts=walk, **options)

    t = way.t_s[90:190]
    run = fresh().run(t, noisy, sky)
    assert (run.status == gnss.AttitudeStatus.SOLVED).all()
    assert "100 epochs, 100 updated" in repr(run)
    stepped = fresh()
    rows = [stepped.step(float(when), data, sky) for when, data in zip(t, noisy, strict=True)]
    np.testing.assert_allclose(np.concatenate([row.quaternion for row in rows]), run.quaternion, atol=1e-12)
    np.testing.assert_allclose(stepped.quaternion, run.quaternion[-1], atol=1e-12)
    np.testing.assert_allclose(stepped.covariance_rad2, run.covariance_rad2[-1], rtol=1e-9)
    with pytest.raises(ValueError, match=r"t_s\[0\]"):
        stepped.step(0.0, noisy[0], sky)
    # Wrapped phases about each prediction give the same as the unwrapped ones.
    cycles = -noisy / gnss.L1_M
    wrapped = fresh().run(t, cycles - np.round(cycles), sky, wavelength_m=gnss.L1_M)
    np.testing.assert_allclose(wrapped.quaternion, run.quaternion, atol=1e-9)
    assert np.nanmax(wrapped.farthest_cycles) < 0.45
    # Measured rates take the lag away.
    rates = np.zeros((100, 3))  # only yaw turns, and the body is level: its rate about z
    rates[1:, 2] = np.diff(way.euler_rad[90:190, 0]) / np.diff(t)
    lag, turned = (
        np.abs(f.euler_rad[:, 0] - way.euler_rad[90:190, 0]).max()
        for f in (fresh(0.005).run(t, noisy, sky), fresh(0.005).run(t, noisy, sky, rates_radps=rates))
    )
    assert turned < 0.2 * lag
    # A slip of a cycle is gated and leaves no trace.
    gated = fresh(false_alarm_probability=1e-6)
    gated.run(t[:50], np.broadcast_to(true_path[0], (50, 2, 8)), sky)
    before = gated.quaternion
    slip = true_path[0].copy()
    slip[0, 2] += gnss.L1_M
    assert gated.step(float(t[50]), slip, sky).status[0] == gnss.AttitudeStatus.GATED
    np.testing.assert_array_equal(gated.quaternion, before)
    missing = gated.step(float(t[51]), np.full((2, 8), np.nan), sky)
    assert missing.status[0] == gnss.AttitudeStatus.TOO_FEW_SATELLITES


@pytest.mark.crosscheck
def test_heading_error_by_quadrature():
    for baseline, sigma in ((0.5, 1.0), (3.0, 0.7), (50.0, 1.0)):
        edge = min(np.pi, 20.0 * sigma / baseline)
        mass, _ = quad(
            lambda d, b=baseline, s=sigma: float(gnss.heading_error_density(d, b, s)), -np.pi, np.pi, points=[0]
        )
        square = 2.0 * sum(
            quad(lambda d, b=baseline, s=sigma: d * d * float(gnss.heading_error_density(d, b, s)), *ends)[0]
            for ends in ((0.0, edge), (edge, np.pi))
        )
        error = gnss.heading_error(baseline, sigma)
        assert mass == pytest.approx(1.0, abs=1e-7)
        assert error.rms_rad == pytest.approx(np.sqrt(square), rel=1e-6)
        assert error.inversion_probability == pytest.approx(norm.cdf(-baseline / (np.sqrt(2.0) * sigma)), rel=1e-9)
    for baseline in (1e7, 1e20, 1e200):  # far beyond, the linear law is exact
        error = gnss.heading_error(baseline, 1.0)
        assert error.rms_rad == pytest.approx(error.linear_sigma_rad, rel=1e-12)
    assert gnss.heading_error(1e300, 1e-300) == (0.0, 0.0, 0.0)


@pytest.mark.unit
def test_arrival_angle():
    np.testing.assert_allclose(
        gnss.arrival_angle([[1.0, 0.0], [-2.0, 0.5]], 1.0), [[0.0, np.pi / 2], [np.pi, np.pi / 3]]
    )
    assert np.isnan(gnss.arrival_angle(np.nan, 1.0))
    np.testing.assert_allclose(gnss.arrival_angle_sigma([np.pi / 2, np.pi / 6], 0.5, 0.01), [0.02, 0.04])


@pytest.mark.unit
@pytest.mark.parametrize("id", ["carter-3.5", "carter-3.7", "carter-3.11", "carter-3.12"])
def test_every_claim_holds(id, tmp_path):
    (item,) = REGISTRY.select([id])
    outcome = perform(item, seed=3, out=tmp_path)
    assert outcome.error is None
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []
    assert (tmp_path / f"{id}.png").stat().st_size > 10_000
    assert (tmp_path / f"{id}.npz").exists()
