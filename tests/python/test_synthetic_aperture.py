"""Bearings from phases along a path: against NumPy, against themselves, with an IMU's path, from IQ, in the locator."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import soopnav_cpp as sn

Floats = npt.NDArray[np.float64]
WAVELENGTH_M = 0.15
STATUS = sn.array.ApertureStatus


def loop(snapshots: int = 50, turn: float = 2.0 * np.pi) -> Floats:
    at = turn * np.arange(snapshots) / snapshots
    return 5.0 * WAVELENGTH_M / turn * np.column_stack((np.cos(at), np.sin(at)))


def wrapped(angle: npt.ArrayLike) -> Floats:
    return np.asarray(np.angle(np.exp(1j * np.asarray(angle))), dtype=np.float64)


def model(path: Floats, time_s: Floats, unknowns: Floats, nodes: int, modes: Floats) -> npt.NDArray[np.complex128]:
    """Phasors of the model with everything in one vector: bearings, offsets, phases, amplitudes, psi, path error, z."""
    n = len(path)
    theta, omega, phi, amplitude = unknowns[: 4 * nodes].reshape(4, nodes)
    psi = unknowns[4 * nodes : 4 * nodes + n]
    drift = unknowns[4 * nodes + n : 4 * nodes + 3 * n].reshape(n, 2)
    place = path + drift + np.tensordot(unknowns[4 * nodes + 3 * n :], modes, axes=1)
    u = np.stack((np.cos(theta), np.sin(theta)))
    eta = psi[:, None] + phi + omega * (time_s - time_s.mean())[:, None] + 2 * np.pi / WAVELENGTH_M * place @ u
    return np.asarray(amplitude * np.exp(1j * eta))


def dense_bound(path: Floats, time_s: Floats, bearing: Floats, snr: float, sigma_m: float, modes: Floats) -> Floats:
    """The bound by one dense Fisher matrix from central differences, priors added, gauge by a pseudo-inverse."""
    n, nodes = len(path), len(bearing)
    x = np.concatenate((bearing, np.zeros(2 * nodes), np.full(nodes, np.sqrt(snr)), np.zeros(3 * n + len(modes))))
    columns = []
    for a in range(len(x)):
        step = np.zeros(len(x))
        step[a] = 1e-6
        columns.append(
            (model(path, time_s, x + step, nodes, modes) - model(path, time_s, x - step, nodes, modes)) / 2e-6
        )
    jacobian = np.stack([c.ravel() for c in columns], axis=1)
    fisher = 2.0 * np.real(jacobian.conj().T @ jacobian)
    first = 4 * nodes + n
    if sigma_m > 0.0:
        difference = np.kron(np.eye(n, k=0)[1:] - np.eye(n, k=-1)[1:], np.eye(2))
        fisher[first : first + 2 * n, first : first + 2 * n] += difference.T @ difference / sigma_m**2
        keep = np.r_[0:first, first + 2 : len(x)]
    else:
        keep = np.r_[0:first, first + 2 * n : len(x)]
    z = np.arange(first + 2 * n, len(x))
    fisher[z, z] += 1.0
    reduced = fisher[np.ix_(keep, keep)]
    scale = 1.0 / np.sqrt(np.diag(reduced))
    inverse = np.linalg.pinv(reduced * scale * scale[:, None], rcond=1e-9, hermitian=True) * scale * scale[:, None]
    return np.asarray(inverse[:nodes, :nodes])


@pytest.mark.crosscheck
@pytest.mark.parametrize(("sigma_m", "n_modes"), [(0.0, 0), (5e-4, 0), (5e-4, 2)])
def test_bound_is_that_of_a_dense_fisher_matrix(sigma_m: float, n_modes: int) -> None:
    path, time_s = loop(20), np.cumsum(np.linspace(0.03, 0.05, 20))
    bearing = np.array([0.3, 2.1, -1.9, -0.4])
    s = np.linspace(0.0, 1.0, 20)[:, None]
    modes = 0.02 * np.stack((s**2 * [1.0, 0.3], s**3 * [0.2, 1.0]))[:n_modes]
    ours = sn.array.synthetic_aperture_crlb(
        path, WAVELENGTH_M, bearing, 10.0, time_s=time_s, path_sigma_m_per_sqrt_step=sigma_m, path_modes_m=modes
    )
    np.testing.assert_allclose(ours, dense_bound(path, time_s, bearing, 10.0, sigma_m, modes), rtol=2e-4, atol=1e-9)


@pytest.mark.law
def test_bound_falls_with_what_is_known() -> None:
    path, bearing = loop(), 0.3 + 2.0 * np.pi / 3.0 * np.arange(3)

    def rms(**given: Any) -> float:
        bound = sn.array.synthetic_aperture_crlb(path, WAVELENGTH_M, bearing, 10.0, **given)
        return float(np.sqrt(np.trace(bound) / 3))

    free, walk = rms(), rms(phase="random_walk", phase_sigma_rad_per_sqrt_s=0.05)
    known, no_offset = rms(phase="known"), rms(phase="known", frequency_offsets=False)
    drifting = rms(path_sigma_m_per_sqrt_step=5e-4)
    assert drifting > free > walk > known > no_offset
    assert np.rad2deg(free) == pytest.approx(0.85, abs=0.01)
    assert no_offset == pytest.approx(1.0 / np.sqrt(10.0 * 50 * 5.0**2), rel=1e-6)  # 2 pi r / lambda = 5
    with pytest.raises(ValueError, match="do not determine"):
        sn.array.synthetic_aperture_crlb(path * [1.0, 0.0], WAVELENGTH_M, bearing, 10.0)


@pytest.mark.crosscheck
def test_estimate_is_the_maximum_of_the_likelihood() -> None:
    optimize = pytest.importorskip("scipy.optimize")
    path, time_s, bearing = loop(30), 0.04 * np.arange(30), np.array([0.3, 2.4, -1.7])
    seen = sn.simulation.aperture_snapshots(
        path, bearing, WAVELENGTH_M, frequency_hz=[0.0, 2.0, -1.0], time_s=time_s,
        clock=sn.clock.TwoState(7.2e-19, 1e-22), seed=5,
    )  # fmt: skip
    found = sn.array.SyntheticAperture().bearings(seen.phasors, path, WAVELENGTH_M, time_s=time_s)
    assert found.status is STATUS.OK
    none = np.zeros((0, 30, 2))

    def residuals(x: Floats) -> Floats:
        full = np.concatenate((x[:3], [0.0], x[3:5], [0.0], x[5:7], x[7:10], x[10:], np.zeros(60)))
        off = (seen.phasors - model(path, time_s, full, 3, none)).ravel()
        return np.concatenate((off.real, off.imag))

    start = np.concatenate((
        bearing, 2 * np.pi * np.array([2.0, -1.0]), [0.0, 0.0], np.full(3, np.sqrt(10.0)), seen.phase_rad,
    ))  # fmt: skip
    offsets = np.angle(np.sum(seen.phasors * model(path, time_s, np.concatenate((
        bearing, [0.0], start[3:5], np.zeros(3), np.ones(3), seen.phase_rad, np.zeros(60),
    )), 3, none).conj(), axis=0))  # fmt: skip
    start[5:7] = offsets[1:] - offsets[0]
    start[10:] += offsets[0]
    peer = optimize.least_squares(residuals, start, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(wrapped(found.bearing_rad - peer.x[:3]), 0.0, atol=1e-5)
    np.testing.assert_allclose(found.amplitude, peer.x[7:10], rtol=1e-4)


@pytest.mark.unit
def test_results_read_well_and_refusals_are_sentences() -> None:
    path = loop()
    aperture = sn.array.SyntheticAperture()
    seen = sn.simulation.aperture_snapshots(path, [0.3, 2.4, -1.7], seed=2)
    found = aperture.bearings(seen.phasors, path, WAVELENGTH_M)
    assert found.ok
    assert repr(found).startswith("ApertureBearings(ok, [1")
    two = aperture.bearings(seen.phasors[:, :2], path, WAVELENGTH_M)
    assert two.status is STATUS.TOO_FEW_NODES
    assert not two.ok
    assert "three nodes" in two.message
    assert np.isnan(two.bearing_rad).all()
    line = np.column_stack((np.linspace(0.0, 0.7, 50), np.zeros(50)))
    straight = aperture.bearings(seen.phasors, line, WAVELENGTH_M)
    assert straight.status is STATUS.SINGULAR
    assert "straight" in straight.message
    with pytest.raises(ValueError, match="phasors: shape"):
        aperture.bearings(seen.phasors[:, 0], path, WAVELENGTH_M)
    with pytest.raises(ValueError, match="path_m"):
        aperture.bearings(seen.phasors, path[:-1], WAVELENGTH_M)
    with pytest.raises(ValueError, match="path_modes_m"):
        aperture.bearings(seen.phasors, path, WAVELENGTH_M, path_modes_m=np.zeros((1, 3, 2)))
    with pytest.raises(ValueError, match="smallest eigenvalue"):
        aperture.bearings(seen.phasors, path, WAVELENGTH_M, path_covariance_m2=-np.eye(100))
    with pytest.raises(ValueError, match='phase: "loud"'):
        sn.array.SyntheticAperture(phase="loud")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="clock, phase_rad"):
        sn.simulation.aperture_snapshots(path, 0.1, clock=sn.clock.TwoState.tcxo(), phase_rad=np.zeros(50), seed=1)
    with pytest.raises(ValueError, match="snr"):
        sn.simulation.aperture_snapshots(path, 0.1, snr_db=np.nan, seed=1)
    for name in ("wavelength_m", "snr_db", "k_factor_db", "frequency_hz"):
        with pytest.raises(ValueError, match=rf"{name}: shape \(2,\)"):
            sn.simulation.aperture_snapshots(path, [0.3, 2.4, -1.7], **{name: [1.0, 2.0]}, seed=1)  # type: ignore[arg-type]


def test_noise_gives_no_blind_angles_and_a_sentence() -> None:
    rng = np.random.default_rng(1)
    aperture = sn.array.SyntheticAperture()
    refused = 0
    for _ in range(4):
        noise = rng.standard_normal((50, 6)) + 1j * rng.standard_normal((50, 6))
        found = aperture.blind(noise, WAVELENGTH_M)
        assert not found.ok
        assert np.isnan(found.bearing_rad).all()
        if found.status is STATUS.TOO_FEW_COHERENT:
            refused += 1
            assert "node" in found.message
    assert refused > 0


@pytest.mark.law
def test_same_seed_same_bits_and_a_known_path_error_is_used() -> None:
    path = loop()
    given = {"path_sigma_m_per_sqrt_step": 5e-4, "frequency_hz": [0.0, 1.0, 2.0], "seed": 4}
    a = sn.simulation.aperture_snapshots(path, [0.3, 2.4, -1.7], **given)  # type: ignore[arg-type]
    b = sn.simulation.aperture_snapshots(path, [0.3, 2.4, -1.7], **given)  # type: ignore[arg-type]
    np.testing.assert_array_equal(a.phasors, b.phasors)
    np.testing.assert_array_equal(a.path_m, b.path_m)
    assert np.std(np.diff(a.path_m - path, axis=0)) == pytest.approx(5e-4, rel=0.35)
    exact, aware = (
        sn.array.SyntheticAperture(path_sigma_m_per_sqrt_step=s).bearings(a.phasors, a.path_m, WAVELENGTH_M)
        for s in (0.0, 5e-4)
    )
    assert (aware.sigma_rad > exact.sigma_rad).all()


@pytest.mark.consistency
def test_path_of_an_imu_with_its_covariance() -> None:
    """Dead reckoning from accelerometers: unknown start velocity, a bias each; NEES as the covariance says."""
    rng = np.random.default_rng(8)
    n, dt, bias_sigma = 50, 0.04, 0.004
    time_s = dt * np.arange(n)
    truth = loop(n)
    shapes = [np.outer(0.5 * time_s**2 * bias_sigma, axis) for axis in np.eye(2)]
    modes = np.stack(shapes)
    covariance = sum(np.outer(m.ravel(), m.ravel()) for m in modes)
    aware, plain = (sn.array.SyntheticAperture(max_frequency_hz=2.0) for _ in range(2))
    nees, unaware = [], []
    for run in range(40):
        bearing = 2.0 * np.pi / 4 * (np.arange(4) + rng.uniform(-0.2, 0.2, 4))
        seen = sn.simulation.aperture_snapshots(truth, bearing, WAVELENGTH_M, time_s=time_s, seed=run)
        velocity = rng.normal(0.0, 0.05, 2)
        reported = truth + np.outer(time_s, velocity) + np.tensordot(rng.normal(size=2), modes, axes=1)
        found = aware.bearings(seen.phasors, reported, WAVELENGTH_M, time_s=time_s, path_covariance_m2=covariance)
        other = plain.bearings(seen.phasors, reported, WAVELENGTH_M, time_s=time_s)
        assert found.ok
        nees.append(sn.estimation.nees(wrapped(found.bearing_rad - bearing)[None], found.covariance_rad2[None])[0])
        unaware.append(sn.estimation.nees(wrapped(other.bearing_rad - bearing)[None], other.covariance_rad2[None])[0])
    assert 2.2 < np.mean(nees) < 6.0  # 4 +- 4 sqrt(8/40), a little room
    assert np.mean(unaware) > np.mean(nees)


@pytest.mark.unit
def test_reflection_is_told_by_the_position_only() -> None:
    nodes = np.array([[30.0, 0.0], [-5.0, 28.0], [-26.0, -9.0], [8.0, -31.0]])
    place, heading = np.array([1.0, 2.0]), 0.6
    truth = wrapped(np.arctan2(*(nodes - place).T[::-1]) - heading)
    seen_at = truth.copy()
    seen_at[1] += 0.9  # by way of a mirror
    seen = sn.simulation.aperture_snapshots(loop(), seen_at, WAVELENGTH_M, snr_db=15.0, seed=3)
    found = sn.array.SyntheticAperture().bearings(seen.phasors, loop(), WAVELENGTH_M)
    assert found.los.all()
    check = sn.array.check_bearings(found.bearing_rad, found.covariance_rad2, nodes, place, 0.09 * np.eye(2))
    assert check.consistent.tolist() == [True, False, True, True]
    assert wrapped(check.heading_rad - heading) == pytest.approx(0.0, abs=0.1)


@pytest.mark.crosscheck
def test_bearings_from_iq_of_lte_cells() -> None:
    """Four cells, 6 RB: each snapshot's reference signals of one subframe make one gain per cell."""
    rng = np.random.default_rng(11)
    rate, n, size = 1.92e6, 48, 128
    bearing = np.array([0.4, 1.9, -2.6, -0.9])
    ids = (0, 1, 2, 9)
    path = loop(n)
    time_s = 0.04 * np.arange(n)
    offset_hz = np.array([0.0, 1.5, -2.0, 0.7])
    psi = np.cumsum(rng.normal(0.0, 1.5, n))
    phi = rng.uniform(0.0, 2.0 * np.pi, 4)
    phasors = np.zeros((n, 4), dtype=np.complex128)
    starts = {0: 10, 4: 10 + 4 * 137 + 0}  # first samples after the cyclic prefixes of symbols 0 and 4
    for k in range(n):
        phase = psi[k] + phi + 2 * np.pi * offset_hz * time_s[k]
        phase += 2 * np.pi / WAVELENGTH_M * path[k] @ np.stack((np.cos(bearing), np.sin(bearing)))
        cells = [
            sn.lte.CellParameters(
                cell_id=cell, n_rb=6, carrier_phase_rad=float(np.angle(np.exp(1j * p))), data_load=0.0
            )
            for cell, p in zip(ids, phase, strict=True)
        ]
        iq = sn.lte.synthesize(cells, rate, 960, snr_db=-6.0, seed=100 + k)
        for symbol, first in starts.items():
            grid = np.fft.fftshift(np.fft.fft(iq[first : first + size])) / np.sqrt(size)
            for i, cell in enumerate(ids):
                values, carriers = sn.lte.crs(cell, 0, symbol, n_rb=6)
                at = 64 + np.where(carriers < 36, carriers - 36, carriers - 35)
                phasors[k, i] += np.sum(grid[at] * values.conj())
    found = sn.array.SyntheticAperture().bearings(phasors, path, WAVELENGTH_M, time_s=time_s)
    assert found.status is STATUS.OK, found
    error = wrapped(found.bearing_rad - bearing)
    assert (np.abs(error) < 5.0 * found.sigma_rad).all()
    assert np.rad2deg(found.sigma_rad).max() < 2.0
    np.testing.assert_allclose(found.frequency_offset_hz, offset_hz - offset_hz[0], atol=0.1)
    snr_db = 10.0 * np.log10(found.amplitude**2 / found.noise_variance)
    assert (snr_db > 5.0).all()
    assert (snr_db < 14.0).all()


