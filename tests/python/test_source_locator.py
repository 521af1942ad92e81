"""navigation.locate_source and its kin: values, refusals, consistency against the bound."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import soopnav_cpp as sn
from soopnav_cpp.navigation import (
    BearingUse,
    SourceLocator,
    SourceStatus,
    SourceTracks,
    cep,
    likelihood_surface,
    locate_source,
    source_crlb,
)

Array = npt.NDArray[np.float64]
METHODS = ("centroid", "incenter", "linear", "stansfield", "least_squares", "ml", "ekf", "ekf_bank", "particle")
SOURCE = np.array([40.0, 60.0])
CHI_FAR = 3.9  # standard normal deviations that a mean of many stays within but once in ten thousand


def drive(n: int = 120) -> Array:
    """700 m east at 160 m from the source, then 700 m north."""
    s = np.linspace(0.0, 1.0, n)
    return np.stack([-500.0 + 700.0 * np.minimum(2 * s, 1.0), -100.0 + 700.0 * np.maximum(2 * s - 1.0, 0.0)], axis=1)


def heard(positions: Array, source: Array, sigma: npt.ArrayLike, runs: int, seed: int) -> Array:
    """Azimuths (runs, n), or azimuths and elevations (runs, n, 2), with normal errors."""
    d = source - positions
    azimuth = np.arctan2(d[:, 1], d[:, 0])
    truth = azimuth
    if positions.shape[1] == 3:
        truth = np.stack([azimuth, np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1]))], axis=1)
    return truth + np.asarray(sigma) * np.random.default_rng(seed).standard_normal((runs, *truth.shape))


def sigmas(positions: Array, source: Array) -> Array:
    """A degree near, ten far away."""
    return np.radians(1.0 + np.linalg.norm((source - positions)[:, :2], axis=1) / 80.0)


@pytest.mark.unit
@pytest.mark.parametrize("method", METHODS)
def test_exact_bearings_give_the_source(method: str) -> None:
    p = drive()
    sigma = sigmas(p, SOURCE)
    start = [150.0, 200.0] if method in ("ekf", "particle") else None
    fix = locate_source(p, heard(p, SOURCE, 0.0, 1, 1)[0], sigma, method, start_m=start, start_sigma_m=300.0)
    assert fix.status is SourceStatus.CONVERGED, fix
    assert fix.position_m == pytest.approx(SOURCE, abs=1e-3 if method not in ("ekf", "ekf_bank", "particle") else 3.0)
    assert fix.covariance_m2.shape == (2, 2)
    assert fix.unobservable == []
    assert fix.line is None
    assert "the source is at" in fix.message
    assert "bearings used" in repr(fix)
    if method not in ("centroid", "incenter"):
        assert fix.cep_m == pytest.approx(cep(fix.covariance_m2))


@pytest.mark.consistency
@pytest.mark.parametrize("method", ["stansfield", "least_squares", "ml", "ekf_bank", "particle"])
def test_errors_reach_the_bound_and_are_what_the_covariance_says(method: str) -> None:
    runs = 40 if method == "particle" else 150
    p = drive()
    sigma = sigmas(p, SOURCE)
    start = np.tile([60.0, 90.0], (runs, 1)) if method == "particle" else None
    locator = SourceLocator(method, start_sigma_m=100.0, seed=3, particles=3000, grid_size=16)
    run = locator.run_many(np.arange(len(p)), p, heard(p, SOURCE, sigma, runs, 11), sigma, starts_m=start)
    bound = source_crlb(p, SOURCE, sigma)[-1]
    ratio = np.mean(run.error_m(SOURCE) ** 2) / np.trace(bound)
    # Mean of `runs` squared errors of two components: deviation sqrt(2 / (2 runs)) or a little more.
    spread = CHI_FAR * np.sqrt(1.6 / runs)
    assert 1.0 - spread < ratio < 1.0 + spread + 0.08
    nees = run.nees(SOURCE)[:, 0]
    assert 2.0 * (1.0 - spread) < nees.mean() < 2.0 * (1.0 + spread) + 0.2
    assert set(run.status) == {SourceStatus.CONVERGED}


@pytest.mark.consistency
@pytest.mark.parametrize("method", ["ml", "ekf_bank"])
def test_a_moving_source_and_its_velocity(method: str) -> None:
    runs, n = 120, 120
    p, t = drive(n), np.linspace(0.0, 100.0, n)
    velocity = np.array([0.8, -0.5])
    truth = SOURCE + np.outer(t - 50.0, velocity)
    d = truth - p
    sigma = np.radians(0.5 + np.linalg.norm(d, axis=1) / 200.0)
    z = np.arctan2(d[:, 1], d[:, 0]) + sigma * np.random.default_rng(5).standard_normal((runs, n))
    locator = SourceLocator(method, motion="constant_velocity", start_speed_sigma_mps=3.0, grid_size=16)
    run = locator.run_many(t, p, z, sigma)
    bound = source_crlb(p, truth[0], sigma, times=t, motion="constant_velocity", velocity=velocity)[-1]
    spread = CHI_FAR * np.sqrt(1.6 / runs)
    ratio = np.mean(run.error_m(truth[-1]) ** 2) / np.trace(bound[:2, :2])
    assert 1.0 - spread < ratio < 1.0 + spread + 0.15
    assert 2.0 * (1.0 - spread) < run.nees(truth[-1])[:, 0].mean() < 2.0 * (1.0 + spread) + 0.4
    speed = np.mean(np.sum((run.velocity_mps[:, 0] - velocity) ** 2, axis=1)) / np.trace(bound[2:, 2:])
    assert 1.0 - spread < speed < 1.0 + spread + 0.15


@pytest.mark.consistency
def test_a_source_that_wanders_is_followed_with_process_noise() -> None:
    runs, n, psd = 60, 120, 1e-3
    rng = np.random.default_rng(8)
    t = np.linspace(0.0, 120.0, n)
    dt = t[1]
    p = 300.0 * np.stack([np.cos(0.08 * t), np.sin(0.08 * t)], axis=1)
    noise = np.sqrt(psd) * rng.standard_normal((2, runs, n - 1, 2))
    kick = np.sqrt(dt) * (np.sqrt(0.75) * noise[0] + 0.5 * noise[1])
    speed = np.concatenate([np.zeros((runs, 1, 2)), np.cumsum(kick, axis=1)], axis=1)
    step = dt * speed[:, :-1] + dt**1.5 / np.sqrt(3.0) * noise[0]
    truth = SOURCE + np.concatenate([np.zeros((runs, 1, 2)), np.cumsum(step, axis=1)], axis=1)
    d = truth - p
    z = np.arctan2(d[..., 1], d[..., 0]) + np.radians(1.0) * rng.standard_normal((runs, n))
    epochs = [59, 89, 119]
    locator = SourceLocator("ekf_bank", motion="constant_velocity", acceleration_psd=psd, start_speed_sigma_mps=2.0)
    run = locator.run_many(t, p, z, np.radians(1.0), epochs=epochs)
    nees = run.nees(truth[:, epochs])[:, 1:]
    # 60 runs of two epochs that depend on each other: at least 60 draws of chi-square with two degrees of freedom.
    assert 2.0 * (1.0 - CHI_FAR / np.sqrt(60.0)) < nees.mean() < 2.0 * (1.0 + CHI_FAR / np.sqrt(60.0))
    still = SourceLocator("ekf_bank").run_many(t, p, z, np.radians(1.0))
    assert still.nees(truth[:, -1:])[:, 0].mean() > 10.0


@pytest.mark.consistency
@pytest.mark.parametrize("method", ["stansfield", "ml", "ekf_bank"])
def test_three_dimensions_reach_the_bound(method: str) -> None:
    runs = 150
    p = np.column_stack([drive(), np.zeros(120)])
    source = np.array([*SOURCE, 50.0])
    one = sigmas(p, source)
    sigma = np.stack([one, 1.5 * one], axis=1)
    locator = SourceLocator(method, dimensions=3, grid_size=16)
    run = locator.run_many(np.arange(120.0), p, heard(p, source, sigma, runs, 12), sigma)
    bound = source_crlb(p, source, sigma)[-1]
    spread = CHI_FAR * np.sqrt(1.6 / runs)
    error = run.position_m[:, 0] - source
    for part in (slice(0, 2), slice(2, 3)):
        ratio = np.mean(np.sum(error[:, part] ** 2, axis=1)) / np.trace(bound[part, part])
        assert 1.0 - 1.3 * spread < ratio < 1.0 + 1.3 * spread + 0.15
    assert 3.0 * (1.0 - spread) < run.nees(source)[:, 0].mean() < 3.0 * (1.0 + spread) + 0.5


@pytest.mark.consistency
def test_pose_errors_are_accounted_for() -> None:
    """Platform known to 8 m, heading to 2 degrees: errors grow, and the covariance says by how much."""
    runs, p = 150, drive()
    sigma = sigmas(p, SOURCE)
    rng = np.random.default_rng(4)
    z = heard(p, SOURCE, sigma, runs, 13) + np.radians(2.0) * rng.standard_normal((runs, len(p)))
    # The true place is off by a draw; the bearing is taken there, the locator is told `p`.
    off = 8.0 * rng.standard_normal((runs, len(p), 2))
    d = SOURCE - p
    there = SOURCE - (p + off)
    z += np.arctan2(there[..., 1], there[..., 0]) - np.arctan2(d[:, 1], d[:, 0])
    pose = {"position_covariance": 64.0 * np.eye(2), "heading_sigma_rad": np.radians(2.0)}
    spread = CHI_FAR * np.sqrt(1.6 / runs)
    for method in ("stansfield", "ml", "ekf_bank"):
        run = SourceLocator(method, grid_size=16).run_many(np.arange(len(p)), p, z, sigma, **pose)
        nees = run.nees(SOURCE)[:, 0].mean()
        assert 2.0 * (1.0 - spread) < nees < 2.0 * (1.0 + spread) + 0.3, method
        naive = SourceLocator(method, grid_size=16).run_many(np.arange(len(p)), p, z, sigma)
        assert naive.nees(SOURCE)[:, 0].mean() > 2.0 * (1.0 + spread) + 0.6, method


@pytest.mark.law
def test_bearings_rotate_and_move_with_the_world() -> None:
    p = drive()
    sigma = sigmas(p, SOURCE)
    z = heard(p, SOURCE, sigma, 1, 2)[0]
    turn, shift = 2.2, np.array([1e5, -3e5])
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    for method in ("centroid", "incenter", "stansfield", "least_squares", "ml", "ekf_bank"):
        one = locate_source(p, z, sigma, method)
        other = locate_source(p @ R.T + shift, z + turn, sigma, method, max_range_m=20.0 * float(np.hypot(700, 700)))
        assert other.position_m == pytest.approx(R @ one.position_m + shift, abs=2e-3), method
        if method not in ("centroid", "incenter"):
            assert other.covariance_m2 == pytest.approx(R @ one.covariance_m2 @ R.T, rel=1e-3, abs=1e-4)


@pytest.mark.crosscheck
@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_filter_step_is_that_of_the_general_filter(dimensions: int) -> None:
    """Updates beside the library's own filter with its own models, which have the state as the receiver: the bearing
    from the source back to the platform. Its azimuths count from north in three dimensions."""
    start = np.array([90.0, 30.0, 20.0])[:dimensions]
    ekf = sn.estimation.ExtendedKalmanFilter(f"position{dimensions}", start, 900.0 * np.eye(dimensions))
    locator = SourceLocator("ekf", dimensions=dimensions, start_m=start, start_sigma_m=30.0)
    for k, place in enumerate(np.array([[-20.0, -70.0, 0.0], [60.0, -90.0, 5.0], [150.0, 0.0, -3.0]])):
        azimuth, elevation, sigma = [0.9, 1.2, 2.6][k], 0.2, np.array([0.05, 0.08])
        if dimensions == 2:
            fix = locator.step(float(k), place[:2], azimuth, sigma[0])
            ekf.update(sn.measurement.Azimuth(place[:2]), azimuth + np.pi, sigma[0] ** 2)
        else:
            fix = locator.step(float(k), place, [azimuth, elevation], sigma)
            back = [0.5 * np.pi - (azimuth + np.pi), -elevation]
            ekf.update(sn.measurement.AzimuthElevation(place), back, np.diag(sigma**2))
        assert fix.position_m == pytest.approx(ekf.x, rel=1e-9)
        assert fix.covariance_m2 == pytest.approx(ekf.P, rel=1e-8, abs=1e-8)


@pytest.mark.unit
def test_nothing_observable_is_said_with_the_line() -> None:
    p = drive()
    z = heard(p, SOURCE, 0.0, 1, 1)[0]
    rng = np.random.default_rng(3)
    still = locate_source(np.tile(p[:1], (30, 1)), z[0] + 0.01 * rng.standard_normal(30), 0.01)
    assert still.status is SourceStatus.UNOBSERVABLE
    assert still.line is not None
    assert still.line.point_m[:2] == pytest.approx(p[0])
    assert np.arctan2(still.line.direction[1], still.line.direction[0]) == pytest.approx(z[0], abs=0.01)
    assert still.line.sigma_rad == pytest.approx(0.01 / np.sqrt(30))
    assert still.unobservable[0].startswith("range along azimuth")
    assert np.isnan(still.position_m).all()
    parallel = locate_source(p, np.full(len(p), 0.7), 0.01)
    assert parallel.status is SourceStatus.UNOBSERVABLE
    assert "not observable" in parallel.message
    assert "SourceLine" in repr(parallel.line)
    assert locate_source(p[:1], z[:1], 0.1).status is SourceStatus.TOO_FEW_BEARINGS
    assert locate_source(np.empty((0, 2)), [], 0.1).status is SourceStatus.TOO_FEW_BEARINGS


@pytest.mark.unit
def test_bad_bearings_are_left_out_and_said_so() -> None:
    p = drive()
    z = heard(p, SOURCE, 0.0, 1, 1)[0]
    sigma = sigmas(p, SOURCE)
    z[5], sigma[7] = np.nan, -1.0
    for method in METHODS:
        fix = locate_source(p, z, sigma, method)
        assert fix.rejected == 2, method
        assert np.isfinite(fix.position_m).all(), method
    locator = SourceLocator("ekf", start_m=[0.0, 0.0])
    assert locator.step(1.0, p[0], z[0], 0.1).last is BearingUse.USED
    before = locator.step(2.0, p[1], z[1], 0.1)
    after = locator.step(3.0, p[2], np.nan, 0.1)
    assert after.last is BearingUse.NOT_FINITE
    assert "not finite" in after.message
    assert (after.position_m == before.position_m).all()
    assert locator.step(1.5, p[3], z[3], 0.1).last is BearingUse.OUT_OF_ORDER
    bank = SourceLocator("ekf_bank")
    assert bank.step(0.0, p[0], z[0], 0.5).last is BearingUse.WAITING
    assert bank.members[0].shape == (0, 2)
    bank.step(1.0, p[1], z[1], 0.05)
    assert bank.members[0].shape == (10, 2)
    assert bank.members[1].sum() == pytest.approx(1.0)


@pytest.mark.unit
def test_a_filter_that_went_wrong_says_so() -> None:
    p = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
    fix = locate_source(p, heard(p, np.array([150.0, 80.0]), 0.0, 1, 1)[0], 0.01, "ekf")
    assert float(np.linalg.norm(fix.position_m - [150.0, 80.0])) > 10.0 * float(np.sqrt(np.trace(fix.covariance_m2)))
    assert fix.status is SourceStatus.INCONSISTENT
    assert fix.chi_square > 50.0


@pytest.mark.unit
def test_contradictory_bearings_are_inconsistent() -> None:
    p = drive()
    z = heard(p, SOURCE, 0.01, 1, 1)[0]
    z[::2] += 1.5
    for method in ("stansfield", "least_squares", "ml"):
        assert locate_source(p, z, 0.01, method).status is SourceStatus.INCONSISTENT, method


@pytest.mark.consistency
def test_a_heading_bias_is_estimated() -> None:
    runs, p = 100, drive()
    sigma = sigmas(p, SOURCE)
    z = heard(p, SOURCE, sigma, runs, 6) + np.radians(5.0)
    for method in ("ml", "ekf_bank"):
        locator = SourceLocator(method, heading_bias_sigma_rad=np.radians(10.0), grid_size=16)
        run = locator.run_many(np.arange(len(p)), p, z, sigma)
        assert np.mean(run.heading_bias_rad) == pytest.approx(np.radians(5.0), abs=np.radians(1.0)), method
        assert run.nees(SOURCE)[:, 0].mean() < 3.5, method


@pytest.mark.unit
def test_the_surface_peaks_at_the_source_and_leaves_bad_bearings_out() -> None:
    p = drive()
    z = heard(p, SOURCE, 0.0, 1, 1)[0]
    z[3] = np.nan
    x, y, logs = likelihood_surface(p, z, 0.05, (-60.0, 140.0), (-40.0, 160.0), shape=(101, 51))
    assert logs.shape == (101, 51)
    assert x.shape == (51,)
    assert y.shape == (101,)
    row, column = np.unravel_index(np.argmax(logs), logs.shape)
    assert (x[column], y[row]) == (40.0, 60.0)
    d = np.array([x[4], y[9]]) - np.delete(p, 3, axis=0)
    e = np.delete(z, 3) - np.arctan2(d[:, 1], d[:, 0])
    e -= 2 * np.pi * np.round(e / (2 * np.pi))
    normal = np.exp(-0.5 * (e / 0.05) ** 2) / (np.sqrt(2 * np.pi) * 0.05)
    assert logs[9, 4] == pytest.approx(np.sum(np.log(0.98 * normal + 0.02 / (2 * np.pi))), rel=1e-5)


@pytest.mark.unit
def test_particles_and_seeds() -> None:
    p = drive()
    sigma = sigmas(p, SOURCE)
    z = heard(p, SOURCE, sigma, 1, 2)[0]
    runs = []
    for seed in (1, 1, 2):
        locator = SourceLocator("particle", start_m=[0.0, 0.0], start_sigma_m=200.0, particles=1000, seed=seed)
        runs.append(locator.run(np.arange(len(p)), p, z, sigma))
        assert locator.particles_m.shape == (1000, 2)
        assert locator.particle_weights.sum() == pytest.approx(1.0)
        assert locator.particle_weights @ locator.particles_m == pytest.approx(runs[-1].position_m[-1])
    assert (runs[0].position_m == runs[1].position_m).all()
    assert (runs[0].position_m != runs[2].position_m).any()
    many = SourceLocator("particle", start_sigma_m=200.0, particles=1000).run_many(
        np.arange(len(p)), p, z[None], sigma, starts_m=[[0.0, 0.0]], seeds=[1]
    )
    assert (many.position_m[0, -1] == runs[0].position_m[-1]).all()


@pytest.mark.unit
def test_two_sources_are_told_apart() -> None:
    p = drive(160)
    others = (SOURCE, np.array([120.0, -380.0]))
    rng = np.random.default_rng(2)
    tracks = SourceTracks()
    for k, place in enumerate(p):
        z = [float(heard(place[None], s, 0.02, 1, 1000 * k + i)[0, 0]) for i, s in enumerate(others)]
        if k % 3 == 0:
            z.append(float(rng.uniform(-np.pi, np.pi)))
        order = rng.permutation(len(z))
        tracks.step(float(k), place, np.array(z)[order], 0.02)
    assert len(tracks.confirmed) == 2
    assert "confirmed" in repr(tracks.confirmed[0])
    for source in others:
        assert min(np.linalg.norm(t.fix.position_m - source) for t in tracks) < 12.0
    assert [t.misses for t in tracks.step(200.0, p[-1], [], 0.02) if t in tracks.confirmed] == [1, 1]


@pytest.mark.law
def test_bounds_grow_with_what_is_unknown() -> None:
    p = drive()
    sigma = sigmas(p, SOURCE)
    plain = source_crlb(p, SOURCE, sigma)
    assert np.isinf(plain[0]).any()
    assert np.isfinite(plain[-1]).all()
    assert (np.diff([np.trace(b) for b in plain[2:]]) <= 1e-9).all()
    biased = source_crlb(p, SOURCE, sigma, heading_bias_sigma_rad=0.1)
    moving = source_crlb(p, SOURCE, sigma, motion="constant_velocity")
    pushed = source_crlb(p, SOURCE, sigma, motion="constant_velocity", acceleration_psd=0.1)
    prior = source_crlb(p, SOURCE, sigma, start_sigma_m=5.0)
    rough = source_crlb(p, SOURCE, sigma, position_covariance=100.0 * np.eye(2))
    traces = [float(np.trace(b[-1][:2, :2])) for b in (prior, plain, biased, rough, moving, pushed)]
    assert traces[0] < traces[1] < min(traces[2:4])
    assert traces[1] < traces[4] < traces[5]


@pytest.mark.unit
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"method": "guess"}, "method = 'guess'"),
        ({"motion": "circles"}, "motion = 'circles'"),
        ({"positions": np.zeros((5, 4))}, "positions: expected shape"),
        ({"bearings": np.zeros(4)}, "bearings: expected shape"),
        ({"sigmas": np.zeros(3)}, "sigmas: shape"),
        ({"times": np.zeros(3)}, "times: expected shape"),
        ({"position_covariance": np.eye(4)}, "position_covariance: expected shape"),
        ({"heading_sigma_rad": np.zeros(3)}, "heading_sigma_rad: expected"),
        ({"start_m": [1.0, 2.0, 3.0]}, "start_m: 2 numbers expected"),
        ({"particles": 2}, "particles = 2"),
        ({"outlier_probability": 1.0}, "outlier_probability = 1"),
        ({"max_range_m": 1.0, "min_range_m": 2.0}, "max_range_m = 1"),
        ({"colour": 1.0}, "colour: no such option"),
        ({"bearings": np.zeros((5, 2))}, "positions: azimuth and elevation need three"),
        ({"method": "centroid", "motion": "constant_velocity"}, "motion: centroid is for a source at rest"),
    ],
)
def test_wrong_arguments_are_named(change: dict[str, object], says: str) -> None:
    given: dict[str, object] = {"positions": drive(5), "bearings": np.zeros(5), "sigmas": 0.1}
    with pytest.raises(ValueError, match=says.replace("(", r"\(")):
        locate_source(**(given | change))  # type: ignore[arg-type]


@pytest.mark.unit
def test_wrong_arguments_of_the_others_are_named() -> None:
    p = drive(5)
    with pytest.raises(ValueError, match="emitter: expected shape"):
        source_crlb(p, [1.0], 0.1)
    with pytest.raises(ValueError, match="times_s"):
        source_crlb(p, SOURCE, 0.1, times=[0, 1, 2, 1, 3])
    with pytest.raises(ValueError, match="grid: finite limits"):
        likelihood_surface(p, np.zeros(5), 0.1, (1.0, 1.0), (0.0, 1.0))
    with pytest.raises(ValueError, match="starts_m: expected shape"):
        SourceLocator("ekf").run_many(range(5), p, np.zeros((2, 5)), 0.1, starts_m=[[0.0, 0.0]])
    with pytest.raises(ValueError, match="epochs: ascending"):
        SourceLocator("ml").run_many(range(5), p, np.zeros((2, 5)), 0.1, epochs=[3, 2])
    with pytest.raises(ValueError, match="clutter_density_per_rad"):
        SourceTracks(clutter_density_per_rad=-1.0)
    with pytest.raises(ValueError, match="covariance_m2"):
        cep(np.ones(3))


@pytest.mark.unit
def test_many_runs_begin_where_the_locator_does() -> None:
    p = drive()
    sigma = sigmas(p, SOURCE)
    z = heard(p, SOURCE, sigma, 2, 2)
    locator = SourceLocator("ekf", start_m=[60.0, 90.0], start_sigma_m=100.0)
    own = locator.run_many(np.arange(len(p)), p, z, sigma)
    given = locator.run_many(np.arange(len(p)), p, z, sigma, starts_m=[[60.0, 90.0]] * 2)
    bare = SourceLocator("ekf", start_sigma_m=100.0).run_many(np.arange(len(p)), p, z, sigma)
    assert (own.position_m == given.position_m).all()
    assert (own.position_m != bare.position_m).any()


@pytest.mark.unit
def test_numbers_that_cannot_be_are_named() -> None:
    p = drive(5)
    locator = SourceLocator("ekf", start_m=[0.0, 0.0])
    for start in ([np.nan, 0.0], [1.0], [1.0, 2.0, 3.0, 4.0]):
        with pytest.raises(ValueError, match="start_m: "):
            locator.reset(start)
    with pytest.raises(ValueError, match="seed = -1"):
        locator.reset(seed=-1)
    with pytest.raises(ValueError, match="seeds: numbers from 0"):
        locator.run_many(range(5), p, np.zeros((1, 5)), 0.1, seeds=[-3])
    with pytest.raises(ValueError, match="sigma: a number expected"):
        locator.step(0.0, p[0], 0.1, [])
    with pytest.raises(ValueError, match="bearings: real numbers"):
        locate_source(p, np.full(5, 1.0 + 1.0j), 0.1)
    far = p.copy()
    far[0, 0] = 1e300
    with pytest.raises(ValueError, match="positions: they lie too far apart"):
        locate_source(far, np.zeros(5), 0.1)
    with pytest.raises(ValueError, match="options: a number of the wrong kind") as error:
        SourceTracks(filters=2.5)
    assert "Invoked" not in str(error.value)
    assert "cast" not in str(error.value)
    with pytest.raises(ValueError, match="shape = "):
        likelihood_surface(p, np.zeros(5), 0.1, (0.0, 1.0), (0.0, 1.0), shape=(-1, 5))
    short = np.column_stack([np.linspace(0.0, 1.0, 5), np.zeros(5)])
    assert locate_source(short, np.linspace(1.0, 1.2, 5), 0.1, "ekf_bank", min_range_m=100.0).used > 0
