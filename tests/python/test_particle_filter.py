"""Particle filters through the bindings: shapes, statuses, refusals, bits, and agreement with exact filters."""

import copy
import pickle
import threading

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp import measurement, process
from soopnav_cpp.estimation import (
    Gaussian,
    Measured,
    ParticleFilter,
    ParticleStatus,
    Samples,
    Uniform,
    linear_filter,
)

ROOM = [(0.0, 10.0), (0.0, 10.0)]
CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
HERE = np.array([3.0, 6.0])
WALK = process.RandomWalk(0.01)


def ranges(corners=CORNERS):
    return [measurement.Range(q) for q in corners]


def room_filter(count=2000, **options):
    return ParticleFilter(count, prior=Uniform(ROOM), seed=3, **options)


def distances(here=HERE):
    return np.linalg.norm(CORNERS - here, axis=1)


def everything(pf):
    return (pf.particles.tobytes(), pf.weights.tobytes(), pf.log_likelihood, pf.ess)


# ---- shapes and values


@pytest.mark.unit
def test_as_the_tour_has_it():
    node_m, z_m, sigma_m = CORNERS[0], distances()[0], 0.3
    pf = sn.estimation.ParticleFilter(50_000, prior=sn.estimation.Uniform(ROOM), seed=1)
    first = pf.step(sn.measurement.Range(node_m), z_m, sigma_m)
    assert first.accepted
    assert not first.resampled
    second = pf.step(lambda x: -0.5 * ((distances()[1] - np.hypot(*(x - CORNERS[1]).T)) / 0.3) ** 2)
    assert second.accepted
    assert second.resampled
    np.testing.assert_allclose(pf.mean, HERE, atol=0.1)
    assert pf.covariance.shape == (2, 2)
    assert 1.0 <= pf.ess <= 50_000
    assert pf.log_likelihood == pytest.approx(first.log_likelihood + second.log_likelihood)
    assert repr(pf).startswith("ParticleFilter(50000 particles, position2")
    assert repr(first).startswith("ParticleReport(accepted")


@pytest.mark.unit
def test_moments_are_those_of_the_weighted_particles():
    pf = room_filter()
    pf.update(ranges(), distances(), 1.0)
    x, w = pf.particles, pf.weights
    assert x.shape == (2000, 2)
    assert w.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(pf.mean, w @ x, rtol=1e-12)
    off = x - w @ x
    np.testing.assert_allclose(pf.covariance, (off.T * w) @ off, rtol=1e-9)
    assert pf.ess == pytest.approx(1.0 / np.sum(w**2), rel=1e-9)
    weights, edges = pf.histogram("y", 20, (0.0, 10.0))
    np.testing.assert_allclose(weights, np.histogram(x[:, 1], edges, weights=w)[0], atol=1e-12)
    weights, edges = pf.histogram(0, 7)
    assert weights.sum() == pytest.approx(1.0)
    assert len(edges) == 8


@pytest.mark.unit
def test_weights_are_the_likelihood():
    pf = room_filter()
    z, sigma = distances() + 0.2, np.array([0.5, 1.0, 2.0, 1.0])
    report = pf.update(ranges(), z, sigma)
    off = (z - np.linalg.norm(pf.particles[:, None] - CORNERS, axis=2)) / sigma
    log_likelihood = -0.5 * np.sum(off**2 + np.log(2.0 * np.pi * sigma**2), axis=1)
    expected = np.exp(log_likelihood - log_likelihood.max())
    np.testing.assert_allclose(pf.weights, expected / expected.sum(), rtol=1e-9, atol=1e-15)
    assert report.log_likelihood == pytest.approx(np.log(np.mean(np.exp(log_likelihood))), rel=1e-12)


@pytest.mark.unit
def test_full_covariance_and_outliers():
    R = 0.25 * np.eye(4) + 0.5
    z = distances() + 0.2
    pf = room_filter()
    pf.update(ranges(), z, R=R)
    off = z - np.linalg.norm(pf.particles[:, None] - CORNERS, axis=2)
    log_likelihood = -0.5 * np.sum(off * np.linalg.solve(R, off.T).T, axis=1)
    expected = np.exp(log_likelihood - log_likelihood.max())
    np.testing.assert_allclose(pf.weights, expected / expected.sum(), rtol=1e-9, atol=1e-15)

    pf = room_filter()
    report = pf.update(ranges(), z, 0.5, outlier_probability=0.1, outlier_density=0.02)
    off = z - np.linalg.norm(pf.particles[:, None] - CORNERS, axis=2)
    normal = np.exp(-0.5 * (off / 0.5) ** 2) / (0.5 * np.sqrt(2.0 * np.pi))
    likelihood = np.prod(0.9 * normal + 0.1 * 0.02, axis=1)
    np.testing.assert_allclose(pf.weights, likelihood / likelihood.sum(), rtol=1e-9)
    assert report.log_likelihood == pytest.approx(np.log(likelihood.mean()), rel=1e-9)
    assert pf.update(ranges(), [1e6] * 4, 0.5, outlier_probability=0.1, outlier_density=0.02).accepted


