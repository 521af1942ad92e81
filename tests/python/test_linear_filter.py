"""Whole runs of linear systems: against stored references, and what is refused."""

import copy
import json
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.estimation import StepStatus, linear_filter, rts_smooth

VECTORS = Path(__file__).resolve().parents[2] / ".." / "shared" / "vectors" / "filters"
DT = 0.5
CV = {
    "F": np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]]),
    "Q": 0.3 * np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]]),
    "H": np.kron(np.eye(2), [[1.0, 0.0]]),
    "R": np.array([[2.0, 0.4], [0.4, 1.5]]),
    "x0": np.array([3.0, -1.0, 0.5, 2.0]),
    "P0": 10.0 * np.eye(4),
}


def measurements(steps=30, seed=1):
    return np.random.default_rng(seed).normal(size=(steps, 2)).cumsum(axis=0)


def run(**changes):
    return linear_filter(**(CV | {"z": measurements()} | changes))


def refusal(call, *args, **kwargs):
    with pytest.raises(ValueError) as caught:
        call(*args, **kwargs)
    return str(caught.value)


def reference(name):
    path = VECTORS / name
    if not path.exists():
        pytest.skip(f"the reference vectors ../shared/vectors/filters/{name} are not here")
    if path.suffix == ".npz":
        return dict(np.load(path))
    return {key: np.asarray(value) for key, value in json.loads(path.read_text()).items() if not isinstance(value, str)}


def close(actual, expected, relative):
    """Within a share of the largest number of the array."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=relative * np.abs(expected).max())


@pytest.mark.crosscheck
def test_four_states_against_another_program():
    v = reference("kf_rts_filterpy_4state.json")
    result = linear_filter(v["F"], v["Q"], v["H"], v["R"], v["z"], v["x0"], v["P0"])
    close(result.x, v["x_filt"], 1e-9)
    close(result.P, v["P_filt"], 1e-9)
    close(result.nis, v["nis"], 1e-9)
    close(result.step_log_likelihood, v["log_likelihood"], 1e-9)
    assert result.log_likelihood == pytest.approx(float(v["sum_loglik"]), rel=1e-9)
    x, P = rts_smooth(v["F"], result.x_pred, result.P_pred, result.x, result.P)
    close(x, v["x_smooth"], 1e-9)
    close(P, v["P_smooth"], 1e-9)


@pytest.mark.crosscheck
def test_fourteen_states_against_another_program():
    v = reference("joseph_14state.npz")
    result = linear_filter(v["F"], v["Q"], v["H"], v["R"], v["z"], v["x0"], v["P0"])
    for ours, theirs in (("x_pred", "x_pred"), ("P_pred", "P_pred"), ("x", "x_filt"), ("P", "P_filt")):
        close(getattr(result, ours), v[theirs], 1e-9)
    x, P = rts_smooth(v["F"], result.x_pred, result.P_pred, result.x, result.P)
    close(x, v["x_smooth"], 1e-9)
    close(P, v["P_smooth"], 1e-9)


@pytest.mark.crosscheck
def test_fourteen_states_run_on():
    """Plain subtraction goes indefinite near step 560 of this system; ours follows Joseph's full product for 2400."""
    v = reference("joseph_14state.npz")
    F, Q, H, R = (v[name] for name in "FQHR")
    rng = np.random.default_rng(560)
    z = np.vstack([v["z"], rng.normal(size=(2200, 4)) * 3.0 + v["z"][-1]])
    result = linear_filter(F, Q, H, R, z, v["x0"], v["P0"])
    P = v["P0"]
    plain = v["P0"]
    indefinite = 0
    for k in range(2400):
        P = F @ P @ F.T + Q
        K = np.linalg.solve(H @ P @ H.T + R, H @ P.T).T
        A = np.eye(14) - K @ H
        P = A @ P @ A.T + K @ R @ K.T
        if not indefinite:
            plain = F @ plain @ F.T + Q
            S = H @ plain @ H.T + R
            K = np.linalg.solve(S, (plain @ H.T).T).T
            plain = plain - K @ S @ K.T
            indefinite = k + 1 if np.linalg.eigvalsh(plain + plain.T)[0] <= 0 else 0
        assert np.abs(result.P[k] - P).max() < 1e-11 * np.abs(P).max()
    assert 450 < indefinite < 670
    assert np.linalg.eigvalsh(result.P).min() > 1e-3
    x, P = rts_smooth(F, result.x_pred, result.P_pred, result.x, result.P)
    assert np.isfinite(x).all()
    assert np.linalg.eigvalsh(P).min() > 0


