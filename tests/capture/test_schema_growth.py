"""Schemas that grow while rows are appended: whatever comes between loses no row and no field."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.capture.journal import Journal
from ml_dash_mcap.errors import BacklogFullError, StorageError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.recovery.unfinished_segments import finish
from tests.capture.test_backpressure import a_disk_that_stands_still, is_sound
from tests.interruptions import at_every_point, within
from tests.support import disk
from tests.zygote import Zygote

Row = dict[str, Any]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the children are forked")

SMALL: dict[str, Any] = {
    "encoding": "protobuf",
    "chunk_bytes": 65536,
    "backlog_bytes": 16 * 65536,
    "flush_interval_s": 3600.0,
    "sync_interval_s": 0.0,
}


@pytest.fixture(scope="module")
def zygote() -> Iterator[Zygote]:
    with Zygote() as one:
        yield one


def read(folder: Path) -> dict[str, list[Row]]:
    """Return the rows of each topic, on which our reader and google's agree."""
    with Recording(folder) as recording:
        rows = {topic: list(recording[topic].rows()) for topic in recording}
    others = {topic: sorted(found, key=lambda row: row["_ts"]) for topic, found in disk.rows(folder).items()}
    assert {topic: found for topic, found in others.items() if not topic.startswith("ml_dash/")} == rows
    return rows