@pytest.mark.unit
def test_a_wild_range_rules_no_particle_out_with_a_floor():
    z = distances() + np.array([0.0, 0.0, 60.0, 0.0])
    pf = room_filter(5000)
    assert pf.step(ranges(), z, 0.5, outlier_probability=0.05, outlier_density=0.01).accepted
    np.testing.assert_allclose(pf.mean, HERE, atol=0.5)


STATES = {
    "position1": 1,
    "position2": 2,
    "position3": 3,
    "position_velocity1": 2,
    "position_velocity2": 4,
    "position_velocity3": 6,
    "position_clock2": 3,
    "position_clock3": 4,
    "position_velocity_bias2": 5,
    "position_velocity_clock2": 6,
    "position_velocity_clock3": 8,
    "planar_inertial": 5,
    "pose2": 3,
    "coordinated_turn": 5,
}


@pytest.mark.unit
@pytest.mark.parametrize("state", STATES)
def test_every_state(state):
    n = STATES[state]
    pf = ParticleFilter(700, prior=Gaussian(np.arange(n) * 0.1, 0.01 * np.eye(n)), state=state, seed=1)
    assert pf.state == state
    assert len(pf.component_names) == n
    np.testing.assert_allclose(pf.mean, np.arange(n) * 0.1, atol=0.02)
    np.testing.assert_allclose(pf.covariance, 0.01 * np.eye(n), atol=0.004)
    if "velocity" in state:
        clock = {"clock": (0.01, 0.01)} if "clock" in state else {}
        assert pf.predict(process.NearlyConstantVelocity(0.1, **clock), 1.0).accepted
    assert pf.predict(process.RandomWalk(np.full(n, 0.04)), 1.0).accepted
    assert np.all(np.diag(pf.covariance) > 0.03)


@pytest.mark.unit
def test_states_of_your_own():
    pf = ParticleFilter(100, prior=Gaussian(np.zeros(4), np.eye(4)))
    assert pf.state == "custom"
    pf = ParticleFilter(100, prior=Gaussian(np.zeros(2), np.eye(2)), state=("level", "slope"))
    assert pf.component_names == ["level", "slope"]
    assert pf.histogram("slope", 5)[0].sum() == pytest.approx(1.0)
    with pytest.raises(ValueError, match=r"component: 'flow' is none of 'level', 'slope'"):
        pf.histogram("flow")


@pytest.mark.unit
def test_headings_wrap():
    psi = np.pi - 0.01
    pf = ParticleFilter(4000, prior=Gaussian([0.0, 0.0, psi], np.diag([1.0, 1.0, 0.04])), state="pose2", seed=2)
    assert np.all(np.abs(pf.particles[:, 2]) <= np.pi)
    assert abs((pf.mean[2] - psi + np.pi) % (2 * np.pi) - np.pi) < 0.02
    assert pf.covariance[2, 2] == pytest.approx(0.04, rel=0.2)
    turned = pf.predict(lambda x, w: x + np.array([0.0, 0.0, 0.2]), noise=0)
    assert turned.accepted
    assert np.all(np.abs(pf.particles[:, 2]) <= np.pi)
    assert pf.mean[2] == pytest.approx(psi + 0.2 - 2 * np.pi, abs=0.02)


@pytest.mark.unit
def test_priors():
    x = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    np.testing.assert_array_equal(ParticleFilter(3, prior=Samples(x)).particles, x)
    low, high = np.array([-1.0, 5.0]), np.array([0.0, 5.0])
    for prior in (Uniform(low, high), Uniform(np.stack([low, high], axis=1))):
        drawn = ParticleFilter(1000, prior=prior, seed=1).particles
        assert np.all((drawn >= low) & (drawn <= high))
        assert drawn[:, 0].std() == pytest.approx(1.0 / np.sqrt(12.0), rel=0.1)
    certain = ParticleFilter(10, prior=Gaussian([1.0, 2.0], np.diag([1.0, 0.0])))
    np.testing.assert_array_equal(certain.particles[:, 1], 2.0)


