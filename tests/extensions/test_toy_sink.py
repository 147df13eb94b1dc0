"""Sinks that are added from here, without a change to the package: what they get, and that they hold up nothing."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, TextIO

import pytest
from mcap.reader import make_reader

from ml_dash_mcap import (
    PreparedBlock,
    Recorder,
    RecorderOptions,
    Recording,
    SessionInfo,
    Sink,
    UsageError,
    recover,
)
from ml_dash_mcap.capture import sink_threads
from tests.support import disk

ROWS = 3000
OPTIONS = RecorderOptions(chunk_bytes=65536, backlog_bytes=4 * 65536, flush_interval_s=60)
"""Small buffers, so that a recording has some blocks."""


class Counting:
    """Counts rows by topic."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.counts: Counter[str] = Counter()

    def open(self, session: SessionInfo) -> None:
        self.calls.append(f"open {session.folder.name}")

    def write(self, block: PreparedBlock) -> None:
        self.counts.update(message.channel.topic for message in block.messages())

    def close(self) -> None:
        self.calls.append("close")


class JsonLines:
    """Writes each row as a line of JSON, for `tail -f`."""

    file: TextIO

    def open(self, session: SessionInfo) -> None:
        self.file = (session.folder / "tail.jsonl").open("w")

    def write(self, block: PreparedBlock) -> None:
        for message in block.messages():
            self.file.write(json.dumps({"topic": message.channel.topic, **message.row()}) + "\n")
        self.file.flush()

    def close(self) -> None:
        self.file.close()


class Sleeping(Counting):
    """Stands still in its first block until it is told to go on."""

    def __init__(self) -> None:
        super().__init__()
        self.sleeps, self.goes_on = threading.Event(), threading.Event()

    def write(self, block: PreparedBlock) -> None:
        self.sleeps.set()
        self.goes_on.wait()
        super().write(block)


class Raising(Counting):
    """Raises in some of its methods."""

    def __init__(self, *where: str) -> None:
        super().__init__()
        self.where = where

    def open(self, session: SessionInfo) -> None:
        super().open(session)
        self._raise("open")

    def write(self, block: PreparedBlock) -> None:
        self._raise("write")
        super().write(block)

    def close(self) -> None:
        super().close()
        self._raise("close")

    def _raise(self, where: str) -> None:
        if where in self.where:
            raise ValueError(f"odd {where}")


def record(folder: Path, *sinks: Sink) -> Recorder:
    """Record some topics whose rows do not depend on when they are recorded, and close."""
    with Recorder(folder, OPTIONS, sinks=sinks) as recorder:
        append_rows(recorder)
    return recorder


def append_rows(recorder: Recorder) -> None:
    for number in range(ROWS):
        recorder.topic("robot").append(q=[number + 0.5] * 7, step=number, _ts=1.0 + number / 100)
        if number % 3 == 0:
            recorder.topic("camera").append(frame=bytes(20), _ts=1.0 + number / 100)
            recorder.topic("camera").append(name=str(number), _ts=1.0 + number / 100)  # merges with the row before


def messages(folder: Path) -> list[tuple[str, int, int, bytes]]:
    """Return what the file has of each row, by topic in order: topic, time, sequence number and payload."""
    found: list[tuple[str, int, int, bytes]] = []
    for segment in disk.segments(folder):
        with segment.open("rb") as file:
            found += [
                (channel.topic, message.log_time, message.sequence, message.data)
                for _, channel, message in make_reader(file).iter_messages()
            ]
    return sorted(found, key=lambda message: (message[0], message[2]))


@pytest.fixture
def expected(tmp_path: Path) -> list[tuple[str, int, int, bytes]]:
    """Return what the file has without any sink."""
    record(tmp_path / "alone")
    return messages(tmp_path / "alone")


@pytest.fixture
def sleeping(monkeypatch: pytest.MonkeyPatch) -> Iterator[Sleeping]:
    """Yield a sink that sleeps until the test is over; a recorder does not wait for it long."""
    monkeypatch.setattr(sink_threads, "_CLOSE_PATIENCE_S", 0.2)
    sink = Sleeping()
    yield sink
    sink.goes_on.set()


