"""Bounds and consistency in Python: against NumPy and SciPy, laws, refusals."""

import math

import hypothesis
import numpy as np
import pytest
import scipy.stats
from hypothesis.extra import numpy as hnp

from soopnav_cpp import estimation

RNG = np.random.default_rng(8)


def covariance(n, rng=RNG):
    a = rng.normal(size=(n, n))
    return a @ a.T + np.eye(n)


@pytest.mark.crosscheck
@pytest.mark.parametrize("seed", range(5))
def test_crlb_is_the_inverse_of_the_information(seed):
    rng = np.random.default_rng(seed)
    H, R, prior = rng.normal(size=(12, 4)), covariance(12, rng), covariance(4, rng)
    bound = estimation.crlb(H, R, prior_information=prior, names=["a", "b", "c", "d"])
    information = H.T @ np.linalg.solve(R, H) + prior
    assert bound.rank == 4
    np.testing.assert_allclose(bound.information, information, rtol=1e-10)
    np.testing.assert_allclose(bound.covariance, np.linalg.inv(information), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(bound.sigma**2, np.diag(bound.covariance), rtol=1e-13)
    assert bound.unobservable == ()
    assert bound.unobservable_basis.shape == (4, 0)


@pytest.mark.law
def test_forms_of_r_agree():
    H = RNG.normal(size=(6, 3))
    for forms in (
        (2.0, np.full(6, 2.0), 2.0 * np.eye(6), 2.0 * np.eye(3)),
        (np.arange(1.0, 7.0), np.diag(np.arange(1.0, 7.0))),
    ):
        bounds = [estimation.crlb(H, R).covariance for R in forms]
        for other in bounds[1:]:
            np.testing.assert_allclose(other, bounds[0], rtol=1e-11)
    one = estimation.crlb([[2.0]], [4.0])
    assert one.sigma[0] == pytest.approx(1.0)
    assert one.names == ("x0",)


@pytest.mark.unit
def test_what_cannot_be_seen_is_named_and_the_rest_is_finite():
    bound = estimation.crlb([[1, 0, 1, 0], [0, 2, 0, 0], [1, 0, 1, 0]], 4.0, names=["x", "y", "b", "drift"])
    assert bound.rank == 2
    assert bound.unobservable == ("drift", "0.71 x - 0.71 b")
    assert bound.sigma[1] == pytest.approx(1.0)
    assert np.isinf(bound.sigma[[0, 2, 3]]).all()
    assert math.isnan(bound.covariance[0, 2])
    assert bound.covariance[1, 1] == pytest.approx(1.0)
    assert repr(bound) == ("Crlb(rank 2 of 4; sigma: x inf, y 1, b inf, drift inf; cannot see: drift, 0.71 x - 0.71 b)")
    np.testing.assert_allclose(bound.information @ bound.unobservable_basis, 0.0, atol=1e-14)


@pytest.mark.unit
def test_sigma_of_is_a_dilution_of_precision_when_r_is_one():
    nodes = np.array([[900.0, 0.0], [-400.0, 800.0], [-500.0, -700.0]])
    H = np.column_stack([-nodes / np.linalg.norm(nodes, axis=1)[:, None], np.ones(3)])
    bound = estimation.crlb(H, 1.0, names=["x", "y", "b"])
    cofactor = np.linalg.inv(H.T @ H)
    assert bound.sigma_of("x", "y") == pytest.approx(math.sqrt(cofactor[0, 0] + cofactor[1, 1]))
    assert bound.sigma_of("x", "y", "b") == pytest.approx(math.sqrt(np.trace(cofactor)))
    with pytest.raises(ValueError, match="names: no parameter 'z'; there are x, y, b"):
        bound.sigma_of("z")
    with pytest.raises(ValueError, match="names: at least one of x, y, b"):
        bound.sigma_of()


@pytest.mark.unit
@pytest.mark.parametrize(
    ("arguments", "options", "sentence"),
    [
        (([1.0, 2.0], 1.0), {}, "H: expected numbers with shape"),
        (([[1.0, math.nan]], 1.0), {}, "H: it holds NaN or infinity"),
        (([[1.0, 2.0]], 0.0), {}, "R: it must be positive definite"),
        (([[1.0, 2.0]], -1.0), {}, "R: it must be positive definite"),
        (([[1.0], [2.0]], [1.0, 0.0]), {}, "R: variance 1 is 0; it must be positive"),
        (([[1.0], [2.0]], [1.0, math.inf]), {}, "R: it holds NaN or infinity"),
        (([[1.0], [2.0]], [1.0, 1.0, 1.0]), {}, r"R: shape \(3,\)"),
        (([[1.0], [2.0]], np.ones((3, 3))), {}, r"R: shape \(3, 3\)"),
        (([[1.0], [2.0]], [[1.0, 0.5], [0.4, 1.0]]), {}, "R: it must be symmetric"),
        (([[1.0, 2.0]], 1.0), {"names": ["a"]}, "names: 2 different ones expected"),
        (([[1.0, 2.0]], 1.0), {"names": ["a", "a"]}, "names: 2 different ones expected"),
        (([[1.0, 2.0]], 1.0), {"prior_information": np.eye(3)}, "prior_information: shape"),
        (([[1.0, 2.0]], 1.0), {"prior_information": -np.eye(2)}, "prior_information: it must be"),
        (([[1.0, 2.0]], 1.0), {"tolerance": 1.0}, "tolerance: 1; it must lie between 0 and 1"),
    ],
)
def test_crlb_refuses(arguments, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        estimation.crlb(*arguments, **options)


@pytest.mark.fuzz
@hypothesis.given(
    hnp.arrays(np.float64, hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4)),
    hnp.arrays(np.float64, hnp.array_shapes(min_dims=0, max_dims=2, min_side=0, max_side=4)),
)
@hypothesis.settings(max_examples=150, deadline=None)
def test_crlb_answers_or_refuses(H, R):
    try:
        bound = estimation.crlb(H, R)
    except ValueError:
        return
    assert 0 <= bound.rank <= bound.sigma.size
    assert len(bound.unobservable) == bound.sigma.size - bound.rank or not np.isfinite(bound.information).all()


@pytest.mark.law
def test_crlb_map_is_crlb_of_each():
    H = RNG.normal(size=(2, 3, 5, 2))
    H[1, 0, :, 1] = H[1, 0, :, 0]  # what cannot be told apart
    H[1, 1, 2, 0] = np.nan
    R = covariance(5)
    sigma, rank = estimation.crlb_map(H, R)
    assert sigma.shape == (2, 3, 2)
    assert rank.tolist() == [[2, 2, 2], [1, 0, 2]]
    assert np.isnan(sigma[1, 1]).all()
    assert np.isinf(sigma[1, 0]).all()
    for i, j in ((0, 0), (0, 2), (1, 2)):
        np.testing.assert_allclose(sigma[i, j], estimation.crlb(H[i, j], R).sigma, rtol=1e-12)
    with pytest.raises(ValueError, match="H: expected numbers with shape"):
        estimation.crlb_map(np.ones(3), 1.0)
    with pytest.raises(ValueError, match="R: it must be positive definite"):
        estimation.crlb_map(np.ones((2, 1, 1)), 0.0)


@pytest.mark.crosscheck
def test_posterior_crlb_of_a_linear_system_is_the_kalman_filters():
    rng = np.random.default_rng(4)
    steps, n, m = 30, 3, 2
    F = np.eye(n) + 0.2 * rng.normal(size=(steps, n, n))
    G = rng.normal(size=(n, 1))
    Q, R, P = G @ G.T, covariance(m, rng), covariance(n, rng)  # Q of rank one
    H = rng.normal(size=(steps, m, n))
    bound = estimation.posterior_crlb(F, Q, H, R, P)
    for k in range(steps):
        P = F[k] @ P @ F[k].T + Q
        np.testing.assert_allclose(bound.P_pred[k], P, rtol=1e-8, atol=1e-10 * np.abs(P).max())
        gain = P @ H[k].T @ np.linalg.inv(H[k] @ P @ H[k].T + R)
        P = P - gain @ H[k] @ P
        np.testing.assert_allclose(bound.P[k], P, rtol=1e-7, atol=1e-9 * np.abs(P).max())
    assert bound.sigma.shape == (steps, n)
    np.testing.assert_allclose(bound.sigma[-1] ** 2, np.diag(bound.P[-1]))
    assert "30 steps" in repr(bound)


@pytest.mark.law
def test_posterior_crlb_over_equal_trajectories_is_that_of_one():
    F, H, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.diag([0.1, 0.2])
    one = estimation.posterior_crlb(F, Q, H, 2.0, np.eye(2), steps=8)
    series = estimation.posterior_crlb(np.tile(F, (8, 1, 1)), np.tile(Q, (8, 1, 1)), H, [[2.0]], np.eye(2))
    many = estimation.posterior_crlb(np.tile(F, (8, 5, 1, 1)), Q, H, 2.0, np.eye(2))
    np.testing.assert_allclose(series.P, one.P, rtol=1e-12)
    np.testing.assert_allclose(many.P, one.P, rtol=1e-8)
    np.testing.assert_allclose(many.P_pred, one.P_pred, rtol=1e-8)


@pytest.mark.crosscheck
def test_posterior_crlb_averages_the_information_over_trajectories():
    # Scalar: J+ = 1/q - (f/q)^2 / (J + f2/q) + h2/r with the means f of F, f2 of F², h2 of H².
    rng = np.random.default_rng(9)
    F, H = rng.normal(size=(6, 50, 1, 1)), rng.normal(size=(6, 50, 1, 1))
    bound = estimation.posterior_crlb(F, [[0.5]], H, 2.0, [[3.0]])
    J = 1 / 3.0
    for k in range(6):
        J = 1 / 0.5 - (F[k].mean() / 0.5) ** 2 / (J + (F[k] ** 2).mean() / 0.5)
        assert bound.P_pred[k, 0, 0] == pytest.approx(1 / J)
        J += (H[k] ** 2).mean() / 2.0
        assert bound.P[k, 0, 0] == pytest.approx(1 / J)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"F": np.ones(2)}, "F: expected matrices of shape"),
        ({"F": np.ones((3, 3))}, "F: expected matrices of shape"),
        ({"F": np.full((2, 2), np.nan)}, "F: it holds NaN"),
        ({"F": np.tile(np.eye(2), (4, 1, 1)), "H": np.ones((3, 1, 2))}, "H: 3 steps; 4 expected"),
        ({"F": np.tile(np.eye(2), (4, 2, 1, 1)), "H": np.ones((4, 3, 1, 2))}, "H: 3 trajectories; 2 expected"),
        ({"Q": -np.eye(2)}, "Q: "),
        ({"Q": np.zeros((2, 2)), "F": np.tile(np.eye(2), (2, 3, 1, 1))}, "Q: "),
        ({"H": np.ones((1, 3))}, "H: expected shape"),
        ({"R": [[0.0]]}, "R: "),
        ({"R": np.eye(2)}, "R: expected matrices of shape"),
        ({"P0": np.ones((2, 3))}, "P0: a square matrix"),
        ({"P0": np.zeros((2, 2))}, "P0: "),
        ({"steps": None}, "steps: needed when no matrix varies"),
        ({"steps": 0}, "steps: 0 steps"),
        ({"F": np.zeros((2, 2)), "Q": np.zeros((2, 2))}, "F: step 0 cannot be taken"),
    ],
)
def test_posterior_crlb_refuses(changed, sentence):
    arguments = {"F": np.eye(2), "Q": np.eye(2), "H": np.ones((1, 2)), "R": 1.0, "P0": np.eye(2), "steps": None}
    if "F" not in changed or np.ndim(changed["F"]) < 3:
        arguments["steps"] = 3
    arguments |= changed
    with pytest.raises(ValueError, match=sentence):
        estimation.posterior_crlb(**arguments)


