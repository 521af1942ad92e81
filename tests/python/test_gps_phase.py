"""Positions by GPS phase from Python: the recording, broken pieces of it, the command, the skipped experiment."""

import dataclasses
import json
import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import soopnav_cpp as sn
from soopnav_cpp import _rinex, gnss
from soopnav_cpp.cli.app import cli
from soopnav_cpp.experiments import registry
from soopnav_cpp.gnss import PhaseUse, StaticPhaseStatus, static_phase

ROOT = Path(__file__).resolve().parents[2]
STATIC = registry.recording("gnss_static") or ROOT.parent / "shared" / "captures" / "gnss_static"
OBS, NAV = STATIC / "SEPT078M.21O", STATIC / "SEPT078M.21P"

offair = pytest.mark.skipif(
    not OBS.exists() or find_spec("georinex") is None, reason="no recording ../shared/captures/gnss_static, or georinex"
)
HERE = sn.geometry.geodetic_to_ecef(0.6, 2.4, 100.0)


@pytest.fixture(scope="module")
def static():
    """Every 20th epoch of the recording on both frequencies, and its orbits."""
    return (
        gnss.read_observations(OBS, interval_s=20.0),
        gnss.read_observations(OBS, codes={"G": "2W"}, interval_s=20.0),
        gnss.read_navigation(NAV),
    )


def solved(first, second, orbits, **options):
    return static_phase(first, orbits, second, min_arc_epochs=10, max_gap_s=45.0, **options)


@offair
@pytest.mark.offair
def test_the_recordings_antenna_is_found(static):
    first, second, orbits = static
    fix = solved(first, second, orbits)
    error = fix.position_m - first.approximate_position_ecef_m
    assert fix.ok
    assert np.linalg.norm(error) < 2.5
    assert fix.phase_rms_m < 0.03
    assert error @ np.linalg.solve(fix.covariance_m2, error) < 21.1  # once in 1e4
    assert np.sqrt(np.trace(fix.formal_m2)) < 0.5 * fix.sigma_m
    partial = (fix.use == PhaseUse.PARTIAL).any(axis=0)
    assert "G12" in {name for name, some in zip(fix.satellites, partial, strict=True) if some}
    assert "position within" in repr(fix)
    np.testing.assert_allclose(np.linalg.eigvalsh(fix.covariance_enu_m2), np.linalg.eigvalsh(fix.covariance_m2))


@offair
@pytest.mark.offair
def test_one_frequency_is_worth_less_and_says_so(static):
    first, second, orbits = static
    one, two = solved(first, None, orbits), solved(first, second, orbits)
    assert one.ok
    assert one.sigma_m > 2.0 * two.sigma_m
    assert np.linalg.norm(one.position_m - first.approximate_position_ecef_m) < 4.0 * one.sigma_m


@offair
@pytest.mark.offair
def test_gaps_slips_and_missing_satellites(static):
    first, second, orbits = static
    whole = solved(first, second, orbits)
    keep = np.r_[0:20, 25 : len(first)]  # a gap of 100 s: every phase begins anew
    cut = {
        name: getattr(first, name)[keep]
        for name in ("week", "time_of_week_s", "code_m", "phase_cycles", "doppler_hz", "cn0_dbhz", "lli")
    }
    gap = solved(dataclasses.replace(first, **cut), second, orbits)
    assert gap.ok
    assert gap.arcs > whole.arcs
    assert np.linalg.norm(gap.position_m - whole.position_m) < 1.0
    phase = first.phase_cycles.copy()
    column = first.satellites.index("G17")
    phase[22:, column] += 3.0
    slipped = solved(dataclasses.replace(first, phase_cycles=phase), second, orbits)
    assert slipped.slips == whole.slips + 1
    assert np.linalg.norm(slipped.position_m - whole.position_m) < 0.3


@offair
@pytest.mark.offair
def test_a_message_that_an_upload_replaced_is_not_used(static):
    """G28 sends toe 12:00:00 until an upload, then 11:59:44 with a clock 3.2 m off that: the later one is right."""
    orbits = static[2].records
    of_28 = orbits[(orbits["prn"] == 28) & (orbits["toe_s"] < 478_800.0)]
    assert of_28["toe_s"].tolist() == [475_184.0]


