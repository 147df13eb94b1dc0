"""A signal handler, a finalizer, Ctrl-C: whatever comes between two instructions of the recorder loses nothing."""

from __future__ import annotations

import contextlib
import gc
import itertools
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import BacklogFullError, StateError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder, open_topic
from ml_dash_mcap.topic import EventTopic
from tests.interruptions import at_every_point, within
from tests.support import disk

SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=65536 * 16, flush_interval_s=3600.0, sync_interval_s=0.0)
"""Buffers are sealed when they are full, and never by the clock."""

FILLER = "x" * 20_000
"""Three rows with it fill a buffer."""


class Rows:
    """Rows by number, and which of them `append` returned for."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self.topics = {name: recorder.topic(name) for name in ("main", "handler")}
        self.metric = open_topic(recorder, "ml_dash/metrics/m", "metric", EventTopic)
        self.numbers = itertools.count()
        self.taken: list[int] = []
        self.parameters = 0

    def append(self, topic: str, **fields: Any) -> None:
        number = next(self.numbers)
        self.topics[topic].append(n=number, **fields, _ts=float(number))
        self.taken.append(number)

    def fill(self, topic: str) -> None:
        for _ in range(4):
            self.append(topic, fill=FILLER)

    def batch(self, count: int) -> None:
        numbers = [next(self.numbers) for _ in range(count)]
        self.topics["main"].append_batch([{"n": n, "fill": FILLER, "_ts": float(n)} for n in numbers])
        self.taken += numbers

    def columns(self, count: int) -> None:
        numbers = np.array([next(self.numbers) for _ in range(count)])
        self.topics["main"].append_columns(_ts=numbers.astype(float), n=numbers, fill=np.zeros((count, 600)))
        self.taken += numbers.tolist()

    def log(self) -> None:
        number = next(self.numbers)
        self.metric.add({"n": number})
        self.taken.append(number)

    def set_parameter(self) -> None:
        self.parameters += 1
        self.recorder.set_parameters({f"p{self.parameters}": self.parameters})

    def missing_or_twice(self, *, may_be: set[int] = frozenset()) -> dict[str, list[int]]:  # type: ignore[assignment]
        """Close, and compare with what mcap's own reader finds."""
        self.recorder.close()
        found = Counter(row["n"] for rows in disk.rows(self.recorder.path).values() for row in rows)
        taken = set(self.taken)
        return {
            "missing": [number for number in self.taken if number not in found],
            "twice": [number for number, count in found.items() if count > 1],
            "foreign": [number for number in found if number not in taken and number not in may_be],
        }


class CtrlC(BaseException):
    """Stands for KeyboardInterrupt, which would end the tests where the recorder lets it through in a wrong place."""


CLEAN: dict[str, list[int]] = {"missing": [], "twice": [], "foreign": []}

ACTIONS: dict[str, Callable[[Rows], None]] = {
    "append": lambda rows: rows.append("main"),
    "appends that fill a buffer": lambda rows: rows.fill("main"),
    "append of a row larger than a buffer": lambda rows: rows.append("main", fill=FILLER * 5),
    "append_batch": lambda rows: rows.batch(4),
    "append_columns": lambda rows: rows.columns(12),
    "a metric": lambda rows: rows.log(),
    "parameters": lambda rows: rows.set_parameter(),
    "stats": lambda rows: rows.recorder.stats(),
}

HANDLERS: dict[str, Callable[[Rows], None]] = {
    "append": lambda rows: rows.append("handler"),
    "appends that fill a buffer": lambda rows: rows.fill("handler"),
    "append of a row larger than a buffer": lambda rows: rows.append("handler", fill=FILLER * 5),
    "parameters": lambda rows: rows.set_parameter(),
}


@pytest.mark.parametrize("handler", HANDLERS)
@pytest.mark.parametrize("action", ACTIONS)
def test_a_handler_that_records_may_interrupt_the_recorder_anywhere(tmp_path: Path, action: str, handler: str) -> None:
    recorder = Recorder(tmp_path, SMALL)
    rows = Rows(recorder)
    points = []

    def act() -> None:
        ACTIONS[action](rows)

    def handle() -> None:
        with contextlib.suppress(
            BacklogFullError
        ):  # it cannot wait for room inside of one who waits for room: it is told so
            HANDLERS[handler](rows)

    def through() -> None:
        for interruption in at_every_point(act, handle):
            points.append(interruption.where)
            if interruption.number % 10 == 0:
                recorder.flush()

    within(20, through, recorder._finalizer.detach)
    assert rows.missing_or_twice() == CLEAN, points
    parameters = {name for record in disk.metadata(tmp_path, "ml_dash.parameters") for name in record}
    assert parameters == {f"p{number + 1}" for number in range(rows.parameters)}
    assert recorder.stats()["written"] == len(rows.taken)
    assert recorder.stats()["dropped"] <= len(points)
    assert len(points) >= 3


@pytest.mark.parametrize("action", [name for name in ACTIONS if name not in ("stats", "parameters")])
def test_ctrl_c_anywhere_in_the_recorder_loses_no_row_that_was_taken(tmp_path: Path, action: str) -> None:
    recorder = Recorder(tmp_path, SMALL)
    rows = Rows(recorder)
    started: set[int] = set()

    def interrupted() -> None:
        raise CtrlC

    def act() -> None:
        before = next(rows.numbers)
        with contextlib.suppress(CtrlC):
            ACTIONS[action](rows)
        started.update(range(before, next(rows.numbers)))

    points = []

    def through() -> None:
        for interruption in at_every_point(act, interrupted):
            points.append(interruption.where)
            for _ in range(4):  # the recorder goes on as if nothing had been
                rows.append("handler", fill=FILLER)
            recorder.flush()

    within(20, through, recorder._finalizer.detach)
    assert rows.missing_or_twice(may_be=started) == CLEAN, points
    assert len(points) >= 3


