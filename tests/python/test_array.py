"""Arrays: reference spectra, bounds, statistics of the estimators, manifolds from files, and bad input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import soopnav_cpp as sn
from soopnav_cpp.array import ArrayGeometry, ArrayStatus, DirectionFinder, Manifold

VECTORS = Path(__file__).resolve().parents[3] / "shared" / "vectors" / "filters"
Reals = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def ula8() -> tuple[dict[str, Any], dict[str, Any]]:
    if not (VECTORS / "doa_ula8.npz").is_file():
        pytest.skip("the reference vectors ../shared/vectors/filters/doa_ula8 are not here")
    with np.load(VECTORS / "doa_ula8.npz") as archive:
        return {name: archive[name] for name in archive.files}, json.loads((VECTORS / "doa_ula8.json").read_text())


def simulated(
    manifold: Manifold, directions: npt.ArrayLike, snr_db: float, snapshots: int, seed: int
) -> npt.NDArray[np.complex64]:
    """Independent sources of equal power in noise of variance 1."""
    rng = np.random.default_rng(seed)
    at = np.asarray(directions, dtype=np.float64)
    a = manifold.steering(at[:, 0], at[:, 1])

    def normal(*shape: int) -> npt.NDArray[np.complex128]:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)

    x = 10.0 ** (snr_db / 20.0) * a @ normal(len(at), snapshots) + normal(len(manifold), snapshots)
    return x.astype(np.complex64)


def wishart(R: npt.NDArray[np.complex128], snapshots: int, count: int, seed: int) -> npt.NDArray[np.complex128]:
    """Sample covariances of Gaussian snapshots with covariance R: Bartlett's decomposition."""
    rng = np.random.default_rng(seed)
    m = len(R)
    T = np.zeros((count, m, m), dtype=np.complex128)
    low = np.tril_indices(m, -1)
    T[:, low[0], low[1]] = (rng.standard_normal((count, len(low[0]), 2)) @ np.array([1.0, 1.0j])) / np.sqrt(2.0)
    for i in range(m):
        T[:, i, i] = np.sqrt(rng.gamma(snapshots - i, 1.0, count))
    half = np.linalg.cholesky(R) @ T
    return half @ half.conj().transpose(0, 2, 1) / snapshots


# --- reference vectors


def test_spectra_match_the_reference(ula8: tuple[dict[str, Any], dict[str, Any]]) -> None:
    data, numbers = ula8
    R, steering = data["R"], data["steering"]
    np.testing.assert_allclose(sn.array.covariance(data["X"]), R, rtol=1e-12)
    np.testing.assert_allclose(sn.array.covariance(data["X"].astype(np.complex64)), R, atol=3e-5)
    np.testing.assert_allclose(sn.array.music(R, steering, 2), data["music"], rtol=1e-9)
    np.testing.assert_allclose(sn.array.music(data["R_exact"], steering, 2), data["music_exact"], rtol=1e-9)
    np.testing.assert_allclose(sn.array.capon(R, steering), data["mvdr"], rtol=1e-9)
    np.testing.assert_allclose(sn.array.bartlett(R, steering), data["bartlett"], rtol=1e-9)
    np.testing.assert_allclose(sn.array.eigenvalues(R)[::-1], numbers["eigenvalues"], rtol=1e-9)
    ula = Manifold(ArrayGeometry.ula(8))
    np.testing.assert_allclose(ula.steering(np.pi / 2 - data["grid_rad"]), steering, atol=1e-12)


