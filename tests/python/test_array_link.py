"""From an emitter to array samples: powers, directions, samples, covariances, front end, the drive."""

import math

import numpy as np
import pytest

from soopnav_cpp import array, simulation
from soopnav_cpp.scenarios.emitter_drive import (
    EXCESS_LOSS_DB,
    emitter_drive,
    heading_rotation,
    measure,
    wrapped,
)
from soopnav_cpp.simulation import ArrayLink, FrontEnd

pytestmark = pytest.mark.unit

C = 299_792_458.0


def square(spacing=0.2):
    return array.ArrayGeometry.planar(2, 2, spacing)


def ideal(geometry, azimuth, elevation):
    """Steering vectors by the sign convention, written out: an element nearer to the source is ahead."""
    u = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return np.exp(2j * np.pi * np.asarray(geometry.positions_m) @ u * geometry.frequency_hz / C)


# ---- Powers


def test_power_chain_and_noise_floor():
    link = ArrayLink(square(), splitter_loss_db=6.0, delay_system_loss_db=3.0, excess_loss_db=1.0)
    path = 20 * math.log10(4 * math.pi * 1000.0 * 1575.42e6 / C)
    assert link.received_power_dbm(1000.0) == pytest.approx(10.0 - 6.0 - 3.0 - 1.0 - path, abs=1e-9)
    assert link.noise_floor_dbm == pytest.approx(10 * math.log10(1.380649e-23 * 290 * 20e6 * 1e3) + 6.0, abs=1e-9)
    # The scenario of the paper: useless at 1.2 km only with the excess loss.
    assert ArrayLink(square(), excess_loss_db=EXCESS_LOSS_DB).snr_db(1000.0) == pytest.approx(-18.03, abs=0.01)
    assert ArrayLink(square()).snr_db([[1000.0]]).shape == (1, 1)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"sample_rate_hz": 0.0}, "sample_rate_hz"),
        ({"excess_loss_db": -1.0}, "excess_loss_db: -1; it must be finite and not negative"),
        ({"bandwidth_ratio": 0.0}, "bandwidth_ratio: 0; it must be above 0"),
        ({"waveform": "chirp"}, 'waveform: "chirp"; it must be "noise" or "tone"'),
        ({"tone_hz": math.nan}, "tone_hz"),
    ],
)
def test_links_that_cannot_be(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        ArrayLink(square(), **options)


def test_far_field_warns():
    assert simulation.far_field_limit_m(1.0, 3e8) == pytest.approx(max(1.6 * C / 3e8, 2 * 3e8 / C, 5.0))
    link = ArrayLink(square())
    with pytest.warns(UserWarning, match=r"emitter_m: 0.2 m from the array, nearer than its far field of 0.30"):
        link.directions([[0.0, 0.0, 0.0]], [0.2, 0.0, 0.0])
    with pytest.raises(ValueError, match="row 1 is not finite, or lies on the emitter"):
        link.directions([[0.0, 0.0, 9.0], [1.0, 2.0, 3.0]], [1.0, 2.0, 3.0])


# ---- Directions and samples


def test_directions_turn_with_the_platform():
    link = ArrayLink(square())
    azimuth, elevation, distance = link.directions([[0, 0, 0]], [0, 100.0, 100.0], heading_rotation([math.pi / 2]))
    np.testing.assert_allclose(
        [azimuth[0], elevation[0], distance[0]], [0.0, math.pi / 4, 100 * math.sqrt(2)], atol=1e-12
    )
    # Nose up by 45 degrees: what was 45 degrees up lies on axis 1.
    c = math.sqrt(0.5)
    _, elevation, _ = link.directions([[0, 0, 0]], [100.0, 0, 100.0], np.array([[c, 0, -c], [0, 1, 0], [c, 0, c]]))
    assert elevation[0] == pytest.approx(0.0, abs=1e-12)


def test_covariance_of_samples_is_that_of_the_model():
    geometry, link = square(), ArrayLink(square())
    azimuth, elevation = np.array([0.3, -2.0]), np.array([0.5, 1.0])
    blocks = link.blocks(azimuth, elevation, snr_db=3.0, n_samples=40_000, seed=1)
    assert (blocks.shape, blocks.dtype) == ((2, 4, 40_000), np.complex64)
    a = ideal(geometry, azimuth, elevation)
    for block, column in zip(blocks, a.T, strict=True):
        truth = np.eye(4) + 10**0.3 * np.outer(column, column.conj())
        sample = block @ block.conj().T / block.shape[1]
        # Each element is off by sqrt(R_ii R_jj / N) = 3 / 200: six times as much allowed
        assert np.abs(sample - truth).max() < 0.09


def test_same_seed_same_bits_and_epochs_of_their_own():
    link = ArrayLink(square())
    az, el = np.linspace(0, 1, 5), np.full(5, 0.4)
    first = link.blocks(az, el, snr_db=0.0, n_samples=50, seed=4)
    np.testing.assert_array_equal(first, link.blocks(az, el, snr_db=0.0, n_samples=50, seed=4))
    np.testing.assert_array_equal(first[:2], link.blocks(az[:2], el[:2], snr_db=0.0, n_samples=50, seed=4))
    assert not np.array_equal(first, link.blocks(az, el, snr_db=0.0, n_samples=50, seed=5))
    np.testing.assert_array_equal(first[0], link.iq(az[0], el[0], snr_db=0.0, n_samples=50, seed=4))


def test_narrow_band_signal_has_the_same_power():
    for ratio in (0.05, 0.3, 1.0):
        link = ArrayLink(square(), bandwidth_ratio=ratio)
        block = link.iq(0.3, 0.5, snr_db=60.0, n_samples=50_000, seed=2)[0]
        density = np.abs(np.fft.fft(block)) ** 2
        inside = np.abs(np.fft.fftfreq(len(block))) <= 0.5 * ratio + 1e-4
        assert density[~inside].sum() / density.sum() < 1e-5 or ratio == 1.0
        assert np.mean(np.abs(block) ** 2) / 1e6 == pytest.approx(1.0, abs=5.0 / math.sqrt(ratio * 50_000))


def test_two_emitters_add_up():
    link = ArrayLink(square())
    both = link.iq([0.0, 2.0], [0.3, 0.3], snr_db=[10.0, -np.inf], n_samples=200, seed=3)
    one = link.iq(0.0, 0.3, snr_db=10.0, n_samples=200, seed=3)
    np.testing.assert_allclose(both, one, atol=1e-6)


def test_wideband_delays_and_tones_are_sampled_exactly():
    geometry = array.ArrayGeometry([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]], 100e6)
    link = ArrayLink(geometry, sample_rate_hz=C / 10.0, waveform="noise", wideband=True)
    early = link.iq(0.0, 0.0, snr_db=80.0, n_samples=1000, seed=1)  # element 1 lies three samples nearer
    turned = early[1] / ideal(geometry, np.zeros(1), np.zeros(1))[1]
    assert np.abs(np.roll(turned, 3) - early[0]).max() / np.abs(early[0]).max() < 2e-3
    tone = ArrayLink(square(), waveform="tone", tone_hz=1e6).iq(0.2, 0.2, snr_db=100.0, n_samples=400, seed=1)[0]
    step = np.angle(tone[1:] / tone[:-1])
    np.testing.assert_allclose(step, 2 * np.pi / 20.0, atol=1e-3)


