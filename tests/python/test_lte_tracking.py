"""Closely spaced paths, snapshots, loops and streams of LTE cells through Python; loops over the recorded captures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import soopnav_cpp as sn
from soopnav_cpp._core import lte as _lte

SPEED_OF_LIGHT_MPS = 299_792_458.0
FOLDER = Path(__file__).resolve().parents[3] / "shared" / "captures" / "lte"
offair = pytest.mark.skipif(not (FOLDER / "truth.json").exists(), reason="the captures in ../shared are not there")

pytestmark = pytest.mark.unit

Iq = npt.NDArray[np.complex64]


def two_paths(**options: Any) -> tuple[Iq, sn.lte.Detection]:
    cell = sn.lte.CellParameters(
        cell_id=77, n_rb=50, n_ports=2, delay_s=20.3e-6, taps=[(0.0, 1.0), (60e-9, 0.8j)], **options
    )
    iq = sn.lte.synthesize(cell, 15.36e6, 48_000, snr_db=20.0, seed=2)
    return iq, sn.lte.Detection(cell_id=77, n_rb=50, n_ports=2, frame_start_s=20e-6)


def test_two_paths_are_told_apart_from_samples() -> None:
    iq, known = two_paths()
    for subframes in (1, 2):
        paths = sn.lte.resolve_paths(iq, 15.36e6, known, subframes=subframes)
        assert len(paths) == 2
        assert abs(paths.toa_s - 20.3e-6) < 5.0 * paths.toa_sigma_s
        assert paths.delays_s[1] - paths.delays_s[0] == pytest.approx(60e-9, abs=6.0 * paths.sigmas_s.max())
        assert paths.gains.shape == (2, 2)
        np.testing.assert_allclose(np.sqrt(np.diag(paths.covariance_s2)), paths.sigmas_s)
        np.testing.assert_allclose(np.abs(paths.gains[1] / paths.gains[0]), 0.8, atol=0.1)


def test_options_are_refused_by_name() -> None:
    iq, known = two_paths()
    for option, match in (
        ({"order": "bic"}, "order"),
        ({"subspace": "prony"}, "subspace"),
        ({"peak_window": "kaiser"}, "peak_window"),
        ({"max_paths": 9}, "max_paths"),
        ({"subframes": 11}, "subframes"),
        ({"start_s": 1.0}, "iq"),
    ):
        with pytest.raises(ValueError, match=match):
            sn.lte.resolve_paths(iq, 15.36e6, known, **option)  # type: ignore[arg-type]
    noise = np.random.default_rng(1).normal(size=(2, 48_000)).astype(np.float32)
    with pytest.raises(sn.lte.CellLostError):
        sn.lte.resolve_paths((noise[0] + 1j * noise[1]).astype(np.complex64), 15.36e6, known)
    with pytest.raises(ValueError, match="channel"):
        sn.lte.PathResolver().resolve(np.zeros(30, np.complex64), np.arange(20.0))


@pytest.mark.parametrize("options", [{"max_paths": 3}, {"max_paths": 4}, {"order": 3}])
@pytest.mark.parametrize("seed", [1010, 1842])
def test_paths_that_cannot_be_parted_leave_a_lower_order(seed: int, options: dict[str, int]) -> None:
    # Three paths within 20 m: the best fit of three puts two where no delay's covariance can be told.
    k = np.arange(-600, 600)[::3]
    frequencies = np.where(k >= 0, k + 1, k)
    rng = np.random.default_rng(seed)
    delays_s = np.sort(rng.uniform(0.0, 20.0, 3)) / SPEED_OF_LIGHT_MPS
    gains = 10.0 ** (rng.uniform(-6.0, 6.0, 3) / 20.0) * np.exp(2j * np.pi * rng.random(3))
    noise = rng.standard_normal((400, 2)) @ [1.0, 1.0j]
    variance = 10.0**-1.5
    channel = np.exp(-2j * np.pi * 15e3 * np.outer(frequencies, delays_s)) @ gains + np.sqrt(variance / 2.0) * noise
    channel = channel.astype(np.complex64)
    two = sn.lte.PathResolver(max_paths=2).resolve(channel, frequencies, variance)
    more = sn.lte.PathResolver(**options).resolve(channel, frequencies, variance)  # type: ignore[arg-type]
    assert more.toa_s == two.toa_s
    assert np.isfinite(more.sigmas_s).all()


def test_refusals_blame_what_is_wrong() -> None:
    k = np.arange(-600, 600)[::3]
    frequencies = np.where(k >= 0, k + 1, k)
    channel = np.ones(400, np.complex64)
    resolver = sn.lte.PathResolver()
    for variance in (np.nan, -1.0, np.inf):
        with pytest.raises(ValueError, match="noise_variance"):
            resolver.resolve(channel, frequencies, variance)
    with pytest.raises(ValueError, match=r"frequencies: -599\.5"):
        resolver.resolve(channel, frequencies + 0.5)
    iq, known = two_paths()
    with pytest.raises(ValueError, match=r"cfo_hz: shape \(2,\)"):
        sn.lte.SnapshotRanger(15.36e6, [known]).range(iq, [20e-6], [0.0, 1.0])


def test_more_lost_samples_than_can_be_counted_are_refused() -> None:
    known = sn.lte.Detection(cell_id=77, n_rb=6, n_ports=2, frame_start_s=2.3e-3)
    loop = sn.lte.CrsLoop(1.92e6, known)
    loop.skip(2**52)
    with pytest.raises(ValueError, match="samples"):
        loop.skip(2**62)
    assert loop.position == 2**52
    stream = _lte.MeasurementStream(1.92e6, [known])
    with pytest.raises(ValueError, match="samples"):
        stream.skip(2**50)
    assert stream.position == 0


def test_a_snapshot_ranges_cells_on_their_own_time_line() -> None:
    iq, known = two_paths()
    other = sn.lte.Detection(cell_id=12, n_rb=50, n_ports=2, frame_start_s=0.0)
    snapshot = sn.lte.SnapshotRanger(15.36e6, [known, other]).range(iq, [20e-6 - 0.5, 20e-6], 0.0)
    assert snapshot.status.tolist() == [sn.lte.ResolveStatus.OK, sn.lte.ResolveStatus.LOST]
    assert abs(snapshot.toa_s[0] + 0.5 - 20.3e-6) < 5.0 * snapshot.sigma_s[0] + 1e-12
    with pytest.raises(ValueError, match="frame_start_s"):
        sn.lte.SnapshotRanger(15.36e6, [known, other]).range(iq, [0.0])
    with pytest.raises(ValueError, match="cells"):
        sn.lte.SnapshotRanger(15.36e6, [])


def test_a_stream_gives_the_same_from_memory_and_from_a_recording_with_a_gap(tmp_path: Path) -> None:
    cell = sn.lte.CellParameters(cell_id=77, n_ports=2, delay_s=2.3e-3, cfo_hz=50.0)
    iq = sn.lte.synthesize(cell, 1.92e6, 960_000, snr_db=15.0, seed=3)
    known = sn.lte.Detection(cell_id=77, n_rb=6, n_ports=2, frame_start_s=2.3e-3, cfo_hz=50.0)
    epochs = list(sn.lte.measurement_stream(iq, 1.92e6, cells=[known]))
    assert [round(e.time_s, 9) for e in epochs] == [0.1, 0.2, 0.3, 0.4, 0.5]
    for epoch in epochs:
        (row,) = epoch.cells
        assert row["status"] == sn.lte.LoopStatus.TRACKING
        assert abs(row["toa_s"] - 2.3e-3) < 6.0 * row["sigma_s"] + 1e-9
        assert row["cfo_hz"] == pytest.approx(50.0, abs=1.0)
        assert not row["slip"]
    # The same samples from a file whose recorder lost 20 ms after 0.25 s.
    kept = np.concatenate([iq[:480_000], iq[518_400:]])
    meta = sn.io.write_iq(tmp_path / "walk.sigmf-meta", kept, 1.92e6, center_frequency_hz=0.0)
    path = Path(meta if isinstance(meta, (str, Path)) else tmp_path / "walk.sigmf-meta")
    document = json.loads(path.read_text())
    document["captures"] = [
        {"core:sample_start": 0, "core:global_index": 0},
        {"core:sample_start": 480_000, "core:global_index": 518_400},
    ]
    document["global"].pop("core:sha512", None)
    path.write_text(json.dumps(document))
    again = list(sn.lte.measurement_stream(path, cells=[known], carrier_hz=0.0))
    assert [e.time_s for e in again] == [e.time_s for e in epochs]
    for before, after in zip(epochs[:2], again[:2], strict=True):
        assert np.array_equal(before.cells, after.cells)
    assert abs(again[-1].cells["toa_s"][0] - 2.3e-3) < 1e-7
    with pytest.raises(ValueError, match="sample_rate_hz"):
        sn.lte.measurement_stream(iq)


@offair
@pytest.mark.offair
@pytest.mark.crosscheck
@pytest.mark.parametrize(
    ("name", "cell_id", "phase_cycles", "toa_m"),
    [
        ("f1815.3_s19.2_bw20_0.08s_hackrf-1", 301, 0.01, 0.05),
        ("f1815.3_s19.2_bw20_0.08s_hackrf-1", 196, 0.01, 0.1),
        ("f796_s19.2_bw20_0.08s_hackrf", 360, 0.01, 0.05),
        ("f806_s19.2_bw20_0.08s_hackrf", 300, 0.01, 0.1),
        ("f806_s19.2_bw20_0.08s_hackrf", 115, 0.01, 0.15),
        ("f2360_s19.2_bw20_0.08s_hackrf", 30, 0.05, 0.1),
    ],
)
def test_off_air_carriers_are_followed_without_slips(
    name: str, cell_id: int, phase_cycles: float, toa_m: float
) -> None:
    iq, meta = sn.io.read_iq(FOLDER / f"{name}.sigmf-meta")
    carrier_hz = float(json.loads((FOLDER / "truth.json").read_text())[name]["fc_hz"])
    found = next(c for c in sn.lte.search(iq, meta.sample_rate_hz) if c.cell_id == cell_id)
    updates = sn.lte.CrsLoop(meta.sample_rate_hz, found, carrier_hz=carrier_hz).push(iq)
    settled = updates[updates["time_s"] > 0.03]
    assert not updates["slip"].any()
    assert (settled["arc"] == settled["arc"][0]).all()
    late = updates["status"][updates["time_s"] > 0.06]
    assert (late == sn.lte.LoopStatus.TRACKING).mean() >= 0.9
    t = settled["time_s"] - settled["time_s"].mean()
    for column, scale, bar in (
        ("carrier_phase_cycles", 1.0, phase_cycles),
        ("toa_s", SPEED_OF_LIGHT_MPS, toa_m),
    ):
        degree = 3 if scale == 1.0 else 1
        values = settled[column] - settled[column][0]
        residual = (values - np.polyval(np.polyfit(t, values, degree), t)) * scale
        assert residual.std() < bar
