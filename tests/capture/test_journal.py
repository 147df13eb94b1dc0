"""The journal: MCAP files without an end, in memory where there is some, never with a ghost in them, gone at close."""

from __future__ import annotations

import errno
import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.capture import journal_files as place
from ml_dash_mcap.errors import StorageError, TopicError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.store import session_lock
from tests.support import disk
from tests.support.records import MAGIC, PREFIX_BYTES, Opcode

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a mapped file cannot be read there")

QUIET = {"chunk_bytes": 65536, "backlog_bytes": 4 * 65536, "flush_interval_s": 3600.0, "sync_interval_s": 0.0}


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    """A folder for the buffers."""
    (tmp_path / "journal").mkdir()
    return tmp_path / "journal"


@pytest.fixture
def recorder(tmp_path: Path, journal: Path) -> Iterator[Recorder]:
    with Recorder(tmp_path / "run", RecorderOptions(**QUIET, journal_dir=str(journal))) as one:
        yield one


def buffers(folder: Path) -> list[bytes]:
    return [path.read_bytes() for path in sorted(folder.glob(".ml_dash-*.journal"))]


def walk(data: bytes) -> tuple[list[tuple[int, bytes]], int]:
    """Opcode and content of each record up to the first byte that begins none, and where that is."""
    assert data.startswith(MAGIC)
    found, at = [], len(MAGIC)
    while data[at]:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, data[at + PREFIX_BYTES : at + PREFIX_BYTES + length]))
        at += PREFIX_BYTES + length
    return found, at


def test_a_buffer_is_an_mcap_file_without_an_end(recorder: Recorder, journal: Path) -> None:
    recorder.topic("a").append(x=1, _ts=1.0)
    recorder.set_parameters({"p": 1})
    recorder.topic("b").append(x=2, _ts=2.0)
    (used,) = [data for data in buffers(journal) if data[0]]
    found, end = walk(used)
    assert [Opcode(opcode).name for opcode, _ in found] == [
        "HEADER",
        "METADATA",
        "SCHEMA",
        "CHANNEL",
        "MESSAGE",
        "METADATA",
        "SCHEMA",
        "CHANNEL",
        "MESSAGE",
    ]
    messages = [content for opcode, content in found if opcode == Opcode.MESSAGE]
    assert [(struct.unpack_from("<H", one)[0], one[22:]) for one in messages] == [
        (1, b'{"x":1,"_ts":1.0}'),
        (2, b'{"x":2,"_ts":2.0}'),
    ]
    assert set(used[end:]) == {0}


def test_every_buffer_begins_with_all_topics(recorder: Recorder, journal: Path) -> None:
    for number in range(10):
        recorder.topic(f"t{number}").append(x=number, _ts=1.0)
    recorder.flush()
    recorder.topic("t3").append(x=1, _ts=2.0)
    (used,) = [data for data in buffers(journal) if data[0]]
    kinds = [Opcode(opcode).name for opcode, _ in walk(used)[0]]
    assert kinds == ["HEADER", "METADATA", *["SCHEMA", "CHANNEL"] * 10, "MESSAGE"]


def test_nothing_of_an_earlier_use_is_left_in_a_buffer(recorder: Recorder, journal: Path) -> None:
    for number in range(3000):
        recorder.topic("a").append(n=number, fill="x" * 300, _ts=float(number))
    recorder.flush()
    used = [data for data in buffers(journal) if any(data)]
    assert len(used) == 1
    found, end = walk(used[0])
    assert [Opcode(opcode).name for opcode, _ in found] == ["HEADER", "METADATA", "SCHEMA", "CHANNEL"]
    assert not any(used[0][end:])


def test_a_buffer_that_is_full_to_the_last_byte_still_ends_with_a_zero(recorder: Recorder, journal: Path) -> None:
    topic = recorder.topic("a").append(fill="", _ts=1.0)
    empty = len(b'{"fill":"","_ts":1.0}') + PREFIX_BYTES + 22
    (used,) = [data for data in buffers(journal) if data[0]]
    room = len(used) - 1 - walk(used)[1]
    assert room > empty
    topic.append(fill="x" * (room - empty), _ts=2.0)
    (used,) = [data for data in buffers(journal) if data[0]]
    assert used[-2:] == b"}\0"
    topic.append(fill="", _ts=3.0)
    recorder.close()
    assert [row["_ts"] for row in disk.rows(recorder.path)["a"]] == [1.0, 2.0, 3.0]


def test_closing_takes_the_buffers_and_the_session_file_away(recorder: Recorder, journal: Path) -> None:
    recorder.topic("a").append(fill="x" * 100_000, _ts=1.0)
    assert len(list(journal.iterdir())) >= 4
    recorder.close()
    assert list(journal.iterdir()) == []
    assert list(recorder.path.iterdir()) == disk.segments(recorder.path)


def test_without_shared_memory_the_buffers_lie_in_the_runs_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place, "_SHARED_MEMORY", tmp_path / "missing")
    with Recorder(tmp_path / "run", RecorderOptions(**QUIET)) as recorder:
        recorder.topic("a").append(x=1, _ts=1.0)
        assert len(list((tmp_path / "run").glob(".ml_dash-*.journal"))) == 4
    assert list((tmp_path / "run").iterdir()) == disk.segments(tmp_path / "run")
    assert disk.rows(tmp_path / "run") == {"a": [{"x": 1, "_ts": 1.0}]}


