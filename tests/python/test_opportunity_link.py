"""GPS acquisition and the receiver of one oscillator, from Python."""

import math

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.clock import TwoState
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.gps import Acquirer, AcquisitionStatus, AidedCorrelator, SatelliteSignal, acquire, search_frequencies
from soopnav_cpp.simulation import LinkBand, LinkSource, OpportunityLink

RATE_HZ = 2.048e6
L1_HZ = 1575.42e6
CELL_HZ = 1.93125e9
HERE = np.array([6_378_137.0, 0.0, 0.0])
NAN = np.nan


def satellite(duration_s, phase=0.3):
    t = np.arange(-10.0, duration_s + 20.0, 10.0)
    slope, earth = math.radians(55.0), 7.292115e-5
    fine = 1e-2
    places = []
    for sign in (-1.0, 0.0, 1.0):
        a, e = 1.4585e-4 * (t + sign * fine) + phase, earth * (t + sign * fine)
        q = 26_560e3 * np.stack([np.cos(a), np.cos(slope) * np.sin(a), np.sin(slope) * np.sin(a)])
        places.append(np.stack([np.cos(e) * q[0] + np.sin(e) * q[1], -np.sin(e) * q[0] + np.cos(e) * q[1], q[2]], 1))
    return SampledOrbit(-10.0, 10.0, places[1], (places[2] - places[0]) / (2 * fine))


def pilot_chips(seed=1):
    bits = np.random.default_rng(seed).integers(0, 2, (2, 4096)) * 2 - 1
    return ((bits[0] - 1j * bits[1]) / math.sqrt(2.0)).astype(np.complex64)


@pytest.mark.unit
def test_acquire_finds_who_is_there():
    signals = [
        SatelliteSignal(7, delay_s=0.000_234, doppler_hz=1523.0, cn0_dbhz=45.0),
        SatelliteSignal(19, delay_s=0.000_871, doppler_hz=-3310.0, cn0_dbhz=43.0),
    ]
    iq = sn.gps.synthesize(signals, 102_400, RATE_HZ, seed=1)
    found = {a.prn: a for a in acquire(iq, RATE_HZ, [3, 7, 19], coherent_ms=5, noncoherent=10)}
    assert [bool(found[prn]) for prn in (3, 7, 19)] == [False, True, True]
    assert found[7].delay_s == pytest.approx(234e-6, abs=0.2e-6)
    assert found[19].doppler_hz == pytest.approx(-3310.0, abs=10.0)
    assert found[7].cn0_dbhz == pytest.approx(44.0, abs=1.5)
    assert "PRN 7" in repr(found[7])
    assert "not found" in repr(found[3])
    assert acquire(iq[:100], RATE_HZ, 7)[0].status is AcquisitionStatus.TOO_FEW_SAMPLES
    assert acquire(iq[:100], RATE_HZ, np.int64(7))[0].prn == 7
    with pytest.raises(ValueError, match="prn"):
        acquire(iq, RATE_HZ, 40)
    with pytest.raises(ValueError, match="kilohertz"):
        acquire(iq, 2.0481e6 + 0.5)
    with pytest.raises(ValueError, match="complex64"):
        acquire(iq.astype(np.complex128), RATE_HZ, 7)
    broken = iq.copy()
    broken[3] = NAN
    assert acquire(broken, RATE_HZ, 7)[0].status is AcquisitionStatus.NOT_FINITE