class Growing:
    """Appends rows of which each has a field of its own, or a type of its own."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self.numbers = itertools.count()
        self.taken: dict[str, list[Row]] = {}

    def append(self, topic: str, **fields: Any) -> None:
        number = next(self.numbers)
        row = {f"f{number}": number, "grows": [1, 1.5, "a", True][number % 4], **fields, "_ts": float(number)}
        self.recorder.topic(topic).append(**row)
        self.taken.setdefault(topic, []).append(row)

    def expected(self) -> dict[str, list[Row]]:
        return {topic: sorted(rows, key=lambda row: row["_ts"]) for topic, rows in self.taken.items()}


HANDLERS: dict[str, Callable[[Growing], None]] = {
    "a row of the same topic": lambda rows: rows.append("main"),
    "a row of another topic": lambda rows: rows.append("other"),
    "a new topic": lambda rows: rows.append(f"new{next(rows.numbers)}"),
    "rows that fill a buffer": lambda rows: [rows.append("main", fill="x" * 20_000) for _ in range(4)],
}


@pytest.mark.parametrize("handler", HANDLERS)
def test_a_handler_may_append_at_every_point_of_a_growth(tmp_path: Path, handler: str) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(**SMALL))
    rows = Growing(recorder)
    rows.append("main")
    rows.append("other")
    points = []

    def handle() -> None:
        with contextlib.suppress(BacklogFullError):  # inside of one who waits for room it cannot wait
            HANDLERS[handler](rows)

    def through() -> None:
        # Each further row begins at a later point; the layout of one topic grows two hundred times only.
        for interruption in at_every_point(lambda: rows.append("main"), handle):
            points.append(interruption.where)
            if interruption.number % 20 == 0:
                recorder.flush()
            if interruption.number > 150:
                break
        sys.setprofile(None)

    within(40, through, recorder._finalizer.detach)
    recorder.close()
    assert read(tmp_path) == rows.expected()
    assert len(points) > 50


def test_ctrl_c_at_every_point_of_a_growth_loses_no_row_that_was_taken(tmp_path: Path) -> None:
    class CtrlC(BaseException):
        pass

    def interrupt() -> None:
        raise CtrlC

    recorder = Recorder(tmp_path, RecorderOptions(**SMALL))
    rows = Growing(recorder)

    def act() -> None:
        with contextlib.suppress(CtrlC):
            rows.append("main")

    def through() -> None:
        for interruption in at_every_point(act, interrupt):
            rows.append("main")
            if interruption.number > 90:
                break
        sys.setprofile(None)

    within(40, through, recorder._finalizer.detach)
    recorder.close()
    found = read(tmp_path)["main"]
    assert [row for row in rows.expected()["main"] if row not in found] == []


# -- what children of the zygote do ------------------------------------------------------------------------------------


def die_at_growth(folder: str, number: int, moment: str) -> None:
    """Append rows, and be killed at one of the growths: before the journal has the schema, after, or in the middle."""
    redefine, put_gap, count = Journal.redefine, Journal._put_gap, itertools.count(1)

    def die() -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def dying(journal: Journal, topic: int, schema: bytes) -> bool:
        is_last = next(count) == number
        if is_last and moment == "before":
            die()
        if is_last and moment == "in the middle of":
            Journal._put_gap = lambda *args, **more: die()  # type: ignore[method-assign,assignment]
        taken = redefine(journal, topic, schema)
        if is_last:
            die()
        return taken

    Journal.redefine = dying  # type: ignore[method-assign]
    try:
        append_some(folder)
    finally:
        Journal.redefine, Journal._put_gap = redefine, put_gap  # type: ignore[method-assign]


def append_some(folder: str) -> None:
    recorder = Recorder(folder, RecorderOptions(**SMALL))
    with (Path(folder).parent / "taken").open("ab", buffering=0) as said:
        for at, row in enumerate(some_rows()):
            recorder.topic("t").append(**row)
            said.write(b".")
            if at == 10:
                recorder.flush()


def some_rows() -> list[Row]:
    rows: list[Row] = []
    for number in range(30):
        row = {"q": [number / 7, 0.5], "n": number, "late": {"x": number, f"y{number // 6}": [number]}}
        row["wide"] = number if number < 8 else number + 0.5 if number < 16 else f"{number}"
        rows.append({**row, "_ts": float(number)})
    return rows


@pytest.mark.parametrize("moment", ["before", "in the middle of", "after"])
def test_death_at_any_growth_loses_no_row_that_was_taken(zygote: Zygote, tmp_path: Path, moment: str) -> None:
    number, ended = 0, -signal.SIGKILL
    while ended == -signal.SIGKILL:
        number += 1
        folder = tmp_path / str(number) / "run"
        folder.mkdir(parents=True)
        ended = zygote.run("tests.capture.test_schema_growth:die_at_growth", str(folder), number, moment)
        taken = len((folder.parent / "taken").read_bytes())
        if taken:
            assert read(folder) == {"t": some_rows()[:taken]}, number
    assert ended == 0
    assert number > 5


def grow_in_threads(folder: str) -> None:
    """Let two threads widen the same topics at once, and die."""
    recorder = Recorder(folder, RecorderOptions(**{**SMALL, "flush_interval_s": 0.01}))

    def work(first: int) -> None:
        for number in range(first, first + 80):
            recorder.topic("both").append(**thread_row(first, number))
            recorder.topic(f"own{first}").append(**thread_row(first, number))

    threads = [threading.Thread(target=work, args=(first,)) for first in (0, 1000)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    os.kill(os.getpid(), signal.SIGKILL)


def thread_row(first: int, number: int) -> Row:
    shared = number % 1000
    row = {f"shared{shared}": shared, "wide": [1, 0.5, "a", [1, 2]][shared % 4], f"of{first}": {f"k{shared}": shared}}
    return {**row, "_ts": float(number)}


@pytest.mark.parametrize("run", range(3))
def test_two_threads_that_widen_one_topic_lose_nothing_when_they_are_killed(
    zygote: Zygote, tmp_path: Path, run: int
) -> None:
    folder = tmp_path / "run"
    assert zygote.run("tests.capture.test_schema_growth:grow_in_threads", str(folder)) == -signal.SIGKILL
    low, high = ([thread_row(first, number) for number in range(first, first + 80)] for first in (0, 1000))
    assert read(folder) == {"both": low + high, "own0": low, "own1000": high}


# -- no room -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("on_full", ["drop", "raise"])
def test_a_row_with_new_fields_never_waits_for_a_full_journal(tmp_path: Path, on_full: str) -> None:
    options = RecorderOptions(**{**SMALL, "backlog_bytes": 3 * 65536, "on_full": on_full})
    recorder = Recorder(tmp_path, options)
    taken: list[Row] = []

    def produce() -> None:
        for number in range(60):
            row = {f"f{number}": number, "fill": "x" * 20_000, "_ts": float(number)}
            with contextlib.suppress(BacklogFullError, StorageError):
                recorder.topic("a").append(**row)
                taken.append(row)

    with a_disk_that_stands_still(tmp_path):
        within(20, produce, recorder._finalizer.detach)
        stats = recorder.stats()
        assert is_sound(stats)
        assert stats["dropped"] >= 40
    recorder.topic("a").append(late=1.5, _ts=100.0)
    recorder.close()
    rows = {row["_ts"]: row for row in taken}
    found = read(tmp_path)["a"]
    assert len(found) == 60 - stats["dropped"] + 1
    assert [row for row in found[:-1] if row != rows[row["_ts"]]] == []
    assert found[-1] == {"late": 1.5, "_ts": 100.0}


def test_a_row_with_new_fields_waits_for_a_full_journal_if_it_is_told_to(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(**{**SMALL, "backlog_bytes": 3 * 65536}))
    rows = [{f"f{number}": number, "fill": "x" * 20_000, "_ts": float(number)} for number in range(60)]
    with a_disk_that_stands_still(tmp_path) as go_on:
        thread = threading.Thread(target=lambda: [recorder.topic("a").append(**row) for row in rows])
        thread.start()
        thread.join(0.3)
        assert thread.is_alive()
        go_on()
        thread.join()
    recorder.close()
    assert read(tmp_path) == {"a": rows}


@pytest.mark.parametrize("name_bytes", [1, 50, 97, 300])
def test_a_layout_that_no_chunk_could_hold_stops_growing_and_loses_nothing(tmp_path: Path, name_bytes: int) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(**SMALL))
    rows = [
        {f"{'k' * name_bytes}{number}_{at}": number + at / 8 for at in range(15)} | {"_ts": float(number)}
        for number in range(150)
    ]

    def produce() -> None:
        for row in rows:
            recorder.topic("a").append(**row)
        recorder.close()

    within(60, produce, recorder._finalizer.detach)
    assert read(tmp_path) == {"a": rows}


def test_topics_that_grow_leave_room_for_more_topics(tmp_path: Path) -> None:
    rows = {f"t{number}": [{"q": [number / 7], f"f{number}": {"x": number}, "_ts": 1.0}] for number in range(90)}
    with Recorder(tmp_path, RecorderOptions(**SMALL)) as recorder:
        for topic, (row,) in rows.items():
            recorder.topic(topic).append(**row)
    assert read(tmp_path) == rows


def test_a_row_that_fitted_before_the_topics_grew_goes_into_a_buffer_of_its_own(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(**SMALL))
    recorder.topic("a").append(x=1, _ts=0.0)
    journal = recorder._journal
    real = journal._fits_no_buffer
    journal._fits_no_buffer = lambda size: False  # type: ignore[method-assign]  # as if it had been asked before
    within(20, lambda: recorder.topic("a").append(x="y" * 65_300, _ts=1.0), recorder._finalizer.detach)
    within(
        20,
        lambda: recorder.topic("a").append_columns(_ts=[2.0, 3.0], x=["y" * 65_400, "z"]),
        recorder._finalizer.detach,
    )
    journal._fits_no_buffer = real  # type: ignore[method-assign]
    recorder.close()
    assert [len(str(row["x"])) for row in read(tmp_path)["a"]] == [1, 65_300, 65_400, 1]


# -- a schema that was torn while it was widened in place --------------------------------------------------------------


class Grown:
    """A segment as it lay before and after its schema was widened in place."""

    rows = ({"q": 1.5, "_ts": 1.0}, {"q": 2.5, "late": [1, 2], "_ts": 2.0}, {"q": 3.5, "later": {"x": "a"}, "_ts": 3.0})

    def __init__(self, folder: Path) -> None:
        states: list[bytes] = []
        with Recorder(folder, RecorderOptions(encoding="protobuf")) as recorder:
            for row in self.rows:
                recorder.topic("t").append(**row).flush()
                (active,) = folder.glob("*.active")
                states.append(active.read_bytes())
        self.name, (self.old, self.middle, self.new) = active.name, states
        changed = [at for at, (a, b) in enumerate(zip(self.old, self.new, strict=False)) if a != b]
        self.first, self.last = changed[0], changed[-1] + 1

    def torn(self, at: int, other: bytes) -> bytes:
        """Return the segment with its schema from the new one up to a place, and from another one behind it."""
        return self.new[:at] + other[at : self.last] + self.new[self.last :]


@pytest.mark.parametrize("state", ["old", "middle"])
def test_a_schema_that_a_crash_tore_in_its_place_is_taken_from_its_copy(tmp_path: Path, state: str) -> None:
    grown = Grown(tmp_path / "run")
    whole = range(grown.first, grown.last + 1)
    for number, at in enumerate([*whole[:: max(1, len(whole) // 25)], grown.last]):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = folder / grown.name
        path.write_bytes(grown.torn(at, getattr(grown, state)))
        with Recording(folder, recover=False) as recording:
            assert list(recording["t"].rows()) == list(grown.rows), at
        finish(path, ())
        assert read(folder) == {"t": list(grown.rows)}, at
        (finished,) = folder.glob("*.mcap")
        assert finished.read_bytes()[: grown.last] == grown.new[: grown.last], at


def test_a_schema_of_which_nothing_is_left_is_taken_from_its_copy(tmp_path: Path) -> None:
    grown = Grown(tmp_path / "run")
    folder = tmp_path / "torn"
    folder.mkdir()
    path = folder / grown.name
    path.write_bytes(grown.torn(grown.first, bytes(len(grown.new))))
    finish(path, ())
    assert read(folder) == {"t": list(grown.rows)}


def test_a_reader_of_a_growing_file_reads_rows_by_the_schema_that_was_written_before_them(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf")) as recorder:
        recorder.topic("t").append(**Grown.rows[0]).flush()
        with Recording(tmp_path) as recording:
            assert list(recording["t"].rows()) == list(Grown.rows[:1])
            for count in (2, 3):
                recorder.topic("t").append(**Grown.rows[count - 1]).flush()
                recording.refresh()
                assert list(recording["t"].rows()) == list(Grown.rows[:count])


@pytest.mark.parametrize(
    "content", [b"", b"junk", bytes(40), b"\x01\x00\x01\x00\x00\x00x\x00\x00\x00\x00\x00\x00\x00\x00"]
)
def test_private_records_of_others_with_the_same_number_are_passed_over(tmp_path: Path, content: bytes) -> None:
    grown = Grown(tmp_path / "run")
    folder = tmp_path / "other"
    folder.mkdir()
    path = folder / grown.name
    path.write_bytes(grown.new + b"\x8c" + len(content).to_bytes(8, "little") + content)
    finish(path, ())
    assert read(folder) == {"t": list(grown.rows)}


def test_a_type_without_room_to_grow_is_told_once_and_loses_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [{f"key {number}": 0.5} for number in range(250)]
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf")) as recorder:
        topic = recorder.topic("odd")
        for number, row in enumerate(rows):
            topic.append(**row, _ts=float(number))
    assert [record.getMessage() for record in caplog.records if "'odd'" in record.getMessage()] == [
        "topic 'odd': its protobuf type has no room to grow; values that it has no field for are kept in the text"
        " `_exact` (see docs/guides/encodings.md, Limits of protobuf)"
    ]
    with Recording(tmp_path) as recording:
        assert list(recording["odd"].rows()) == [{**row, "_ts": float(number)} for number, row in enumerate(rows)]