def test_a_counting_sink_gets_every_row_of_the_file_once(tmp_path: Path) -> None:
    counting = Counting()
    stats = record(tmp_path / "run", counting).stats()
    assert counting.counts == Counter(topic for topic, *_ in messages(tmp_path / "run"))
    assert counting.counts["robot"] == ROWS
    assert counting.calls == ["open run", "close"]
    (sink,) = stats.sinks
    assert (sink.name, sink.rows, sink.waiting, sink.missed) == ("Counting", stats.written - stats.merged, 0, 0)
    assert (sink.errors, sink.failure) == (0, None)


def test_a_sink_gets_rows_as_they_are_in_the_file(tmp_path: Path, expected: list[Any]) -> None:
    given: list[tuple[str, int, int, bytes]] = []

    class Keeping(Counting):
        def write(self, block: PreparedBlock) -> None:
            assert len(block) == len(list(block.messages()))
            for message in block.messages():
                assert message.channel.kind == "track"
                given.append((message.channel.topic, message.time_ns, message.sequence, message.payload))

    record(tmp_path / "run", Keeping())
    given.sort(key=lambda message: (message[0], message[2]))
    assert given == messages(tmp_path / "run") == expected


def test_a_tail_of_json_lines_has_the_rows_that_the_recording_gives(tmp_path: Path) -> None:
    class RobotOnly(JsonLines):
        def write(self, block: PreparedBlock) -> None:
            for message in block.messages():
                if message.channel.topic == "robot":
                    self.file.write(json.dumps(message.row()) + "\n")

    record(tmp_path, RobotOnly())
    lines = [json.loads(line) for line in (tmp_path / "tail.jsonl").read_text().splitlines()]
    with Recording(tmp_path) as recording:
        assert lines == list(recording["robot"].rows())


def test_a_tail_of_json_lines_can_be_followed_while_the_recording_goes_on(tmp_path: Path) -> None:
    written = threading.Event()

    class Following(JsonLines):
        def write(self, block: PreparedBlock) -> None:
            super().write(block)
            written.set()

    with Recorder(tmp_path, sinks=[Following()]) as recorder:
        recorder.topic("a").append(x=1, _ts=1.0)
        recorder.flush()
        assert written.wait(30)
        assert (tmp_path / "tail.jsonl").read_text() == '{"topic": "a", "x": 1, "_ts": 1.0}\n'


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
def test_a_sink_decodes_rows_of_any_encoding(tmp_path: Path, encoding: str) -> None:
    rows: list[dict[str, Any]] = []

    class Keeping(Counting):
        def write(self, block: PreparedBlock) -> None:
            rows.extend(message.row() for message in block.messages())

    with Recorder(tmp_path, RecorderOptions(encoding=encoding), sinks=[Keeping()]) as recorder:
        recorder.topic("a").append(data=b"\x00\xff", q=[0.5, float("inf")], _ts=1.0)
    assert rows == [{"data": b"\x00\xff", "q": [0.5, float("inf")], "_ts": 1.0}]


def test_a_sink_is_told_the_parameters_too(tmp_path: Path) -> None:
    given: dict[str, dict[str, str]] = {}

    class Keeping(Counting):
        def write(self, block: PreparedBlock) -> None:
            given.update({entry.name: dict(entry.values) for entry in block.metadata})

    with Recorder(tmp_path, sinks=[Keeping()]) as recorder:
        recorder.set_parameters({"gain": 2})
    assert list(given.values()) == [{"gain": "2"}]


BAD: dict[str, Callable[[], Raising]] = {
    "raises on each block": lambda: Raising("write"),
    "raises when it is opened": lambda: Raising("open"),
    "raises when it is closed": lambda: Raising("close"),
    "raises always": lambda: Raising("open", "write", "close"),
}


