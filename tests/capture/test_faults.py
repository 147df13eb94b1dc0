"""A disk that fails at any call, for a moment or for good: no row is lost or written twice, files are clean."""

from __future__ import annotations

import errno
import itertools
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.capture import writer
from ml_dash_mcap.errors import StorageError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.faulty_os import calls_go_through, fails
from tests.support import disk
from tests.workload import KINDS, OPTIONS, actions, lost_or_twice

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="calls are told apart through /proc")

SMALL = {"segment_bytes": 65536, "sync_interval_s": 0.01}
"""So that a short recording has segments, syncs and all the rest."""


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Close gives a disk that refuses 0.3 s, and a first retry comes after 5 ms."""
    monkeypatch.setattr(writer, "_CLOSE_PATIENCE_S", 0.3)
    monkeypatch.setattr(writer, "_FIRST_RETRY_S", 0.005)


def record(folder: Path, seed: int, plan: Any, until: int = 1200) -> tuple[dict[str, int], int, StorageError | None]:
    """Record, flush now and then, and close; returns what was accepted, the calls made and close's error."""
    counts = dict.fromkeys(KINDS, 0)
    failure = None
    with calls_go_through(folder, plan) as calls:
        recorder = Recorder(folder, RecorderOptions(**{**OPTIONS, **SMALL}))
        for done, (kind, number) in enumerate(itertools.islice(actions(recorder, seed), until)):
            counts[kind] = number
            if done % 400 == 399:
                try:
                    recorder.flush()
                except StorageError:
                    pass  # it says so, and goes on trying
        try:
            recorder.close()
        except StorageError as error:
            failure = error
        return counts, calls.count, failure


def through_every_call(tmp_path: Path, faulty: Callable[[int], Any], step: int = 1) -> list[str]:
    """Record again and again, the fault one call later each time, until there are no more calls."""
    wrong = []
    for number in itertools.count(1, step):
        folder = tmp_path / str(number)
        folder.mkdir()
        counts, made, failure = record(folder, number, faulty(number))
        if failure is None and list(folder.glob("*.active")):
            wrong.append(f"call {number}: a segment stays unfinished")
        wrong += [f"call {number}: {one}" for one in lost_or_twice(folder, counts, in_flight=0)]
        if made < number:
            assert number > 15
            return wrong
    raise AssertionError("unreachable")


@pytest.mark.parametrize("halfway", [False, True], ids=["at once", "halfway"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO], ids=["no space", "input/output error"])
def test_one_failure_at_any_call_is_survived(tmp_path: Path, code: int, halfway: bool) -> None:
    def faulty(number: int) -> Any:
        return fails(lambda current, name: current == number, code, halfway=halfway)

    assert through_every_call(tmp_path, faulty) == []


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO], ids=["no space", "input/output error"])
def test_a_row_of_failures_from_any_call_on_is_survived(tmp_path: Path, code: int) -> None:
    def faulty(number: int) -> Any:
        return fails(lambda current, name: number <= current < number + 4, code, halfway=True)

    assert through_every_call(tmp_path, faulty, step=3) == []


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO], ids=["no space", "input/output error"])
def test_a_disk_that_fails_for_good_leaves_a_journal_that_the_next_one_recovers(tmp_path: Path, code: int) -> None:
    wrong, number, made = [], -2, 10**9
    while made > number:
        number += 3
        folder = tmp_path / str(number)
        folder.mkdir()
        plan = fails(lambda current, name, first=number: current >= first and name != "unlink", code, halfway=True)
        counts, made, failure = record(folder, number, plan, until=900)
        if made >= number and failure is None and list(folder.glob("*.active")):
            wrong.append(f"from call {number} on: close said nothing")
        wrong += [f"from call {number} on: {one}" for one in lost_or_twice(folder, counts, in_flight=0)]
    assert wrong == []


def test_a_disk_with_errors_does_not_eat_up_files_and_descriptors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "_CLOSE_PATIENCE_S", 1.3)
    broken = threading.Event()
    chunks = fails(lambda number, name: broken.is_set() and name == "writev" and number % 3 == 0, errno.EIO)
    with calls_go_through(tmp_path, chunks):
        recorder = Recorder(tmp_path, RecorderOptions(**OPTIONS))
        recorder.topic("a").append(x=1, _ts=0.0)
        recorder.flush()
        broken.set()
        recorder.topic("a").append(x=1, _ts=1.0)
        try:
            recorder.close()
        except StorageError:
            pass
    assert len(disk.segments(tmp_path)) + len(list(tmp_path.glob("*.active"))) < 20