@pytest.mark.unit
def test_one_particle():
    pf = ParticleFilter(1, prior=Gaussian([1.0, 2.0], np.eye(2)))
    assert pf.step(ranges(), distances(), 1.0, process=WALK).accepted
    assert pf.ess == 1.0
    np.testing.assert_array_equal(pf.mean, pf.particles[0])
    np.testing.assert_array_equal(pf.covariance, np.zeros((2, 2)))


@pytest.mark.unit
def test_storage_of_a_million():
    pf = ParticleFilter(1_000_000, prior=Gaussian(np.zeros(5), np.eye(5)), state="position_velocity_bias2")
    assert pf.storage_bytes <= 100e6
    single = ParticleFilter(
        1_000_000, prior=Gaussian(np.zeros(5), np.eye(5)), state="position_velocity_bias2", precision="float"
    )
    assert single.storage_bytes <= 0.51 * pf.storage_bytes


@pytest.mark.unit
def test_single_precision_is_near_double():
    settled = []
    for precision in ("double", "float"):
        pf = room_filter(20_000, precision=precision)
        for _ in range(5):
            assert pf.step(ranges(), distances(), 0.3, process=WALK).accepted
        settled.append(pf)
    np.testing.assert_allclose(settled[0].mean, settled[1].mean, atol=0.01)
    np.testing.assert_allclose(settled[0].covariance, settled[1].covariance, rtol=0.1, atol=1e-3)


# ---- against exact filters


def linear_run(steps=40):
    """Nearly constant velocity in a plane, both coordinates measured with correlated noise."""
    rng = np.random.default_rng(8)
    dt, q = 0.5, 0.3
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    block = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    Q = np.zeros((4, 4))
    for axis in (0, 1):
        Q[np.ix_([axis, axis + 2], [axis, axis + 2])] = block
    H, R = np.eye(2, 4), np.array([[1.0, 0.5], [0.5, 0.8]])
    x0, P0 = np.array([1.0, -1.0, 0.5, 0.0]), np.diag([1.0, 1.0, 0.25, 0.25])
    z = rng.multivariate_normal(np.zeros(2), R, steps) + np.outer(np.arange(steps), [0.3, -0.1])
    return dt, q, R, x0, P0, z, linear_filter(F, Q, H, R, z, x0, P0)


@pytest.mark.crosscheck
@pytest.mark.consistency
@pytest.mark.parametrize("resampling", ["systematic", "stratified", "residual", "multinomial"])
def test_linear_gaussian_system(resampling):
    dt, q, R, x0, P0, z, exact = linear_run()
    pf = ParticleFilter(20_000, prior=Gaussian(x0, P0), state="position_velocity2", seed=5, resampling=resampling)
    run = pf.run(
        dt * np.arange(1, len(z) + 1),
        process.NearlyConstantVelocity(q),
        Measured(measurement.Position(2), z, R=R),
        start_s=0.0,
    )
    assert np.all(run.status == ParticleStatus.ACCEPTED)
    sigma = np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
    # Means of 20 000 particles, resampled again and again, lie within a few hundredths of a sigma.
    assert np.sqrt(np.mean(((run.mean - exact.x) / sigma) ** 2)) < 0.04
    assert np.max(np.abs(run.mean - exact.x) / sigma) < 0.2
    ratio = np.diagonal(run.covariance, axis1=1, axis2=2) / sigma**2
    assert np.abs(ratio - 1.0).mean() < 0.05
    assert run.log_likelihood == pytest.approx(exact.log_likelihood, abs=0.6)


@pytest.mark.crosscheck
def test_wrong_resampling_is_noticed():
    dt, q, R, x0, P0, z, exact = linear_run()
    pf = ParticleFilter(
        20_000, prior=Gaussian(x0, P0), state="position_velocity2", seed=5, resampling="nearest", ess_threshold=1.0
    )
    run = pf.run(
        dt * np.arange(1, len(z) + 1), process.NearlyConstantVelocity(q),
        Measured(measurement.Position(2), z, R=R), start_s=0.0,
    )  # fmt: skip
    sigma = np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
    assert np.sqrt(np.mean(((run.mean - exact.x) / sigma) ** 2)) > 0.04


