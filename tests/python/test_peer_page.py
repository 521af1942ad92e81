"""The page of the peers' protocol says what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from soopnav_cpp.peer import frames, messages, snippets

PAGE = Path(__file__).parents[2] / "docs" / "peer_protocol.md"

pytestmark = pytest.mark.example


def test_messages_and_frames_are_those_of_the_code() -> None:
    text = PAGE.read_text(encoding="utf-8")
    listed = {int(number): name for number, name in re.findall(r"^\| (\d+) \| `([A-Z]+)` \|", text, re.MULTILINE)}
    assert listed == {int(kind): kind.name for kind in messages.Kind}
    sizes = re.findall(r"^\| (?:marker|version|kind|length|sequence|check|tag|crc) \| (\d+) \|", text, re.MULTILINE)
    assert sum(map(int, sizes)) == frames.OVERHEAD
    assert len(sizes) == 8
    assert f"at most {frames.MAX_BODY:,}".replace(",", " ") in text


def test_bandwidth_table_is_that_of_the_code() -> None:
    rows = re.findall(r"^\| [\d.]+ ms \((\d+)[^|]*\| ([\d.]+)[^|]*\| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$",
                      PAGE.read_text(encoding="utf-8"), re.MULTILINE)  # fmt: skip
    assert len(rows) == 4
    for count, *kilobits in rows:
        for bits, said in enumerate(kilobits, start=1):
            assert float(said) == pytest.approx(8e-3 * snippets.snippet_bytes(int(count), bits), abs=0.06)


def test_two_machines_are_not_told_to_listen_to_themselves() -> None:
    """A port alone listens on this machine alone."""
    from soopnav_cpp.cli.app import cli

    page = PAGE.read_text(encoding="utf-8")
    assert "`:PORT` (this machine alone)" in page
    for text in (page[: page.index("## ")], cli.help or ""):
        listening = re.findall(r"--listen (\S+)", text)
        assert listening
        assert not any(address.startswith(":") for address in listening)


def test_bits_by_snr_are_those_of_the_code() -> None:
    page = PAGE.read_text(encoding="utf-8")
    said = re.search(r"takes (\d) bits up to (\d+) dB, (\d) up to (\d+) dB and (\d) above", page)
    assert said is not None
    few, low, more, high, most = map(int, said.groups())
    assert [snippets.bits_for(db) for db in (low, low + 0.1, high, high + 0.1)] == [few, more, more, most]
