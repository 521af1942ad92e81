"""Arrays: geometry and its ambiguities, manifolds and their files, antennas, and what is refused."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import soopnav_cpp as sn
from soopnav_cpp.array import AmbiguityWarning, ArrayGeometry, ArrayStatus, DirectionFinder, Manifold


def test_steering_sign_and_makers() -> None:
    wavelength = ArrayGeometry.ula(3).wavelength_m
    # A source on axis 1: the element farther along axis 1 is nearer to it, hence ahead.
    a = Manifold(ArrayGeometry.ula(2, 0.25)).steering(0.0)
    np.testing.assert_allclose(np.angle(a[1] / a[0]), np.pi / 2)
    assert ArrayGeometry.ula(3).rank == 1
    np.testing.assert_allclose(ArrayGeometry.ula(3).positions_m / wavelength, [[0, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    uca = ArrayGeometry.uca(4, 0.3)
    np.testing.assert_allclose(
        uca.positions_m / wavelength, 0.3 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]), atol=1e-12
    )
    assert uca.rank == 2
    grid = ArrayGeometry.planar(3, 2, 0.4)
    np.testing.assert_allclose(grid.positions_m[[1, 3]] / wavelength, [[0.4, 0, 0], [0, 0.4, 0]], atol=1e-12)
    assert grid.aperture_m == pytest.approx(np.hypot(0.8, 0.4) * wavelength)
    cube = ArrayGeometry([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], 1e9, "tetra")
    assert cube.rank == 3
    assert "tetra" in repr(cube)


def test_ambiguous_directions_have_the_same_steering_vector() -> None:
    cases = [
        ArrayGeometry.ula(4, 1.0),
        ArrayGeometry.planar(3, 3, 0.8),
        ArrayGeometry.uca(4, 1.0),
        ArrayGeometry(1.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.299792458, 1e9),
    ]
    for geometry in cases:
        assert geometry.ambiguous
        manifold, found = Manifold(geometry), 0
        for azimuth, elevation in ((0.3, 0.0), (1.4, 0.4), (np.pi / 2, 0.0), (0.0, 0.0)):
            here = manifold.steering(azimuth, elevation)[:, 0]
            for double in geometry.ambiguous_directions(azimuth, elevation):
                there = manifold.steering(*double)[:, 0]
                assert abs(np.vdot(here, there)) == pytest.approx(len(geometry), abs=1e-6)
                found += 1
        assert found > 0
    assert not ArrayGeometry.planar(2, 2, 0.49).ambiguous
    assert len(ArrayGeometry.planar(2, 2, 0.49).ambiguous_directions(0.0, 0.0)) == 0
    # Half a wavelength: only the two ends are doubles.
    assert not ArrayGeometry.ula(4, 0.5).ambiguous
    np.testing.assert_allclose(ArrayGeometry.ula(4, 0.5).ambiguous_directions(0.0), [[np.pi, 0.0]], atol=1e-7)


def test_ambiguous_spacing_warns_with_directions() -> None:
    with pytest.warns(AmbiguityWarning, match=r"0\.7 wavelengths.*doubles \("):
        DirectionFinder(ArrayGeometry.planar(3, 3, 0.7), azimuth_step_deg=5, elevation_step_deg=5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        DirectionFinder(ArrayGeometry.planar(3, 3, 0.5), azimuth_step_deg=5, elevation_step_deg=5)


def test_ambiguity_is_that_of_the_signal_s_frequency() -> None:
    half = ArrayGeometry.ula(4, 0.5)
    with pytest.warns(AmbiguityWarning, match=r"elements 1 wavelengths apart.*doubles \("):
        DirectionFinder(half, frequency_hz=2.0 * half.frequency_hz)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        DirectionFinder(ArrayGeometry.ula(4, 0.9), frequency_hz=0.5 * half.frequency_hz)


def test_forward_backward_is_for_arrays_with_that_symmetry() -> None:
    for geometry in (ArrayGeometry.uca(5, 0.4), ArrayGeometry.uca(4, 0.3)):
        with pytest.raises(ValueError, match=r"forward_backward: True; elements . and . are not symmetric"):
            DirectionFinder(geometry, forward_backward=True)
    for geometry in (ArrayGeometry.ula(4), ArrayGeometry.planar(3, 2, 0.3)):
        DirectionFinder(geometry, forward_backward=True)


def test_a_plane_whose_measured_responses_tell_its_sides_apart_is_not_folded() -> None:
    plane = ArrayGeometry.planar(2, 2, 0.2)
    real = plane.positions_m
    real[:, 2] = [0.0, 0.03, 0.01, 0.02]
    bent = Manifold(ArrayGeometry(real, 1575.42e6))
    azimuth, elevation = np.deg2rad(np.arange(-180.0, 180.0, 5.0)), np.deg2rad(np.arange(-90.0, 91.0, 5.0))
    el, az = np.meshgrid(elevation, azimuth, indexing="ij")
    sphere = Manifold.measured(plane, 1575.42e6, azimuth, elevation, bent.steering(az, el).reshape(4, 1, *el.shape))
    a = bent.steering(0.5, np.deg2rad(-10.0))
    R = a @ a.conj().T + np.eye(4)
    found = DirectionFinder(sphere, elevation_min_deg=-30).estimate_covariance(R, 2500)
    assert not found.mirror
    np.testing.assert_allclose([found.azimuth_rad[0], found.elevation_rad[0]], [0.5, np.deg2rad(-10.0)], atol=3e-3)
    assert DirectionFinder(sphere).estimate_covariance(R, 2500).mirror  # one side only is searched


def test_mirror_is_stated_and_folded_to_the_reported_side() -> None:
    a = Manifold(ArrayGeometry.planar(2, 2, 0.2)).steering(0.5, -0.8)  # from below
    R = a @ a.conj().T + np.eye(4)
    found = DirectionFinder(ArrayGeometry.planar(2, 2, 0.2)).estimate_covariance(R, 2500)
    assert found.mirror
    np.testing.assert_allclose([found.azimuth_rad[0], found.elevation_rad[0]], [0.5, 0.8], atol=1e-7)
    cube = [*ArrayGeometry.planar(2, 2, 0.2).positions_m.tolist(), [0.0, 0.0, 0.05]]
    solid = Manifold(ArrayGeometry(cube, 1575.42e6))
    a = solid.steering(0.5, -0.8)
    found = DirectionFinder(solid, elevation_min_deg=-90).estimate_covariance(a @ a.conj().T + np.eye(5), 2500)
    assert not found.mirror
    np.testing.assert_allclose([found.azimuth_rad[0], found.elevation_rad[0]], [0.5, -0.8], atol=1e-7)
    wall = ArrayGeometry([[0, 0, 0], [0, 0.05, 0], [0, 0, 0.05], [0, 0.05, 0.05]], 1575.42e6)  # looks along axis 1
    a = Manifold(wall).steering(2.5, 0.3)
    found = DirectionFinder(wall, elevation_min_deg=-90).estimate_covariance(a @ a.conj().T + np.eye(4), 2500)
    np.testing.assert_allclose([found.azimuth_rad[0], found.elevation_rad[0]], [np.pi - 2.5, 0.3], atol=1e-7)


def test_a_vertical_line_tells_elevation() -> None:
    mast = ArrayGeometry([[0, 0, 0.0], [0, 0, 0.09], [0, 0, 0.18]], 1575.42e6)
    a = Manifold(mast).steering(1.0, 0.4)
    found = DirectionFinder(mast).estimate_covariance(a @ a.conj().T + np.eye(3), 1000)
    assert found.elevation_rad[0] == pytest.approx(0.4, abs=1e-7)
    assert np.isinf(found.covariance_rad2[0, 0, 0])
    assert 0.0 < found.covariance_rad2[0, 1, 1] < 0.01
    with pytest.raises(ValueError, match="horizontal or vertical"):
        DirectionFinder(ArrayGeometry([[0, 0, 0], [0.1, 0, 0.1]], 1e9))


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_manifold_files(tmp_path: Path, suffix: str) -> None:
    geometry = ArrayGeometry.uca(4, 0.3)
    real = Manifold(geometry).with_random_errors(1.0, 0.3, seed=1).with_coupling(np.eye(4) + 0.05j)
    path = real.save(tmp_path / f"manifold{suffix}", frequency_hz=[1.5e9, 1.6e9])
    read = Manifold.load(path, geometry)
    rng = np.random.default_rng(2)
    az, el = rng.uniform(-np.pi, np.pi, 50), rng.uniform(0.0, np.pi / 2, 50)
    # Between grid points of 5 degrees: the coupling's part turns with the geometry, so it is interpolated.
    np.testing.assert_allclose(read.steering(az, el), real.steering(az, el), atol=2e-3)
    on_grid = np.deg2rad(35.0), np.deg2rad(40.0)
    np.testing.assert_allclose(read.steering(*on_grid, 1.5e9), real.steering(*on_grid, 1.5e9), atol=1e-9)
    assert not read.ideal
    with pytest.raises(ValueError, match="do not reach"):
        read.steering(0.0, -0.5)
    iq_a = real.steering(0.4, 0.7)
    found = DirectionFinder(read).estimate_covariance(iq_a @ iq_a.conj().T + np.eye(4), 1000)
    np.testing.assert_allclose([found.azimuth_rad[0], found.elevation_rad[0]], [0.4, 0.7], atol=2e-3)


def test_a_measured_sector_is_all_that_is_searched() -> None:
    geometry = ArrayGeometry.uca(5, 0.4)
    azimuth, elevation = np.deg2rad(np.arange(-60.0, 61.0, 5.0)), np.deg2rad(np.arange(10.0, 71.0, 5.0))
    el, az = np.meshgrid(elevation, azimuth, indexing="ij")
    response = Manifold(geometry).steering(az, el).reshape(5, 1, *el.shape)
    sector = Manifold.measured(geometry, geometry.frequency_hz, azimuth, elevation, response)
    assert sector.reaches([0.0, 2.0, 0.0, 0.0], [0.5, 0.5, 0.0, np.nan]).tolist() == [True, False, False, False]
    finder = DirectionFinder(sector)
    for at in ((0.3, 0.5), (3.0, 0.5), (0.3, 0.05)):  # the last two outside: something inside, finite, comes out
        a = Manifold(geometry).steering(*at)
        R = a @ a.conj().T + np.eye(5)
        found = finder.estimate_covariance(R, 1000, spectrum=True)
        assert found.status == ArrayStatus.OK
        assert sector.reaches(found.azimuth_rad, found.elevation_rad).all()
        assert np.isfinite(found.covariance_rad2).all()
        assert found.spectrum is not None
        assert np.count_nonzero(found.spectrum) == 121 * 61
    found = finder.estimate_covariance(np.outer(a := sector.steering(0.3, 0.5)[:, 0], a.conj()) + np.eye(5), 1000)
    np.testing.assert_allclose([found.azimuth_rad[0], found.elevation_rad[0]], [0.3, 0.5], atol=1e-3)


def test_pickled_manifold_is_the_same(tmp_path: Path) -> None:
    geometry = ArrayGeometry.uca(4, 0.3)
    read = Manifold.load(Manifold(geometry).with_random_errors(1.0, 0.3, seed=1).save(tmp_path / "m.npz"), geometry)
    for manifold in (
        Manifold(geometry),
        read,
        read.with_errors([1, 2, 3, 4], [0.1] * 4).with_coupling(2.0 * np.eye(4)),
    ):
        copy = pickle.loads(pickle.dumps(manifold))
        np.testing.assert_array_equal(copy.steering(0.3, 0.4), manifold.steering(0.3, 0.4))
        assert copy.ideal == manifold.ideal
        assert copy.geometry.name == geometry.name


def test_manifold_files_refused(tmp_path: Path) -> None:
    geometry = ArrayGeometry.uca(4, 0.3)
    path = Manifold(geometry).save(tmp_path / "m.csv", azimuth_rad=[0.0, 0.1], elevation_rad=[0.0, 0.1])
    lines = path.read_text().splitlines()
    bad = tmp_path / "bad.csv"
    for edit, message in (
        (lines[:-2] + lines[-1:], "1 holes, the first at element 3, azimuth 0"),
        ([lines[0].replace("gain_db", "gain"), *lines[1:]], "line 1: no column 'gain_db'"),
        ([*lines, "1,2,x,0,0,0"], f"line {len(lines) + 1}: six numbers"),
        ([*lines, lines[-1]], "twice"),
        ([lines[0], lines[1].replace(",0,0.0,", ",9,0.0,")], "line 2: element 9; 0 to 3 expected"),
        (lines[:1], "no responses"),
        ([*lines[:-1], lines[-1].rsplit(",", 1)[0] + ",nan"], "holes"),
        ([*lines[:-1], lines[-1].rsplit(",", 2)[0] + ",1e308,0"], "holes"),
        ([lines[0], *(f"{n + 1}e6,{n / 9},{n / 7},0,0,0" for n in range(200))], "200 x 200 x 200 points"),
    ):
        bad.write_text("\n".join(edit) + "\n")
        with pytest.raises(ValueError, match=message) as caught:
            Manifold.load(bad, geometry)
        assert "bad.csv" in str(caught.value)
    (tmp_path / "damaged.npz").write_bytes(b"PK\x03\x04 not an archive")
    with pytest.raises(ValueError, match=r"damaged\.npz"):
        Manifold.load(tmp_path / "damaged.npz", geometry)
    np.savez(tmp_path / "short.npz", frequency_hz=[1e9])
    with pytest.raises(ValueError, match="no array 'azimuth_rad'"):
        Manifold.load(tmp_path / "short.npz", geometry)
    with pytest.raises(ValueError, match=r"\.csv or \.npz"):
        Manifold.load(tmp_path / "m.txt", geometry)
    holes = np.ones((4, 1, 2, 36), dtype=complex)
    holes[2, 0, 1, 5] = np.nan
    with pytest.raises(ValueError, match="1 holes, the first at element 2, azimuth 50 deg, elevation 45 deg"):
        Manifold.measured(geometry, 1e9, np.deg2rad(np.arange(0, 360, 10)), [0.0, np.pi / 4], holes)
    with pytest.raises(ValueError, match="evenly"):
        Manifold.measured(geometry, 1e9, [0.0, 0.1, 0.3], [0.0, 0.1], np.ones((4, 1, 2, 3)))


def test_load_array(tmp_path: Path) -> None:
    pytest.importorskip("tomlkit")
    path = tmp_path / "array.toml"
    path.write_text(
        'name = "roof"\nkind = "planar"\nfrequency_hz = 1575.42e6\nnx = 2\nny = 2\nspacing_wavelengths = 0.2\n'
    )
    manifold = sn.array.load_array(path)
    assert manifold.geometry.name == "roof"
    np.testing.assert_allclose(manifold.geometry.positions_m, ArrayGeometry.planar(2, 2, 0.2).positions_m)
    path.write_text("frequency_hz = 1e9\nelements_m = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]\ngain_db = [0, 1, 2]\n")
    assert sn.array.load_array(path).gain_db.tolist() == [0, 1, 2]
    Manifold(ArrayGeometry.uca(4, 0.3, frequency_hz=1e9)).save(tmp_path / "m.npz")
    path.write_text('frequency_hz = 1e9\nkind = "uca"\nn = 4\nradius_wavelengths = 0.3\nmanifold = "m.npz"\n')
    assert not sn.array.load_array(path).ideal
    for text, message in (
        ("frequency_hz = 1e9\n", "elements_m is missing"),
        ("kind = 'ula'\nn = 4\n", "frequency_hz is missing"),
        ("frequency_hz = 1e9\nkind = 'star'\n", "'star'; one of"),
        ("frequency_hz = -1\nkind = 'ula'\nn = 3\n", "frequency_hz: -1.0; a positive"),
        ("frequency_hz = 1e9\ncolour = 'red'\n", "colour: no such key"),
        ("frequency_hz = 1e9\nelements_m = [[0,0,0],[0,0,0]]\n", "lie on one point"),
        ("frequency_hz = \n", "array.toml"),
        ("frequency_hz = 1e9\nkind = ['ula']\n", "kind: .'ula'.; one of"),
        ("frequency_hz = 1e9\nkind = 'ula'\nn = 4.5\n", "n: 4.5; a whole number"),
        ("frequency_hz = 1e9\nkind = 'planar'\nn = 4\nnx = 2\nny = 2\n", "n: not for kind 'planar'"),
        (
            "frequency_hz = 1e9\nkind = 'ula'\nn = 4\nspacing_m = 0.1\nspacing_wavelengths = 0.5\n",
            "spacing_m, spacing_wavelengths: both",
        ),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            sn.array.load_array(path)


def test_a_response_of_nothing_is_kept_in_a_file(tmp_path: Path) -> None:
    geometry = ArrayGeometry.ula(2)
    azimuth, elevation = np.deg2rad([0.0, 10.0]), np.deg2rad([0.0, 10.0])
    response = np.ones((2, 1, 2, 2), complex)
    response[1, 0, 0, 0] = 0.0
    silent = Manifold.measured(geometry, 1e9, azimuth, elevation, response)
    read = Manifold.load(silent.save(tmp_path / "m.csv"), geometry)
    np.testing.assert_allclose(read.steering(0.0, 0.0, 1e9)[:, 0], [1.0, 0.0], atol=1e-12)


def test_a_faulty_line_is_named_though_blank_ones_are_before_it(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    header = "frequency_hz,azimuth_deg,elevation_deg,element,gain_db,phase_deg\n\n\n"
    for row, message in (
        ("1e9,0,0,7,0,0", "line 4: element 7"),
        ("1e9,nan,0,0,0,0", "line 4: frequency, angles"),
        ("1e9,0,0,zero,0,0", "line 4: six numbers"),
    ):
        path.write_text(f"{header}{row}\n")
        with pytest.raises(ValueError, match=message):
            Manifold.load(path, ArrayGeometry.ula(2))


def test_a_faint_source_is_found() -> None:
    rng = np.random.default_rng(1)
    manifold = Manifold(ArrayGeometry.planar(2, 2, 0.2))
    noise = 0.01 * rng.standard_normal((4, 500))
    iq = 1e-25 * (manifold.steering(0.5, 0.9) @ rng.standard_normal((1, 500)) + noise)
    found = DirectionFinder(manifold).estimate(iq.astype(np.complex64))
    assert found.status == ArrayStatus.OK
    np.testing.assert_allclose([found.azimuth_rad[0], found.elevation_rad[0]], [0.5, 0.9], atol=0.01)


def test_a_covariance_is_hermitian() -> None:
    R = 2.0 * np.eye(4) + np.tri(4, k=-1)
    for call in (
        lambda: sn.array.eigenvalues(R),
        lambda: sn.array.music(R, ArrayGeometry.ula(4), 1),
        lambda: sn.array.root_music(R, 1),
    ):
        with pytest.raises(ValueError, match=r"R: R and its conjugate transpose differ by 0\.5"):
            call()
    with pytest.raises(ValueError, match="R: matrix 1 is not Hermitian"):
        DirectionFinder(ArrayGeometry.ula(4)).run([np.eye(4), R], 100)
    single = (np.ones((4, 4)) + 1e-6 * np.tri(4)).astype(np.complex64)
    assert sn.array.eigenvalues(single)[0] == pytest.approx(4.0, rel=1e-5)


def test_antennas() -> None:
    right, left, flat, upright = (0.0, -np.pi / 4), (0.3, np.pi / 4), (0.0, 0.0), (np.pi / 2, 0.0)
    factor = sn.array.polarization_factor
    assert factor(right, right) == pytest.approx(1.0)
    assert factor(right, left) == pytest.approx(0.0, abs=1e-15)
    assert factor(flat, upright) == pytest.approx(0.0, abs=1e-15)
    assert factor(flat, right) == pytest.approx(0.5)
    assert factor(flat, (np.pi / 6, 0.0)) == pytest.approx(np.cos(np.pi / 6) ** 2)
    assert sn.array.impedance_factor(50 + 10j, 50 - 10j) == pytest.approx(1.0)
    assert sn.array.impedance_factor(75, 50) == pytest.approx(1 - (25 / 125) ** 2)
    with pytest.raises(ValueError, match="resistance"):
        sn.array.impedance_factor(-1, 50)
    # 10 dBm at 1 km and L1: 96.4 dB of free space; half the power each by polarisation and impedance.
    assert sn.array.received_power_dbm(10.0, distance_m=1000.0, frequency_hz=1575.42e6) == pytest.approx(
        -86.4, abs=0.05
    )
    lossy = sn.array.received_power_dbm(
        10.0, distance_m=1000.0, frequency_hz=1575.42e6, polarization=0.5, impedance=0.5
    )
    assert lossy == pytest.approx(-86.4 - 6.02, abs=0.05)
    with pytest.raises(ValueError, match="distance_m"):
        sn.array.received_power_dbm(10.0, distance_m=0.0, frequency_hz=1e9)
    geometry = ArrayGeometry.ula(21, 0.5)  # ten wavelengths
    far = sn.array.far_field(geometry, 30.0)
    wavelength = geometry.wavelength_m
    assert far.radiating_m == pytest.approx(1.6 * wavelength)
    assert far.phase_m == pytest.approx(200 * wavelength)
    assert far.amplitude_m == pytest.approx(50 * wavelength)
    assert far.region == "near"
    assert sn.array.far_field(geometry, 60.0).region == "marginal"
    assert sn.array.far_field(geometry, 100.0).region == "far"


def test_bad_input_is_refused_by_name() -> None:
    nan = float("nan")
    R = np.eye(4, dtype=complex)
    ula = ArrayGeometry.ula(4)
    for call, message in (
        (lambda: ArrayGeometry([[0, 0, 0], [1, 0, 0], [0, 0, 0]], 1e9), "0 and 2; these elements lie on one point"),
        (lambda: ArrayGeometry([[0, 0, 0]], 1e9), "positions_m: 1; 2 to 32"),
        (lambda: ArrayGeometry([[0, 0, 0], [nan, 0, 0]], 1e9), "not finite"),
        (lambda: ArrayGeometry([[0, 0, 0], [1, 0, 0]], 0.0), "frequency_hz: 0"),
        (lambda: ArrayGeometry.ula(33), "n: 33"),
        (lambda: Manifold(ula).steering(nan, 0.0), "finite angles expected"),
        (lambda: DirectionFinder(ula).track(np.zeros((4, 20), np.complex64), 10, 0), "hop: 0"),
        (lambda: sn.array.root_music(R, -1), "n_sources: -1"),
        (
            lambda: sn.array.crlb(ArrayGeometry.planar(2, 2), [[0.5, 0.0]], 1.0, 1.0, 100),
            "directions: azimuth 0.5, elevation 0 rad; the array does not determine",
        ),
        (lambda: sn.array.esprit(R, -1), "n_sources: -1"),
        (lambda: ArrayGeometry.planar(8, 8), "nx"),
        (lambda: DirectionFinder(ula, n_sources=4), "n_sources: 4; 0 .* to the number of elements less one"),
        (lambda: DirectionFinder(ula, n_sources=0), "n_sources: 0"),
        (lambda: DirectionFinder(ula, method="espirit"), "method"),
        (lambda: DirectionFinder(ula, azimuth_step_deg=0.0), "azimuth_step"),
        (lambda: DirectionFinder(ula).estimate(np.zeros((4, 8))), "iq: expected complex64"),
        (lambda: DirectionFinder(ula).estimate(np.zeros(8, np.complex64)), "iq: expected complex64 with shape"),
        (lambda: DirectionFinder(ula).estimate(np.zeros((8, 4), np.complex64).T), "ascontiguousarray"),
        (lambda: sn.array.root_music(R, 4), "n_sources: 4"),
        (lambda: sn.array.root_music(np.ones((4, 4)), 2), "singular"),
        (lambda: sn.array.root_music(R * nan, 2), "R: NaN"),
        (lambda: sn.array.esprit(R, 2, method="best"), "method: 'best'"),
        (lambda: sn.array.capon(np.ones((4, 4)), np.ones((4, 3))), "singular covariance.*loading"),
        (lambda: sn.array.music(R, np.ones((3, 5)), 1), "steering: 3 rows; 4 expected"),
        (lambda: sn.array.music(R, np.ones((4, 5)), 4), "n_sources"),
        (lambda: sn.array.source_count(R, 100, "guess"), "method"),
        (lambda: sn.array.source_count(np.zeros((4, 4)), 100), "no positive eigenvalue"),
        (lambda: sn.array.spatial_smoothing(R, 5), "subarray_size: 5"),
        (lambda: sn.array.crlb([0.0, 0.5], [0.1, 0.2], 1.0, 1.0, 10), "directions: 2"),
        (lambda: sn.array.crlb(0.5 * np.arange(4), [[0.1, 0.2]], 1.0, 1.0, 10), "does not determine"),
        (lambda: sn.array.crlb(0.5 * np.arange(4), [0.1, 0.1], 1.0, 1.0, 10), "cannot tell"),
        (lambda: sn.array.crlb(0.5 * np.arange(4), [0.1], 1.0, 0.0, 10), "noise: 0"),
        (lambda: sn.array.crlb(0.5 * np.arange(4), [0.1], -1.0, 1.0, 10), "powers"),
        (lambda: Manifold(ula).with_errors([0, 0, 0], [0, 0, 0, 0]), "gain_db: 3"),
        (lambda: Manifold(ula).with_coupling(np.eye(3)), "coupling: 3"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_bad_channels() -> None:
    rng = np.random.default_rng(1)
    iq = (rng.standard_normal((4, 100)) + 1j * rng.standard_normal((4, 100))).astype(np.complex64)
    finder = DirectionFinder(ArrayGeometry.uca(4, 0.3), azimuth_step_deg=5, elevation_step_deg=5)
    poisoned, dead = iq.copy(), iq.copy()
    poisoned[1, 50] = np.nan
    dead[3] = 0.0
    for samples, status, message in (
        (poisoned, ArrayStatus.NON_FINITE, "channel 1 has NaN"),
        (dead, ArrayStatus.DEAD_CHANNEL, "channel 3 is dead"),
    ):
        found = finder.estimate(samples)
        assert (found.status, found.channel, len(found)) == (status, int(message[8]), 0)
        for same in (samples, samples.astype(np.complex128)):
            with pytest.raises(ValueError, match=message):
                sn.array.covariance(same)
    few = np.ascontiguousarray(iq[:, :3])
    assert finder.estimate(few).status == ArrayStatus.TOO_FEW_SNAPSHOTS
    R = sn.array.covariance(few.astype(np.complex128))  # singular, which Capon refuses and loading mends
    assert np.linalg.matrix_rank(R) == 3
    with pytest.raises(ValueError, match="singular"):
        sn.array.capon(R, np.ones((4, 1)))
    assert np.isfinite(sn.array.capon(R, np.ones((4, 1)), loading=0.01)).all()
    assert (
        DirectionFinder(ArrayGeometry.uca(4, 0.3), method="capon").estimate_covariance(R, 4).status
        == ArrayStatus.SINGULAR
    )
    with pytest.raises(ValueError, match="no snapshot"):
        sn.array.covariance(np.zeros((4, 0), np.complex64))


@given(st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_manifold_files_raise_or_are_finite(tmp_path: Path, data: st.DataObject) -> None:
    geometry = ArrayGeometry.ula(2)
    path = Manifold(geometry).save(tmp_path / "m.csv", azimuth_rad=[0.0, 0.1], elevation_rad=[0.0, 0.1])
    text = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        text[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    path.write_bytes(bytes(text))
    try:
        manifold = Manifold.load(path, geometry)
    except ValueError as error:
        assert "m.csv" in str(error)
        return
    angles = np.array([0.0, 0.05, 0.1])
    there = angles[manifold.reaches(angles, angles)]
    assert np.isfinite(manifold.steering(there, there)).all()
