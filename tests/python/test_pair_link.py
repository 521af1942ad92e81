"""PairLink against the model evaluated by NumPy, its signs, and a correlator that knows nothing of it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy import optimize

from soopnav_cpp import clock, geometry, iridium, orbits
from soopnav_cpp.simulation import ClockTrack, PairLink, PairReceiver, PairSnippets

LIGHT = 299_792_458.0
RING = 1626.270833e6
SITE = geometry.geodetic_to_ecef(math.radians(60.2), math.radians(25.0), 20.0)
OFFSET = np.array([-4000.0, 8000.0, 3000.0])


@pytest.fixture(scope="module")
def beacon() -> geometry.SampledOrbit:
    sky = orbits.iridium_walker(600.0, gmst_rad=1.0)
    return sky[int(orbits.visible(sky, 300.0, SITE, math.radians(8.0))[0][0])]


def steady_pair(**rest: object) -> PairLink:
    target = PairReceiver(SITE + OFFSET, ClockTrack.steady(4e-4, 6e-7, 300.0))
    anchor = PairReceiver(SITE, ClockTrack.steady(-2e-4, -3e-7, 300.0))
    return PairLink(target, anchor, **rest)  # type: ignore[arg-type]


def measure(pair: PairSnippets, row: int = 0) -> tuple[float, float]:
    """TDOA and FDOA of two noiseless snippets: the correlation's peak, climbed by a general optimiser.

    The anchor's row is moved in its spectrum and stretched as an echo of the same carrier would be; what is left of the
    anchor's carrier at baseband, below 500 Hz, is not stretched: 1 uHz.
    """
    rate = pair.sample_rate_hz
    a, b = pair.target[row].astype(complex), pair.anchor[row].astype(complex)
    n = np.arange(len(a))
    truth = pair.truth
    start = pair.target_start_s[row] - pair.anchor_start_s[row]
    power = np.abs(b) ** 2
    middle = (power * n).sum() / power.sum() / rate
    frequency = np.fft.fftfreq(4 * len(b), 1.0 / rate)
    spectrum = np.fft.fft(np.concatenate([b, np.zeros(3 * len(b))]))
    derivative = 2j * np.pi * frequency * spectrum

    def moved(of: npt.NDArray[np.complex128], tau: float) -> npt.NDArray[np.complex128]:
        return np.asarray(np.fft.ifft(of * np.exp(-2j * np.pi * frequency * tau))[: len(b)])

    t = n / rate

    def minus(x: npt.NDArray[np.float64]) -> float:
        tau, nu = 1e-6 * x[0], x[1]
        late = moved(spectrum, tau) + (nu / RING) * (t - middle - tau) * moved(derivative, tau)
        return -float(np.abs(np.vdot(late * np.exp(2j * np.pi * nu * t), a)))

    first = [1e6 * (truth.tdoa_s[row] - start) + 0.3, truth.fdoa_hz[row] - 0.2]
    found = optimize.minimize(minus, first, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10})
    return start + 1e-6 * found.x[0], found.x[1]


def test_samples_follow_the_model(beacon: geometry.SampledOrbit) -> None:
    """Every 37th sample by NumPy in long double, delay and clock solved for it alone."""
    link = steady_pair()
    burst = iridium.make_burst(iridium.BurstKind.DUPLEX, seed=3)
    pair = link.burst(burst, beacon, start_s=300.0, carrier_hz=RING - 5e3)
    for row, begin, p_e, bias, drift in (
        (pair.target[0], pair.target_start_s[0], SITE + OFFSET, 4e-4, 6e-7),
        (pair.anchor[0], pair.anchor_start_s[0], SITE, -2e-4, -3e-7),
    ):
        for n in range(0, len(row), 37):
            reading = np.longdouble(begin) + np.longdouble(n) / np.longdouble(link.sample_rate_hz)
            since = (reading - 300 - np.longdouble(bias)) / (1 + np.longdouble(drift))
            offset = reading - 300 - since  # the clock's bias
            delay = 0.0
            for _ in range(6):  # light time with the Earth turning underneath
                source = beacon.at(float(300 + since) - delay)
                turn = 7.2921151467e-5 * delay
                x, y, z = np.asarray(source[0]).ravel()
                turned = np.array([x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn), z])
                delay = float(np.linalg.norm(turned - p_e)) / LIGHT
            turns = np.longdouble(RING - 5e3 - pair.center_hz[0]) * reading - np.longdouble(RING - 5e3) * (
                np.longdouble(delay) + offset
            )
            envelope = burst.at([float(since - delay)])[0]
            expected = complex(envelope) * np.exp(2j * np.pi * float(turns - np.round(turns)))
            # 1e-10 s of rounding in system times moves the satellite by 1 um: 3e-5 rad
            assert abs(row[n] - expected) < 1e-3


@pytest.mark.parametrize("clocks", ["steady", "wandering"])
def test_truth_is_what_a_correlator_finds(beacon: geometry.SampledOrbit, clocks: str) -> None:
    link = steady_pair()
    if clocks == "wandering":
        tracks = []
        for stream in range(2):
            series = clock.TwoState(2e-19, 2e-20).simulate_at(
                [299.0, 300.0, 301.0], seed=8, stream=stream, bias_s=1e-4 * stream, drift=4e-7
            )
            tracks.append(ClockTrack.of(series, steady_s=0.1))
        link = PairLink(PairReceiver(SITE + OFFSET, tracks[0]), PairReceiver(SITE, tracks[1]))
    burst = iridium.make_burst(iridium.BurstKind.LONG, seed=11, duration_s=32.4e-3)
    pair = link.burst(burst, beacon, start_s=300.0, carrier_hz=RING + 2e3)
    tdoa, fdoa = measure(pair)
    assert abs(tdoa - pair.truth.tdoa_s[0]) < 1e-9
    assert abs(fdoa - pair.truth.fdoa_hz[0]) < 1e-3


def test_clocks_are_straight_about_their_instants() -> None:
    series = clock.TwoState(2e-19, 2e-20).simulate_at([0.0, 1.0, 2.0], seed=8, drift=4e-7)
    track = ClockTrack.of(series, steady_s=0.1)
    bias, drift = track.at(1.0 + np.array([-0.05, -0.02, 0.0, 0.05]))
    assert drift == pytest.approx(series.drift[1], rel=1e-12)
    assert bias == pytest.approx(series.bias_s[1] + series.drift[1] * np.array([-0.05, -0.02, 0.0, 0.05]), abs=1e-18)
    assert track.at(1.5)[1] != pytest.approx(series.drift[1], rel=1e-6)
    assert ClockTrack.of(series).at(2.0)[0] == pytest.approx(series.bias_s[2], abs=1e-20)
    with pytest.raises(ValueError, match="time_s"):
        ClockTrack.of(series, steady_s=1.5)


def test_signs(beacon: geometry.SampledOrbit) -> None:
    here = PairReceiver(SITE)

    def of(target: PairReceiver) -> tuple[float, float]:
        truth = PairLink(target, here).truth(beacon, 300.0, RING)
        return truth.tdoa_s[0], truth.fdoa_hz[0]

    away = SITE - np.asarray(beacon.at(300.0)[0]).ravel()
    away *= 3000.0 / np.linalg.norm(away)
    assert of(PairReceiver(SITE + away))[0] == pytest.approx(3000.0 / LIGHT, rel=1e-3)  # farther: later
    assert of(PairReceiver(SITE, ClockTrack.steady(1e-6)))[0] == pytest.approx(1e-6, rel=1e-6)  # ahead: later
    assert of(PairReceiver(SITE, ClockTrack.steady(0.0, 1e-7, 300.0)))[1] == pytest.approx(-1e-7 * RING, rel=1e-4)
    moving = geometry.SampledOrbit(290.0, 20.0, np.array([SITE + away, SITE - away]), np.tile(-away / 10.0, (2, 1)))
    assert of(PairReceiver(moving))[1] > 0.9 * RING * 300.0 / LIGHT  # coming nearer: higher
    link = steady_pair()
    truth = link.truth(beacon, [300.0, 301.0], RING)
    geometric = LIGHT * (truth.target.delay_s - truth.anchor.delay_s)
    assert truth.tdoa_s * LIGHT == pytest.approx(geometric + truth.theta_m, abs=1e-6)
    assert truth.alpha_mps == pytest.approx(9e-7 * LIGHT, rel=1e-9)


def test_noise_is_as_stated(beacon: geometry.SampledOrbit) -> None:
    link = steady_pair()
    pair = link.bursts(beacon, start_s=[300.0] * 40, carrier_hz=RING, snr_db=7.0, anchor_snr_db=3.0)
    quiet = link.bursts(beacon, start_s=[300.0] * 40, carrier_hz=RING)
    guard = pair.target[:, :80]
    # 3200 samples: power to 1 / sqrt(3200), five times that allowed
    assert np.mean(np.abs(guard) ** 2) == pytest.approx(1.0, abs=0.09)
    for rows, silent, snr_db in ((pair.target, quiet.target, 7.0), (pair.anchor, quiet.anchor, 3.0)):
        gain = np.vdot(silent, rows).real / np.vdot(silent, silent).real
        assert gain**2 == pytest.approx(10.0 ** (snr_db / 10.0) * 25e3 / 50e3, rel=0.05)
    assert np.mean(np.abs(quiet.anchor[:, 110:1700]) ** 2) == pytest.approx(1.0, abs=0.03)
    cross = np.vdot(pair.target[:, :80], pair.anchor[:, :80]) / 3200
    assert abs(cross) < 5.0 / math.sqrt(3200)


def test_bursts_are_named_by_their_seed(beacon: geometry.SampledOrbit) -> None:
    link = steady_pair()
    same = {"start_s": [300.0, 301.0], "carrier_hz": RING, "snr_db": 10.0}
    one, again = link.bursts(beacon, seed=5, **same), link.bursts(beacon, seed=5, **same)  # type: ignore[arg-type]
    first = link.bursts(beacon, seed=5, start_s=[300.0], carrier_hz=RING, snr_db=10.0)
    other = link.bursts(beacon, seed=6, **same)  # type: ignore[arg-type]
    assert np.array_equal(one.target, again.target)
    assert np.array_equal(one.anchor, again.anchor)
    assert np.array_equal(one.target[0], first.target[0])
    assert not np.array_equal(one.target, other.target)


def test_any_waveform_and_recordings(beacon: geometry.SampledOrbit) -> None:
    """Samples of a burst do as the burst; a recording in blocks holds it where the snippet has it."""
    link = steady_pair()
    burst = iridium.make_burst(iridium.BurstKind.DUPLEX, seed=3)
    samples = burst.evaluate(-1e-3, 1.0 / 250e3, 2500)
    exact = link.burst(burst, beacon, start_s=300.0, carrier_hz=RING)
    # 1 ms of the samples lies before the burst
    rendered = link.burst(
        samples,
        beacon,
        start_s=299.999,
        carrier_hz=RING,
        waveform_rate_hz=250e3,
        target_start_s=exact.target_start_s[0],
        anchor_start_s=exact.anchor_start_s[0],
        samples=exact.target.shape[1],
    )
    assert np.max(np.abs(rendered.target - exact.target)) < 3e-3
    recording = np.zeros(exact.target.shape[1], np.complex64)
    for first in range(0, len(recording), 100):
        link.target.receive(
            burst,
            beacon,
            recording[first : first + 100],
            start_s=300.0,
            carrier_hz=RING,
            recording_start_s=exact.target_start_s[0],
            sample_rate_hz=50e3,
            center_hz=exact.center_hz[0],
            first_sample=first,
        )
    assert np.max(np.abs(recording - exact.target[0])) < 1e-4
    assert "PairSnippets(1 bursts" in repr(exact)
    assert "50000 Hz about each burst" in repr(link)
    assert "tdoa" in repr(exact.truth)
    assert "ClockTrack(+0.0004 s" in repr(link.target)


def test_refusals(beacon: geometry.SampledOrbit) -> None:
    link = steady_pair()
    burst = iridium.make_burst(iridium.BurstKind.DUPLEX, seed=3)
    with pytest.raises(ValueError, match="outside the samples"):
        link.burst(burst, beacon, start_s=1e6, carrier_hz=RING)
    with pytest.raises(ValueError, match=r"beacon\[0\] = 3"):
        link.truth([beacon], 300.0, RING, beacon=3)
    with pytest.raises(ValueError, match="snr_bandwidth_hz"):
        link.burst(burst, beacon, start_s=300.0, carrier_hz=RING, snr_bandwidth_hz=0.0)
    with pytest.raises(ValueError, match="snr_db"):
        link.burst(burst, beacon, start_s=300.0, carrier_hz=RING, snr_db=math.nan)
    with pytest.raises(ValueError, match="sample_rate_hz"):
        PairLink(PairReceiver(SITE), PairReceiver(SITE), sample_rate_hz=0.0)
    with pytest.raises(ValueError, match="sample_rate_hz"):
        link.burst(np.ones(10, np.complex64), beacon, start_s=300.0, carrier_hz=RING)
    with pytest.raises(ValueError, match="drift"):
        ClockTrack.steady(0.0, 0.1)
    with pytest.raises(ValueError, match="delay_s"):
        PairReceiver(SITE, taps=[(math.inf, 1.0)])
