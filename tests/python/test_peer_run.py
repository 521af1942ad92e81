"""Two receivers from recordings to a track: in one process, over a socket, over a bad connection, by the command."""

from __future__ import annotations

import asyncio
import errno
import json
import math
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from soopnav_cpp import geometry, io, orbits
from soopnav_cpp.experiments import mei_peer as experiment
from soopnav_cpp.experiments import mei_peer_setup, mei_setup
from soopnav_cpp.experiments.registry import REGISTRY, perform
from soopnav_cpp.peer import frames, local, messages, proxy, report, roles
from soopnav_cpp.peer.beacons import Beacons, Candidate, read_beacons
from soopnav_cpp.peer.ends import OwnSkew
from soopnav_cpp.peer.roles import Anchor, ExchangeOptions, Target, _Asked
from soopnav_cpp.peer.session import Address, PeerRefusedError, Session, SessionOptions, Traffic
from soopnav_cpp.peer.sources import Recording
from soopnav_cpp.peer.track import Measured, Track

pytest.importorskip("msgpack")

KEY = b"0123456789abcdef"
FAST = SessionOptions(wait_s=5.0, retry_s=0.05, heartbeat_s=0.1, silence_s=2.0, first_backoff_s=0.05)


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> mei_peer_setup.PeerWorld:
    return mei_peer_setup.record(2, tmp_path_factory.mktemp("pair"), duration_s=12.0)


def place(text: str) -> np.ndarray:
    latitude, longitude, height = (float(x) for x in text.split(","))
    return np.asarray(geometry.geodetic_to_ecef(math.radians(latitude), math.radians(longitude), height))


def known(world: mei_peer_setup.PeerWorld, source: Recording) -> Beacons:
    reference = source.reference_unix_s
    return read_beacons(world.ephemeris, reference + source.start_s, reference + source.end_s)


def anchor_of(world: mei_peer_setup.PeerWorld, path: Path | None = None, **more: object) -> Anchor:
    source = Recording(path or world.anchor)
    antenna = geometry.SampledOrbit.fixed(place(world.anchor_at))
    return Anchor(source, known(world, source), antenna, **more)


def target_of(
    world: mei_peer_setup.PeerWorld, path: Path | None = None, options: ExchangeOptions | None = None, **more: object
) -> Target:
    source = Recording(path or world.target)
    beacons = known(world, source)
    track = Track(
        beacons, place(world.guess_at), height_m=world.height_m, height_sigma_m=10.0, target_clock=mei_setup.OCXO,
        anchor_clock=mei_setup.OCXO, **more,
    )  # fmt: skip
    return Target(source, beacons, track, options=options)


def off(world: mei_peer_setup.PeerWorld, target: Target) -> float:
    """Squared error of the position in its stated covariance."""
    tracker = target.track.tracker
    error = tracker.mean[:3] - np.array(world.truth_e_m)
    return float(error @ np.linalg.solve(tracker.covariance[:3, :3], error))


@pytest.mark.consistency
def test_one_process_finds_the_target_and_its_clock(world, tmp_path: Path) -> None:
    anchor, target = anchor_of(world), target_of(world)
    local.run_together(anchor, target)
    assert anchor.counts["scanned"] == target.counts["scanned"] == world.bursts
    used = target.counts["used"]
    assert used == target.counts["measured"] == anchor.counts["exchanged"] >= world.bursts // 2
    assert off(world, target) < 28.0
    assert np.sqrt(np.trace(target.track.tracker.covariance[:3, :3])) < 200.0
    numbers = report.write(target, Traffic(), tmp_path)
    assert numbers == json.loads((tmp_path / "metrics.json").read_text())
    rows = (tmp_path / "track.csv").read_text().splitlines()
    assert len(rows) == 1 + used
    assert numbers["estimate"]["latitude_deg"] == pytest.approx(float(rows[-1].split(",")[10]), abs=1e-8)
    assert (tmp_path / "track.png").stat().st_size > 20_000
    assert numbers["estimate"]["sigma_east_m"] > 0.0


