"""dsp and simulation through the bindings, against NumPy."""

import numpy as np
import pytest

import soopnav_cpp as sn

RATE = 1e6


def noise(n, seed=0):
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(n, 2)) @ [1, 1j]).astype(np.complex64)


@pytest.mark.crosscheck
def test_correlation_and_convolution_equal_numpy():
    iq, kernel = noise(5000), noise(130, 1)
    size = np.abs(iq).max() * np.abs(kernel).sum()
    expected = np.correlate(iq.astype(complex), kernel.astype(complex), "valid")
    np.testing.assert_allclose(sn.dsp.correlate(iq, kernel), expected, atol=1e-5 * size)
    expected = np.convolve(iq.astype(complex), kernel.astype(complex))
    np.testing.assert_allclose(sn.dsp.convolve(iq, kernel), expected, atol=1e-5 * size)
    assert sn.dsp.convolve(iq[:0], kernel).shape == (0,)


def tones(times_s):
    return sum(np.exp(2j * np.pi * f * times_s) for f in (-11e3, 3e3, 32e3)).astype(np.complex64)


@pytest.mark.crosscheck
@pytest.mark.parametrize("out_rate_hz", [5e5, 123_456.789, 1.92e6])
def test_resampling_keeps_time(out_rate_hz):
    iq = tones(np.arange(20_000) / RATE)
    out = sn.dsp.resample(iq, RATE, out_rate_hz)
    assert out.size == int(np.ceil(20_000 * out_rate_hz / RATE))
    middle = slice(out.size // 4, 3 * out.size // 4)
    expected = tones(np.arange(out.size) / out_rate_hz)
    assert np.abs(out - expected)[middle].max() < 3 * 3e-4


@pytest.mark.crosscheck
def test_delays_and_taps():
    times = np.arange(4000) / RATE
    iq = tones(times)
    middle = slice(1000, 3000)
    assert np.abs(sn.dsp.delay(iq, 3.25) - tones(times - 3.25e-6))[middle].max() < 1e-3
    out = sn.simulation.apply_taps(iq, RATE, [(0.0, 1.0), (2.5e-6, 0.5j)])
    assert np.abs(out - tones(times) - 0.5j * tones(times - 2.5e-6))[middle].max() < 1e-3


@pytest.mark.crosscheck
def test_carrier_and_clock():
    times = np.arange(4000) / RATE
    iq = tones(times)
    turned = sn.simulation.apply_cfo(iq, 1234.5, RATE, phase_rad=0.3)
    np.testing.assert_allclose(turned, iq * np.exp(1j * (2 * np.pi * 1234.5 * times + 0.3)), atol=1e-5)
    fast = sn.simulation.apply_clock_error(iq, 100.0)
    assert np.abs(fast - tones(times[: fast.size] * (1 + 1e-4)))[1000:3000].max() < 1e-3


@pytest.mark.consistency
def test_noise_is_named_by_its_seed():
    silence = np.zeros(200_000, np.complex64)
    a = sn.simulation.add_awgn(silence, 2.0, seed=1)
    np.testing.assert_array_equal(a, sn.simulation.add_awgn(silence, 2.0, seed=1))
    b = sn.simulation.add_awgn(silence, 2.0, seed=1, stream=1)
    # Standard deviation of the mean power is its size over sqrt(n): bounds of five.
    assert sn.simulation.mean_power(a) == pytest.approx(2.0, rel=5 / np.sqrt(200_000))
    assert abs(np.vdot(a, b)) / 200_000 < 5 * 2.0 / np.sqrt(200_000)


@pytest.mark.unit
def test_budgets():
    assert sn.simulation.free_space_path_loss_db(1000.0, 1e9) == pytest.approx(92.4478, abs=1e-3)
    assert sn.simulation.thermal_noise_dbm(1.0) == pytest.approx(-173.975, abs=2e-3)
    assert sn.simulation.noise_variance_for_snr(4.0, 20.0) == pytest.approx(0.04)
    assert sn.simulation.noise_variance_for_element_snr(10.0) == pytest.approx(0.1)
    assert sn.simulation.friis_received_power_dbm(
        transmit_power_dbm=46.0, transmit_gain_dbi=15.0, distance_m=1000.0, frequency_hz=1e9
    ) == pytest.approx(61.0 - 92.4478, abs=1e-3)
    assert sn.simulation.log_distance_path_loss_db(
        100.0, exponent=3.5, reference_distance_m=1.0, reference_loss_db=40.0
    ) == pytest.approx(110.0)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: sn.dsp.correlate(noise(3), noise(4)), "iq: 3 samples are fewer than the kernel's 4"),
        (lambda: sn.dsp.correlate(noise(3), noise(0)), "kernel"),
        (lambda: sn.dsp.resample(noise(3), 0.0, 1.0), "rate"),
        (lambda: sn.dsp.delay(noise(3), np.nan), "delay"),
        (lambda: sn.simulation.add_awgn(noise(3), -1.0, seed=1), "variance"),
        (lambda: sn.simulation.apply_clock_error(noise(3), 1e6), "clock_error_ppm"),
        (lambda: sn.simulation.apply_cfo(noise(3), 1.0, 0.0), "rate"),
        (lambda: sn.simulation.free_space_path_loss_db(0.0, 1e9), "distance"),
    ],
)
def test_mistakes(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()


@pytest.mark.unit
def test_transform_library_is_named():
    assert sn.dsp.fft_library() in ("fftw", "eigen")
