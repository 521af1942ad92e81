"""Process models from Python: steps, transitions, noise, refusals."""

import pickle

import numpy as np
import pytest

from soopnav_cpp import process

PV2 = [1.0, 2.0, 3.0, -4.0]
CLOCK = (0.2, 0.03)
CASES = [
    (process.RandomWalk(0.3), "position2", [1.0, 2.0], None),
    (process.RandomWalk([0.1, 0.2, 0.3, 0.4]), "position_velocity", PV2, None),
    (process.NearlyConstantVelocity(0.5), "position_velocity1", [1.0, 2.0], None),
    (process.NearlyConstantVelocity([0.5, 0.1]), "position_velocity2", PV2, None),
    (
        process.NearlyConstantVelocity(0.5, diffusion_psd=[0, 0, 0, 0, 0.3]),
        "position_velocity_bias2",
        [*PV2, 7.0],
        None,
    ),
    (process.NearlyConstantVelocity(0.5, clock=CLOCK), "position_velocity_clock2", [*PV2, 7.0, 0.5], None),
    (process.NearlyConstantVelocity(0.5, clock=CLOCK), "position_velocity_clock3", [1, 2, 3, 4, 5, 6, 7, 0.5], None),
    (process.PiecewiseConstantAcceleration(0.5), "position_velocity3", [1, 2, 3, 4, 5, 6], None),
    (process.CoordinatedTurn(0.5, 0.01), "coordinated_turn", [*PV2, 0.4], None),
    (
        process.PlanarMechanization(gyro_sigma_radps=0.01, accelerometer_sigma_mps2=0.1),
        "planar_inertial",
        [0.3, 3.0, -4.0, 1.0, 2.0],
        [0.1, 0.5, -0.2],
    ),
    (
        process.PlanarMechanization(accelerometer_sigma_mps2=0.1, integration="euler", diffusion_psd=1e-3),
        "planar_inertial",
        [0.3, 3.0, -4.0, 1.0, 2.0],
        [0.1, 0.5, -0.2],
    ),
    (process.PlanarOdometry(np.diag([0.1, 0.05, 0.02])), "pose2", [1.0, 2.0, 0.3], [0.5, 0.1, 0.05]),
]
IDS = [f"{model.kind}-{state}" for model, state, _, _ in CASES]


@pytest.mark.jacobian
@pytest.mark.parametrize(("model", "state", "x", "u"), CASES, ids=IDS)
def test_transition_is_the_derivative_and_noise_a_covariance(model, state, x, u):
    x, dt = np.asarray(x, float), 0.4
    assert model.input_size == (0 if u is None else 3)
    _, F, Q = model.propagate(state, x, dt, u)
    for j, e in enumerate(1e-6 * np.eye(len(x))):
        slope = (model.propagate(state, x + e, dt, u)[0] - model.propagate(state, x - e, dt, u)[0]) / 2e-6
        np.testing.assert_allclose(F[:, j], slope, atol=1e-8)
    np.testing.assert_allclose(Q, Q.T)
    assert np.linalg.eigvalsh(Q).min() > -1e-12
    assert np.trace(Q) > 0.0


@pytest.mark.unit
def test_nearly_constant_velocity_and_clock_are_exact():
    dt, q = 0.7, 0.5
    x, F, Q = process.NearlyConstantVelocity(q, clock=CLOCK).propagate("position_velocity_clock2", [*PV2, 7.0, 0.5], dt)
    block = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    for axis in (0, 1):
        np.testing.assert_allclose(Q[np.ix_([axis, axis + 2], [axis, axis + 2])], block)
    clock = [[0.2 * dt + 0.03 * dt**3 / 3, 0.03 * dt**2 / 2], [0.03 * dt**2 / 2, 0.03 * dt]]
    np.testing.assert_allclose(Q[4:, 4:], clock)
    np.testing.assert_allclose(x, [1.0 + 3.0 * dt, 2.0 - 4.0 * dt, 3.0, -4.0, 7.0 + 0.5 * dt, 0.5])
    assert F[4, 5] == dt
    assert np.count_nonzero(Q[:4, 4:]) == 0