@pytest.mark.parametrize("bad", BAD)
def test_a_sink_that_raises_costs_neither_the_file_nor_other_sinks_a_row(
    tmp_path: Path, expected: list[Any], caplog: pytest.LogCaptureFixture, bad: str
) -> None:
    raising, counting = BAD[bad](), Counting()
    with caplog.at_level(logging.WARNING):
        stats = record(tmp_path / "run", raising, counting).stats()
    assert messages(tmp_path / "run") == expected
    assert stats.accepted == stats.written == ROWS + 2 * ROWS // 3
    assert (stats.waiting, stats.dropped, stats.failure) == (0, 0, None)
    assert counting.counts.total() == len(expected)
    ill, well = stats.sinks
    assert (well.rows, well.missed, well.errors) == (len(expected), 0, 0)
    assert ill.errors >= 1
    assert ill.failure == f"ValueError('odd {raising.where[0]}')"
    assert (ill.rows, ill.missed) == ((len(expected), 0) if raising.where == ("close",) else (0, len(expected)))
    assert f"the sink Raising missed {ill.missed} rows" in caplog.text
    assert ill.failure in caplog.text


def test_a_sink_that_could_not_be_opened_is_neither_written_to_nor_closed(tmp_path: Path) -> None:
    raising = Raising("open")
    record(tmp_path / "run", raising)
    assert (raising.calls, raising.counts) == (["open run"], {})


def test_a_sink_that_sleeps_holds_up_neither_append_nor_the_file_nor_other_sinks(
    tmp_path: Path, expected: list[Any], sleeping: Sleeping
) -> None:
    counting = Counting()
    recorder = Recorder(tmp_path / "run", OPTIONS, sinks=[sleeping, counting])
    append_rows(recorder)
    recorder.flush()
    assert sleeping.sleeps.wait(30)
    stats = recorder.stats()
    assert stats.written == stats.accepted == ROWS + 2 * ROWS // 3
    assert (stats.waiting, stats.dropped) == (0, 0)
    assert stats.sinks[0].rows == 0
    assert stats.sinks[0].waiting + stats.sinks[0].missed == len(expected)
    recorder.close()
    assert messages(tmp_path / "run") == expected
    assert counting.counts.total() == len(expected)


def test_what_waits_for_a_sink_has_an_end_and_what_it_misses_is_counted(tmp_path: Path, sleeping: Sleeping) -> None:
    with Recorder(tmp_path, OPTIONS, sinks=[sleeping]) as recorder:
        for first in range(0, 16 * ROWS, ROWS):
            recorder.topic("a").append_columns(_ts=[float(first + number) for number in range(ROWS)], x=[0.5] * ROWS)
        recorder.flush()
        (sink,) = recorder.stats().sinks
        assert sink.waiting + sink.missed == 16 * ROWS
        assert sink.missed > 0
        assert 0 < sink.waiting * 60 < 2 * OPTIONS.backlog_bytes  # a row has some 60 bytes
    assert recorder.stats().sinks[0].missed == 16 * ROWS
    assert recorder.stats().written == 16 * ROWS