def test_angles_match_the_reference(ula8: tuple[dict[str, Any], dict[str, Any]]) -> None:
    data, numbers = ula8
    R = data["R"]
    np.testing.assert_allclose(sn.array.root_music(R, 2), numbers["root_music"], atol=1e-12)
    np.testing.assert_allclose(sn.array.root_music(data["R_exact"], 2), [-0.3, 0.25], atol=1e-9)
    found = sn.array.music(R, ArrayGeometry.ula(8), 2, n_snapshots=200)
    assert isinstance(found, sn.array.Bearings)
    np.testing.assert_allclose(np.sort(np.pi / 2 - found.azimuth_rad), numbers["music_refined"], atol=2e-6)
    smoothed = sn.array.spatial_smoothing(data["R_coherent"], 4, forward_backward=True)  # five subarrays of four
    np.testing.assert_allclose(sn.array.root_music(smoothed, 2), numbers["coherent_ssfb_root_music"], atol=1e-9)
    assert sn.array.source_count(data["R_coherent"], 200) == numbers["mdl_coherent"] == 1
    assert sn.array.source_count(smoothed, 200) == numbers["mdl_coherent_after_ssfb"] == 2
    counts = [sn.array.source_count(R, 200, method) for method in ("aic", "mdl", "sorte")]
    assert counts == [numbers["aic"], numbers["mdl"], numbers["sorte"]] == [3, 2, 2]


def test_esprit_solves_its_equations(ula8: tuple[dict[str, Any], dict[str, Any]]) -> None:
    # The reference's digits come from weighting overlapping views of the eigenvectors twice, which bends the
    # invariance; so the equations are solved here once more, and the reference is met within what that costs.
    data, numbers = ula8
    E = np.linalg.eigh(data["R"])[1][:, -2:]
    w = np.sqrt(np.minimum(np.arange(1, 8), np.arange(7, 0, -1)))[:, None]
    U1, U2 = w * E[:-1], w * E[1:]
    least = np.linalg.lstsq(U1, U2, rcond=None)[0]
    V = np.linalg.svd(np.hstack([U1, U2]))[2].conj().T
    total = -V[:2, 2:] @ np.linalg.inv(V[2:, 2:])
    for method, Psi in (("ls", least), ("tls", total)):
        wanted = np.sort(np.arcsin(np.angle(np.linalg.eigvals(Psi)) / np.pi))
        got = sn.array.esprit(data["R"], 2, method=method)
        np.testing.assert_allclose(got, wanted, atol=1e-10)
        np.testing.assert_allclose(got, numbers[f"esprit_{method}"], atol=3e-3)
    np.testing.assert_allclose(sn.array.esprit(data["R_exact"], 2), [-0.3, 0.25], atol=1e-9)


def test_coherent_sources_are_resolved(ula8: tuple[dict[str, Any], dict[str, Any]]) -> None:
    R = ula8[0]["R_coherent"]
    for fit in (sn.array.weighted_subspace_fitting, sn.array.maximum_likelihood):
        found = fit(R, ArrayGeometry.ula(8), 2, n_snapshots=200)
        np.testing.assert_allclose(np.sort(np.pi / 2 - found.azimuth_rad), [-0.3, 0.25], atol=5e-3)


# --- bounds


def fisher(manifold: Manifold, directions: Reals, S: npt.NDArray[np.complex128], noise: float, n: int) -> Reals:
    """Slepian and Bangs, by central differences over directions, the signals' covariance and the noise."""
    K = len(directions)

    def covariance(theta: Reals) -> npt.NDArray[np.complex128]:
        at = theta[: 2 * K].reshape(K, 2)
        P = np.zeros((K, K), dtype=np.complex128)
        rest = iter(theta[2 * K : -1])
        for i in range(K):
            P[i, i] = next(rest)
            for j in range(i):
                P[i, j] = next(rest) + 1j * next(rest)
                P[j, i] = P[i, j].conj()
        A = manifold.steering(at[:, 0], at[:, 1])
        return A @ P @ A.conj().T + theta[-1] * np.eye(len(A))

    rest: list[float] = []
    for i in range(K):
        rest.append(S[i, i].real)
        for j in range(i):
            rest += [S[i, j].real, S[i, j].imag]
    theta = np.array([*directions.ravel(), *rest, noise])
    inverse = np.linalg.inv(covariance(theta))
    slopes = []
    for i in range(len(theta)):
        h = np.zeros_like(theta)
        h[i] = 1e-5
        slopes.append(inverse @ (covariance(theta + h) - covariance(theta - h)) / 2e-5)
    return n * np.array([[np.trace(a @ b).real for b in slopes] for a in slopes])