async def over_socket(anchor: Anchor, target: Target, address: Address, faults: object = None) -> list[Session]:
    there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
    first = Session(anchor, KEY, address, listen=True, options=FAST, on_listening=there.set_result)
    running = asyncio.create_task(first.run())
    inner = await there
    try:
        if faults is None:
            second = Session(target, KEY, inner, listen=False, options=FAST)
            await second.run()
        else:
            with proxy.BadConnection(inner, faults) as between:
                second = Session(target, KEY, between.address, listen=False, options=FAST)
                await second.run()
        await running
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    return [first, second]


@pytest.mark.law
def test_over_a_socket_it_is_the_same_to_the_last_bit(world, tmp_path: Path) -> None:
    alone = target_of(world)
    local.run_together(anchor_of(world), alone)
    anchor, target = anchor_of(world), target_of(world)
    asyncio.run(over_socket(anchor, target, Address(path=tmp_path / "socket")))
    assert np.array_equal(target.track.tracker.mean, alone.track.tracker.mean)
    assert np.array_equal(target.track.tracker.covariance, alone.track.tracker.covariance)
    assert +target.counts == +alone.counts


@pytest.mark.consistency
def test_over_a_bad_connection_updates_are_lost_and_the_track_is_not(world) -> None:
    anchor, target = anchor_of(world), target_of(world)
    faults = proxy.Faults(4, lost=0.2, damaged=0.05, repeated=0.05, delayed=0.05)
    sessions = asyncio.run(over_socket(anchor, target, Address("127.0.0.1", 0), faults))
    refused = sessions[0].traffic.refused + sessions[1].traffic.refused
    assert faults.counts["lost"] > 3
    assert refused["missing"] > 0
    assert 2 <= target.counts["used"] < world.bursts
    assert off(world, target) < 28.0


def all_asked(anchor: Anchor, target: Target) -> list[messages.Message]:
    """Both have listened to the end; what the target then asks for."""
    assert anchor.attach(target.info()) == target.attach(anchor.info()) == ""
    while not (anchor.heartbeat().done and target.heartbeat().done):
        for message in anchor.step(0.0) or ():
            target.handle(message, 0.0)
        target._asked.clear()
        target.step(0.0)
        target.handle(replace(anchor.heartbeat(), proposals=0), 0.0)
        anchor.handle(replace(target.heartbeat(), proposals=0), 0.0)
    target.counts.clear()
    target._settled.clear()
    target._settled_to_s = -math.inf
    bursts = [heard for heard, _ in anchor._kept.values()]
    said = [
        messages.Detection(k, b.start_s, b.duration_s, b.frequency_hz, b.bandwidth_hz, b.snr_db, anchor._kept[k][1])
        for k, b in zip(anchor._kept, bursts, strict=True)
    ]
    return target.handle(messages.Announce(tuple(said)), 0.0)


@pytest.mark.law
def test_answers_are_used_however_late_and_given_up_by_their_order(world) -> None:
    anchor, target = anchor_of(world), target_of(world)
    asked = all_asked(anchor, target)
    assert len(asked) >= 6
    now = 0.0
    for number, proposal in enumerate(asked):
        now += 1e4  # a peer that sleeps
        if number in (1, 2, len(asked) - 1):
            continue  # lost
        for answer in anchor.handle(proposal, now):
            target.handle(answer, now)
            target.step(now)
    assert target.counts["exchanged"] == len(asked) - 3
    assert target.counts["no answer"] == 2
    anchor.handle(target.heartbeat(), now)
    target.handle(replace(anchor.heartbeat(), proposals=0), now)  # said before the target's last
    assert not target.finished
    assert target.counts["no answer"] == 2
    target.handle(anchor.heartbeat(), now)
    assert target.counts["no answer"] == 3
    target.step(now)
    assert target.finished
    assert target.counts["used"] == len(asked) - 3