@pytest.mark.parametrize("on_full", ["drop", "block"])
def test_the_figures_add_up_beside_a_sleeping_sink_and_one_that_raises(
    tmp_path: Path, sleeping: Sleeping, on_full: Literal["drop", "block"]
) -> None:
    sinks: list[Sink] = [sleeping, Raising("write"), Counting()]
    with Recorder(tmp_path, OPTIONS.with_(on_full=on_full), sinks=sinks) as recorder:
        for _ in range(5):
            append_rows(recorder)
            stats = recorder.stats()
            assert stats.accepted == stats.written + stats.waiting + stats.dropped
    stats = recorder.stats()
    assert stats.accepted == 5 * (ROWS + 2 * ROWS // 3) == stats.written + stats.dropped
    assert stats.dropped == 0 or on_full == "drop"
    in_file = len(messages(tmp_path))
    assert in_file == stats.written - stats.merged
    assert [sink.rows + sink.missed for sink in stats.sinks] == [in_file] * 3
    assert [sink.waiting for sink in stats.sinks] == [0, 0, 0]


def test_close_waits_for_a_sleeping_sink_only_for_a_moment(tmp_path: Path, sleeping: Sleeping) -> None:
    begun = time.monotonic()
    record(tmp_path / "run", sleeping)
    assert time.monotonic() - begun < 20
    assert sleeping.calls == ["open run"]
    with Recording(tmp_path / "run") as recording:
        assert recording.topics["robot"].count == ROWS


def test_close_waits_for_a_sink_that_is_only_slow(tmp_path: Path) -> None:
    class Slow(Counting):
        def close(self) -> None:
            threading.Event().wait(0.3)
            super().close()

    sink = Slow()
    with Recorder(tmp_path / "run", sinks=[sink]) as recorder:
        recorder.topic("a").append(x=1, _ts=1.0)
    assert (sink.counts, sink.calls) == ({"a": 1}, ["open run", "close"])


def test_append_takes_no_longer_beside_a_sleeping_sink(tmp_path: Path, sleeping: Sleeping) -> None:
    def append_times(*sinks: Sink) -> list[float]:
        took = []
        options = RecorderOptions(chunk_bytes=65536)  # so that blocks come to the sink, and append waits for no room
        with Recorder(tmp_path / str(len(sinks)), options, sinks=sinks) as recorder:
            topic = recorder.topic("a")
            for number in range(2 * ROWS):
                begun = time.perf_counter()
                topic.append(x=[0.5] * 7, _ts=float(number))
                took.append(time.perf_counter() - begun)
        return sorted(took)

    alone, beside = append_times(), append_times(sleeping)
    assert beside[ROWS] < 3 * alone[ROWS]  # the median; a sink that held it up would show in seconds
    assert beside[-1] < alone[-1] + 1.0


def test_a_sink_may_append_to_its_own_recorder(tmp_path: Path) -> None:
    done = threading.Event()

    class Deriving(Counting):
        recorder: Recorder

        def write(self, block: PreparedBlock) -> None:
            for message in block.messages():
                if message.channel.topic == "a":
                    self.recorder.topic("double").append(x=2 * message.row()["x"], _ts=message.row()["_ts"])
                    done.set()

    sink = Deriving()
    with Recorder(tmp_path, sinks=[sink]) as recorder:
        sink.recorder = recorder
        recorder.topic("a").append(x=1, _ts=1.0)
        recorder.flush()
        assert done.wait(30)
    assert disk.rows(tmp_path)["double"] == [{"x": 2, "_ts": 1.0}]


def test_a_sink_may_close_its_own_recorder(tmp_path: Path) -> None:
    closed = threading.Event()

    class Closing(Counting):
        recorder: Recorder

        def write(self, block: PreparedBlock) -> None:
            super().write(block)
            self.recorder.close()

        def close(self) -> None:
            super().close()
            closed.set()

    sink = Closing()
    sink.recorder = recorder = Recorder(tmp_path, sinks=[sink])
    recorder.topic("a").append(x=1, _ts=1.0)
    recorder.flush()
    assert closed.wait(30)
    assert (recorder.closed, recorder.stats().sinks[0].errors) == (True, 0)
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 1.0}]}


def test_the_figures_of_sinks_are_among_those_of_the_recorder(tmp_path: Path) -> None:
    stats = record(tmp_path, Counting()).stats()
    assert stats.dict()["sinks"][0]["rows"] == stats["sinks"][0]["rows"] == stats.sinks[0].rows


def test_without_sinks_the_figures_are_those_of_the_file(tmp_path: Path) -> None:
    assert "sinks" not in record(tmp_path).stats().dict()


def test_a_sink_is_not_called_for_what_a_recovery_writes(tmp_path: Path) -> None:
    record(tmp_path)
    assert recover(tmp_path).rows == 0


@pytest.mark.parametrize("sinks", [Counting(), [Counting], [object()], ["counting"]])
def test_what_is_no_sink_is_refused_and_leaves_nothing_behind(tmp_path: Path, sinks: Any) -> None:
    with pytest.raises(UsageError, match="sinks="):
        Recorder(tmp_path, sinks=sinks)
    assert list(tmp_path.iterdir()) == []