@pytest.mark.unit
def test_the_result_reads_well():
    result = run(mask=np.arange(30) != 7)
    text = repr(result)
    assert text.startswith("LinearFilterResult(30 steps, 4 states, 2 measured, 29 updated, 1 no observation, mean NIS ")
    assert "(expected 2), log-likelihood -" in text
    assert result.status.dtype == np.uint8
    assert (result.status == StepStatus.UPDATED).sum() == 29
    assert StepStatus(result.status[7]) is StepStatus.NO_OBSERVATION
    assert result.log_likelihood == pytest.approx(result.step_log_likelihood.sum(), rel=1e-12)
    shapes = {name: getattr(result, name).shape for name in ("x_pred", "P", "nis", "innovation", "S")}
    assert shapes == {"x_pred": (30, 4), "P": (30, 4, 4), "nis": (30,), "innovation": (30, 2), "S": (30, 2, 2)}


@pytest.mark.unit
def test_results_are_read_only_and_can_be_kept():
    result = run()
    with pytest.raises(ValueError, match="read-only"):
        result.x[0, 0] = 1.0
    with pytest.raises(AttributeError):
        result.x = None
    for kept in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        np.testing.assert_array_equal(kept.P, result.P)
        assert kept.log_likelihood == result.log_likelihood
    P = result.P
    del result
    assert np.isfinite(P).all()


@pytest.mark.law
def test_matrices_for_each_step_equal_one_for_all():
    steps = len(measurements())
    once = run()
    each = run(**{name: np.repeat(CV[name][None], steps, axis=0) for name in "FQHR"})
    np.testing.assert_array_equal(each.P, once.P)
    np.testing.assert_array_equal(each.x, once.x)
    x, P = rts_smooth(CV["F"], once.x_pred, once.P_pred, once.x, once.P)
    x2, P2 = rts_smooth(np.repeat(CV["F"][None], steps, axis=0), once.x_pred, once.P_pred, once.x, once.P)
    np.testing.assert_array_equal(x2, x)
    np.testing.assert_array_equal(P2, P)


@pytest.mark.law
def test_shapes_that_mean_the_same():
    z = measurements()
    wide = np.zeros((30, 4))
    wide[:, ::2] = z
    np.testing.assert_array_equal(run(z=wide[:, ::2]).x, run().x)  # not contiguous
    np.testing.assert_array_equal(run(F=np.asfortranarray(CV["F"])).x, run().x)
    one = run(H=CV["H"][:1], R=CV["R"][:1, :1], z=z[:, :1])
    np.testing.assert_array_equal(run(H=CV["H"][:1], R=2.0, z=z[:, 0]).x, one.x)
    np.testing.assert_array_equal(run(H=CV["H"][:1], R=2.0, z=z[:, 0].tolist()).x, one.x)
    scalar = linear_filter(1.0, 0.5, 1.0, 2.0, np.arange(40), 0.0, 4.0)
    assert scalar.x.shape == (40, 1)
    assert scalar.P_pred[-1, 0, 0] == pytest.approx((0.5 + np.sqrt(0.25 + 4.0)) / 2, rel=1e-12)  # Riccati


@pytest.mark.law
def test_a_missing_row_is_as_if_it_were_not_measured():
    z = measurements()
    z[:, 1] = np.nan
    mask = np.isfinite(z)
    one = run(H=CV["H"][:1], R=CV["R"][:1, :1], z=z[:, :1])
    masked = run(z=z, mask=mask)
    np.testing.assert_allclose(masked.x, one.x, rtol=1e-13)
    np.testing.assert_allclose(masked.nis, one.nis, rtol=1e-12)
    assert masked.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-12)
    assert np.isnan(masked.innovation[:, 1]).all()
    assert np.isfinite(masked.S[:, 0, 0]).all()
    assert np.isnan(masked.S[:, 0, 1]).all()
    nothing = run(mask=np.zeros(30, bool))
    np.testing.assert_array_equal(nothing.x, nothing.x_pred)
    assert nothing.log_likelihood == 0.0
    assert repr(nothing) == "LinearFilterResult(30 steps, 4 states, 2 measured, 30 no observation, log-likelihood 0)"


@pytest.mark.law
def test_an_input_is_a_known_step_of_the_state():
    B = np.array([[0.125], [0.5], [0.0], [0.0]])
    u = np.linspace(-1, 1, 30)
    moved = run(B=B, u=u)
    x = CV["x0"]
    for k in range(30):
        np.testing.assert_allclose(moved.x_pred[k], CV["F"] @ x + B[:, 0] * u[k], rtol=1e-13, atol=1e-13)
        x = moved.x[k]
    np.testing.assert_array_equal(run(B=B, u=u[:, None]).x, moved.x)


@pytest.mark.unit
def test_no_steps():
    result = run(z=np.empty((0, 2)))
    assert result.x.shape == (0, 4)
    assert result.log_likelihood == 0.0
    x, P = rts_smooth(CV["F"], result.x_pred, result.P_pred, result.x, result.P)
    assert (x.shape, P.shape) == ((0, 4), (0, 4, 4))