def test_music_finds_what_was_sent():
    geometry = square(0.4)
    link = ArrayLink(geometry)
    drive = emitter_drive(epochs=20)
    found = array.DirectionFinder(geometry)
    heard = link.observe(drive.positions_m, drive.emitter_m, rotation=drive.rotation, seed=1)
    azimuth = [found.estimate(block).azimuth_rad[0] for block in heard]
    # No excess loss: at least 7 dB at 1.2 km.
    assert np.abs(wrapped(np.array(azimuth) - drive.array_azimuth_rad)).max() < math.radians(5.0)


def test_covariances_follow_the_law():
    link, n = ArrayLink(square()), 30
    azimuth, elevation = np.full(8000, 0.4), np.full(8000, 0.6)
    drawn = link.covariances(2.0, azimuth, elevation, n, seed=1)
    a = ideal(square(), azimuth[:1], elevation[:1])[:, 0]
    truth = np.eye(4) + 10**0.2 * np.outer(a, a.conj())
    assert np.abs(drawn.mean(axis=0) - truth).max() < 6 * 2.6 / math.sqrt(n * 8000)
    spread = np.mean(np.abs(drawn - truth) ** 2, axis=0) * n / np.outer(np.diag(truth), np.diag(truth)).real
    np.testing.assert_allclose(spread, 1.0, atol=0.12)
    np.testing.assert_allclose(drawn, drawn.conj().transpose(0, 2, 1))