@pytest.mark.unit
def test_silence_of_a_peer_ends_its_proposals(world) -> None:
    anchor, target = anchor_of(world), target_of(world)
    asked = all_asked(anchor, target)
    target.handle(replace(anchor.heartbeat(), proposals=0), 20.0)
    target.step(49.0)
    assert target.counts["no answer"] == 0
    target.step(51.0)
    assert target.counts["no answer"] == len(asked)


@pytest.mark.law
def test_a_running_track_hears_from_where_it_is(world) -> None:
    """Not from where it began: 150 km off, where Dopplers are others."""
    target = target_of(world, within_m=2e3)
    target.track.guess_e_m = target.track.guess_e_m + 150e3 * np.array([0.0, 1.0, 0.0])
    sigma = np.array([2e3] * 3 + [1e-3] * 3 + [1e6, 300.0])
    truth = np.concatenate([np.array(world.truth_e_m), np.zeros(5)])
    target.track.tracker.start_at(0.0, truth, np.diag(sigma**2))
    target.track.running = True
    local.run_together(anchor_of(world), target)
    assert target.counts["beacon disagrees"] == 0
    assert target.counts["used"] >= world.bursts // 2
    # Before it runs, `within` is a standard deviation: three of it count.
    place_e, within = target_of(world, within_m=2e3)._whereabouts(0.0)
    assert within == 6e3
    assert np.array_equal(place_e, place(world.guess_at))
    mean, within = target._whereabouts(target.track.tracker.t_s)
    assert np.array_equal(mean, target.track.tracker.mean[:3])
    assert within == pytest.approx(3.0 * math.sqrt(np.trace(target.track.tracker.covariance[:3, :3])))


@pytest.mark.law
def test_bursts_are_tracked_by_their_middles(world, monkeypatch: pytest.MonkeyPatch) -> None:
    """A short burst inside a long one has its middle before, though it starts after."""
    target = target_of(world)
    taken: list[float] = []
    monkeypatch.setattr(target.track, "add", lambda m: taken.append(m.t_s) or "used")

    def answered(start_s: float, duration_s: float) -> None:
        burst = messages.Detection(0, start_s, duration_s, 1.6263e9, 3e4, 9.0, "W00")
        target._asked[0] = _Asked(None, burst, 0.0, 0)
        middle = start_s + 0.5 * duration_s + target._to_orbits_s
        target._answered(0)
        target._measured.append(Measured(middle, 0, 0.0, 0.0, np.eye(2), 1.6e9, np.zeros(3), np.zeros(3), 2, 9.0))

    for start_s, duration_s in ((1.0, 0.09), (1.01, 0.008), (1.03, 0.02), (1.2, 0.008)):
        answered(start_s, duration_s)
    assert taken == pytest.approx(np.array([1.014, 1.04, 1.045]) + target._to_orbits_s)
    target._drop()
    assert len(taken) == 4


@pytest.mark.unit
def test_swapped_recordings_are_doubted(world) -> None:
    """The mirror image of the target: measured as well as the target, but not where it was said to be."""
    swapped = target_of(world, world.anchor)
    local.run_together(anchor_of(world, world.target), swapped)
    honest = target_of(world)
    local.run_together(anchor_of(world), honest)
    for target, doubts in ((swapped, 1), (honest, 0)):
        numbers = report.summary(target, Traffic())
        assert sum(name.startswith("doubtful") for name in numbers["reasons"]) == doubts
    assert report.estimate(honest)["sigmas_off_guess"] < 2.0
    # Said to be elsewhere, it is doubted too.
    honest.track.guess_e_m = honest.track.guess_e_m + 50e3
    assert any(name.startswith("doubtful") for name in report.summary(honest, Traffic())["reasons"])