def test_superseded_messages_by_their_times_of_sending():
    old, new, far = ({"prn": 5.0, "week": 2200.0, "toe_s": toe} for toe in (7200.0, 7184.0, 14_400.0))
    assert _rinex._not_superseded([old, new, far], [3600.0, 6000.0, 9000.0]) == [new, far]
    assert _rinex._not_superseded([old, new, far], [np.nan, np.nan, np.nan]) == [old, new, far]


def test_no_measurements_are_a_status():
    sky = gnss.walker_constellation(24, 6, 1)
    nothing = sn.simulation.simulate_gnss(sky, HERE, np.arange(3.0), seed=1).antennas[0]
    blank = dataclasses.replace(nothing, code_m=np.full_like(nothing.code_m, np.nan))
    fix = static_phase(blank, sky)
    assert fix.status == StaticPhaseStatus.TOO_FEW_SATELLITES
    assert fix.message().startswith("no position: ")
    with pytest.raises(ValueError, match=r"^fix: no position"):
        sn.plotting.static_phase(fix)
    with pytest.raises(ValueError, match=r"^code_sigma_m = "):
        static_phase(nothing, sky, code_sigma_m=-1.0)
    late = dataclasses.replace(nothing, time_of_week_s=nothing.time_of_week_s + 0.5)
    with pytest.raises(ValueError, match=r"^second: no epoch in common"):
        static_phase(nothing, sky, late)


def test_made_up_measurements_of_one_frequency():
    sky = gnss.walker_constellation(30, 6, 1)
    seen = sn.simulation.simulate_gnss(sky, HERE, np.arange(120.0), seed=3, troposphere=True).antennas[0]
    fix = static_phase(seen, sky)
    assert fix.ok
    assert np.linalg.norm(fix.position_m - HERE) < 1.0
    figure = sn.plotting.static_phase(fix, title="made up")
    assert len(figure.axes) == 4


@pytest.mark.parametrize(("a", "b"), [((1.0, 1.0), 1.0), ((0.0, 1.0), -1.0 / (1.0 - (1227.6 / 1575.42) ** 2) + 1.0)])
def test_ionosphere_free(a, b):
    k = (1227.6 / 1575.42) ** 2
    assert gnss.ionosphere_free(*a) == pytest.approx((a[0] - k * a[1]) / (1.0 - k))
    assert gnss.ionosphere_free(*a) == pytest.approx(b, abs=1e-12)


@offair
@pytest.mark.offair
def test_the_command(tmp_path):
    run = CliRunner().invoke(
        cli, ["gnss", str(OBS), str(NAV), "--every", "30", "--json", "--plot", str(tmp_path / "a.png")]
    )
    assert run.exit_code == 0, run.output
    found = json.loads(run.stdout)
    assert found["from_header_m"] < 2.5
    assert 0.3 < found["sigma_m"] < 2.5
    assert {s["name"] for s in found["satellites"]} >= {"G17", "G19"}
    assert (tmp_path / "a.png").stat().st_size > 10_000


@pytest.mark.skipif(find_spec("georinex") is None, reason="georinex is not installed")
def test_the_command_refuses_in_sentences(tmp_path):
    broken = tmp_path / "a.21O"
    broken.write_text("nothing\n")
    run = CliRunner().invoke(cli, ["gnss", str(broken), str(broken)])
    assert run.exit_code != 0
    assert "a.21O:1: 'RINEX VERSION / TYPE' expected" in run.output
    run = CliRunner().invoke(cli, ["gnss", str(broken), str(broken), "--plot", "a.pdf"])
    assert run.exit_code != 0
    assert "a name that ends in .png expected" in run.output


def test_an_experiment_without_its_recording_is_skipped(monkeypatch, tmp_path):
    monkeypatch.setenv("SOOPNAV_RECORDINGS", str(tmp_path))
    run = CliRunner().invoke(cli, ["reproduce", "pesyna-x3", "--out", str(tmp_path / "out"), "--jobs", "1"])
    assert run.exit_code == 1  # it was asked for by name
    assert "pesyna-x3 skipped: needs the recording 'gnss_static'" in run.output
    assert json.loads((tmp_path / "out" / "claims.json").read_text()) == []
    shutil.rmtree(tmp_path / "out")
    (tmp_path / "gnss_static").mkdir()
    assert registry.recording("gnss_static") == tmp_path / "gnss_static"
    assert registry.recording("none_such") is None
