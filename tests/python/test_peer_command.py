"""`soopnav peer` as a person meets it: what it refuses, and in which words."""

from __future__ import annotations

import shutil
import socket
from pathlib import Path

import pytest
from click.testing import CliRunner

from soopnav_cpp.cli.app import cli
from soopnav_cpp.cli.peer import print_result
from soopnav_cpp.experiments import mei_peer_setup
from soopnav_cpp.peer.session import SessionOptions

pytest.importorskip("msgpack")

KEY = b"0123456789abcdef"
FAST = SessionOptions(wait_s=5.0, retry_s=0.05, heartbeat_s=0.1, silence_s=2.0, first_backoff_s=0.05)


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> mei_peer_setup.PeerWorld:
    return mei_peer_setup.record(2, tmp_path_factory.mktemp("pair"), duration_s=12.0)


def refusal(*arguments: str) -> str:
    result = CliRunner().invoke(cli, ["peer", *arguments])
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    return result.output


@pytest.mark.unit
def test_the_command_refuses_in_a_sentence(world, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOOPNAV_PEER_KEY", raising=False)
    key = tmp_path / "key"
    key.write_bytes(KEY)
    good = ["--role", "anchor", "--source", str(world.anchor), "--orbits", str(world.ephemeris),
            f"--at={world.anchor_at}", "--key-file", str(key)]  # fmt: skip
    assert "--role is missing" in refusal()
    assert "one of --listen and --connect" in refusal(*good)
    assert "HOST:PORT" in refusal(*good, "--listen", "here")
    assert "LAT,LON,HEIGHT" in refusal(*good[:-3], "--at=north", "--listen", ":0")
    assert "--key-file" in refusal(*good[:-2], "--listen", ":0")
    key.write_bytes(b"short")
    assert "16" in refusal(*good, "--listen", ":0")
    assert "short" not in refusal(*good, "--listen", ":0")
    key.write_bytes(KEY)
    assert "no multiple" in refusal(*good, "--listen", ":0", "--snippet-rate", "40e3")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert "in use" in refusal(*good, "--listen", f"127.0.0.1:{taken.getsockname()[1]}")
    empty = tmp_path / "empty.sigmf-meta"
    shutil.copy(world.anchor, empty)
    empty.with_suffix(".sigmf-data").write_bytes(b"")
    good[3] = str(empty)
    assert "empty" in refusal(*good, "--listen", ":0")


@pytest.mark.unit
def test_the_command_says_what_will_not_do_before_it_waits(world, tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_bytes(KEY)
    common = ["--orbits", str(world.ephemeris), "--key-file", str(key), "--wait", "0.1"]
    anchor = [*common, "--role", "anchor", "--source", str(world.anchor), f"--at={world.anchor_at}"]
    target = [*common, "--role", "target", "--source", str(world.target), f"--at={world.guess_at}"]
    assert "--state: of the target alone" in refusal(*anchor, "--listen", ":0", "--state", "x")
    assert "--bits: of the anchor alone" in refusal(*target, "--listen", ":0", "--bits", "2")
    assert "--bandwidth: of the anchor alone" in refusal(*target, "--listen", ":0", "--bandwidth", "9e3")
    assert "no peer at localhost:9 within 0.1 s" in refusal(*target, "--connect", "localhost:9")
    assert f"no peer at unix:{tmp_path}/s within" in refusal(*anchor, "--listen", f"unix:{tmp_path}/s")
    assert f"{tmp_path}/no/s: no such file" in refusal(*anchor, "--listen", f"unix:{tmp_path}/no/s")
    assert f"{key}/out: not a directory" in refusal(*anchor, "--listen", ":0", "--out", f"{key}/out")
    assert "(--state): the track cannot be kept" in refusal(
        *target, "--listen", ":0", "--state", f"{tmp_path}/no/state"
    )


@pytest.mark.unit
def test_what_a_peer_says_is_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    print_result(
        {
            "role": "anchor", "source": "a[/bold].sigmf-meta", "counts": {"[/red]": 1}, "reasons": {"[/bold]": 2},
            "refused": {"[red]x": 3}, "sessions": 1, "sessions_lost": 0, "sent_bytes": 0, "received_bytes": 0,
            "samples_not_finite": 0,
        }
    )  # fmt: skip
    said = capsys.readouterr().out
    for name in ("a[/bold].sigmf-meta", "[/red]", "  [/bold]", "refused: [red]x"):
        assert name in said


@pytest.mark.example
def test_the_example_is_of_options_that_exist() -> None:
    result = CliRunner().invoke(cli, ["peer", "--example"])
    assert result.exit_code == 0
    options = {option for parameter in cli.commands["peer"].params for option in parameter.opts}
    words = result.output.split()
    asked = {word for at, word in enumerate(words) if word.startswith("--")}
    assert asked <= options | {"--example"}
    assert {"--role", "--listen", "--connect", "--key-file"} <= asked