@pytest.mark.parametrize("correlation", [0.0, 0.6 - 0.3j])
def test_stochastic_bound_inverts_the_fisher_information(correlation: complex) -> None:
    manifold = Manifold(ArrayGeometry.uca(7, 0.6)).with_random_errors(1.0, 0.2, seed=4)
    directions = np.array([[0.3, 0.6], [1.7, 0.9]])
    S = np.array([[2.0, correlation], [np.conj(correlation), 1.0]])
    wanted = np.linalg.inv(fisher(manifold, directions, S, 0.7, 300))[:4, :4]
    got = sn.array.crlb(manifold, directions, S, 0.7, 300)
    np.testing.assert_allclose(got, wanted, rtol=1e-4, atol=1e-5 * wanted.max())
    deterministic = sn.array.crlb(manifold, directions, S, 0.7, 300, "deterministic")
    assert np.linalg.eigvalsh(got - deterministic).min() > 0.0


def test_one_source_bounds_differ_by_one_plus_one_over_m_snr() -> None:
    g = ArrayGeometry.planar(2, 2, 0.2)
    stochastic = sn.array.crlb(g, [[0.4, 0.8]], 0.5, 1.0, 2500)
    deterministic = sn.array.crlb(g, [[0.4, 0.8]], 0.5, 1.0, 2500, "deterministic")
    np.testing.assert_allclose(stochastic, deterministic * (1.0 + 1.0 / (4 * 0.5)), rtol=1e-9, atol=1e-12)


def test_line_bound_is_the_textbook_one() -> None:
    # 6 s / (N p M (M^2 - 1) (2 pi d cos(theta))^2), deterministic, one source.
    theta, M, snr, n = 0.4, 8, 10.0, 200
    wanted = 6.0 / (n * snr * M * (M**2 - 1) * (np.pi * np.cos(theta)) ** 2)
    for positions in (0.5 * np.arange(M), np.column_stack([0.5 * np.arange(M), np.zeros(M), np.zeros(M)])):
        got = sn.array.crlb(positions, [theta], snr, 1.0, n, "deterministic")
        assert got.shape == (1, 1)
        np.testing.assert_allclose(got[0, 0], wanted, rtol=1e-9)


# --- statistics


@pytest.mark.parametrize(
    ("geometry", "direction"),
    [
        (ArrayGeometry.planar(2, 2, 0.2), (0.7, 0.8)),
        (ArrayGeometry.uca(6, 0.4), (-2.2, 0.6)),
        (ArrayGeometry.ula(8), (1.1, 0.0)),
    ],
)
def test_music_reaches_the_stochastic_bound_and_says_so(
    geometry: ArrayGeometry, direction: tuple[float, float]
) -> None:
    trials, n, snr = 4000, 2500, 2.0
    a = Manifold(geometry).steering(*direction)
    R = wishart(snr * a @ a.conj().T + np.eye(len(geometry)), n, trials, seed=1)
    finder = DirectionFinder(geometry)
    run = finder.run(R, n)
    assert np.all(run.status == ArrayStatus.OK)
    errors = np.stack([run.azimuth_rad[:, 0] - direction[0], run.elevation_rad[:, 0] - direction[1]], axis=1)
    if geometry.rank == 1:
        bound = sn.array.crlb(geometry, [np.pi / 2 - direction[0]], snr, 1.0, n)
        used = slice(0, 1)
        assert np.all(np.isinf(run.covariance_rad2[:, 0, 1, 1]))
    else:
        bound = sn.array.crlb(geometry, [direction], snr, 1.0, n)
        used = slice(0, 2)
    ratio = np.diag(np.cov(errors.T))[used] / np.diag(bound)
    spread = 5.0 * np.sqrt(2.0 / trials)  # five standard deviations of a variance's estimate
    assert np.all(np.abs(ratio - 1.0) < spread + 0.04), ratio  # MUSIC is asymptotic: 4 % at 2500 snapshots
    assert np.all(np.abs(errors.mean(axis=0)[used]) < 5.0 * np.sqrt(np.diag(bound) / trials))
    reported = run.covariance_rad2[:, 0, used, used].mean(axis=0)
    np.testing.assert_allclose(np.diag(reported), np.diag(bound), rtol=0.05)