def test_refusals_of_shapes():
    link = ArrayLink(square())
    with pytest.raises(ValueError, match=r"azimuth_rad, elevation_rad: shapes \(2, 1\) and \(1, 1\)"):
        link.blocks([0.0, 1.0], [0.5], snr_db=0.0, seed=1)
    with pytest.raises(ValueError, match="snr_db, power_dbm: one of them"):
        link.blocks([0.0], [0.5], seed=1)
    with pytest.raises(ValueError, match="front_end: goes with power_dbm"):
        link.blocks([0.0], [0.5], snr_db=0.0, seed=1, front_end=FrontEnd(4))
    with pytest.raises(ValueError, match=r"snr_db: shape \(3, 1\); one number, or the shape of azimuth_rad"):
        link.blocks([0.0, 1.0], [0.5, 0.5], snr_db=[0.0, 1.0, 2.0], seed=1)
    for call in (link.covariances, lambda level, *at, seed: link.blocks(*at, snr_db=level, seed=seed)):
        for level in (math.nan, math.inf, 1e5):
            with pytest.raises(ValueError, match=rf"snr_db: {level}; at most 300 dB, or -inf"):
                call(level, [0.0], [0.5], seed=1)
    with pytest.raises(ValueError, match="front_end: 2 channels for 4 elements"):
        link.blocks([0.0], [0.5], power_dbm=0.0, seed=1, front_end=FrontEnd(2))
    with pytest.raises(ValueError, match="rotation: not finite"):
        link.directions([[0.0, 0.0, 0.0]], [3000.0, 0.0, 900.0], np.full((3, 3), math.nan))


def test_no_epochs_are_no_samples():
    link = ArrayLink(square())
    assert link.blocks([], [], snr_db=0.0, n_samples=10, seed=1).shape == (0, 4, 10)
    assert link.blocks([], [], power_dbm=0.0, n_samples=10, seed=1, front_end=FrontEnd(4)).shape == (0, 4, 10)
    assert link.covariances(0.0, [], [], seed=1).shape == (0, 4, 4)


# ---- Front end


def test_samples_behind_a_front_end_have_the_powers_of_the_chain():
    link = ArrayLink(square(), excess_loss_db=EXCESS_LOSS_DB)
    front_end = FrontEnd(4, attenuation_db=20.6)
    silent = link.blocks([0.0], [0.5], power_dbm=-np.inf, n_samples=50_000, seed=1, front_end=front_end)[0]
    assert front_end.attenuation_db == pytest.approx((20.0, 0.6))
    # The steps leave the noise where it is, the rest raises it by 0.6 dB.
    np.testing.assert_allclose(10 * np.log10(np.mean(np.abs(silent) ** 2, axis=1)), -40.0 + 0.6, atol=0.12)
    loud = link.blocks([0.0], [0.5], power_dbm=-60.0, n_samples=50_000, seed=1, front_end=front_end)[0]
    expected = -60.0 - 20.0 - front_end.full_scale_dbm
    np.testing.assert_allclose(10 * np.log10(np.mean(np.abs(loud) ** 2, axis=1)), expected, atol=0.2)