@pytest.mark.crosscheck
@pytest.mark.parametrize("rate_hz", [2.048e6, 2.046e6, 4.092e6])
def test_surface_is_the_correlation(rate_hz):
    n = round(rate_hz * 1e-3)
    rng = np.random.default_rng(2)
    iq = (rng.normal(size=(4 * n, 2)) @ [1, 1j]).astype(np.complex64)
    search = Acquirer(rate_hz, coherent_ms=2, noncoherent=2, doppler_hz=(4000.0, 4250.0), noise_variance=2.0)
    search.search(iq, 11)
    code = sn.gps.ca_code(11).astype(float)[np.arange(n) * 1023 // n]
    for row, doppler in enumerate(search.doppler_hz):
        mixed = iq * np.exp(-2j * np.pi * doppler / rate_hz * np.arange(4 * n))
        expected = 0.0
        for i, block in enumerate(mixed.reshape(2, 2, n)):
            moved = doppler / 1575.42e6 * (i + 0.5) * 2 * n  # samples, by which the code comes early
            turn = np.exp(-2j * np.pi * np.fft.fftfreq(n) * moved)
            r = np.fft.ifft(np.fft.fft(block.sum(axis=0)) * np.conj(np.fft.fft(code)) * turn)
            expected = expected + np.abs(r) ** 2 / (2 * n * 2.0)
        np.testing.assert_allclose(search.surface[row], expected, atol=2e-3)


@pytest.mark.unit
def test_search_frequencies_refuses():
    sums = np.ones((10, 2), complex)
    np.testing.assert_allclose(search_frequencies(sums, 0.1, [0.0]), 10.0)
    np.testing.assert_allclose(search_frequencies(sums, 0.1, [0.0], coherent_blocks=5), 10.0)
    assert search_frequencies(sums, 0.1, [0.0, 0.1, 0.2], coherent_blocks=3).shape == (2, 3)
    for bad in ({"coherent_blocks": 11}, {"variance": 0.0}):
        with pytest.raises(ValueError, match="expected"):
            search_frequencies(sums, 0.1, [0.0], **bad)
    with pytest.raises(ValueError, match="evenly"):
        search_frequencies(sums, 0.1, [0.0, 0.1, 0.3])
    with pytest.raises(ValueError, match="shape"):
        search_frequencies(np.ones(3), 0.1, [0.0])
    with pytest.raises(ValueError, match="finite"):
        search_frequencies(np.full((3, 2), NAN), 0.1, [0.0])


@pytest.mark.law
def test_one_oscillator_wanders_alike_in_every_band():
    """A TCXO of 3 s: each band's phase wanders by cycles, the scaled difference of the two by thermal noise only."""
    duration, block = 3.0, 0.02
    clock = TwoState(1e-19, 1e-20)
    link = OpportunityLink(
        [LinkBand(L1_HZ, 1.024e6), LinkBand(CELL_HZ, 1.2288e6, 50e3)],
        [
            LinkSource.gps(7, 0, satellite(duration), cn0_dbhz=50.0),
            LinkSource.pilot("mast", 1, pilot_chips(), HERE + np.array([500.0, 4000.0, 0.0]), cn0_dbhz=55.0),
        ],
        position_e_m=HERE,
        duration_s=duration,
        clock=clock,
        seed=4,
    )
    blocks = round(duration / block)
    start = block * np.arange(blocks)
    quiet = [link.delay_s(i) - link.receiver_bias_s for i in range(2)]  # ranges alone: what a receiver may know
    at = [np.interp(start, link.node_s, known) for known in quiet]
    correlator = AidedCorrelator(7, sample_rate_hz=1.024e6, block_s=block, max_blocks=blocks, half_chips=0)
    count = correlator.block_samples
    for b in range(blocks):
        slope = (np.interp(start[b] + 1e-3, link.node_s, quiet[0]) - at[0][b]) / 1e-3
        assert correlator.push(
            link.render(0, b * count, count),
            transmit_time_s=start[b] - at[0][b],
            carrier_phase_cycles=L1_HZ * at[0][b],
            doppler_hz=-L1_HZ * slope,
        )
    gps = -np.unwrap(np.angle(correlator.sums[:, 0])) / (2 * np.pi)  # the phase grows with the clock
    n = round(block * 1.2288e6)
    chips = pilot_chips()
    pilot = []
    for b in range(blocks):
        t = (b * n + np.arange(n)) / 1.2288e6
        delay = np.interp(t, link.node_s, quiet[1])
        replica = chips[np.floor(1.2288e6 * (t - delay)).astype(int) % 4096]
        turns = 50e3 * t - CELL_HZ * delay
        y = link.render(1, b * n, n) * np.conj(replica) * np.exp(-2j * np.pi * (turns - np.floor(turns)))
        pilot.append(y.sum())
    cell = -np.unwrap(np.angle(pilot)) / (2 * np.pi)
    truth = np.interp(start + 0.5 * block, link.node_s, link.receiver_bias_s)
    for phase, carrier in ((gps, L1_HZ), (cell, CELL_HZ)):
        wander = carrier * truth
        assert np.ptp(wander) > 1.0
        off = phase - wander
        assert np.ptp(off - off.mean()) < 0.1 * np.ptp(wander)
    difference = gps - cell * (L1_HZ / CELL_HZ)
    # sqrt(1 / (2 C/N0 T)) / 2 pi of both, 2.5e-3 and 1.2e-3 cycles, and what wanders within a block.
    assert np.std(difference) < 6e-3
    assert np.std(np.diff(gps)) > 3.0 * np.std(np.diff(difference))


@pytest.mark.unit
def test_clock_of_ones_own_and_refusals():
    source = LinkSource.pilot("mast", 0, pilot_chips(), HERE + np.array([3000.0, 0.0, 0.0]), clock_bias_s=1e-6)
    band = LinkBand(CELL_HZ, 1.2288e6)
    bias = 1e-7 * np.arange(12)
    link = OpportunityLink([band], [source], position_e_m=HERE, duration_s=0.01, clock_bias_s=bias, seed=1)
    np.testing.assert_array_equal(link.receiver_bias_s, bias)
    np.testing.assert_allclose(link.delay_s(0), 3000.0 / 299_792_458.0 + bias - 1e-6, atol=1e-13)
    assert link.samples(0) == 12288
    np.testing.assert_array_equal(link.render(0)[500:600], link.render(0, 500, 100))
    assert link.delay_at(0, 0.0005) == pytest.approx(link.delay_s(0)[:2].mean())
    assert "1 sources in 1 bands" in repr(link)
    with pytest.raises(ValueError, match="band"):
        link.render(1, 0, 10)
    with pytest.raises(ValueError, match="samples"):
        link.render(0, 12288, 1)
    with pytest.raises(ValueError, match="first"):
        link.render(0, -1)
    with pytest.raises(ValueError, match="clock_bias_s"):
        OpportunityLink([band], [source], position_e_m=HERE, duration_s=0.01, clock_bias_s=bias[1:], seed=1)
    with pytest.raises(ValueError, match="position_e_m"):
        OpportunityLink([band], [source], position_e_m=[1.0], duration_s=0.01, seed=1)
    with pytest.raises(ValueError, match="orbit"):
        OpportunityLink(
            [band], [LinkSource.gps(1, 0, satellite(1.0))], position_e_m=HERE, duration_s=0.01, start_s=1e6, seed=1
        )
    with pytest.raises(ValueError, match="bits"):
        OpportunityLink(
            [band], [LinkSource.gps(1, 0, satellite(1.0), bits=[2])], position_e_m=HERE, duration_s=0.01, seed=1
        )


@pytest.mark.law
def test_trackers_of_two_bands_share_the_oscillator():
    """A TCXO tracked through GPS with data and through a pilot: cycles of wander each, none in their difference."""
    duration = 6.0
    clock = TwoState.tcxo()
    bits = [1, -1, -1, 1, 1, 1, -1]
    orbit = satellite(duration)
    mast = HERE + np.array([500.0, 4000.0, 0.0])
    chips = sn.cdma.pilot_code(12)
    link = OpportunityLink(
        [LinkBand(L1_HZ, 1.3e6, 20e3), LinkBand(CELL_HZ, 1.3e6)],
        [
            LinkSource.gps(7, 0, orbit, cn0_dbhz=50.0, bits=bits),
            LinkSource.pilot("mast", 1, chips, mast, cn0_dbhz=55.0),
        ],
        position_e_m=HERE,
        duration_s=duration,
        clock=clock,
        clock_drift=2e-8,
        seed=9,
    )
    phases, times = [], []
    for band, signal in enumerate(
        (sn.tracking.Signal.gps_l1(7), sn.tracking.Signal.cdma_pilot(12, carrier_hz=CELL_HZ))
    ):
        delay = link.delay_s(band)
        slope = (delay[50] - delay[0]) / link.node_s[50]
        epochs = sn.tracking.track(
            link.render(band),
            signal,
            sample_rate_hz=1.3e6,
            intermediate_hz=link.bands[band].intermediate_hz,
            delay_s=delay[0],
            doppler_hz=-signal.carrier_hz * slope,
        )
        settled = epochs.t_s > 2.0
        assert epochs.phase_locked[settled].all()
        assert epochs.code_locked[settled].all()
        t = epochs.t_s[settled]
        np.testing.assert_allclose(epochs.delay_s[settled], link.delay_at(band, t), atol=60e-9)
        # Averages over an epoch of 0.1 s; the range is known, the clock is not.
        range_s = np.interp(t, link.node_s, delay - link.receiver_bias_s)
        phases.append(epochs.carrier_phase_cycles[settled] / signal.carrier_hz - range_s)
        times.append(t)
    count = min(len(t) for t in times)
    phases, t = [phase[:count] for phase in phases], times[0][:count]
    np.testing.assert_allclose(times[1][:count], t, atol=1e-6)
    truth = np.interp(t, link.node_s, link.receiver_bias_s)
    wander = L1_HZ * (truth - truth[0])
    assert np.ptp(wander) > 20.0  # 2e-8 alone is 31 cycles a second
    for phase in phases:
        off = L1_HZ * (phase - truth)
        assert np.std(off - off.mean()) < 0.03  # what the clock does within an epoch
    difference = L1_HZ * (phases[0] - phases[1])
    assert np.ptp(difference) < 0.02
