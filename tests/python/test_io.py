"""Reading and writing captures: what comes back, and what is refused with which sentence."""

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from soopnav_cpp import io

pytestmark = pytest.mark.unit

CAPTURES = Path(__file__).parents[3] / "shared" / "captures" / "lte"


def write_sigmf(folder: Path, data: bytes, *, datatype: str = "ci8", **info: object) -> Path:
    """A recording with one capture segment; keys of `info` with None are left out."""
    (folder / "x.sigmf-data").write_bytes(data)
    fields = {"core:datatype": datatype, "core:sample_rate": 1.92e6, "core:version": "1.2.0"}
    fields |= {f"core:{key}": value for key, value in info.items()}
    meta = {
        "global": {key: value for key, value in fields.items() if value is not None},
        "captures": [{"core:sample_start": 0, "core:frequency": 796e6}],
        "annotations": [],
    }
    path = folder / "x.sigmf-meta"
    path.write_text(json.dumps(meta))
    return path


def edit(path: Path, change) -> Path:
    meta = json.loads(path.read_text())
    change(meta)
    path.write_text(json.dumps(meta))
    return path


@pytest.mark.parametrize(
    ("name", "dtype", "values", "expected"),
    [
        ("cu8", "u1", [0, 255, 127, 128], [-1 + 1j, (-0.5 + 0.5j) / 127.5]),
        ("ci8", "i1", [-128, 127, 0, 64], [-1 + 127j / 128, 0.5j]),
        ("ci16", "<i2", [-32768, 16384, 0, 1], [-1 + 0.5j, 1j / 32768]),
        ("ci16_be", ">i2", [-32768, 16384, 0, 1], [-1 + 0.5j, 1j / 32768]),
        ("cf32", "<f4", [0.25, -2.0, 1e-9, 3.0], [0.25 - 2j, 1e-9 + 3j]),
        ("cf64_be", ">f8", [0.25, -2.0, 1e-9, 3.0], [0.25 - 2j, 1e-9 + 3j]),
    ],
)
def test_full_scale_is_one(tmp_path, name, dtype, values, expected):
    path = tmp_path / "x.raw"
    np.array(values, dtype).tofile(path)
    iq, meta = io.read_iq(path, sample_rate_hz=2e6, format=name)
    assert iq.dtype == np.complex64
    assert iq.flags.c_contiguous
    np.testing.assert_allclose(iq, np.array(expected, np.complex64), rtol=1e-6, atol=0)
    assert (meta.n_samples, meta.sample_rate_hz, meta.format) == (2, 2e6, name)
    assert meta.duration_s == 1e-6
    assert meta.center_frequency_hz is None


def test_suffix_names_the_format_of_a_raw_file(tmp_path):
    path = tmp_path / "x.ci8"
    path.write_bytes(bytes([64, 0]))
    iq, meta = io.read_iq(path, sample_rate_hz=1e6)
    assert iq[0] == 0.5
    assert meta.format == "ci8"


def test_sigmf_is_found_by_any_of_its_names(tmp_path):
    path = write_sigmf(tmp_path, bytes(8))
    for name in (path, path.with_suffix(".sigmf-data"), path.with_suffix("")):
        iq, meta = io.read_iq(name)
        assert iq.shape == (4,)
        assert meta.path == path
        assert (meta.sample_rate_hz, meta.center_frequency_hz) == (1.92e6, 796e6)


def test_header_and_trailing_bytes_are_not_samples(tmp_path):
    data = b"head" + bytes([64, 0, 32, 0]) + b"mid" + bytes([0, 64, 0, 32]) + b"tail!"
    path = write_sigmf(tmp_path, data, trailing_bytes=5)

    def segments(meta):
        meta["captures"] = [
            {"core:sample_start": 0, "core:header_bytes": 4},
            {"core:sample_start": 2, "core:header_bytes": 3},
        ]

    iq, _ = io.read_iq(edit(path, segments))
    np.testing.assert_array_equal(iq, np.array([0.5, 0.25, 0.5j, 0.25j], np.complex64))


def test_dataset_names_another_file(tmp_path):
    path = write_sigmf(tmp_path, bytes(4), dataset="other.bin")
    (tmp_path / "x.sigmf-data").rename(tmp_path / "other.bin")
    assert io.read_iq(path)[0].shape == (2,)