@pytest.mark.crosscheck
def test_models_of_your_own_are_the_built_in_ones():
    """The same normals move the same particles, so only rounding is left."""
    ours, theirs = room_filter(), room_filter()
    for k in range(4):
        z = distances() + 0.05 * k

        def log_likelihood(x, z=z):
            off = (z - np.linalg.norm(x[:, None] - CORNERS, axis=2)) / 0.4
            return -0.5 * np.sum(off**2 + np.log(2.0 * np.pi * 0.16), axis=1)

        built_in = ours.step(ranges(), z, 0.4, process=WALK, dt_s=1.0)
        own = theirs.step(log_likelihood, process=lambda x, w: x + 0.1 * w)
        assert own.resampled == built_in.resampled
        assert own.log_likelihood == pytest.approx(built_in.log_likelihood, rel=1e-9)
        np.testing.assert_allclose(theirs.particles, ours.particles, rtol=1e-12)
        np.testing.assert_allclose(theirs.weights, ours.weights, rtol=1e-7, atol=1e-12)


# ---- the same bits


@pytest.mark.law
@pytest.mark.parametrize("resampling", ["systematic", "multinomial"])
def test_threads_do_not_change_a_bit(resampling):
    results = []
    for threads in (1, 2, 3):
        pf = room_filter(5000, threads=threads, resampling=resampling)
        pf.run(np.arange(6.0), WALK, Measured(ranges(), np.tile(distances(), (6, 1)), 0.3))
        results.append((everything(pf), pf.mean.tobytes(), pf.covariance.tobytes()))
    assert results[0] == results[1] == results[2]


@pytest.mark.law
def test_a_run_is_its_steps():
    T = 8
    z = np.tile(distances(), (T, 1)) + 0.01 * np.arange(T)[:, None]
    mask = np.array([True, True, False, True, False, False, True, True])
    one, many = room_filter(), room_filter()
    run = one.run(0.5 * np.arange(T), WALK, Measured(ranges(), z, 0.3, mask=mask))
    for k in range(T):
        if not mask[k]:
            report = many.predict(WALK, 0.5)
        elif k == 0:
            report = many.step(ranges(), z[k], 0.3)
        else:
            report = many.step(ranges(), z[k], 0.3, process=WALK, dt_s=0.5)
        np.testing.assert_array_equal(run.mean[k], many.mean)
        np.testing.assert_array_equal(run.covariance[k], many.covariance)
        assert run.ess[k] == report.ess
        assert run.step_log_likelihood[k] == report.log_likelihood
        assert run.resampled[k] == report.resampled
    assert everything(one) == everything(many)
    assert repr(run).startswith("ParticleRun(8 steps, 2 states, 8 accepted")
    assert run.log_likelihood == pytest.approx(one.log_likelihood)


@pytest.mark.law
def test_several_sensors_are_one_with_more_rows():
    z, R = np.tile(distances(), (3, 1)), np.diag([0.1, 0.2, 0.3, 0.4])
    together, apart, full = room_filter(), room_filter(), room_filter()
    together.run(np.arange(3.0), WALK, Measured(ranges(), z, np.sqrt(np.diag(R))))
    two = [Measured(ranges()[rows], z[:, rows], R=R[rows, rows]) for rows in (slice(0, 2), slice(2, 4))]
    apart.run(np.arange(3.0), WALK, two)
    full.run(np.arange(3.0), WALK, Measured(ranges(), z, R=np.tile(R, (3, 1, 1))))
    for other in (apart, full):
        np.testing.assert_allclose(other.weights, together.weights, rtol=1e-9)
        np.testing.assert_array_equal(other.particles, together.particles)


@pytest.mark.law
def test_start_of_a_run():
    """With the time of the prior the first step moves as well."""
    a, b = room_filter(), room_filter()
    a.run([2.0], WALK, Measured(ranges(), distances()[None], 0.3), start_s=1.5)
    b.step(ranges(), distances(), 0.3, process=WALK, dt_s=0.5)
    assert everything(a) == everything(b)


@pytest.mark.law
@pytest.mark.parametrize("precision", ["double", "float"])
def test_kept_and_taken_up_again(precision, tmp_path):
    pf = room_filter(precision=precision, recovery="restart")
    pf.constrain(inside=[(0.0, 9.0), (0.0, 9.0)])
    pf.step(ranges(), [1e200] * 4, 0.1)
    pf.step(ranges(), distances(), 0.3, process=WALK)
    pf.predict(lambda x, w: x + 0.1 * w)
    np.savez(tmp_path / "saved.npz", **pf.save())
    others = [pickle.loads(pickle.dumps(pf)), copy.copy(pf), copy.deepcopy(pf)]
    restored = room_filter(precision=precision, recovery="restart")
    restored.constrain(inside=[(0.0, 9.0), (0.0, 9.0)])
    restored.restore(np.load(tmp_path / "saved.npz"))
    others.append(restored)
    assert len({everything(other) for other in [pf, *others]}) == 1
    after = set()
    for other in [pf, *others]:
        other.step(ranges(), distances(), 0.2, process=WALK)
        other.step(ranges(), [1e200] * 4, 0.1)
        after.add(everything(other))
    assert len(after) == 1