@pytest.mark.law
@pytest.mark.parametrize("k", [0, 1, 2, 4, 5, 8])
def test_two_half_steps_are_one(k):
    model, state, x, _ = CASES[k]
    x, dt = np.asarray(x, float), 0.8
    whole = model.propagate(state, x, dt)
    middle, F1, Q1 = model.propagate(state, x, dt / 2)
    end, F2, Q2 = model.propagate(state, middle, dt / 2)
    np.testing.assert_allclose(end, whole[0], rtol=1e-12)
    if model.kind != "CoordinatedTurn":  # there the noise is linearised in each step
        np.testing.assert_allclose(F2 @ F1, whole[1], rtol=1e-12)
        np.testing.assert_allclose(F2 @ Q1 @ F2.T + Q2, whole[2], rtol=1e-12, atol=1e-15)


@pytest.mark.unit
def test_headings_stay_within_a_turn():
    model = process.PlanarOdometry(np.eye(3))
    assert model.propagate("pose2", [0.0, 0.0, 3.0], 1.0, [0.0, 0.0, 0.5])[0][2] == pytest.approx(3.5 - 2 * np.pi)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: process.RandomWalk(-1.0), "psd: -1 is negative"),
        (lambda: process.RandomWalk([0.1, -1.0]), r"psd\[1\]: -1 is negative"),
        (lambda: process.RandomWalk(np.nan), "psd is nan"),
        (lambda: process.RandomWalk("fast"), "psd: expected numbers"),
        (lambda: process.NearlyConstantVelocity(-1.0), "acceleration_psd: -1 is negative"),
        (lambda: process.NearlyConstantVelocity(1.0, clock=[1.0]), "clock: expected 2 numbers"),
        (lambda: process.NearlyConstantVelocity(1.0, clock=[1.0, -2.0]), r"clock\[1\]: -2 is negative"),
        (lambda: process.NearlyConstantVelocity(1.0, diffusion_psd=np.inf), "diffusion_psd is inf"),
        (lambda: process.CoordinatedTurn(0.1, -0.1), "turn_rate_psd: -0.1 is negative"),
        (lambda: process.PlanarMechanization(gyro_sigma_radps=-1.0), "gyro_sigma_radps: -1 is negative"),
        (lambda: process.PlanarMechanization(integration="simpson"), "integration: expected"),
        (lambda: process.PlanarOdometry(np.eye(2)), r"covariance: expected shape \(3, 3\)"),
        (lambda: process.PlanarOdometry(-np.eye(3)), "covariance"),
        (lambda: process.PlanarOdometry([[1.0, 2.0, 0], [0, 1, 0], [0, 0, 1]]), "covariance"),
        (lambda: process.Process("Teleport", []), "kind: no process model 'Teleport'"),
    ],
)
def test_bad_parameters_are_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.unit
@pytest.mark.parametrize(
    ("model", "state", "x", "words"),
    [
        (process.NearlyConstantVelocity(1.0), "position2", [0, 0], "moves a velocity, which state 'position2'"),
        (process.NearlyConstantVelocity([1, 2, 3]), "position_velocity2", PV2, "acceleration_psd: expected 1 or 2"),
        (process.NearlyConstantVelocity(1.0), "position_velocity_clock2", [*PV2, 0, 0], "clock: state .* give its"),
        (process.NearlyConstantVelocity(1.0, clock=(0, 0)), "position_velocity2", PV2, "clock: .* has no clock"),
        (process.CoordinatedTurn(1.0, 1.0), "position_velocity2", PV2, "a turn rate"),
        (process.PlanarMechanization(), "pose2", [0, 0, 0], "a heading and a velocity"),
        (process.PlanarOdometry(np.eye(3)), "position2", [0, 0], "a heading"),
        (process.RandomWalk([1, 2, 3]), "position2", [0, 0], "psd: expected 1 or 2 numbers, got 3"),
    ],
)
def test_a_state_that_does_not_fit_is_told_so(model, state, x, words):
    with pytest.raises(ValueError, match=words):
        model.propagate(state, x, 1.0)


@pytest.mark.unit
def test_steps_and_inputs_are_checked():
    with pytest.raises(ValueError, match="dt_s"):
        process.RandomWalk(1.0).propagate("position2", [0, 0], 0.0)
    with pytest.raises(ValueError, match="input: PlanarOdometry expects 3"):
        process.PlanarOdometry(np.eye(3)).propagate("pose2", [0, 0, 0], 1.0)


@pytest.mark.unit
@pytest.mark.parametrize("model", [model for model, _, _, _ in CASES], ids=IDS)
def test_pickles_compares_and_shows_itself(model):
    again = pickle.loads(pickle.dumps(model))
    assert again == model
    assert hash(again) == hash(model)
    assert repr(again) == repr(model)
    assert repr(process.RandomWalk(0.5)) == "RandomWalk(psd=0.5)"
    assert model != process.RandomWalk(123.0)