@pytest.mark.unit
def test_observability_of_sequences():
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    seen = estimation.observability([[1.0, 0.0]], F, steps=2, names=["position", "rate"])
    assert seen.rank == 2
    blind = estimation.observability([[0.0, 1.0]], F, steps=5, names=["position", "rate"])
    assert blind.rank == 1
    assert blind.unobservable == ("position",)
    # A full R repeats from time to time; a long series of F is read as far as needed.
    R = covariance(2)
    H = RNG.normal(size=(3, 2, 2))
    series = RNG.normal(size=(5, 2, 2))
    stack = np.vstack([H[0], H[1] @ series[0], H[2] @ series[1] @ series[0]])
    bound = estimation.observability(H, series, R=R)
    np.testing.assert_allclose(
        bound.information, stack.T @ np.kron(np.eye(3), np.linalg.inv(R)) @ stack, rtol=1e-9, atol=1e-12
    )
    by_variance = estimation.observability(H, series, R=[1.0, 4.0])
    np.testing.assert_allclose(
        by_variance.information, stack.T @ np.diag([1, 0.25] * 3) @ stack, rtol=1e-10, atol=1e-12
    )
    still = estimation.observability(H)
    np.testing.assert_allclose(still.information, sum(h.T @ h for h in H), rtol=1e-10)
    assert estimation.observability([[1.0, 0.0]], series, steps=1).rank == 1