def test_two_sources_reach_the_bound_by_subspace_fitting() -> None:
    geometry = ArrayGeometry.uca(8, 0.6)
    directions = np.array([[0.5, 0.5], [1.2, 0.8]])
    A = Manifold(geometry).steering(directions[:, 0], directions[:, 1])
    S = np.array([[2.0, 1.2], [1.2, 2.0]])
    trials, n = 1500, 500
    R = wishart(A @ S @ A.conj().T + np.eye(8), n, trials, seed=2)
    bound = np.diag(sn.array.crlb(geometry, directions, S, 1.0, n)).reshape(2, 2)
    for method in ("subspace_fitting", "maximum_likelihood"):
        run = DirectionFinder(geometry, n_sources=2, method=method, azimuth_step_deg=2, elevation_step_deg=2).run(R, n)
        first = np.argmin(np.abs(run.azimuth_rad - 0.5), axis=1)
        for source in range(2):
            pick = (np.arange(trials), first if source == 0 else 1 - first)
            error = np.stack(
                [run.azimuth_rad[pick] - directions[source, 0], run.elevation_rad[pick] - directions[source, 1]], axis=1
            )
            spread = 5.0 * np.sqrt(2.0 / trials) + 0.06
            assert np.all(np.abs(error.var(axis=0) / bound[source] - 1.0) < spread), (method, source)
            reported = np.diagonal(run.covariance_rad2[pick], axis1=1, axis2=2).mean(axis=0)
            np.testing.assert_allclose(reported, bound[source], rtol=0.12)


def test_the_grid_leaves_no_trace() -> None:
    geometry = ArrayGeometry.planar(2, 2, 0.2)
    a = Manifold(geometry).steering(0.7123, 0.8456)
    R = wishart(a @ a.conj().T + np.eye(4), 2500, 50, seed=3)
    runs = [
        DirectionFinder(geometry, azimuth_start_deg=start, elevation_step_deg=step).run(R, 2500)
        for start, step in ((0.0, 1.0), (0.37, 1.0), (0.5, 2.3))
    ]
    for other in runs[1:]:
        np.testing.assert_allclose(other.azimuth_rad, runs[0].azimuth_rad, atol=1e-9)
        np.testing.assert_allclose(other.elevation_rad, runs[0].elevation_rad, atol=1e-9)


def test_estimate_and_track_agree() -> None:
    manifold = Manifold(ArrayGeometry.uca(6, 0.5))
    iq = simulated(manifold, [[0.3, 0.5], [2.5, 0.7]], 10.0, 6000, seed=5)
    finder = DirectionFinder(manifold, n_sources=None)
    run = finder.track(iq, 2000)
    assert run.azimuth_rad.shape == (3, 5)
    assert list(run.count) == [2, 2, 2]
    assert list(run.first_sample) == [0, 2000, 4000]
    one = finder.estimate(np.ascontiguousarray(iq[:, 2000:4000]))
    np.testing.assert_array_equal(one.azimuth_rad, run.azimuth_rad[1, :2])
    np.testing.assert_array_equal(one.covariance_rad2, run.covariance_rad2[1, :2])
    np.testing.assert_allclose(np.sort(one.azimuth_rad), [0.3, 2.5], atol=0.02)
    np.testing.assert_allclose(one.power, 10.0, rtol=0.3)
    assert np.isnan(run.azimuth_rad[:, 2:]).all()
    assert "az" in repr(one)
    shown = finder.estimate_covariance(sn.array.covariance(iq), 6000, spectrum=True).spectrum
    assert shown is not None
    assert shown.shape == (91, 360)
    row, column = np.unravel_index(np.argmax(shown), shown.shape)
    here = (np.deg2rad(column), np.deg2rad(row))
    assert min(np.hypot(here[0] - 0.3, here[1] - 0.5), np.hypot(here[0] - 2.5, here[1] - 0.7)) < 0.02
