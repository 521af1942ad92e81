"""How arrays go in and out of the engine: no copies, no surprises, a sentence for everything else."""

import gc
import resource
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import soopnav_cpp as sn

pytestmark = pytest.mark.unit

RATE = 1.92e6


@pytest.fixture(scope="module")
def capture():
    cell = sn.lte.CellParameters(cell_id=101, n_ports=2, delay_s=1.2345e-3)
    return sn.lte.synthesize(cell, RATE, 76_800, snr_db=15.0, seed=1)


@pytest.fixture(scope="module")
def detection(capture):
    return sn.lte.search(capture, RATE, max_cfo_hz=5e3)[0]


MISTAKES = {
    "double precision": (
        lambda iq: iq.astype(np.complex128),
        "iq: expected complex64 with shape (n,), got complex128 (76800,); convert with iq.astype(np.complex64)",
    ),
    "real": (
        lambda iq: iq.real.copy(),
        "iq: expected complex64 with shape (n,), got float32 (76800,); raw files are decoded by soopnav_cpp.io.read_iq",
    ),
    "bytes of a raw file": (
        lambda iq: np.zeros(100, np.int8),
        "iq: expected complex64 with shape (n,), got int8 (100,); raw files are decoded by soopnav_cpp.io.read_iq",
    ),
    "a row": (
        lambda iq: iq[None, :],
        "iq: expected complex64 with shape (n,), got complex64 (1, 76800); flatten with iq.ravel()",
    ),
    "a column": (
        lambda iq: iq[:, None],
        "iq: expected complex64 with shape (n,), got complex64 (76800, 1); flatten with iq.ravel()",
    ),
    "two channels": (
        lambda iq: np.stack([iq, iq]),
        "iq: expected complex64 with shape (n,), got complex64 (2, 76800); pass one channel, such as iq[0]",
    ),
    "no dimension": (
        lambda iq: np.array(iq[0]),
        "iq: expected complex64 with shape (n,), got complex64 (); pass one channel, such as iq[0]",
    ),
    "every other sample": (
        lambda iq: iq[::2],
        "iq: expected complex64 with shape (n,), got complex64 (38400,) with strides (16,); "
        "copy with np.ascontiguousarray(iq)",
    ),
    "backwards": (
        lambda iq: iq[::-1],
        "iq: expected complex64 with shape (n,), got complex64 (76800,) with strides (-8,); "
        "copy with np.ascontiguousarray(iq)",
    ),
    "other byte order": (
        lambda iq: iq.astype(">c8"),
        "iq: expected complex64 with shape (n,), got >c8 (76800,); convert with iq.astype(np.complex64)",
    ),
    "a list": (
        lambda iq: [1j, 2j],
        "iq: expected complex64 with shape (n,), got list; convert with np.asarray(iq, np.complex64)",
    ),
    "nothing": (
        lambda iq: None,
        "iq: expected complex64 with shape (n,), got NoneType; convert with np.asarray(iq, np.complex64)",
    ),
    "misaligned": (
        lambda iq: np.frombuffer(b"\0" + iq.tobytes(), np.complex64, offset=1),
        "iq: expected complex64 with shape (n,), got complex64 (76800,) with strides (8,); "
        "copy with np.ascontiguousarray(iq)",
    ),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_other_arrays_are_refused_with_a_sentence(capture, detection, case):
    spoil, sentence = MISTAKES[case]
    wrong = spoil(capture)
    for call in (
        lambda: sn.lte.search(wrong, RATE),
        lambda: sn.lte.time_of_arrival(wrong, RATE, detection),
        lambda: sn.lte.Searcher(RATE).search(wrong),
        lambda: sn.dsp.resample(wrong, RATE, 1e6),
        lambda: sn.simulation.mean_power(wrong),
    ):
        with pytest.raises(ValueError) as caught:
            call()
        assert str(caught.value) == sentence


def test_the_argument_is_named(capture):
    with pytest.raises(ValueError, match=r"^kernel: expected complex64 .* kernel\.astype"):
        sn.dsp.correlate(capture, np.zeros(4, np.complex128))
    with pytest.raises(ValueError, match=r"^block: expected complex64"):
        sn.lte.Searcher(RATE).push(capture[::2])


def test_what_need_not_be_copied_is_accepted(capture):
    frozen = capture.copy()
    frozen.flags.writeable = False
    part = capture[100:20_100]
    subclass = capture.view(np.recarray)
    for iq in (frozen, part, subclass):
        assert sn.simulation.mean_power(iq) == pytest.approx(np.mean(np.abs(np.asarray(iq)) ** 2), rel=1e-5)


@pytest.mark.noalloc
def test_samples_are_not_copied_on_the_way_in(detection):
    iq = np.zeros(1 << 26, np.complex64)  # half a gigabyte that is mapped only when it is written
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for call in (
        lambda: sn.lte.search(iq, -1.0),
        lambda: sn.lte.time_of_arrival(iq, -1.0, detection),
        lambda: sn.dsp.resample(iq, -1.0, 1.0),
    ):
        with pytest.raises(ValueError):
            call()
    after_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after_kib - before_kib < 100 * 1024


@pytest.mark.parametrize("call", ["search", "time_of_arrival", "resample", "synthesize", "fix"])
def test_other_threads_run_during_a_call(capture, detection, call):
    ticks, stop = [0], threading.Event()

    def tick():
        while not stop.is_set():
            ticks[0] += 1
            time.sleep(0)

    calls = {
        "search": lambda: sn.lte.search(capture, RATE, max_cfo_hz=50e3),
        "time_of_arrival": lambda: sn.lte.time_of_arrival(capture, RATE, detection),
        "resample": lambda: sn.dsp.resample(np.zeros(1 << 20, np.complex64), 3e6, 1.1e6),
        "synthesize": lambda: sn.lte.synthesize(sn.lte.CellParameters(cell_id=1), RATE, 200_000),
        "fix": lambda: sn.navigation.position_fix(np.eye(3) * 500, np.full(3, 1e-6), np.full(3, 1e-9), height_m=0.0),
    }
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e3)  # so that nobody takes the lock: it has to be given
    other = threading.Thread(target=tick)
    try:
        other.start()
        before = ticks[0]
        for _ in range(500):  # a short call may end before the other thread wakes up
            calls[call]()
            if ticks[0] > before:
                break
        after = ticks[0]
    finally:
        sys.setswitchinterval(interval)
        stop.set()
        other.join()
    assert after > before


