"""Measurement models from Python: values, Jacobians, refusals."""

import copy
import pickle

import numpy as np
import pytest

from soopnav_cpp import measurement

Q2, R2 = [30.0, -40.0], [-5.0, 8.0]
Q3, R3 = [30.0, -40.0, 12.0], [-5.0, 8.0, 3.0]
C = 299_792_458.0

PVC3 = [1.0, 2.0, 3.0, 4.0, -5.0, 6.0, 70.0, 0.8]
INERTIAL = [0.3, 4.0, -5.0, 1.0, 2.0]

# Every model with a state that it reads.
MODELS = [
    (measurement.Position(1), "position1", [4.0]),
    (measurement.Position(2), "pose2", [1.0, 2.0, 0.3]),
    (measurement.Position(3), "position_velocity3", PVC3[:6]),
    (measurement.Range(Q2), "planar_inertial", INERTIAL),
    (measurement.Range(Q3), "position_velocity_clock3", PVC3),
    (measurement.RangeDifference(Q2, R2), "planar_inertial", INERTIAL),
    (measurement.RangeDifference(Q3, R3), "position3", PVC3[:3]),
    (measurement.Pseudorange(Q2, source_clock_m=3.0), "position_clock2", [1.0, 2.0, 70.0]),
    (measurement.Pseudorange(Q3), "position_velocity_clock3", PVC3),
    (measurement.Tdoa(Q2, R2, reference_clock_m=2.0), "position2", [1.0, 2.0]),
    (measurement.Tdoa(Q3, R3, receiver_clock_m=None), "position_clock3", [1.0, 2.0, 3.0, 70.0]),
    (measurement.RangeRate(Q2, receiver_drift_mps=0.5), "position_velocity2", [1.0, 2.0, 4.0, -5.0]),
    (measurement.RangeRate(Q3, source_velocity_mps=[1.0, 2.0, 3.0]), "position_velocity_clock3", PVC3),
    (measurement.Doppler(Q3, 1.5e9), "position_velocity_clock3", PVC3),
    (measurement.Doppler(Q2, 1.5e9, receiver_drift_mps=0.0), "coordinated_turn", [1.0, 2.0, 4.0, -5.0, 0.1]),
    (measurement.Fdoa(Q3, R3, 1.5e9), "position_velocity3", PVC3[:6]),
    (measurement.Fdoa(Q2, R2, 1.5e9, receiver_drift_mps=None), "position_velocity_clock2", [1, 2, 4, -5, 70, 0.8]),
    (measurement.Azimuth(Q2), "position2", [1.0, 2.0]),
    (measurement.Azimuth(Q2, heading_rad=None), "pose2", [1.0, 2.0, 0.3]),
    (measurement.Azimuth(Q3, heading_rad=0.2), "position3", PVC3[:3]),
    (measurement.Elevation(Q3), "position3", PVC3[:3]),
    (measurement.AzimuthElevation(Q3), "position_velocity_clock3", PVC3),
    (measurement.ReceivedPower(Q2, -40.0, exponent=2.7), "position2", [1.0, 2.0]),
    (measurement.ReceivedPower(Q3, -40.0, reference_distance_m=3.0), "position3", PVC3[:3]),
    (measurement.CarrierPhase(Q2, 0.19, ambiguity_cycles=5.5), "position_velocity_bias2", [1.0, 2.0, 4.0, -5.0, 70.0]),
    (measurement.CarrierPhase(Q3, 0.19), "position_clock3", [1.0, 2.0, 3.0, 70.0]),
    (measurement.PlanarIncrement([1.0, -1.0], 0.4), "pose2", [3.0, 2.0, 0.9]),
]
IDS = [f"{model.kind}-{state}" for model, state, _ in MODELS]


@pytest.mark.jacobian
@pytest.mark.parametrize(("model", "state", "x"), MODELS, ids=IDS)
def test_jacobian_is_the_derivative(model, state, x):
    x = np.asarray(x, float)
    h, H = model.predict(state, x)
    assert h.shape == (model.rows,)
    assert H.shape == (model.rows, len(x))
    step = 1e-5 * np.maximum(1.0, np.abs(x))
    for j, e in enumerate(np.diag(step)):
        slope = (model.predict(state, x + e)[0] - model.predict(state, x - e)[0]) / (2.0 * step[j])
        np.testing.assert_allclose(H[:, j], slope, rtol=1e-6, atol=1e-6 * max(1.0, np.abs(H).max()))
    assert np.abs(H).max() > 0.0


