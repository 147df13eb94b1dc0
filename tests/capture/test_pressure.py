"""A disk that stands still: the backlog fills, and `on_full` says what becomes of the next row."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.errors import BacklogFullError, FieldError

SMALL = {"chunk_bytes": 65_536, "backlog_bytes": 262_144, "compression": "none", "flush_interval_s": 60.0}
ROW = "x" * 1000


@contextmanager
def disk_stands_still(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Block every write of a chunk, where the recorder hands it to the system, until the event is set."""
    moves, whole = threading.Event(), os.writev

    def writev(descriptor: int, pieces: list[memoryview]) -> int:
        if sum(map(len, pieces)) > 10_000:
            moves.wait(30)
        return whole(descriptor, pieces)

    monkeypatch.setattr(os, "writev", writev)
    try:
        yield moves
    finally:
        moves.set()


def test_drop_refuses_the_newest_rows_counts_them_and_writes_the_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with disk_stands_still(monkeypatch) as moves:
        recorder = Recorder(tmp_path, RecorderOptions(on_full="drop", **SMALL))
        for i in range(600):
            recorder.topic("a").append(i=i, text=ROW, _ts=i * 1.0)
        stats = recorder.stats()
        moves.set()
        recorder.close()
    assert stats["accepted"] == 600
    assert stats["dropped_by_topic"] == {"a": stats["dropped"]}
    assert 200 < stats["waiting"] + stats["written"] == 600 - stats["dropped"] < 300
    with Recording(tmp_path) as recording:
        assert [row["i"] for row in recording["a"].rows()] == list(range(600 - stats["dropped"]))
        assert dict(recording.metadata)["ml_dash.drops"] == {"a": str(stats["dropped"])}


def test_raise_says_so_and_loses_only_the_row_it_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with disk_stands_still(monkeypatch) as moves:
        recorder = Recorder(tmp_path, RecorderOptions(on_full="raise", **SMALL))
        taken = 0
        with pytest.raises(BacklogFullError, match="'a'"):  # noqa: PT012 - which of them it is, the test finds out
            for i in range(600):
                recorder.topic("a").append(i=i, text=ROW, _ts=i * 1.0)
                taken += 1
        moves.set()
        recorder.flush()
        recorder.topic("a").append(i=-1, text="", _ts=1e3)
        recorder.close()
    with Recording(tmp_path) as recording:
        assert [row["i"] for row in recording["a"].rows()] == [*range(taken), -1]


def test_block_waits_for_the_disk_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with disk_stands_still(monkeypatch) as moves:
        recorder = Recorder(tmp_path, RecorderOptions(on_full="block", **SMALL))
        appended = [0]

        def append() -> None:
            for i in range(600):
                recorder.topic("a").append(i=i, text=ROW, _ts=i * 1.0)
                appended[0] = i + 1

        thread = threading.Thread(target=append)
        thread.start()
        thread.join(1.0)
        held_at, is_held = appended[0], thread.is_alive()
        moves.set()
        thread.join(30)
        recorder.close()
    assert is_held
    assert 200 < held_at < 300
    with Recording(tmp_path) as recording:
        assert [row["i"] for row in recording["a"].rows()] == list(range(600))


def test_a_row_larger_than_a_buffer_is_stored_and_one_larger_than_the_backlog_is_refused(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(**SMALL)) as recorder:
        recorder.topic("a").append(text="before", _ts=0.0)
        recorder.topic("a").append(text="y" * 150_000, _ts=1.0)
        with pytest.raises(FieldError, match="backlog_bytes"):
            recorder.topic("a").append(text="z" * 300_000, _ts=2.0)
        recorder.topic("a").append(text="after", _ts=3.0)
    with Recording(tmp_path) as recording:
        assert [row["text"][:6] for row in recording["a"].rows()] == ["before", "yyyyyy", "after"]


@pytest.mark.parametrize(
    "options",
    [{"segment_bytes": 65_536}, {"segment_duration_s": 1e-9}],
    ids=["by size", "by duration"],
)
def test_segments_are_split_and_read_as_one(tmp_path: Path, options: dict[str, float]) -> None:
    with Recorder(tmp_path, RecorderOptions(**SMALL, **options)) as recorder:
        recorder.set_parameters({"robot": "franka"})
        for i in range(300):
            recorder.topic("a").append(i=i, text=ROW, _ts=i * 1.0)
    assert len(list(tmp_path.glob("*.mcap"))) > 3
    with Recording(tmp_path) as recording:
        assert [row["i"] for row in recording["a"].rows()] == list(range(300))
        assert recording.params == {"robot": "franka"}


def test_a_schema_that_outgrows_its_place_begins_a_new_segment(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(**SMALL)) as recorder:
        for i in range(200):
            recorder.topic("a").append(**{f"field_{i}": i}, _ts=i * 1.0)
            recorder.flush()
    segments = sorted(tmp_path.glob("*.mcap"))
    assert 1 < len(segments) < 12
    with Recording(tmp_path) as recording:
        assert [row[f"field_{i}"] for i, row in enumerate(recording["a"].rows())] == list(range(200))
        assert {f"field_{i}" for i in range(200)} <= set(recording.topics["a"].fields)


def test_without_room_in_shared_memory_the_journal_lies_beside_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ml_dash_mcap.capture.journal_files._SHARED_MEMORY", tmp_path / "not there")
    with Recorder(tmp_path / "run", RecorderOptions(**SMALL)) as recorder:
        recorder.topic("a").append(i=1, _ts=0.0)
        assert len(list((tmp_path / "run").glob(".ml_dash-*.journal"))) == 4
    assert [path.suffix for path in (tmp_path / "run").iterdir()] == [".mcap"]