def test_results_live_as_long_as_they_are_looked_at(capture, detection):
    toa = sn.lte.time_of_arrival(capture, RATE, detection)
    values, kept = toa.toa_s, toa.toa_s.copy()
    del toa
    gc.collect()
    scratch = [np.random.default_rng(i).normal(size=kept.size) for i in range(100)]
    np.testing.assert_array_equal(values, kept)
    assert len(scratch) == 100


def test_results_cannot_be_changed(capture, detection):
    toa = sn.lte.time_of_arrival(capture, RATE, detection)
    for array in (toa.toa_s, toa.sigma_s, toa.impulse_response, toa.frame_index):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    for thing, name in ((toa, "cfo_hz"), (toa, "toa_s"), (detection, "cell_id")):
        with pytest.raises(AttributeError):
            setattr(thing, name, 0)


def test_results_are_not_copied(capture, detection):
    toa = sn.lte.time_of_arrival(capture, RATE, detection)
    assert toa.toa_s.ctypes.data == toa.toa_s.ctypes.data
    assert not toa.toa_s.flags.owndata
    assert not sn.lte.pss(0).flags.owndata
    assert sn.lte.pss(0).flags.writeable  # a new array each time: the caller's own


@pytest.mark.fuzz
@settings(max_examples=60, deadline=None)
@given(
    iq=hnp.arrays(
        st.sampled_from([np.complex64, np.complex128, np.float32, np.int16]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=8),
    )
)
def test_any_small_array_is_refused(iq):
    with pytest.raises(ValueError, match=r"^iq: "):
        sn.lte.search(iq, RATE)