@pytest.mark.unit
def test_values_are_those_of_the_formulas():
    p, v, b, d = np.array(PVC3[:3]), np.array(PVC3[3:6]), PVC3[6], PVC3[7]
    q, r = np.array(Q3), np.array(R3)
    far, near = np.linalg.norm(p - q), np.linalg.norm(r - q)
    u = (p - q) / far
    state = "position_velocity_clock3"

    def value(model):
        return model.predict(state, PVC3)[0]

    def close(model, *expected):
        np.testing.assert_allclose(value(model), expected, rtol=1e-13)

    close(measurement.Position(3), *p)
    close(measurement.Range(q), far)
    close(measurement.RangeDifference(q, r), far - near)
    close(measurement.Pseudorange(q, source_clock_m=4.0), far + b - 4.0)
    close(measurement.Tdoa(q, r, receiver_clock_m=1.0, reference_clock_m=3.0), far - near - 2.0)
    close(measurement.Tdoa(q, r, receiver_clock_m=None), far - near + b)
    close(measurement.RangeRate(q, source_velocity_mps=[1.0, 1.0, 0.0]), u @ (v - [1.0, 1.0, 0.0]) + d)
    close(measurement.RangeRate(q, receiver_drift_mps=0.0, source_drift_mps=2.0), u @ v - 2.0)
    close(measurement.Doppler(q, 2e9), -(u @ v + d) * 2e9 / C)
    close(measurement.Fdoa(q, r, 2e9), -(u @ v) * 2e9 / C)
    east, north, up = q - p
    close(measurement.Azimuth(q, heading_rad=0.1), np.arctan2(east, north) - 0.1)
    close(measurement.Elevation(q), np.arctan2(up, np.hypot(east, north)))
    close(measurement.AzimuthElevation(q), np.arctan2(east, north), np.arctan2(up, np.hypot(east, north)))
    close(measurement.ReceivedPower(q, -30.0, exponent=3.0), -30.0 - 30.0 * np.log10(far))
    close(measurement.CarrierPhase(q, 0.25, ambiguity_cycles=7.0, source_clock_m=1.0), (far + b - 1.0) / 0.25 + 7.0)
    dx, dy = 3.0 - 1.0, 2.0 + 1.0
    c, s = np.cos(0.4), np.sin(0.4)
    np.testing.assert_allclose(
        measurement.PlanarIncrement([1.0, -1.0], 0.4).predict("pose2", [3.0, 2.0, 0.9])[0],
        [c * dx + s * dy, c * dy - s * dx, 0.5],
        rtol=1e-13,
    )
    bearing = measurement.Azimuth([0.0, 10.0], heading_rad=None).predict("pose2", [0.0, 0.0, 0.5])[0]
    np.testing.assert_allclose(bearing, [np.pi / 2 - 0.5])


@pytest.mark.unit
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: measurement.Range([1.0]), "source_m: expected 2 or 3 numbers, got 1"),
        (lambda: measurement.Range([1.0, np.nan]), r"source_m\[1\] is nan"),
        (lambda: measurement.Range([[1.0, 2.0]]), "source_m: .*shape"),
        (lambda: measurement.Range("north"), "source_m: expected numbers"),
        (lambda: measurement.RangeDifference(Q2, R3), "reference_m: expected 2 numbers, got 3"),
        (lambda: measurement.Pseudorange(Q2, source_clock_m=np.inf), "source_clock_m is inf"),
        (lambda: measurement.Pseudorange(Q2, source_clock_m=[1.0, 2.0]), "source_clock_m: expected 1 number"),
        (lambda: measurement.Doppler(Q2, 0.0), "carrier_hz: 0 is not positive"),
        (lambda: measurement.RangeRate(Q3, source_velocity_mps=[1.0, 2.0]), "source_velocity_mps: expected 3"),
        (lambda: measurement.Elevation(Q2), "source_m: expected 3 numbers"),
        (lambda: measurement.Azimuth(Q3, heading_rad=None), "heading_rad: .*source_m of 2 numbers"),
        (lambda: measurement.ReceivedPower(Q2, -40.0, reference_distance_m=-1.0), "reference_distance_m: -1"),
        (lambda: measurement.CarrierPhase(Q2, 0.0), "wavelength_m: 0 is not positive"),
        (lambda: measurement.PlanarIncrement(Q3, 0.0), "previous_position_m: expected 2 numbers"),
        (lambda: measurement.Position(4), "dim: 4 is not 1, 2 or 3"),
        (lambda: measurement.Measurement("Smell", []), "kind: no measurement model 'Smell'|source_m: missing"),
    ],
)
def test_bad_parameters_are_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.unit
def test_a_state_without_what_a_model_reads_is_told_so():
    with pytest.raises(ValueError, match=r"Pseudorange reads .*clock bias.*'position2'.*position_clock2"):
        measurement.Pseudorange(Q2).predict("position2", [1.0, 2.0])
    with pytest.raises(ValueError, match="a position of 2 components"):
        measurement.Range(Q2).predict("position3", [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="clock drift"):
        measurement.RangeRate(Q2).predict("position_velocity2", [1.0, 2.0, 3.0, 4.0])
    with pytest.raises(ValueError, match="no 'velocity'; there are position1"):
        measurement.Range(Q2).predict("velocity", [1.0, 2.0])
    with pytest.raises(ValueError, match="3 numbers, but state 'position2' has 2"):
        measurement.Range(Q2).predict("position2", [1.0, 2.0, 3.0])


@pytest.mark.unit
def test_undefined_on_top_of_the_source():
    with pytest.raises(ValueError, match="Range is undefined"):
        measurement.Range(Q2).predict("position2", Q2)


@pytest.mark.unit
@pytest.mark.parametrize("model", [model for model, _, _ in MODELS], ids=IDS)
def test_pickles_compares_and_shows_itself(model):
    again = pickle.loads(pickle.dumps(model))
    assert again == model
    assert hash(again) == hash(model)
    assert copy.deepcopy(model) == model
    assert repr(again) == repr(model)
    assert repr(model).startswith(model.kind + "(")


@pytest.mark.unit
def test_repr_reads_as_written():
    assert repr(measurement.Range([1.0, 2.5])) == "Range(source_m=[1, 2.5])"
    assert measurement.Range([1.0, 2.0]) != measurement.Range([1.0, 2.5])