@pytest.fixture
def small_memory(tmp_path: Path) -> Iterator[Path]:
    """Shared memory of 512 KiB, as containers have it, only smaller."""
    memory = tmp_path / "memory"
    memory.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(memory)], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"no small file system can be mounted here: {mounted.stderr.decode().strip()}")
    try:
        yield memory
    finally:
        subprocess.run(["umount", str(memory)], check=True)


def test_shared_memory_without_room_is_left_for_the_runs_folder(
    tmp_path: Path, small_memory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place, "_SHARED_MEMORY", small_memory)
    with Recorder(tmp_path / "run", RecorderOptions(chunk_bytes=65536, backlog_bytes=1 << 20)) as recorder:
        assert list(small_memory.iterdir()) == []
        assert len(list((tmp_path / "run").glob(".ml_dash-*.journal"))) == 16
        recorder.topic("a").append(x=1, _ts=1.0)
    assert disk.rows(tmp_path / "run") == {"a": [{"x": 1, "_ts": 1.0}]}


def test_no_room_for_the_backlog_is_an_error_at_start_that_leaves_nothing_behind(
    tmp_path: Path, small_memory: Path
) -> None:
    with pytest.raises(StorageError, match="backlog_bytes=") as caught:
        Recorder(
            tmp_path / "run", RecorderOptions(chunk_bytes=65536, backlog_bytes=1 << 20, journal_dir=str(small_memory))
        )
    assert isinstance(caught.value, OSError)
    assert list(small_memory.iterdir()) + list((tmp_path / "run").iterdir()) == []


@pytest.mark.parametrize("journal_dir", [None, "here"])
def test_a_backlog_that_nothing_holds_is_an_error_before_any_of_it_is_reserved(
    tmp_path: Path, journal_dir: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reserving what there is of it took all shared memory of the machine, and the process was killed."""
    reserved: list[object] = []
    monkeypatch.setattr(place, "Buffer", lambda *given, **more: reserved.append(given))
    (tmp_path / "here").mkdir()
    options = RecorderOptions(backlog_bytes=10**15, journal_dir=journal_dir and tmp_path / journal_dir)
    with pytest.raises(StorageError, match=r"no room for a backlog of 10{15} bytes.*backlog_bytes="):
        Recorder(tmp_path / "run", options)
    assert reserved == []
    assert list((tmp_path / "run").iterdir()) + list((tmp_path / "here").iterdir()) == []


def test_no_room_for_a_large_row_costs_that_row_only(tmp_path: Path, small_memory: Path) -> None:
    options = RecorderOptions(chunk_bytes=65536, backlog_bytes=6 * 65536, journal_dir=str(small_memory))
    with Recorder(tmp_path / "run", options) as recorder:
        topic = recorder.topic("a").append(n=1, _ts=1.0)
        with pytest.raises(StorageError, match="'a'"):
            topic.append(n=2, fill="x" * 300_000, _ts=2.0)
        topic.append(n=3, _ts=3.0)
    stats = recorder.stats()
    assert stats["accepted"] == stats["written"] + stats["waiting"] + stats["dropped"]
    assert disk.rows(tmp_path / "run") == {"a": [{"n": 1, "_ts": 1.0}, {"n": 3, "_ts": 3.0}]}


@pytest.mark.parametrize("where", ["missing", "file"])
def test_a_place_for_the_journal_that_is_no_folder_is_an_error_at_start(tmp_path: Path, where: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="journal_dir="):
        Recorder(tmp_path / "run", RecorderOptions(journal_dir=str(tmp_path / where)))
    assert list((tmp_path / "run").iterdir()) == []


def test_a_session_file_that_cannot_be_written_leaves_no_buffers_behind(
    tmp_path: Path, journal: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(session_lock.SessionLock, "write", no_room)
    with pytest.raises(StorageError):
        Recorder(tmp_path / "run", RecorderOptions(**QUIET, journal_dir=str(journal)))
    assert list(journal.iterdir()) + list((tmp_path / "run").iterdir()) == []


def test_a_relative_place_for_the_journal_is_found_from_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "journal").mkdir()
    monkeypatch.chdir(tmp_path)
    code = (
        "import os, sys; from ml_dash_mcap.recorder import Recorder; from ml_dash_mcap.options import RecorderOptions\n"
        "r = Recorder('run', RecorderOptions(journal_dir='journal'))\n"
        "r.topic('a').append(x=1, _ts=1.0); os._exit(0)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
    monkeypatch.chdir("/")
    Recorder(tmp_path / "run").close()
    assert disk.rows(tmp_path / "run") == {"a": [{"x": 1, "_ts": 1.0}]}
    assert list((tmp_path / "journal").iterdir()) == []


def test_a_topic_that_is_refused_is_not_in_the_journal_either(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(**QUIET)) as recorder:
        with pytest.raises(TopicError):
            recorder.topic("a", description="x" * 40_000)
        recorder.topic("a").append(x=1, _ts=1.0)
        recorder.topic("b").append(x=2, _ts=1.0)
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 1.0}], "b": [{"x": 2, "_ts": 1.0}]}


def test_only_the_owner_may_read_the_journal(recorder: Recorder, journal: Path) -> None:
    assert {path.stat().st_mode & 0o777 for path in journal.iterdir()} == {0o600}