@pytest.mark.unit
@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"F": np.eye(4)[:3]}, "F: shape (3, 4), expected (3, 3)"),
        ({"F": np.ones(4)}, "F: expected one matrix, or one for each step along the first axis, got float64 (4,)"),
        ({"F": np.ones((7, 4, 4))}, "F: 7 matrices for 30 steps; one, or one for each step, is expected"),
        ({"F": "text"}, "F: expected an array of numbers, got "),
        ({"Q": np.eye(3)}, "Q: shape (3, 3), expected (4, 4)"),
        ({"Q": -np.eye(4)}, "Q: not positive semi-definite (smallest eigenvalue -1)"),
        ({"H": np.ones((2, 5))}, "H: shape (2, 5), expected (2, 4)"),
        ({"R": np.diag([2.0, -3.1e-4])}, "R: not positive definite (smallest eigenvalue -0.00031)"),
        ({"R": np.zeros((2, 2))}, "R: not positive definite (smallest eigenvalue 0)"),
        ({"R": np.array([[2.0, 0.4], [0.3, 1.5]])}, "R: not symmetric (elements that should be equal differ by 0.1)"),
        ({"R": np.array([[np.nan, 0.0], [0.0, 1.0]])}, "R: not finite"),
        ({"P0": np.diag([1.0, 1.0, -2.0, 1.0])}, "P0: not positive semi-definite (smallest eigenvalue -2)"),
        ({"P0": np.eye(3)}, "P0: shape (3, 3), expected (4, 4)"),
        ({"x0": np.zeros(3)}, "x0: 3 numbers, expected 4"),
        ({"x0": [0.0, np.inf, 0.0, 0.0]}, "x0: not finite"),
        ({"z": np.ones((30, 3))}, "z: shape (30, 3), expected (T, 2): H has 2 rows"),
        ({"z": np.ones(30)}, "z: expected shape (T, m), got float64 (30,)"),
        ({"z": np.full((30, 2), np.nan)}, "z: step 0 is not finite"),
        ({"z": np.full((30, 2), np.nan), "mask": np.ones(30, bool)}, "z: step 0 is marked as present and not finite"),
        ({"mask": np.ones((30, 3), bool)}, "mask: shape (30, 3), expected (30, 2) or (30,)"),
        ({"mask": np.ones(30)}, "mask: expected bool, got float64"),
        ({"u": np.ones(30)}, "u: given without B"),
        ({"B": np.ones((4, 1))}, "B: given without u"),
        ({"B": np.ones((4, 2)), "u": np.ones(30)}, "u: shape (30, 1), expected (T, 2): B has 2 columns"),
        ({"B": np.ones((3, 1)), "u": np.ones(30)}, "B: shape (3, 1), expected (4, 1)"),
        ({"B": np.ones((4, 1)), "u": np.ones(29)}, "u: 29 numbers, expected 30 x 1"),
    ],
)
def test_filter_refusals(changes, sentence):
    assert refusal(run, **changes).startswith(sentence)


@pytest.mark.unit
def test_smoother_refusals():
    r = run()
    good = {"F": CV["F"], "x_pred": r.x_pred, "P_pred": r.P_pred, "x": r.x, "P": r.P}
    bent = r.P.copy()
    bent[4, 0, 1] += 0.5
    hollow = r.x_pred.copy()
    hollow[5] = np.nan
    for changes, sentence in (
        ({"F": np.eye(3)}, "x: shape (30, 4), expected (T, 3): F has 3 rows"),
        ({"F": np.ones((4, 3))}, "F: shape (4, 3), expected (4, 4)"),
        ({"x": r.x[0]}, "x: expected shape (T, n), got float64 (4,)"),
        ({"x_pred": r.x_pred[1:]}, "x_pred: 116 numbers, expected 30 x 4"),
        ({"P": r.P[:, :3]}, "P: 360 numbers, expected 30 x 16"),
        ({"P": bent}, "P: step 4 is not symmetric"),
        ({"x_pred": hollow}, "x_pred: step 5 is not finite"),
    ):
        assert refusal(rts_smooth, **(good | changes)) == sentence


@pytest.mark.unit
def test_threads_share_nothing():
    z = measurements(4000)
    expected = run(z=z)
    results = [None] * 4

    def work(i):
        results[i] = run(z=z)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results:
        np.testing.assert_array_equal(result.P, expected.P)
        np.testing.assert_array_equal(result.x, expected.x)


@pytest.mark.unit
def test_reachable_from_the_package():
    assert sn.estimation.linear_filter is linear_filter
    assert sn.estimation.rts_smooth is rts_smooth