def test_rate_argument_goes_before_the_metadata(tmp_path):
    path = write_sigmf(tmp_path, bytes(4), sample_rate=None)
    with pytest.raises(io.CaptureError, match="core:sample_rate is missing"):
        io.read_iq(path)
    assert io.read_iq(path, sample_rate_hz=5e6)[1].sample_rate_hz == 5e6


def test_nan_is_left_for_the_search_to_refuse(tmp_path):
    path = tmp_path / "x.cf32"
    np.array([1.0, math.nan], "<f4").tofile(path)
    assert np.isnan(io.read_iq(path, sample_rate_hz=1e6)[0][0].imag)


RAW_MISTAKES = {
    "empty": (b"", {"sample_rate_hz": 1e6, "format": "ci8"}, r"x\.raw: the file is empty; ci8 samples expected"),
    "odd byte count": (
        bytes(7),
        {"sample_rate_hz": 1e6, "format": "cf32"},
        r"x\.raw: 7 bytes of samples are not a whole number of cf32 samples \(8 bytes each\); truncated",
    ),
    "odd byte count of a byte format": (
        bytes(3),
        {"sample_rate_hz": 1e6, "format": "cu8"},
        "not a whole number of cu8",
    ),
    "unknown format": (
        bytes(8),
        {"sample_rate_hz": 1e6, "format": "cq7"},
        "x.raw: format 'cq7' is unknown; expected one of cu8, ci8, ci16, cf32",
    ),
    "real samples": (bytes(8), {"sample_rate_hz": 1e6, "format": "ri8"}, "'ri8' holds real samples"),
    "no format": (bytes(8), {"sample_rate_hz": 1e6}, "not SigMF, so the format of its samples is needed"),
    "no rate": (bytes(8), {"format": "ci8"}, "not SigMF, so the sample rate is needed"),
    "zero rate": (bytes(8), {"sample_rate_hz": 0.0, "format": "ci8"}, "sample rate is 0 Hz; it must be above zero"),
    "negative rate": (bytes(8), {"sample_rate_hz": -1e6, "format": "ci8"}, r"sample rate is -1e\+06 Hz"),
    "infinite rate": (bytes(8), {"sample_rate_hz": math.inf, "format": "ci8"}, "sample rate is inf Hz"),
    "rate that is no number": (bytes(8), {"sample_rate_hz": "fast", "format": "ci8"}, "sample rate is 'fast'"),
}


@pytest.mark.parametrize("case", RAW_MISTAKES)
def test_raw_mistakes(tmp_path, case):
    data, arguments, sentence = RAW_MISTAKES[case]
    path = tmp_path / "x.raw"
    path.write_bytes(data)
    with pytest.raises(io.CaptureError, match=sentence):
        io.read_iq(path, **arguments)


SIGMF_MISTAKES = {
    "empty data": (b"", {}, r"x\.sigmf-data: the file is empty; ci8 samples expected"),
    "odd byte count": (bytes(5), {}, r"x\.sigmf-data: 5 bytes of samples are not a whole number of ci8"),
    "truncated": (bytes(8), {"sha512": "0" * 128}, r"x\.sigmf-data: SHA-512 differs .* truncated or changed"),
    "zero rate": (bytes(8), {"sample_rate": 0}, r"x\.sigmf-meta: sample rate is 0 Hz; it must be above zero"),
    "negative rate": (bytes(8), {"sample_rate": -1e6}, r"x\.sigmf-meta: sample rate is -1e\+06 Hz"),
    "rate that is no number": (bytes(8), {"sample_rate": "fast"}, r"x\.sigmf-meta: sample rate is 'fast'"),
    "unknown datatype": (bytes(8), {"datatype": "cq7"}, r"x\.sigmf-meta: .*cq7"),
    "no datatype": (bytes(8), {"datatype": None}, r"x\.sigmf-meta: core:datatype is missing"),
    "real samples": (bytes(8), {"datatype": "ri8"}, "'ri8' holds real samples"),
    "two channels": (bytes(8), {"num_channels": 2}, "core:num_channels is 2; recordings of one channel are read"),
    "no samples": (bytes(8), {"metadata_only": True}, "core:metadata_only is set"),
    "trailing bytes beyond the file": (bytes(8), {"trailing_bytes": 9}, "8 bytes, but the metadata skips 9 of them"),
    "version of another type": (bytes(8), {"version": 3}, r"x\.sigmf-meta: global\.core:version"),
}