@pytest.mark.slow
@pytest.mark.consistency
def test_claims_hold(tmp_path: Any) -> None:
    from soopnav_cpp.experiments.registry import REGISTRY, perform

    [item] = REGISTRY.select(["nielsen-x1"])
    outcome = perform(item, seed=1, out=tmp_path)
    assert outcome.error is None, outcome.error
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []


@pytest.mark.consistency
def test_a_small_share_of_nielsen_x1() -> None:
    """Forty loops under a TCXO: errors as large as the bound, and a bound three times as small would not do."""
    from soopnav_cpp.experiments import nielsen_aperture

    rows = nielsen_aperture.loops(1, 4, 2.0 * np.pi, nielsen_aperture.PATH_SIGMA_M, 40)
    assert np.isfinite(rows).all()
    assert rows[:, -1].mean() > 0.9
    ratio = np.sqrt(np.mean((rows[:, :4] / rows[:, 4:8]) ** 2))
    assert 0.7 < ratio < 1.35
    assert 2.2 < rows[:, -2].mean() < 6.0


@pytest.mark.fuzz
def test_whatever_comes_gives_a_status_and_no_nan_in_an_answer() -> None:
    rng = np.random.default_rng(0)
    seen = set()
    for case in range(30):
        n, nodes = int(rng.integers(0, 20)), int(rng.integers(1, 7))
        aperture = sn.array.SyntheticAperture(
            phase=("free", "known", "random_walk")[case % 3],  # type: ignore[arg-type]
            phase_sigma_rad_per_sqrt_s=float(10.0 ** rng.uniform(-4, 2)),
            frequency_offsets=bool(rng.integers(2)),
            path_sigma_m_per_sqrt_step=float(rng.choice([0.0, 1e-9, 5e-4, 1.0])),
            noise_variance=float(rng.choice([0.0, 1e-12, 1.0, 1e12])),
            coherence_threshold=float(rng.choice([0.0, 0.7])),
            max_frequency_hz=1.0,
        )
        scale = 10.0 ** rng.uniform(-160, 160) if rng.integers(2) else 1.0
        phasors = (rng.normal(size=(n, nodes)) + 1j * rng.normal(size=(n, nodes))) * scale
        path = np.cumsum(rng.normal(size=(n, 2)) * 10.0 ** rng.uniform(-3, -1), axis=0)
        time_s = np.cumsum(10.0 ** rng.uniform(-6, 6) * rng.uniform(0.5, 1.0, n))
        found = aperture.bearings(phasors, path, WAVELENGTH_M, time_s=time_s)
        blind = aperture.blind(phasors, WAVELENGTH_M, time_s=time_s)
        seen.add(found.status)
        if found.ok:
            there = np.isfinite(found.bearing_rad)
            assert there.any()
            assert np.isfinite(found.sigma_rad[there]).all()
        else:
            assert np.isnan(found.bearing_rad).all()
        assert np.isfinite(blind.path_m).all() == (blind.ok or n == 0)
    assert len(seen) >= 3