def test_ctrl_c_does_not_use_up_the_buffers(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=3 * 65536))
    rows = Rows(recorder)

    def interrupted() -> None:
        raise CtrlC

    def act() -> None:
        with contextlib.suppress(CtrlC):
            for _ in range(4):
                rows.append("main", fill=FILLER)

    def through() -> None:
        for number, _ in enumerate(at_every_point(act, interrupted)):
            if number % 5 == 0:
                recorder.flush()
        for _ in range(20):
            rows.append("main", fill=FILLER)
        recorder.flush()

    within(10, through, recorder._finalizer.detach)
    assert rows.missing_or_twice(may_be=set(range(10**6)))["missing"] == []


@pytest.fixture
def alarm() -> Iterator[Callable[[Callable[[], object]], None]]:
    """Call something every millisecond until the test ends."""
    before = signal.getsignal(signal.SIGALRM)

    def start(handler: Callable[[], object]) -> None:
        signal.signal(signal.SIGALRM, lambda *_: handler())
        signal.setitimer(signal.ITIMER_REAL, 1e-3, 1e-3)

    yield start
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def test_a_real_signal_handler_that_appends_every_millisecond_loses_nothing(
    tmp_path: Path, alarm: Callable[[Callable[[], object]], None]
) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(chunk_bytes=65536))
    rows = Rows(recorder)
    alarm(lambda: rows.append("handler", fill="y" * 300))
    while len(rows.taken) < 40_000:
        rows.append("main", fill="x" * 300)
    signal.setitimer(signal.ITIMER_REAL, 0)
    assert rows.missing_or_twice() == CLEAN


def test_a_handler_may_append_while_the_backlog_is_full(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=2 * 65536))
    rows = Rows(recorder)

    def act() -> None:
        for _ in range(6):
            rows.append("main", fill=FILLER)

    def handle() -> None:
        for _ in range(8):
            with contextlib.suppress(BacklogFullError):
                rows.append("handler", fill=FILLER)

    def through() -> None:
        for number, _ in enumerate(at_every_point(act, handle)):
            if number > 120:
                break
        sys.setprofile(None)

    within(8, through, recorder._finalizer.detach)
    assert rows.missing_or_twice() == CLEAN


def test_a_handler_may_open_a_topic_while_one_is_opened(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(chunk_bytes=4 * 65536))  # which hundreds of topics fit into
    names = (f"t{number}" for number in itertools.count())

    def through() -> None:
        for interruption in at_every_point(lambda: recorder.topic(next(names)), lambda: recorder.topic(next(names))):
            assert interruption.where

    within(10, through, recorder._finalizer.detach)
    recorder.close()


class Finalized:
    """Garbage that appends when it is collected."""

    def __init__(self, rows: Rows) -> None:
        self.rows = rows
        self.self = self

    def __del__(self) -> None:
        self.rows.append("handler", fill="y" * 100)


def test_finalizers_that_append_lose_nothing_whenever_the_collector_runs(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=65536 * 4))
    rows = Rows(recorder)
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(7, 1, 1)
    try:
        for number in range(3000):
            Finalized(rows)
            kept = [
                slice(number, None) for _ in range(2)
            ]  # the interpreter has no slice to spare: the next one is allocated
            rows.append("main", fill=["x", number])
            del kept
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()
    gc.collect()
    assert len(rows.taken) == 6000
    assert rows.missing_or_twice() == CLEAN


def test_a_finalizer_that_runs_on_the_writer_thread_may_append_while_the_backlog_is_full(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=2 * 65536))
    rows = Rows(recorder)
    compress = recorder._segments.compress
    entered, go_on = threading.Event(), threading.Event()

    def collecting(*arguments: Any) -> Any:
        if not entered.is_set():
            entered.set()
            go_on.wait()
            for _ in range(8):
                with contextlib.suppress(BacklogFullError, StateError):
                    rows.append("handler", fill=FILLER)  # as a finalizer would, which the collector runs on this thread
        return compress(*arguments)

    collecting.name = compress.name  # type: ignore[attr-defined]
    recorder._segments.compress = collecting  # type: ignore[assignment]
    for _ in range(4):
        rows.append("main", fill=FILLER)
    assert entered.wait(10)
    go_on.set()
    within(10, recorder.close, recorder._finalizer.detach)
    assert rows.missing_or_twice() == CLEAN


def test_a_recorder_that_is_collected_on_its_own_writer_thread_is_closed_all_the_same(tmp_path: Path) -> None:
    recorder: Recorder | None = Recorder(tmp_path)
    assert recorder is not None
    entered, go_on = threading.Event(), threading.Event()
    compress, thread = recorder._segments.compress, recorder._writer._thread

    def collecting(*arguments: Any) -> Any:
        entered.set()
        go_on.wait()
        gc.collect()
        return compress(*arguments)

    collecting.name = compress.name  # type: ignore[attr-defined]
    recorder._segments.compress = collecting  # type: ignore[assignment]
    recorder.topic("a").append(x=1, _ts=1.0)
    recorder._journal.seal()
    assert entered.wait(10)
    del recorder
    go_on.set()
    thread.join(20)
    assert not thread.is_alive()
    recovered = Recorder(tmp_path)
    recovered.close()
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 1.0}]}