@pytest.mark.parametrize("case", SIGMF_MISTAKES)
def test_sigmf_mistakes(tmp_path, case):
    data, info, sentence = SIGMF_MISTAKES[case]
    with pytest.raises(io.CaptureError, match=sentence):
        io.read_iq(write_sigmf(tmp_path, data, **info))


def test_metadata_of_a_missing_data_file(tmp_path):
    path = write_sigmf(tmp_path, bytes(8))
    (tmp_path / "x.sigmf-data").unlink()
    with pytest.raises(io.CaptureError, match=r"x\.sigmf-meta: its data file x\.sigmf-data is not there"):
        io.read_iq(path)


def test_metadata_of_a_longer_file(tmp_path):
    path = write_sigmf(tmp_path, bytes(8))
    long_note = [{"core:sample_start": 2, "core:sample_count": 100}]
    with pytest.raises(
        io.CaptureError, match=r"holds 4 samples, but annotations\[0\] .* reaches sample 102; truncated"
    ):
        io.read_iq(edit(path, lambda meta: meta.update(annotations=long_note)))
    late = [{"core:sample_start": 0}, {"core:sample_start": 50}]
    with pytest.raises(io.CaptureError, match="holds 4 samples, but the metadata has a segment at sample 50"):
        io.read_iq(edit(path, lambda meta: meta.update(annotations=[], captures=late)))


def test_capture_that_changes_its_frequency(tmp_path):
    hops = [{"core:sample_start": 0, "core:frequency": 1e9}, {"core:sample_start": 2, "core:frequency": 2e9}]
    path = edit(write_sigmf(tmp_path, bytes(8)), lambda meta: meta.update(captures=hops))
    with pytest.raises(io.CaptureError, match="tuned to 2 frequencies"):
        io.read_iq(path)


def test_metadata_that_is_no_metadata(tmp_path):
    path = tmp_path / "x.sigmf-meta"
    for content, sentence in {
        b'{\n"global": }': r"x\.sigmf-meta:2: not JSON",
        b"\xff\xfe\x00": "not a text file",
        b"[]": "no 'global' object",
        b'{"global": 3}': "no 'global' object",
        b"[" * 100_000: r"x\.sigmf-meta: JSON nested too deeply|x\.sigmf-meta:1: not JSON",
    }.items():
        path.write_bytes(content)
        with pytest.raises(io.CaptureError, match=sentence):
            io.read_iq(path)


def test_files_that_are_not_there(tmp_path):
    for name in ("x.sigmf-meta", "x.sigmf-data", "x.ci8", "x"):
        with pytest.raises(FileNotFoundError, match="no such file"):
            io.read_iq(tmp_path / name, sample_rate_hz=1e6, format=None)
    with pytest.raises(io.CaptureError, match="a folder"):
        io.read_iq(tmp_path)
    (tmp_path / "x.sigmf").write_bytes(b"tar")
    with pytest.raises(io.CaptureError, match="an archive; unpack it"):
        io.read_iq(tmp_path / "x.sigmf")


def test_format_is_refused_for_sigmf(tmp_path):
    with pytest.raises(io.CaptureError, match="is for raw files"):
        io.read_iq(write_sigmf(tmp_path, bytes(8)), format="ci8")


@pytest.mark.law
@pytest.mark.parametrize("format", ["cf32", "ci16", "ci8", "cu8"])
def test_round_trip(tmp_path, format):
    rng = np.random.default_rng(1)
    iq = (rng.uniform(-1, 0.99, 1000) + 1j * rng.uniform(-1, 0.99, 1000)).astype(np.complex64)
    path = io.write_iq(
        tmp_path / "a.b", iq, 19.2e6, format=format, center_frequency_hz=806e6, description="noise",
        datetime_utc="2020-01-02T03:04:05Z",
    )  # fmt: skip
    assert path == tmp_path / "a.b.sigmf-meta"
    back, meta = io.read_iq(path)
    step = {"cf32": 0.0, "ci16": 2**-15, "ci8": 2**-7, "cu8": 1 / 127.5}[format]
    assert np.abs((back - iq).view(np.float32)).max() <= step / 2 * 1.0001
    assert (meta.sample_rate_hz, meta.center_frequency_hz, meta.description) == (19.2e6, 806e6, "noise")
    assert meta.datetime_utc == "2020-01-02T03:04:05Z"
    again, _ = io.read_iq(io.write_iq(path, back, 19.2e6, format=format))
    np.testing.assert_array_equal(again, back)


