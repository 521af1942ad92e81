"""GPS L1 C/A from Python: codes, a signal that is found where it was put, loop noise."""

import numpy as np
import pytest

from soopnav_cpp import gps


def test_codes():
    codes = np.array([gps.ca_code(prn) for prn in range(1, 38)])
    assert codes.dtype == np.int8
    assert codes.shape == (37, 1023)
    bits = (codes[:, :10] < 0) @ (2 ** np.arange(9, -1, -1))
    assert [oct(b) for b in bits[:5]] == ["0o1440", "0o1620", "0o1710", "0o1744", "0o1133"]
    for prn in (0, 38):
        with pytest.raises(ValueError, match=f"prn = {prn}"):
            gps.ca_code(prn)


@pytest.mark.law
def test_gold_codes_correlate_in_three_values():
    spectra = np.fft.fft([gps.ca_code(prn) for prn in (1, 7, 30)])
    for i in range(3):
        for j in range(3):
            values = np.unique(np.round(np.fft.ifft(spectra[i] * spectra[j].conj()).real).astype(int))
            assert set(values) <= {-65, -1, 63, 1023}
            assert (1023 in values) == (i == j)


def test_signals_are_found_by_their_codes():
    """Parallel search in code phase, ten codes added: delays to half a sample, Dopplers to a bin."""
    rate, blocks = 4.092e6, 10
    sky = [
        gps.SatelliteSignal(3, delay_s=0.2501e-3, doppler_hz=1750.0, cn0_dbhz=46.0, bits=[1, -1]),
        gps.SatelliteSignal(17, delay_s=0.9012e-3, doppler_hz=-3250.0, cn0_dbhz=43.0),
    ]
    n = int(rate * 1e-3)
    iq = gps.synthesize(sky, n * blocks, rate, seed=5, intermediate_hz=2e5)
    assert iq.dtype == np.complex64
    np.testing.assert_array_equal(
        iq[n:], gps.synthesize(sky, n * (blocks - 1), rate, seed=5, intermediate_hz=2e5, first=n)
    )
    t = np.arange(n) / rate
    for prn, truth in ((3, sky[0]), (17, sky[1]), (9, None)):
        replica = np.fft.fft(gps.ca_code(prn)[(t * gps.CHIP_RATE_HZ).astype(int) % 1023])
        dopplers = np.arange(-5000.0, 5001.0, 250.0)
        surface = np.zeros((len(dopplers), n))
        for row, doppler in zip(surface, dopplers, strict=True):
            wiped = iq.reshape(blocks, n) * np.exp(-2j * np.pi * (2e5 + doppler) * t)
            row += (np.abs(np.fft.ifft(np.fft.fft(wiped) * replica.conj())) ** 2).sum(axis=0)
        peak = surface.max() / surface.mean()
        if truth is None:
            assert peak < 6.0  # ten squares of normals: above 6 times their mean once in 1e16 cells
            continue
        row, column = np.unravel_index(surface.argmax(), surface.shape)
        assert peak > 10.0
        assert dopplers[row] == truth.doppler_hz
        assert abs(column / rate - truth.delay_s) < 0.6 / rate


def test_loop_noise():
    np.testing.assert_allclose(gps.phase_sigma_m(42.0), 0.932e-3, rtol=1e-3)
    np.testing.assert_allclose(gps.phase_sigma_rad([42.0, 52.0]), np.sqrt(15.0 / 10.0 ** np.array([4.2, 5.2])))
    worse = gps.phase_sigma_rad(42.0, power_fraction=0.5, oscillator_rad=0.03, dynamics_rad=0.04)
    np.testing.assert_allclose(worse**2, 30.0 / 10.0**4.2 + 0.0025)
    assert gps.code_sigma_m([[45.0]]).shape == (1, 1)
    assert 0.5 < gps.code_sigma_m(45.0) < 0.7
    with pytest.raises(ValueError, match="bandwidth_hz"):
        gps.phase_sigma_rad(42.0, bandwidth_hz=0.0)
    with pytest.raises(ValueError, match="early_late_chips"):
        gps.code_sigma_m(42.0, early_late_chips=2.0)


def test_refusals():
    with pytest.raises(ValueError, match=r"prn = 0"):
        gps.synthesize([gps.SatelliteSignal(99)], 10, 1e6)
    with pytest.raises(ValueError, match=r"signals\[0\].bits"):
        gps.synthesize([gps.SatelliteSignal(9, bits=[0])], 10, 1e6)
    with pytest.raises(ValueError, match="sample_rate_hz"):
        gps.synthesize([], 10, 0.0)
    assert (gps.synthesize([], 10, 1e6) == 0.0).all()