def test_no_two_epochs_of_any_streams_share_a_front_end_s_noise():
    link, options = ArrayLink(square()), {"power_dbm": -np.inf, "n_samples": 50, "front_end": FrontEnd(4)}
    streams = [link.blocks(np.zeros(3), np.full(3, 0.5), seed=1, stream=k, **options) for k in range(3)]
    rows = np.concatenate(streams).reshape(-1, 50)
    assert len(np.unique(rows, axis=0)) == len(rows)
    np.testing.assert_array_equal(link.blocks([0.0], [0.5], seed=1, stream=2, **options), streams[2][:1])


def test_snr_behind_a_front_end_is_that_of_the_link():
    link = ArrayLink(square())
    front_end = FrontEnd(4)
    block = link.observe([[0.0, 0.0, 0.0]], [3000.0, 0.0, 900.0], n_samples=40_000, seed=2, front_end=front_end)[0]
    values = np.sort(np.linalg.eigvalsh(block @ block.conj().T / block.shape[1]))[::-1]
    snr = 10 ** (link.snr_db(math.hypot(3000.0, 900.0)) / 10)
    assert values[0] / values[1:].mean() == pytest.approx(1 + 4 * snr, rel=0.05)


def test_converter_counts_what_it_clips():
    front_end = FrontEnd(2, adc_bits=8, full_scale_dbm=0.0)
    samples = np.array([[0.5, 2.0, -3.0], [0.1j, 0.2, 0.3]], np.complex64)
    out, clipped = front_end.apply_counting(samples, seed=1)
    assert clipped == 2
    assert np.all(out * 128 == np.rint(out * 128))
    assert out[0, 1].real == 127 / 128
    assert FrontEnd(1, phase_delay_rad=0.77, phase_step_rad=0.1).phase_delay_rad == pytest.approx([0.8])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"adc_bits": 1}, "adc_bits: 1; it must be 0"),
        ({"attenuator_step_db": 0.0}, "attenuator_step_db: 0"),
        ({"iq_phase_rad": 2.0}, "iq_phase_rad: 2; it must lie between"),
        ({"gain": [1.0, 2.0, 3.0]}, "gain: 3 elements; one per channel, 4, expected"),
        ({"noise_figure_db": -1.0}, "noise_figure_db"),
        ({"gain": 1e200}, "gain: 1e\\+200; its amplitude must be at most 1e12"),
        ({"sample_rate_hz": 0.0}, "sample_rate_hz: 0; it must be finite and positive"),
    ],
)
def test_front_ends_that_cannot_be(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        FrontEnd(4, **options)
    with pytest.raises(ValueError, match="channels: 0"):
        FrontEnd(0)
    with pytest.raises(ValueError, match=r"iq: shape \(3, 5\); \(4, n\)"):
        FrontEnd(4).apply(np.zeros((3, 5), np.complex64), seed=1)
    with pytest.raises(ValueError, match=r"iq: .*complex64"):
        FrontEnd(1).apply([[0.0, 1.0]], seed=1)


def test_down_conversion_moves_a_carrier_to_baseband():
    n = np.arange(16_000)
    radio = 0.5 * np.cos(2 * np.pi * 0.2603 * n + 1.0)
    x = simulation.down_convert(radio, 1.0, 0.26, decimation=16)
    np.testing.assert_allclose(x[50:-50], (0.5 * np.exp(1j * (2 * np.pi * 0.0003 * n[::16] + 1.0)))[50:-50], atol=3e-4)
    with pytest.raises(ValueError, match="lo_hz"):
        simulation.down_convert(radio, 1.0, 0.6, decimation=16)


# ---- The drive


def test_drive_is_the_paper_s():
    drive = emitter_drive()
    assert drive.positions_m.shape == (240, 3)
    np.testing.assert_allclose(drive.positions_m[[0, -1]], [[-1200, -150, 0], [150, 1200, 0]], atol=1e-9)
    arc = (drive.positions_m[:, 0] >= 0) & (drive.positions_m[:, 1] <= 0)
    assert arc.sum() >= 20
    np.testing.assert_allclose(np.hypot(*drive.positions_m[arc, :2].T), 150.0)
    np.testing.assert_allclose(drive.distance_m.min(), math.hypot(150, 30))
    assert drive.distance_m.max() == pytest.approx(1209.7, abs=0.1)
    steps = np.linalg.norm(np.diff(drive.positions_m, axis=0), axis=1)
    assert np.ptp(steps) < 0.01
    # Heading is the direction of motion, and the emitter stays on the left.
    motion = np.diff(drive.positions_m, axis=0)
    along = np.arctan2(motion[:, 1], motion[:, 0])
    assert np.abs(wrapped(0.5 * (drive.heading_rad[1:] + drive.heading_rad[:-1]) - along)).max() < 0.02
    assert np.all(drive.array_azimuth_rad > 0)
    link = ArrayLink(square())
    azimuth, elevation, distance = link.directions(drive.positions_m, drive.emitter_m, drive.rotation)
    np.testing.assert_allclose(azimuth, drive.array_azimuth_rad, atol=1e-12)
    np.testing.assert_allclose(elevation, drive.elevation_rad, atol=1e-12)
    np.testing.assert_allclose(distance, drive.distance_m)
    np.testing.assert_allclose(drive.local_azimuth(azimuth), drive.azimuth_rad, atol=1e-12)


def test_drive_measured_with_and_without_samples():
    drive, geometry = emitter_drive(epochs=60), square()
    link, finder = ArrayLink(geometry, excess_loss_db=EXCESS_LOSS_DB), array.DirectionFinder(geometry)
    near = drive.distance_m < 300.0
    for generated in (True, False):
        found = measure(drive, link, finder, seed=1, generated_iq=generated)
        azimuth, elevation = found.errors(drive)
        assert np.sqrt(np.mean(azimuth[near] ** 2)) < math.radians(4.0)
        assert np.sqrt(np.mean(azimuth[~near] ** 2)) > math.radians(8.0)
        assert np.isfinite(elevation).all()
        assert np.all(np.diff(found.eigenvalues, axis=1) <= 0)


def test_drive_through_receivers_with_faults():
    """carter figs. 5.4 and 5.8: useless as they are, as good as without faults once calibrated."""
    drive, geometry = emitter_drive(epochs=40, leg_m=100.0), square()
    link, finder = ArrayLink(geometry), array.DirectionFinder(geometry)
    faults = {"gain": np.exp(1j * np.array([0.0, 2.0, -2.5, 1.0])), "iq_gain_db": 2.0, "iq_phase_rad": 0.17}
    front_end = FrontEnd(4, **faults, adc_bits=12)
    level = 10 ** ((front_end.noise_floor_dbm + 33.0) / 20)
    tone = level * np.exp(2j * np.pi * 0.05 * np.arange(10_000)) * np.ones((4, 1))
    calibration = array.calibrate(front_end.apply(tone.astype(np.complex64), seed=1), 20e6, 1e6, geometry)
    wrong, right = (
        np.abs(measure(drive, link, finder, seed=1, front_end=front_end, calibration=made).errors(drive)[0]).max()
        for made in (None, calibration)
    )
    assert right < math.radians(2.0)
    assert wrong > math.radians(30.0)
    with pytest.raises(ValueError, match="generated_iq: False; a front end and its calibration need samples"):
        measure(drive, link, finder, seed=1, generated_iq=False, front_end=front_end)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [({"epochs": 1}, "epochs: 1"), ({"leg_m": 0.0}, "leg_m: 0"), ({"height_m": math.inf}, "height_m: inf")],
)
def test_drives_that_cannot_be(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        emitter_drive(**options)