def test_integers_clip_at_full_scale(tmp_path):
    iq = np.array([3 - 3j], np.complex64)
    back, _ = io.read_iq(io.write_iq(tmp_path / "x", iq, 1e6, format="ci8"))
    assert back[0] == np.complex64(127 / 128 - 1j)


def test_truncated_after_writing(tmp_path):
    path = io.write_iq(tmp_path / "x", np.ones(100, np.complex64), 1e6)
    data = path.with_suffix(".sigmf-data")
    data.write_bytes(data.read_bytes()[:-8])
    with pytest.raises(io.CaptureError, match="SHA-512 differs"):
        io.read_iq(path)


@pytest.mark.parametrize(
    ("iq", "rate", "format", "sentence"),
    [
        (np.zeros(0), 1e6, "cf32", "at least one sample"),
        (np.zeros((1, 4)), 1e6, "cf32", r"shape \(1, 4\)"),
        ([math.nan], 1e6, "ci8", "not finite; ci8 cannot hold them"),
        (np.zeros(4), 0, "cf32", "must be above zero"),
        (np.zeros(4), 1e6, "xx", "'xx' is unknown"),
    ],
)
def test_writing_mistakes(tmp_path, iq, rate, format, sentence):
    with pytest.raises(io.CaptureError, match=sentence):
        io.write_iq(tmp_path / "x", iq, rate, format=format)
    assert not list(tmp_path.iterdir())


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-10, 10**18) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
global_keys = st.sampled_from(
    ["datatype", "sample_rate", "num_channels", "trailing_bytes", "dataset", "sha512", "metadata_only", "description"]
)
segment_keys = st.sampled_from(["core:sample_start", "core:header_bytes", "core:frequency", "core:datetime"])
fuzz_settings = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


@pytest.mark.fuzz
@fuzz_settings
@given(
    data=st.binary(max_size=64),
    info=st.dictionaries(global_keys, json_values, max_size=4),
    segments=st.lists(st.dictionaries(segment_keys, json_values, max_size=4), max_size=3) | json_values,
    notes=json_values,
)
def test_any_metadata_reads_or_is_refused(tmp_path, data, info, segments, notes):
    path = write_sigmf(tmp_path, data, **info)
    edit(path, lambda meta: meta.update(captures=segments, annotations=notes))
    try:
        iq, meta = io.read_iq(path)
    except io.CaptureError as error:
        assert "x.sigmf-" in str(error)
    else:
        assert iq.dtype == np.complex64
        assert iq.shape == (meta.n_samples,)
        assert meta.sample_rate_hz > 0


@pytest.mark.fuzz
@fuzz_settings
@given(data=st.binary(max_size=64), format=st.sampled_from(io.RAW_FORMATS) | st.text(max_size=6), rate=st.floats())
def test_any_raw_file_reads_or_is_refused(tmp_path, data, format, rate):
    path = tmp_path / "x.raw"
    path.write_bytes(data)
    try:
        iq, meta = io.read_iq(path, sample_rate_hz=rate, format=format)
    except io.CaptureError as error:
        assert "x.raw" in str(error)
    else:
        assert iq.shape == (meta.n_samples,)
        assert meta.n_samples > 0


@pytest.mark.fuzz
@fuzz_settings
@given(text=st.binary(max_size=200))
def test_any_bytes_as_metadata(tmp_path, text):
    path = write_sigmf(tmp_path, bytes(8))
    path.write_bytes(text)
    with pytest.raises(io.CaptureError):
        io.read_iq(path)


@pytest.mark.fuzz
@fuzz_settings
@given(iq=hnp.arrays(np.complex64, st.integers(1, 20)))
def test_floats_survive_bit_by_bit(tmp_path, iq):
    back, _ = io.read_iq(io.write_iq(tmp_path / "x", iq, 1e6))
    np.testing.assert_array_equal(back.view(np.uint32), iq.view(np.uint32))


@pytest.mark.offair
@pytest.mark.crosscheck
def test_recordings_equal_the_sigmf_library(tmp_path):
    sigmf = pytest.importorskip("sigmf")
    if not CAPTURES.is_dir():
        pytest.skip("needs the recordings in ../shared/captures/lte")
    for name in ("f2646_s1.92_noise_hackrf", "clean_c101_p6", "f796_s19.2_bw20_0.08s_hackrf"):
        for suffix in (".sigmf-meta", ".sigmf-data"):
            shutil.copy(CAPTURES / (name + suffix), tmp_path)
        iq, meta = io.read_iq(tmp_path / f"{name}.sigmf-meta")
        theirs = sigmf.fromfile(tmp_path / f"{name}.sigmf-meta")
        samples = theirs.read_samples()
        if meta.format == "cu8":  # the library centres at 128 and divides by 128
            samples = (samples * 128 + (0.5 + 0.5j)) / 127.5
        np.testing.assert_allclose(iq, samples, atol=1e-6)
        assert meta.sample_rate_hz == theirs.sample_rate