def test_close_does_not_keep_a_processor_busy_while_it_waits_for_a_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "_CLOSE_PATIENCE_S", 1.3)
    tries = []
    with calls_go_through(tmp_path, fails(lambda number, name: bool(tries.append(number) or True), errno.ENOSPC)):
        recorder = Recorder(tmp_path, RecorderOptions(**OPTIONS))
        recorder.topic("a").append(x=1, _ts=1.0)
        with pytest.raises(StorageError):
            recorder.close()
    assert len(tries) < 100


@pytest.mark.parametrize("call", ["fsync", "fdatasync"])
def test_a_failing_sync_is_not_asked_twice_but_the_recording_goes_on_in_a_new_segment(
    tmp_path: Path, call: str
) -> None:
    failed: set[str] = set()

    def plan(number: int, name: str, do: Callable[[], Any]) -> Any:
        if name == call and not failed:
            failed.add(name)
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return do()

    with calls_go_through(tmp_path, plan):
        recorder = Recorder(tmp_path, RecorderOptions(flush_interval_s=0.01, sync_interval_s=0.01))
        topic = recorder.topic("a")
        for number in range(100):
            topic.append(n=number, _ts=float(number))
            if number % 10 == 0:
                recorder.flush()
        recorder.close()
    with Recording(tmp_path) as recording:
        assert [row["n"] for row in recording["a"].rows()] == list(range(100))
    assert list(tmp_path.glob("*.active")) == []


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO], ids=["no space", "input/output error"])
def test_a_sync_that_fails_when_a_segment_is_finished_does_not_give_it_two_ends(tmp_path: Path, code: int) -> None:
    plan = fails(lambda number, name: name == "fdatasync", code)
    with calls_go_through(tmp_path, plan):
        recorder = Recorder(tmp_path, RecorderOptions(sync_interval_s=1e3))
        recorder.topic("a").append(x=1, _ts=0.0)
        try:
            recorder.close()
        except StorageError:
            pass
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"x": 1, "_ts": 0.0}]


def test_flush_says_that_nothing_can_be_written_and_the_next_flush_that_it_can_again(tmp_path: Path) -> None:
    broken = threading.Event()
    broken.set()
    with calls_go_through(tmp_path, fails(lambda number, name: broken.is_set() and name == "writev", errno.ENOSPC)):
        recorder = Recorder(tmp_path)
        recorder.topic("a").append(x=1, _ts=0.0)
        with pytest.raises(StorageError, match="No space left"):
            recorder.flush()
        assert "No space left" in recorder.stats()["failure"]
        broken.clear()
        while recorder.stats()["failure"] is not None:
            pass
        recorder.flush()
        assert recorder.stats()["written"] == 1
        recorder.close()
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 0.0}]}


def test_a_schema_that_is_rewritten_half_does_not_stay_half_written(tmp_path: Path) -> None:
    with calls_go_through(
        tmp_path, fails(lambda number, name: name == "pwrite" and number < 30, errno.EIO, halfway=True)
    ):
        recorder = Recorder(tmp_path)
        topic = recorder.topic("a")
        topic.append(x=1, _ts=0.0)
        recorder.flush()
        topic.append(x=0.5, y="text", _ts=1.0)
        recorder.close()
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"x": 1, "_ts": 0.0}, {"x": 0.5, "y": "text", "_ts": 1.0}]


def test_a_write_that_the_system_cuts_short_is_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = os.writev
    monkeypatch.setattr(
        os, "writev", lambda fd, pieces: os.write(fd, bytes(pieces[0])[:7]) if len(pieces[0]) else whole(fd, pieces)
    )
    cut = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, at: cut(fd, bytes(data)[:5], at))
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(x=1, _ts=0.0)
        recorder.flush()
        recorder.topic("a").append(x=0.5, _ts=1.0)
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 0.0}, {"x": 0.5, "_ts": 1.0}]}


def test_what_close_could_not_write_is_recovered_by_a_recorder_in_the_same_process(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path)
    with calls_go_through(tmp_path, fails(lambda number, name: name in ("writev", "open"), errno.EIO)):
        recorder.topic("a").append(x=1, _ts=0.0)
        with pytest.raises(StorageError):
            recorder.close()
    recorder.close()
    with Recorder(tmp_path) as again:
        again.topic("a").append(x=2, _ts=1.0)
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 0.0}, {"x": 2, "_ts": 1.0}]}


def test_a_row_that_the_writer_cannot_handle_does_not_make_the_folder_unusable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ml_dash_mcap.capture import segment_sink

    broken = Recorder(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(segment_sink, "split", lambda *_: 1 / 0)
        broken.topic("a").append(x=1, _ts=0.0)
        with pytest.raises(StorageError):
            broken.close()
        with Recorder(tmp_path) as recorder:  # what was left behind cannot be recovered yet, but this must not fail
            del recorder
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"x": 1, "_ts": 0.0}]
