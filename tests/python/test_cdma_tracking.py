"""CDMA pilots and tracking from Python: search, observables, refusals."""

import numpy as np
import pytest

import soopnav_cpp as sn

RATE = 1.5e6


def pilot_iq(seconds: float, cn0_dbhz: float = 45.0) -> np.ndarray:
    pilot = sn.cdma.PilotSignal(20, delay_s=13.4e-6, doppler_hz=-140.0, cn0_dbhz=cn0_dbhz)
    return sn.cdma.synthesize([pilot], int(seconds * RATE), RATE, seed=11)


def test_search_then_track():
    iq = pilot_iq(1.5)
    (found,) = sn.cdma.acquire(iq, RATE, max_doppler_hz=300.0, noncoherent=2)
    assert found.pn_offset == 20
    assert abs(found.excess_s - 13.4e-6) < 5 * found.sigma_delay_s
    assert abs(found.doppler_hz + 140.0) < 5 * found.sigma_doppler_hz
    assert sn.cdma.offset_candidates(found.delay_s) == [20]
    signal = sn.tracking.Signal.cdma_pilot()  # the delay found is that of offset 0
    epochs = sn.tracking.track(iq, signal, RATE, delay_s=found.delay_s, doppler_hz=found.doppler_hz, pull_in_s=0.3)
    assert len(epochs) == 15
    assert epochs.phase_locked[8:].all()
    slope = np.polyfit(epochs.t_s[8:], epochs.carrier_phase_cycles[8:], 1)[0]
    assert slope == pytest.approx(140.0, abs=0.05)  # receding: the phase grows
    assert "15 epochs" in repr(epochs)


def test_blocks_join():
    iq = pilot_iq(0.45)
    whole = sn.tracking.track(iq, sn.tracking.Signal.cdma_pilot(20), RATE, doppler_hz=-140.0, delay_s=13.4e-6)
    tracker = sn.tracking.Tracker(sn.tracking.Signal.cdma_pilot(20), RATE, doppler_hz=-140.0, delay_s=13.4e-6)
    parts = [tracker.push(iq[:100_001]), tracker.push(iq[100_001:])]
    np.testing.assert_array_equal(np.concatenate([p.carrier_phase_cycles for p in parts]), whole.carrier_phase_cycles)
    assert tracker.samples == len(iq)


def test_code_spectrum_is_white():
    """All but the peak of the pilot's circular autocorrelation, by NumPy: below 3 %."""
    code = sn.cdma.pilot_code(0)
    spectrum = np.fft.fft(code)
    correlation = np.abs(np.fft.ifft(np.abs(spectrum) ** 2)) / len(code)
    assert correlation[0] == pytest.approx(1.0, rel=1e-5)
    assert correlation[1:].max() < 0.03
    np.testing.assert_array_equal(sn.cdma.pilot_code(3), np.roll(code, 192))


def test_theory():
    gain = sn.tracking.design_loop(2, 10.0, 20e-3)
    assert gain[2] == 0.0
    variance = sn.tracking.loop_variance(2, 10.0, 20e-3, mean_variance=1.0)
    assert variance.thermal_phase == pytest.approx(2 * 10.0 * 20e-3, rel=1e-9)
    assert sn.tracking.phase_sigma_cycles(45.0, 0.1) == pytest.approx(2.0e-3, rel=0.01)  # pesyna's 2.0e-3 cycles
    noise = sn.tracking.PhaseNoise.from_allan(1e-20, 0.0, 1575.42e6)
    assert sn.tracking.window_sigma_cycles(noise, 0.1) == pytest.approx(0.01017, rel=1e-3)


@pytest.mark.parametrize(
    ("option", "value"), [("pll_order", 5), ("epoch_s", 0.01), ("sample_rate_hz", 1e6), ("early_late_chips", 2.0)]
)
def test_refusals(option: str, value: float):
    options = {"sample_rate_hz": RATE, option: value}
    with pytest.raises(ValueError, match=option):
        sn.tracking.Tracker(sn.tracking.Signal.cdma_pilot(), **options)


def test_bad_samples():
    with pytest.raises(ValueError, match="pn_offset"):
        sn.cdma.pilot_code(512)
    with pytest.raises(ValueError, match=r"signals\[0\].pn_offset"):
        sn.cdma.synthesize([sn.cdma.PilotSignal(700)], 10, RATE)
    with pytest.raises(ValueError, match="complex64"):
        sn.tracking.track(np.zeros(10), sn.tracking.Signal.cdma_pilot(), RATE)
    with pytest.raises(ValueError, match="samples expected"):
        sn.cdma.acquire(np.zeros(10, np.complex64), RATE)
    with pytest.raises(ValueError, match="iq: finite samples expected"):
        sn.cdma.acquire(np.full(int(0.1 * RATE), np.nan + 0j, np.complex64), RATE)
    epochs = sn.tracking.track(np.full(int(0.3 * RATE), np.nan + 0j, np.complex64), sn.tracking.Signal.gps_l1(4), RATE)
    assert not epochs.phase_locked.any()
    assert np.isfinite(epochs.carrier_phase_cycles).all()