# ---- Several channels


@pytest.mark.parametrize("format", ["cf32", "ci16", "ci8"])
@pytest.mark.parametrize("channels", [1, 4])
def test_channels_come_back_in_their_rows(tmp_path, format, channels):
    iq = ((np.arange(3 * channels).reshape(channels, 3) - 2 + 1j * np.arange(3)) / 16).astype(np.complex64)
    meta_path = io.write_iq_channels(tmp_path / "x", iq, 20e6, format=format, center_frequency_hz=1575.42e6)
    back, meta = io.read_iq_channels(meta_path)
    np.testing.assert_array_equal(back, iq)
    assert back.flags.c_contiguous
    assert back.dtype == np.complex64
    assert (meta.n_samples, meta.n_channels, meta.center_frequency_hz) == (3, channels, 1575.42e6)
    assert meta.duration_s == 3 / 20e6


def test_channels_lie_in_turn_in_the_file(tmp_path):
    iq = np.array([[1, 2], [3, 4]], np.complex64)
    path = io.write_iq_channels(tmp_path / "x", iq, 1e6)
    raw = np.fromfile(path.with_suffix(".sigmf-data"), np.complex64)
    np.testing.assert_array_equal(raw, [1, 3, 2, 4])


def test_headers_and_annotations_count_samples_per_channel(tmp_path):
    path = write_sigmf(tmp_path, bytes([9] * 6) + bytes(range(12)), num_channels=2)
    edit(path, lambda meta: meta["captures"][0].update({"core:header_bytes": 6}))
    edit(path, lambda meta: meta["annotations"].append({"core:sample_start": 0, "core:sample_count": 3}))
    iq, meta = io.read_iq_channels(path)
    np.testing.assert_array_equal(iq * 128, [[0 + 1j, 4 + 5j, 8 + 9j], [2 + 3j, 6 + 7j, 10 + 11j]])
    assert meta.n_samples == 3
    edit(path, lambda meta: meta["annotations"][0].update({"core:sample_count": 4}))
    with pytest.raises(io.CaptureError, match="holds 3 samples, but annotations"):
        io.read_iq_channels(path)


def test_a_recording_per_channel(tmp_path):
    rows = np.arange(6).reshape(2, 3).astype(np.complex64)
    paths = [io.write_iq(tmp_path / f"c{i}", rows[i], 1e6) for i in range(2)]
    iq, meta = io.read_iq_channels(paths)
    np.testing.assert_array_equal(iq, rows)
    assert meta.n_channels == 2
    paths[1] = io.write_iq(tmp_path / "c1", rows[1, :2], 1e6)
    with pytest.raises(io.CaptureError, match=r"n_samples is 2, that of .* is 3; channels of one array agree"):
        io.read_iq_channels(paths)
    with pytest.raises(io.CaptureError, match="no recording given"):
        io.read_iq_channels([])


def test_refusals_of_several_channels(tmp_path):
    with pytest.raises(io.CaptureError, match=r"iq has shape \(3,\); two dimensions"):
        io.write_iq_channels(tmp_path / "x", np.ones(3, np.complex64), 1e6)
    with pytest.raises(io.CaptureError, match=r"iq has shape \(0, 3\); two dimensions"):
        io.write_iq_channels(tmp_path / "x", np.ones((0, 3), np.complex64), 1e6)
    torn = write_sigmf(tmp_path, bytes(10), num_channels=2)
    with pytest.raises(io.CaptureError, match=r"not a whole number of ci8 samples of 2 channels \(4 bytes each\)"):
        io.read_iq_channels(torn)
    with pytest.raises(io.CaptureError, match="core:num_channels is 2; recordings of one channel are read"):
        io.read_iq(torn)
    (tmp_path / "y.cf32").write_bytes(bytes(16))
    with pytest.raises(io.CaptureError, match="not SigMF; a recording with core:num_channels is needed"):
        io.read_iq_channels(tmp_path / "y.cf32")
    with pytest.raises(FileNotFoundError):
        io.read_iq_channels(tmp_path / "none")