@pytest.mark.law
def test_two_threads_may_call_one_filter():
    """Calls are done one after the other: two hundred equal steps give the same bits whoever calls."""

    def steps(pf, count):
        for _ in range(count):
            pf.step(ranges(), distances(), 0.3, process=WALK)

    alone, shared = room_filter(3000), room_filter(3000)
    steps(alone, 200)
    callers = [threading.Thread(target=steps, args=(shared, 100)) for _ in range(2)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert everything(alone) == everything(shared)


# ---- what is refused, and what recovers


@pytest.mark.unit
@pytest.mark.parametrize(
    ("z", "noise", "status"),
    [
        ([np.nan, 1.0, 1.0, 1.0], {"sigma": 0.3}, ParticleStatus.NON_FINITE),
        ([np.inf, 1.0, 1.0, 1.0], {"sigma": 0.3}, ParticleStatus.NON_FINITE),
        ([1.0] * 4, {"sigma": np.nan}, ParticleStatus.NON_FINITE),
        ([1.0] * 4, {"sigma": 0.0}, ParticleStatus.NOT_POSITIVE_DEFINITE),
        ([1.0] * 4, {"sigma": [0.3, -0.3, 0.3, 0.3]}, ParticleStatus.NOT_POSITIVE_DEFINITE),
        ([1.0] * 4, {"R": np.full((4, 4), 1.0)}, ParticleStatus.NOT_POSITIVE_DEFINITE),
        ([1.0] * 4, {"R": np.diag([1.0, 1.0, 1.0, -1.0])}, ParticleStatus.NOT_POSITIVE_DEFINITE),
        ([1.0] * 4, {"R": np.eye(4) + np.triu(np.ones((4, 4)), 1)}, ParticleStatus.NOT_POSITIVE_DEFINITE),
        ([1.0] * 4, {"R": np.full((4, 4), np.nan)}, ParticleStatus.NON_FINITE),
    ],
)
def test_a_refused_measurement_changes_nothing(z, noise, status):
    pf = room_filter(300)
    pf.update(ranges(), distances(), 1.0)
    before = everything(pf)
    for refused in (
        pf.update(ranges(), z, **noise),
        pf.step(ranges(), z, **noise),
        pf.step(ranges(), z, **noise, process=WALK),
    ):
        assert refused.status is status
        assert not refused.accepted
        assert np.isnan(refused.log_likelihood)
        assert everything(pf) == before
    run = pf.run([0.0], None, Measured(ranges(), [z], **noise))
    assert run.status[0] == status
    assert everything(pf) == before


@pytest.mark.unit
@pytest.mark.parametrize("dt_s", [0.0, -1.0, np.nan, np.inf])
def test_time_must_advance(dt_s):
    pf = room_filter(300)
    before = everything(pf)
    assert pf.predict(WALK, dt_s).status is ParticleStatus.TIME_NOT_ADVANCING
    assert pf.step(ranges(), distances(), 1.0, process=WALK, dt_s=dt_s).status is ParticleStatus.TIME_NOT_ADVANCING
    assert everything(pf) == before


@pytest.mark.unit
def test_too_many_correlated_rows():
    pf = room_filter(300)
    models = ranges() * 5
    assert pf.update(models, [1.0] * 20, R=np.eye(20)).status is ParticleStatus.TOO_MANY_ROWS
    assert pf.update(models, np.tile(distances(), 5), 1.0).accepted


@pytest.mark.unit
@pytest.mark.parametrize("moving", [False, True])
def test_when_every_weight_vanishes_the_cloud_is_kept(moving):
    pf = room_filter(300)
    pf.update(ranges(), distances(), 1.0)
    weights = pf.weights
    options = {"process": WALK} if moving else {}
    for attempt in (
        pf.step(ranges(), [1e200] * 4, 0.1, **options),  # weights are logarithms: only an overflow ends them
        pf.step(lambda x: np.full(len(x), -np.inf), **options),
        pf.step(lambda x: np.full(len(x), np.nan), **options),
    ):
        assert attempt.status is ParticleStatus.DEGENERATE
        assert attempt.log_likelihood == -np.inf
        assert np.all(np.isfinite(pf.mean))
        assert np.all(np.isfinite(pf.weights))
        assert pf.weights.sum() == pytest.approx(1.0)
    assert pf.reweight(np.full(300, -np.inf)).status is ParticleStatus.DEGENERATE
    assert np.isfinite(pf.log_likelihood)
    assert weights.shape == (300,)
    assert pf.step(ranges(), distances(), 1.0, **options).accepted


@pytest.mark.unit
def test_when_every_weight_vanishes_it_may_restart():
    pf = room_filter(4000, recovery="restart")
    lost = HERE + np.array([4.0, -4.0])
    for _ in range(5):
        pf.step(ranges(), distances(), 0.05, process=process.RandomWalk(1e-4))
    assert np.all(np.diag(pf.covariance) < 0.01)
    report = pf.step(lambda x: np.where(np.all(np.abs(x - lost) < 1.0, axis=1), 0.0, -np.inf))
    assert report.status is ParticleStatus.DEGENERATE
    assert np.all(np.diag(pf.covariance) > 5.0)
    assert pf.ess == pytest.approx(4000.0)
    assert not np.array_equal(pf.particles, room_filter(4000).particles)
    assert pf.step(ranges(), distances(lost), 0.3, process=process.RandomWalk(1e-4)).accepted
    np.testing.assert_allclose(pf.mean, lost, atol=0.5)


@pytest.mark.unit
def test_particles_that_go_astray_stay_and_lose_their_weight():
    pf = room_filter(300)
    before = pf.particles

    def some_lost(x, w):
        x = x + 1.0
        x[::3] = np.nan
        return x

    assert pf.predict(some_lost).accepted
    np.testing.assert_array_equal(pf.particles[::3], before[::3])
    np.testing.assert_array_equal(pf.weights[::3], 0.0)
    np.testing.assert_array_equal(pf.particles[1::3], before[1::3] + 1.0)
    pf = room_filter(300)
    assert pf.predict(lambda x, w: np.full_like(x, np.inf)).status is ParticleStatus.DEGENERATE
    np.testing.assert_array_equal(pf.particles, before)
    assert np.all(np.isfinite(pf.mean))


@pytest.mark.unit
def test_exceptions_of_your_functions_leave_the_filter_as_it_was():
    pf = room_filter(300)
    pf.update(ranges(), distances(), 0.5)
    before = everything(pf)

    def broken(*_):
        raise KeyError("mine")

    for call in (
        lambda: pf.predict(broken),
        lambda: pf.step(broken),
        lambda: pf.step(broken, process=WALK),
        lambda: pf.step(broken, process=lambda x, w: x),
    ):
        with pytest.raises(KeyError, match="mine"):
            call()
        assert everything(pf) == before
    with pytest.raises(ValueError, match=r"log_likelihood: shape \(2,\), expected \(300,\)"):
        pf.step(lambda x: [0.0, 1.0], process=WALK)
    with pytest.raises(ValueError, match=r"process: returned shape \(300,\), expected \(300, 2\)"):
        pf.predict(lambda x, w: x[:, 0])
    assert everything(pf) == before


# ---- walls


@pytest.mark.law
def test_nobody_leaves_through_walls():
    """A door in the middle wall: particles come through it and nowhere else."""
    walls = [[[0, 0], [10, 0]], [[10, 0], [10, 10]], [[10, 10], [0, 10]], [[0, 10], [0, 0]],
             [[5, 0], [5, 4]], [[5, 6], [5, 10]]]  # fmt: skip
    pf = ParticleFilter(3000, prior=Uniform([(0.0, 5.0), (0.0, 10.0)]), seed=4, ess_threshold=1.0)
    pf.constrain(walls=walls)
    through = 0
    for _ in range(40):
        pf.resample()
        before = pf.particles
        report = pf.predict(process.RandomWalk(0.3))
        assert report.accepted
        assert report.log_likelihood < 0.0  # the share that walked into walls
        after, alive = pf.particles, pf.weights > 0.0
        assert np.all((after[alive] >= 0.0) & (after[alive] <= 10.0))
        crossed = alive & ((before[:, 0] < 5.0) != (after[:, 0] < 5.0))
        share = (5.0 - before[crossed, 0]) / (after[crossed, 0] - before[crossed, 0])
        y = before[crossed, 1] + share * (after[crossed, 1] - before[crossed, 1])
        assert np.all((y > 4.0) & (y < 6.0))
        through += np.count_nonzero(crossed)
    assert through > 100
    assert np.mean(pf.particles[pf.weights > 0.0, 0] > 5.0) > 0.05


@pytest.mark.unit
def test_a_box_holds_at_once_and_at_every_step():
    box = np.array([(2.0, 8.0), (-np.inf, 5.0)])
    pf = room_filter(4000)
    assert pf.constrain(inside=box).log_likelihood == pytest.approx(np.log(0.3), abs=0.15)
    for k in range(3):
        pf.step(ranges()[:1], 5.0, 2.0, process=process.RandomWalk(1.0))
        pf.update(ranges()[1], 6.0, 2.0)
        alive = pf.particles[pf.weights > 0.0]
        assert np.all((alive >= box[:, 0]) & (alive <= box[:, 1])), k
    assert pf.constrain(inside=[(20.0, 30.0), (0.0, 1.0)]).status is ParticleStatus.DEGENERATE
    assert pf.constrain().accepted
    assert pf.step(ranges(), distances(), 1.0, process=WALK).accepted


# ---- errors that name the argument


def bad_prior(prior, **options):
    return lambda: ParticleFilter(10, prior=prior, **options)


FLAT = Gaussian(np.zeros(2), np.eye(2))


@pytest.mark.unit
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ParticleFilter(0, prior=FLAT), "count: 0 is not in 1"),
        (lambda: ParticleFilter(2.5, prior=FLAT), "count: an integer expected, got float"),
        (bad_prior(FLAT, seed=-1), "seed: -1"),
        (bad_prior(FLAT, threads=0), "threads: 0"),
        (bad_prior(FLAT, resampling="random"), "resampling: 'random' is none of"),
        (bad_prior(FLAT, ess_threshold=1.5), "ess_threshold"),
        (bad_prior(FLAT, ess_threshold=np.nan), "ess_threshold"),
        (bad_prior(FLAT, precision="half"), "precision: 'half' is none of"),
        (bad_prior(Gaussian(np.zeros(3), np.eye(3)), precision="float"), "precision"),
        (bad_prior(FLAT, recovery="pray"), "recovery: 'pray' is none of"),
        (bad_prior(FLAT, state="position7"), "position7"),
        (bad_prior(FLAT, state="pose2"), "pose2"),
        (bad_prior(FLAT, state=("a",)), "state: 1 names; the prior has 2"),
        (bad_prior((0, 1)), "prior: Gaussian, Uniform or Samples expected, got tuple"),
        (bad_prior(Gaussian(np.zeros(9), np.eye(9))), "9 numbers"),
        (bad_prior(Gaussian([np.nan, 0.0], np.eye(2))), "x0"),
        (bad_prior(Gaussian(np.zeros(2), np.eye(3))), r"prior.P0: shape \(3, 3\), expected \(2, 2\)"),
        (bad_prior(Gaussian(np.zeros(2), -np.eye(2))), "P0"),
        (bad_prior(Gaussian(np.zeros(2), [[1.0, 0.5], [0.0, 1.0]])), "P0"),
        (bad_prior(Gaussian(np.zeros(2), np.full((2, 2), np.nan))), "P0"),
        (bad_prior(Uniform([1.0, 0.0], [0.0, 1.0])), r"low\[0\]"),
        (bad_prior(Uniform([0.0, 0.0], [np.inf, 1.0])), "high"),
        (bad_prior(Uniform([0.0, 0.0], [1.0])), r"prior.high: shape \(1,\)"),
        (bad_prior(Uniform([0.0, 0.0])), r"prior.low: shape \(2,\); \(n, 2\) expected"),
        (bad_prior(Samples(np.zeros((9, 2)))), "samples: 9 rows, expected count = 10"),
        (bad_prior(Samples(np.zeros((0, 2)))), "not empty"),
        (bad_prior(Samples(np.full((10, 2), np.nan))), "particles"),
    ],
)  # fmt: skip
def test_filters_that_cannot_be(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.unit
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda pf: pf.update(ranges(), [1.0, 2.0], 1.0), "z: 2 numbers; the model has 4 rows"),
        (lambda pf: pf.update(ranges()[0], 1.0), "sigma, R: one of them expected, got none"),
        (lambda pf: pf.update(ranges()[0], 1.0, 1.0, R=1.0), "sigma, R: one of them expected, got both"),
        (lambda pf: pf.update(ranges(), [1.0] * 4, [1.0, 1.0]), r"sigma: shape \(2,\)"),
        (lambda pf: pf.update(ranges(), [1.0] * 4, R=np.eye(3)), r"R: shape \(3, 3\), expected \(4, 4\)"),
        (lambda pf: pf.update([], [], 1.0), "model: no measurement model"),
        (lambda pf: pf.update("range", 1.0, 1.0), "model: a measurement model expected, got str"),
        (lambda pf: pf.update(measurement.Pseudorange([0.0, 0.0]), 1.0, 1.0), "clock bias"),
        (lambda pf: pf.update(measurement.Range([0.0, 0.0, 0.0]), 1.0, 1.0), "position"),
        (lambda pf: pf.update(ranges()[0], 1.0, 1.0, outlier_probability=2.0), "outlier_probability: 2.0"),
        (lambda pf: pf.update(ranges()[0], 1.0, 1.0, outlier_probability=0.1), "outlier_density: 0.0"),
        (lambda pf: pf.update(ranges()[0], 1.0, R=1.0, outlier_probability=0.1, outlier_density=1.0), "not with R"),
        (lambda pf: pf.step(ranges()[0]), "z: expected"),
        (lambda pf: pf.step(lambda x: x[:, 0], 1.0), "not with a likelihood of your own"),
        (lambda pf: pf.predict(process.NearlyConstantVelocity(1.0)), "velocity"),
        (lambda pf: pf.predict(process.RandomWalk([1.0, 2.0, 3.0])), "psd"),
        (lambda pf: pf.predict("walk"), "process: a process model or a callable expected, got str"),
        (lambda pf: pf.predict(WALK, 1.0, [1.0]), "input"),
        (lambda pf: pf.predict(lambda x, w: x, input=[1.0]), "input"),
        (lambda pf: pf.predict(lambda x, w: x, noise=-1), "noise: -1"),
        (lambda pf: pf.reweight(np.zeros(7)), r"log_likelihood: shape \(7,\), expected \(300,\)"),
        (lambda pf: pf.constrain(walls=np.zeros((3, 2))), "walls: shape"),
        (lambda pf: pf.constrain(walls=np.full((1, 2, 2), np.nan)), "walls: a number is not finite"),
        (lambda pf: pf.constrain(walls=[[[0, 1], [2, 3]], [[9, 9], [9, 9]]]), r"walls\[1\]: both ends are \[9.0"),
        (lambda pf: pf.constrain(inside=[(0.0, 1.0)]), "inside: shape"),
        (lambda pf: pf.constrain(inside=[(1.0, 0.0), (0.0, 1.0)]), r"inside\[0\]"),
        (lambda pf: pf.constrain(inside=[(np.nan, 0.0), (0.0, 1.0)]), r"inside\[0\]"),
        (lambda pf: pf.histogram(2), "component: 2 is not in 0 … 1"),
        (lambda pf: pf.histogram(0, 0), "bins: 0"),
        (lambda pf: pf.histogram(0, 5, (1.0, 1.0)), "range"),
        (lambda pf: pf.run([0.0, 1.0, 1.0], WALK), r"time_s\[2\]"),
        (lambda pf: pf.run([0.0, np.nan], WALK), r"time_s\[1\]"),
        (lambda pf: pf.run([0.0], WALK, start_s=0.0), r"time_s\[0\].*start_s"),
        (lambda pf: pf.run([0.0], lambda x, w: x), "process"),
        (lambda pf: pf.run([0.0], "walk"), "process"),
        (lambda pf: pf.run([0.0], WALK, [ranges()]), r"measurements\[0\]: Measured, .* expected, got list"),
        (lambda pf: pf.run([0.0], WALK, Measured(ranges(), [[1.0]], 1.0)), r"measurements\[0\].z: shape \(1, 1\)"),
        (lambda pf: pf.run([0.0], WALK, Measured(ranges()[0], [1.0])), r"measurements\[0\].sigma, R"),
        (lambda pf: pf.run([0.0], WALK, Measured(ranges()[0], [1.0], 1.0, mask=[1])), r"measurements\[0\].mask"),
        (lambda pf: pf.run([0.0], WALK, inputs=[[1.0]]), r"inputs: shape \(1, 1\), expected \(1, 0\)"),
        (lambda pf: pf.run([0.0], WALK, Measured(measurement.Pseudorange([0.0, 0.0]), [1.0], 1.0)), "clock bias"),
        (lambda pf: pf.run([0.0, 1.0], process.NearlyConstantVelocity(1.0)), "velocity"),
        (lambda pf: pf.restore({}), "saved: no particles"),
        (lambda pf: pf.restore(room_filter(20).save()), "particles"),
        (lambda pf: pf.restore(pf.save() | {"log_weights": np.full(300, -np.inf)}), "log_weights"),
        (lambda pf: pf.restore(pf.save() | {"particles": np.full((300, 2), np.nan)}), "not finite"),
    ],
)  # fmt: skip
def test_calls_that_cannot_be(call, words):
    pf = room_filter(300)
    before = everything(pf)
    with pytest.raises(ValueError, match=words):
        call(pf)
    assert everything(pf) == before