@pytest.mark.unit
def test_a_target_goes_on_where_it_was(world, tmp_path: Path) -> None:
    """Half of a recording, then all of it with the state that the first left."""
    state = tmp_path / "state.json"
    half = tmp_path / "half"
    iq, meta = io.read_iq(world.target)
    tuned = {"center_frequency_hz": meta.center_frequency_hz, "datetime_utc": mei_peer_setup.START}
    io.write_iq(half, iq[: iq.size // 2], meta.sample_rate_hz, format="ci8", **tuned)
    whole = target_of(world)
    local.run_together(anchor_of(world), whole)
    first = target_of(world, half, state=state)
    local.run_together(anchor_of(world), first)
    second = target_of(world, state=state)
    assert second.track.tracker.t_s == first.track.tracker.t_s
    local.run_together(anchor_of(world), second)
    # Those that began as the recordings ended or began may be cut; none counts twice.
    assert whole.counts["used"] - 2 <= first.counts["used"] + second.counts["used"] <= whole.counts["used"]
    assert off(world, second) < 28.0
    for text in ("", "{}", "[1]", state.read_text().replace("state 1", "state 9"), state.read_text()[:-30]):
        state.write_text(text)
        with pytest.raises(ValueError, match="not a state"):
            target_of(world, state=state)


@pytest.mark.unit
def test_a_state_that_cannot_be_kept_or_true_is_refused_at_set_up(
    world, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for bad in (tmp_path / "nowhere" / "state", tmp_path):
        with pytest.raises(ValueError, match=rf"{bad} \(--state\): the track cannot be kept there"):
            target_of(world, state=bad)
    state = tmp_path / "state"
    target = target_of(world, state=state)
    assert not list(tmp_path.iterdir())
    mean = np.concatenate([np.array(world.truth_e_m), np.zeros(5)])
    target.track.tracker.start_at(0.0, mean, np.eye(8))
    target.track.running = True
    target.track.write()
    kept = json.loads(state.read_text())
    assert np.array_equal(target_of(world, state=state).track.tracker.mean, mean)
    with monkeypatch.context() as full:
        full.setattr(Path, "replace", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
        with pytest.raises(OSError, match=str(state)):
            target.track.write()
    for lie in (
        {"t_s": 10**400}, {"mean": [10**400] * 8}, {"mean": [0.0] * 8}, {"mean": [1e300] * 8},
        {"mean": [*mean[:5], 1e7, 0.0, 0.0]}, {"mean": [*mean[:6], 1e300, 0.0]}, {"mean": [*mean[:7], 1e300]},
        {"mean": [*mean[:7], math.nan]},
    ):  # fmt: skip
        state.write_text(json.dumps({**kept, **lie}))
        with pytest.raises(ValueError, match="not a state"):
            target_of(world, state=state)


@pytest.mark.unit
def test_a_proxy_tells_of_what_came_through() -> None:
    fates = iter([[], [b"damaged"], None, None])
    told: list[int] = []

    async def run() -> None:
        done = asyncio.Event()

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            for kind in (5, 6, 7, 8):
                writer.write(frames.encode(kind, 0, b"x"))
            await done.wait()
            writer.close()

        def faults(frame: bytes, _: bool) -> list[bytes]:
            fate = next(fates)
            return [frame] if fate is None else [frame[:-1] + bytes([frame[-1] ^ 1]) for _ in fate]

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        inner = Address("127.0.0.1", server.sockets[0].getsockname()[1])
        with proxy.BadConnection(inner, faults, on_frame=told.append) as between:
            reader, writer = await asyncio.open_connection(between.address.host, between.address.port)
            await reader.readexactly(3 * (frames.OVERHEAD + 1))
            writer.close()
            done.set()
        server.close()

    asyncio.run(run())
    assert told == [7, 8]


@pytest.mark.slow
def test_far_off_a_batch_starts_the_track(tmp_path: Path) -> None:
    far = mei_peer_setup.record(3, tmp_path, duration_s=120.0, off_m=60e3)
    target = target_of(far, within_m=50e3, batch=90)
    local.run_together(anchor_of(far), target)
    assert target.counts["waiting"] >= 89
    assert target.counts["used"] >= 20
    assert off(far, target) < 28.0


@pytest.mark.unit
def test_a_batch_waits_until_it_is_long_enough(world) -> None:
    target = target_of(world, within_m=50e3, batch=12)
    local.run_together(anchor_of(world), target)
    assert target.counts["waiting"] >= 9
    assert len(target.track.history.use) == target.counts["measured"]
    with pytest.raises(ValueError, match="batch = 3"):
        target_of(world, batch=3)
    with pytest.raises(ValueError, match="within_m"):
        target_of(world, within_m=math.nan)


@pytest.mark.unit
def test_bandwidth_bounds_what_is_sent(world) -> None:
    anchor, target = anchor_of(world, bandwidth_bps=4e3), target_of(world)
    local.run_together(anchor, target)
    assert anchor.counts["declined: bandwidth"] == target.counts["declined: bandwidth"] > 0
    assert anchor.counts["bits: 1"] > 0
    assert 0 < target.counts["used"] < world.bursts
    with pytest.raises(ValueError, match="bits = 7"):
        anchor_of(world, bits=7)


@pytest.mark.unit
def test_recordings_that_do_not_overlap_are_refused(world, tmp_path: Path) -> None:
    late = tmp_path / "late"
    iq, meta = io.read_iq(world.target)
    io.write_iq(late, iq, meta.sample_rate_hz, format="ci8", center_frequency_hz=meta.center_frequency_hz,
                datetime_utc="2014-08-27T06:05:00Z")  # fmt: skip
    path = late.with_name("late.sigmf-meta")
    eph = orbits.read_ephemeris(world.ephemeris)
    moved = tmp_path / "later.npz"
    orbits.write_ephemeris(moved, eph.orbits, "2014-08-27T06:05:00Z")
    source = Recording(path)
    beacons = read_beacons(moved, source.reference_unix_s, source.reference_unix_s + 5.0)
    target = Target(source, beacons, Track(beacons, place(world.guess_at)))
    with pytest.raises(
        PeerRefusedError, match=r"do not overlap: the anchor's is 2014-08-27T06:00:00.000Z to .* the targ"
    ):
        local.run_together(anchor_of(world), target)
    with pytest.raises(PeerRefusedError, match="do not overlap"):
        asyncio.run(over_socket(anchor_of(world), target, Address("127.0.0.1", 0)))
    with pytest.raises(ValueError, match="do not cover"):
        read_beacons(world.ephemeris, source.reference_unix_s, source.reference_unix_s + 5.0)


@pytest.mark.unit
def test_identical_recordings_tones_and_nothing_make_no_track(world, tmp_path: Path) -> None:
    same = target_of(world, world.anchor)
    local.run_together(anchor_of(world, bits=0), same)
    assert same.counts["not measured: identical recordings"] == same.counts["exchanged"] > 0
    assert not same.track.running
    assert report.summary(same, Traffic())["estimate"] is None
    assert report.figure(same, path=tmp_path / "none.png") is not None
    tone = tmp_path / "tone"
    n = np.arange(600_000)
    iq = 0.4 * np.exp(2j * np.pi * 0.05 * n) * (n % 60_000 < 6000) + 0.05 * np.random.default_rng(1).standard_normal(
        n.size
    )
    io.write_iq(tone, iq.astype(np.complex64), 150e3, center_frequency_hz=mei_peer_setup.CENTER_HZ,
                datetime_utc=mei_peer_setup.START)  # fmt: skip
    anchor, target = anchor_of(world, tone.with_name("tone.sigmf-meta")), target_of(world)
    local.run_together(anchor, target)
    assert anchor.counts["announced"] == 0
    assert anchor.counts["tone"] > 3
    assert not target.track.running


@pytest.mark.unit
def test_beacons_are_told_by_channel_and_doppler(world) -> None:
    source = Recording(world.anchor)
    beacons = known(world, source)
    here = place(world.anchor_at)
    t = 8.0
    for index, orbit in enumerate(beacons.orbits):
        path = geometry.signal_path(orbit, t, here)
        for skew in (-1.5e-6, 0.0, 1.5e-6):
            heard = 1626270833.3 * (1.0 - float(path.delay_rate)) * (1.0 - skew)
            found = beacons.candidates(t, heard, here, skew=2e-6, sigma_hz=20.0, within_m=0.0)
            assert index in [c.index for c in found]
            mine = next(c for c in found if c.index == index)
            assert mine.carrier_hz == pytest.approx(1626270833.3, abs=1.0)
            assert mine.residual_hz / mine.carrier_hz == pytest.approx(-skew, abs=1e-9)
        assert not beacons.candidates(t, 1600e6, here, skew=2e-6, sigma_hz=20.0, within_m=0.0)
    mast = Beacons({"FM@101.7e6": geometry.SampledOrbit.fixed(here * 1.00001)}, 0.0)
    assert [
        c.carrier_hz for c in mast.candidates(0.0, 101.7e6 + 50.0, here, skew=1e-6, sigma_hz=5.0, within_m=0.0)
    ] == [101.7e6]
    assert not mast.candidates(0.0, 101.8e6, here, skew=1e-6, sigma_hz=5.0, within_m=0.0)
    with pytest.raises(ValueError, match="NAME@HZ"):
        Beacons({"FM@loud": geometry.SampledOrbit.fixed(here)}, 0.0)
    with pytest.raises(ValueError, match="no beacons"):
        Beacons({}, 0.0)


@pytest.mark.unit
def test_bursts_of_two_satellites_tell_the_anchors_skew() -> None:
    """Each burst fits both; the right one of each has the same skew, the wrong ones differ."""

    def burst(*skews: float) -> list[Candidate]:
        return [Candidate(i, f"S{i}", 1.62e9, -1.62e9 * skew) for i, skew in enumerate(skews)]

    skew = OwnSkew()
    for k in range(8):
        skew.take(burst(0.4e-6, 1.1e-6))  # all of the first satellite: its wrong skew is always there too
        assert skew.known is None, k
    for _ in range(8):
        skew.take(burst(-0.5e-6, 0.4e-6))
    assert skew.known == pytest.approx(0.4e-6)
    assert [c.index for c in skew.agree(burst(-0.5e-6, 0.4e-6))] == [1]
    skew.take([])
    assert skew.known is not None
    for k in range(60):  # the clock jumps
        skew.take(burst(-0.2e-6) if k % 2 else burst(-0.2e-6, 0.3e-6 + 1e-8 * k))
    assert skew.known == pytest.approx(-0.2e-6)


@pytest.mark.fuzz
def test_a_peer_that_has_the_key_and_lies_raises_nothing(world) -> None:
    rng = np.random.default_rng(1)
    anchor, target = anchor_of(world), target_of(world, options=ExchangeOptions(answer_s=0.5))
    lies = [messages.Info(2**40, -1e10, 1e10, 1e10, 1.0, 0.0), anchor.info()]
    assert target.attach(lies[0]) == "" or "overlap" in target.attach(lies[0])
    assert "overlap" in target.attach(messages.Info(-(2**40), 0.0, 1.0, 0.0, 1.0, 0.0))
    assert anchor.attach(target.info()) == target.attach(anchor.info()) == ""
    told: list[messages.Message] = []
    while not target.finished:
        told += anchor.step(0.0) or []
        target.handle(anchor.heartbeat(), 0.0)
        anchor.handle(target.heartbeat(), 0.0)
        for message in told:
            for asked in target.handle(message, 0.0) + (target.step(0.0) or []):
                for true in anchor.handle(asked, 0.0):
                    assert isinstance(true, messages.Snippet)
                    change = [
                        {"count": 4, "data": bytes(4)}, {"count": 40_000, "bits": 1, "data": bytes(10_000)},
                        {"mix_hz": 0.0}, {"mix_hz": 1e12}, {"scale": 0.0}, {"scale": 1e15}, {"beacon": "none"},
                        {"bits": 0, "data": rng.bytes(8 * true.count)}, {"position_e_m": (0.0, 0.0, 0.0)},
                        {"start_s": 1e10}, {"velocity_e_mps": (1e6, 1e6, 1e6)}, {"id": 10**9},
                    ][int(rng.integers(12))]  # fmt: skip
                    target.handle(replace(true, **change), 0.0)
        told = []
        target.step(10.0)
    for message in (messages.Propose(10**9, ""), messages.Propose(0, "none"), messages.Decline(0, ""), lies[1]):
        anchor.handle(message, 0.0)
        target.handle(message, 0.0)
    assert target.counts["snippet of another burst"] + target.counts["answer to nothing"] > 0
    assert not target.track.running or np.isfinite(target.track.tracker.covariance).all()


@pytest.mark.unit
def test_snippets_that_no_message_can_carry_are_refused_at_set_up(world) -> None:
    with pytest.raises(ValueError, match="--snippet-rate"):
        ExchangeOptions(snippet_rate_hz=20e3)
    fast = ExchangeOptions(snippet_rate_hz=75e3)
    with pytest.raises(ValueError, match=r"--snippet-rate.*--bits"):
        anchor_of(world, options=fast, bits=0)
    anchor_of(world, options=fast)
    anchor_of(world, bits=0)


def exchange(anchor: Anchor, target: Target) -> list[tuple[messages.Propose, messages.Message]]:
    """Proposals of the first seconds, and what the anchor says to them."""
    assert anchor.attach(target.info()) == target.attach(anchor.info()) == ""
    found: list[tuple[messages.Propose, messages.Message]] = []
    while not found:
        said = anchor.step(0.0) or []
        asked = [*(target.step(0.0) or []), *(reply for message in said for reply in target.handle(message, 0.0))]
        found = [(p, reply) for p in asked if isinstance(p, messages.Propose) for reply in anchor.handle(p, 0.0)]
        for one, other in ((anchor, target), (target, anchor)):
            one.handle(replace(other.heartbeat(), proposals=0), 0.0)  # answers are still to come
    return found


@pytest.mark.unit
def test_an_answer_too_long_is_declined_and_reasons_are_of_a_fixed_set(world, monkeypatch: pytest.MonkeyPatch) -> None:
    for reason, counted in (("too long", "too long"), ("[/bold] anything", "another reason")):
        anchor, target = anchor_of(world), target_of(world)
        monkeypatch.setattr(roles, "MAX_BODY", 200)
        (asked, reply), *_ = exchange(anchor, target)
        monkeypatch.undo()
        assert reply == messages.Decline(asked.id, "too long")
        target.handle(messages.Decline(asked.id, reason), 0.0)
        assert target.counts[f"declined: {counted}"] == 1


@pytest.mark.unit
def test_a_burst_is_settled_whatever_comes_of_it(world, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: object) -> str:
        raise OSError("no space left on device")

    anchor, target = anchor_of(world), target_of(world)
    (_, reply), *_ = exchange(anchor, target)
    monkeypatch.setattr(target.track, "add", full)
    settled = len(target._settled)
    target.handle(reply, 0.0)
    assert len(target._settled) == settled + 1
    with pytest.raises(OSError, match="no space"):
        target.detach()
    assert not target._measured


# ---- the command


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_claim_holds(seed: int, tmp_path: Path) -> None:
    (item,) = REGISTRY.select(["mei-x1"])
    outcome = perform(item, seed=seed, out=tmp_path)
    assert outcome.error is None
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []
    assert (tmp_path / "mei-x1.png").stat().st_size > 10_000


@pytest.mark.slow
def test_two_processes_find_what_one_does(world, tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(KEY)
    target, anchor = experiment.two_processes(world, tmp_path)
    alone = report.summary(experiment.one_process(world), Traffic())
    assert target["estimate"] == alone["estimate"]
    assert anchor["counts"]["exchanged"] == target["counts"]["measured"]
