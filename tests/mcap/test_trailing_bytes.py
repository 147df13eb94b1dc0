"""Bytes behind the end of a file are named: another MCAP file that was appended, zeros, or what nobody knows."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from ml_dash_mcap import Recording

FIRST, SECOND = 10, 7


def file(count: int, **options: bool) -> bytes:
    """A file of the mcap package with so many messages."""
    output = io.BytesIO()
    writer = Writer(output, chunk_size=100, compression=CompressionType.NONE, **options)  # type: ignore[arg-type]
    writer.start("", "tests")
    channel = writer.register_channel("t", "json", writer.register_schema("t", "jsonschema", b"{}"))
    for i in range(count):
        writer.add_message(channel, i, b'{"i":%d}' % i, i)
    writer.finish()
    return output.getvalue()


SUMMARIES = [
    {},
    {"use_statistics": False},
    {"use_chunking": False},
    {"use_summary_offsets": False, "enable_crcs": False},
    {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "use_summary_offsets": False},
]
BEHIND = {
    "another file": (file(SECOND), "a second MCAP file starts at byte {}", None),
    "another file, behind zeros": (bytes(100) + file(SECOND), "a second MCAP file starts at byte {}", None),
    "another file that was cut": (file(SECOND)[:-50], "a second MCAP file starts at byte {}", None),
    "zeros": (bytes(70_000), "zeros", 0),
    "one zero": (b"\0", "zeros", 0),
    "what nobody knows": (b"HTTP/1.1 206 Partial Content\r\n", "what they are is not known", None),
    "part of a magic": (b"\x89MCAP", "what they are is not known", None),
}


@pytest.mark.parametrize("options", SUMMARIES, ids=str)
@pytest.mark.parametrize("behind", BEHIND)
@pytest.mark.parametrize("on_damage", ["raise", "skip"])
def test_bytes_behind_a_files_end_are_a_loss_that_says_what_they_are(
    tmp_path: Path, options: dict[str, bool], behind: str, on_damage: str
) -> None:
    first = file(FIRST, **options)
    more, what, messages = BEHIND[behind]
    at = len(first) + (100 if "behind zeros" in behind else 0)
    path = tmp_path / "a.mcap"
    path.write_bytes(first + more)
    with Recording(path, on_damage=on_damage) as recording:
        [loss] = recording.losses
        assert (loss.offset, loss.messages) == (at if "second" in what else len(first), messages)
        assert f"{len(more)} bytes lie behind the file's end, byte {len(first)}" in loss.what
        assert what.format(at) in loss.what
        assert [row["i"] for row in recording["t"].rows()] == list(range(FIRST))
        assert recording.topics["t"].count == FIRST
        assert recording.finished
        findings = [finding.what for finding in recording.check() if finding.kind in ("damage", "index")]
        assert findings == [f"{path}, byte {loss.offset}: {loss.what}"]


def test_of_a_file_cut_in_its_end_nothing_is_said_to_lie_behind_it(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = file(FIRST)
    for cut in range(1, 37):
        path.write_bytes(whole[:-cut])
        with Recording(path) as recording:
            [loss] = recording.losses
            assert (loss.what, loss.messages) == ("the file's end is damaged; all its data is there", 0)
            assert not recording.finished


def test_a_whole_file_has_nothing_behind_its_end(tmp_path: Path) -> None:
    for number, options in enumerate(SUMMARIES):
        path = tmp_path / f"{number}.mcap"
        path.write_bytes(file(FIRST, **options))
        with Recording(path) as recording:
            assert recording.losses == []
            assert not [finding for finding in recording.check() if finding.kind in ("damage", "index")]