@pytest.mark.unit
@pytest.mark.parametrize(
    ("arguments", "options", "sentence"),
    [
        (([1.0],), {}, "H: expected shape"),
        (([[1.0, 0.0]],), {}, "steps: needed"),
        (([[1.0, 0.0]], np.eye(3)), {"steps": 2}, "F: expected shape"),
        ((np.ones((3, 1, 2)), np.ones((1, 2, 2))), {}, "F: 1 matrices; at least 2"),
        ((np.ones((3, 1, 2)),), {"steps": 2}, "steps: 2 do not fit"),
        (([[1.0, 0.0]],), {"steps": 0}, "steps: 0"),
        (([[1.0, 0.0]],), {"steps": 2, "R": np.eye(3)}, "R: shape"),
        (([[1.0, math.inf]],), {"steps": 2}, "H: it holds"),
    ],
)
def test_observability_refuses(arguments, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        estimation.observability(*arguments, **options)


@pytest.mark.crosscheck
def test_marginal_information_is_the_schur_complement():
    J = covariance(5)
    kept, out = [3, 0], [1, 2, 4]
    expected = J[np.ix_(kept, kept)] - J[np.ix_(kept, out)] @ np.linalg.solve(J[np.ix_(out, out)], J[np.ix_(out, kept)])
    np.testing.assert_allclose(estimation.marginal_information(J, kept), expected, rtol=1e-8)
    for bad, sentence in (([5], "kept: index 5"), ([0, 0], "kept: index 0 is there twice")):
        with pytest.raises(ValueError, match=sentence):
            estimation.marginal_information(J, bad)
    with pytest.raises(ValueError, match="information: it must be"):
        estimation.marginal_information(-J, [0])


@pytest.mark.crosscheck
def test_statistics_against_numpy_and_scipy():
    errors, P = RNG.normal(size=(40, 3)), np.stack([covariance(3) for _ in range(40)])
    expected = np.einsum("ti,tij,tj->t", errors, np.linalg.inv(P), errors)
    np.testing.assert_allclose(estimation.nees(errors, P), expected, rtol=1e-10)
    np.testing.assert_allclose(
        estimation.nees(errors, P[0]), np.einsum("ti,ij,tj->t", errors, np.linalg.inv(P[0]), errors), rtol=1e-10
    )
    np.testing.assert_allclose(estimation.rmse(errors), np.sqrt((errors**2).mean(axis=0)))
    inside = (expected <= scipy.stats.chi2.ppf(0.6, 3)).mean()
    assert estimation.coverage(errors, P, probability=0.6) == inside
    low, high = estimation.mean_nees_bounds(3, 40, failure_probability=1e-3)
    assert low == pytest.approx(scipy.stats.chi2.ppf(5e-4, 120) / 40)
    assert high == pytest.approx(scipy.stats.chi2.isf(5e-4, 120) / 40)
    radii = np.hypot(errors[:, 0], errors[:, 1])
    assert estimation.sample_circular_error_m(errors[:, :2]) == np.sort(radii)[19]
    P[3, 0, 0] = np.nan
    assert np.flatnonzero(np.isnan(estimation.nees(errors, P))).tolist() == [3]


@pytest.mark.crosscheck
@pytest.mark.parametrize(("probability", "runs"), [(0.5, 10), (0.95, 200), (0.03, 57), (0.683, 1000)])
@pytest.mark.parametrize("failure", [0.1, 1e-4])
def test_coverage_bounds_are_the_binomials(probability, runs, failure):
    low, high = (round(bound * runs) for bound in
                 estimation.coverage_bounds(probability, runs, failure_probability=failure))  # fmt: skip
    k = scipy.stats.binom(runs, probability)
    assert k.cdf(low - 1) <= failure / 2 < k.cdf(low)
    assert k.sf(high) <= failure / 2 < k.sf(high - 1)


@pytest.mark.unit
def test_statistics_refuse():
    for call, sentence in (
        (lambda: estimation.nees([1.0], np.eye(1)), "errors: expected"),
        (lambda: estimation.nees([[1.0, 2.0]], np.eye(3)), "P: expected shape"),
        (lambda: estimation.rmse(np.empty((0, 2))), "errors: shape"),
        (lambda: estimation.coverage([[1.0]], [[1.0]], probability=1.0), "probability: 1"),
        (lambda: estimation.mean_nees_bounds(0, 10), "dof: 0.000000 is not positive"),
        (lambda: estimation.coverage_bounds(1.5, 10), "probability: 1.500000 is not between 0 and 1"),
        (lambda: estimation.sample_circular_error_m([[1.0, 2.0, 3.0]]), "errors_m: expected"),
        (lambda: estimation.sample_circular_error_m([[1.0, 2.0]], probability=0.0), "probability: 0"),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()


NODES = np.array([[0.0, 0.0, 3.0], [40.0, -5.0, 4.0], [10.0, 30.0, -6.0]])


def measured(kind, nodes, start, shape, p):
    """What the nodes measure: shape (N, L), for parameters by name."""
    turn = p.get("heading", 0.0)
    rotation = np.eye(nodes.shape[1])
    rotation[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    track = start + shape @ rotation.T
    for axis, name in enumerate("xyz"[: nodes.shape[1]]):
        track[:, axis] += p.get(f"offset {name}", 0.0)
        track[:, axis] += p.get(f"step {name}", 0.0) * np.arange(1, len(shape) + 1)
    d = track[:, None] - nodes
    z = np.linalg.norm(d, axis=2) if kind == "range" else np.arctan2(-d[..., 1], -d[..., 0])
    times = 0.5 * np.arange(len(shape))
    z = z + p.get("bias", 0.0) + p.get("drift", 0.0) * times[:, None]
    for j in range(len(nodes)):
        z[:, j] += p.get(f"bias {j + 1}", 0.0) + p.get(f"drift {j + 1}", 0.0) * times
    return z


@pytest.mark.jacobian
@pytest.mark.parametrize("kind", ["range", "azimuth"])
@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("extent", ["common", "separate"])
def test_track_jacobian_is_the_derivative(kind, axes, extent):
    nodes, start = NODES[:, :axes], np.array([12.0, 7.0, 1.0])[:axes]
    shape = np.column_stack([np.linspace(1, 6, 7), np.sin(np.arange(7)), 0.2 * np.arange(7)])[:, :axes]
    names_of = ("x", "y", "z")[:axes]
    H, names = estimation.track_jacobian(
        kind, nodes, start + shape, offset=names_of, step=names_of, heading=True, bias=extent, drift=extent,
        times_s=0.5 * np.arange(7), start_m=start,
    )  # fmt: skip
    assert H.shape == (21, len(names))
    for column, name in enumerate(names):
        step = 1e-5
        ahead, behind = (measured(kind, nodes, start, shape, {name: sign * step}) for sign in (1.0, -1.0))
        numeric = ((ahead - behind) / (2.0 * step)).ravel()
        np.testing.assert_allclose(H[:, column], numeric, rtol=1e-6, atol=1e-8, err_msg=name)


@pytest.mark.unit
def test_track_jacobian_takes_many_tracks_and_blanks_a_node():
    tracks = np.array([[[1.0, 1.0], [2.0, 1.0]], [[0.0, 0.0], [2.0, 1.0]]])
    H, names = estimation.track_jacobian("range", [[0.0, 0.0], [5.0, 5.0]], tracks, offset=["x"], bias="common")
    assert H.shape == (2, 4, 2)
    assert names == ("offset x", "bias")
    assert np.isnan(H[1]).any(axis=1).tolist() == [True, False, False, False]
    one, _ = estimation.track_jacobian("range", [[0.0, 0.0], [5.0, 5.0]], tracks[0], offset=["x"], bias="common")
    np.testing.assert_array_equal(H[0], one)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"kind": "doppler"}, "kind: 'doppler'"),
        ({"nodes_m": [[1.0]]}, "nodes_m: expected shape"),
        ({"positions_m": [1.0, 2.0]}, "positions_m: expected shape"),
        ({"positions_m": [[1.0, 2.0, 3.0]]}, "positions_m: expected shape"),
        ({"offset": ["z"]}, "offset: no axis 'z'; there are x, y"),
        ({"offset": []}, "at least one unknown"),
        ({"node_names": ["a", "b"]}, "node_names: 2 for 1"),
        ({"drift": "common"}, "times_s: needed"),
        ({"steps_taken": [1.0, 2.0]}, "steps_taken: expected shape"),
    ],
)
def test_track_jacobian_refuses(changed, sentence):
    arguments = {"kind": "range", "nodes_m": [[0.0, 0.0]], "positions_m": [[1.0, 2.0]], "offset": ["x"]} | changed
    with pytest.raises(ValueError, match=sentence):
        estimation.track_jacobian(arguments.pop("kind"), arguments.pop("nodes_m"), arguments.pop("positions_m"),
                                  **arguments)  # fmt: skip


@pytest.mark.consistency
def test_least_squares_reaches_the_bound():
    # 1000 linear problems with matched noise: the errors' NEES against the bound, within bounds that a right bound
    # leaves with probability 1e-5; one wrong by 20 % would leave them.
    rng = np.random.default_rng(77)
    H, R = rng.normal(size=(9, 3)), covariance(9, rng)
    bound = estimation.crlb(H, R)
    weight = np.linalg.solve(R, H)
    noise = rng.multivariate_normal(np.zeros(9), R, size=1000)
    errors = np.linalg.solve(H.T @ weight, weight.T @ noise.T).T
    low, high = estimation.mean_nees_bounds(3, 1000, failure_probability=1e-5)
    assert low < estimation.nees(errors, bound.covariance).mean() < high
    assert low > 3.0 / 1.2
    assert high < 3.0 * 1.2
