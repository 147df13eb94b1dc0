"""A compiled `append` does what the plain one does: the same rows, errors and return values, whatever comes between."""

from __future__ import annotations

import contextlib
import copy
import gc
import inspect
import itertools
import math
import random
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap import Experiment, clock
from ml_dash_mcap.errors import BacklogFullError, StateError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.topic import Topic
from tests.interruptions import at_every_point, within
from tests.support import disk

Row = dict[str, Any]

SMALL = RecorderOptions(encoding="protobuf", chunk_bytes=65536, backlog_bytes=65536 * 16, flush_interval_s=3600.0)

KINDS: dict[str, Row] = {
    "of one length": {"x": 0.5, "q": [0.5, 1.5]},
    "with text": {"x": 0.5, "mode": "idle"},
    "with an array": {"x": 0.5, "q": np.arange(3.0)},
    "with an array of another type": {"x": 0.5, "q": np.arange(3, dtype=np.float32)},
    "with a large array": {"x": 0.5, "q": np.zeros(5000)},
    "with a dict": {"x": 0.5, "d": {"s": "a", "y": 0.5}},
    "with integers among doubles": {"x": 0.5, "q": [0.5, 1], "g": None},
}


def compiled(recorder: Recorder, name: str, row: Row) -> Topic:
    """Return a topic whose `append` is compiled for rows like one."""
    topic = recorder.topic(name)
    for number in range(6):
        topic.append(n=number, **row, _ts=0.001 * (number + 0.5))
    assert is_compiled(topic)
    return topic


def is_compiled(topic: Topic) -> bool:
    return type(topic).append is not Topic.append


class Numbered:
    """Appends numbered rows to a compiled topic and to another one."""

    def __init__(self, folder: Path, row: Row, options: RecorderOptions = SMALL) -> None:
        self.recorder = Recorder(folder, options)
        self.row = row
        self.topics = {name: compiled(self.recorder, name, row) for name in ("main", "other")}
        self.numbers = itertools.count(1000)
        self.taken: list[int] = []

    def append(self, name: str = "main") -> None:
        number = next(self.numbers)
        self.topics[name].append(n=number, **self.row, _ts=number + 0.25)
        self.taken.append(number)

    def append_short(self) -> None:
        number = next(self.numbers)
        self.recorder.topic("short").append(n=number, _ts=number + 0.25)
        self.taken.append(number)

    def fill(self) -> None:
        journal = self.recorder._journal
        active = journal.active
        while journal.active is active:
            self.append()

    def counts(self) -> Counter[int]:
        """Close, and count the rows by number as mcap's own reader finds them."""
        self.recorder.close()
        rows = itertools.chain.from_iterable(disk.rows(self.recorder.path).values())
        return Counter(row["n"] for row in rows if row["n"] >= 1000)


HANDLERS: dict[str, Callable[[Numbered], None]] = {
    "to the same topic": lambda rows: rows.append(),
    "a shorter row": lambda rows: rows.append_short(),
    "until a buffer is full": lambda rows: rows.fill(),
}


@pytest.mark.parametrize("handler", HANDLERS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_signal_handler_may_append_at_every_point(tmp_path: Path, kind: str, handler: str) -> None:
    rows = Numbered(tmp_path, KINDS[kind])
    points = []

    def handle() -> None:
        with contextlib.suppress(BacklogFullError):
            HANDLERS[handler](rows)

    def through() -> None:
        for interruption in at_every_point(rows.append, handle):
            points.append(interruption.where)
            rows.recorder.flush()

    within(60, through, rows.recorder._finalizer.detach)
    assert any(point.startswith("append:") for point in points)
    assert is_compiled(rows.topics["main"])
    assert rows.counts() == Counter(rows.taken), points


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_that_a_signal_handler_raises_behind_a_row_passes_and_repeats_none(tmp_path: Path, kind: str) -> None:
    rows = Numbered(tmp_path, KINDS[kind])
    raised: list[str] = []

    def refuse() -> None:
        raise ValueError("of the handler")

    def act() -> None:
        try:
            rows.append()
        except ValueError:
            raised.append("")

    for interruption in at_every_point(act, refuse):
        assert interruption.where
    assert raised
    counts = rows.counts()
    assert set(counts.values()) == {1}
    assert set(rows.taken) <= counts.keys()


class Finalized:
    """Garbage that appends when it is collected."""

    def __init__(self, act: Callable[[], None]) -> None:
        self.act = act
        self.self = self

    def __del__(self) -> None:
        self.act()


@pytest.fixture
def collector() -> Iterator[None]:
    """Run the collector when the test says so only."""
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    yield
    gc.set_threshold(*before)
    gc.unfreeze()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.usefixtures("collector")
def test_a_finalizer_may_append_at_every_allocation(tmp_path: Path, kind: str) -> None:
    rows = Numbered(tmp_path, KINDS[kind])
    for allocation in range(12):
        for act in (rows.append, rows.append_short):
            gc.set_threshold(0)
            gc.collect()
            Finalized(act)
            spare = [slice(allocation, None) for _ in range(3)]  # the interpreter has none left
            gc.set_threshold(gc.get_count()[0] + allocation, 1000, 1000)
            rows.append()
            gc.set_threshold(0)
            del spare
    gc.collect()
    assert rows.counts() == Counter(rows.taken)


@pytest.mark.parametrize(
    "odd", [{"n": 2**63}, {"n": 2**70}, {"n": "a"}, {"x": None}, {"_ts": -1.0}, {"_ts": math.nan}], ids=str
)
def test_a_row_that_is_refused_or_of_another_kind_leaves_nothing_behind_the_last_record(
    tmp_path: Path, odd: Row
) -> None:
    rows = Numbered(tmp_path, KINDS["of one length"])
    with contextlib.suppress(ValueError):
        rows.topics["main"].append(**{"n": 1000, **rows.row, "_ts": 1000.0, **odd})
    active = rows.recorder._journal.active
    assert not any(active.map[active.end : active.end + 4096])
    rows.append_short()
    assert not any(active.map[active.end : active.end + 4096])
    rows.recorder.close()


CALLS: dict[str, Callable[[Topic], Any]] = {
    "an integer as time": lambda topic: topic.append(n=1, x=0.5, _ts=3),
    "a double of numpy as time": lambda topic: topic.append(n=1, x=0.5, _ts=np.float64(3.25)),
    "a text as time": lambda topic: topic.append(n=1, x=0.5, _ts="3.25"),
    "an array as time": lambda topic: topic.append(n=1, x=0.5, _ts=np.array(3.25)),
    "no time": lambda topic: topic.append(n=1, x=0.5),
    "None as time": lambda topic: topic.append(n=1, x=0.5, _ts=None),
    "True as time": lambda topic: topic.append(n=1, x=0.5, _ts=True),
    "time 0": lambda topic: topic.append(n=1, x=0.5, _ts=0.0),
    "time -0": lambda topic: topic.append(n=1, x=0.5, _ts=-0.0),
    "whole seconds": lambda topic: topic.append(n=1, x=0.5, _ts=7.0),
    "a negative time": lambda topic: topic.append(n=1, x=0.5, _ts=-0.5),
    "time -1": lambda topic: topic.append(n=1, x=0.5, _ts=-1),
    "NaN as time": lambda topic: topic.append(n=1, x=0.5, _ts=math.nan),
    "infinity as time": lambda topic: topic.append(n=1, x=0.5, _ts=math.inf),
    "nanoseconds as time": lambda topic: topic.append(n=1, x=0.5, _ts=1.7e18),
    "the last time": lambda topic: topic.append(n=1, x=0.5, _ts=math.nextafter(clock.END_S, 0)),
    "a time too late": lambda topic: topic.append(n=1, x=0.5, _ts=clock.END_S),
    "a positional argument": lambda topic: topic.append({"n": 1}, _ts=3.25),
    "a positional time": lambda topic: topic.append(3.25, n=1, x=0.5),
    "a field timestamp": lambda topic: topic.append(n=1, x=0.5, timestamp=4.5, _ts=3.25),
    "a field _exact": lambda topic: topic.append(n=1, x=0.5, _exact=4, _ts=3.25),
    "fields called as parameters are": lambda topic: topic.append(
        n=1, x=0.5, self=1, positional=2, fields=3, _positional=4, _others=5, _M=6, _journal=7, _ts=3.25
    ),
    "fields called as builtins are": lambda topic: topic.append(type=1, len="a", print=0.5, int=2, slice=3, _ts=3.25),
    "fields that are keywords": lambda topic: topic.append(**{"class": 1, "a b": 2, "": 3, "_ts": 3.25}),
    "fewer fields": lambda topic: topic.append(n=1, _ts=3.25),
    "no fields": lambda topic: topic.append(_ts=3.25),
    "more fields": lambda topic: topic.append(n=1, x=0.5, y=0.5, _ts=3.25),
    "another order": lambda topic: topic.append(_ts=3.25, x=0.5, n=1),
    "other types": lambda topic: topic.append(n=1.5, x="a", _ts=3.25),
    "what cannot be stored": lambda topic: topic.append(n=1, x=object(), _ts=3.25),
    "an integer too large": lambda topic: topic.append(n=2**64, x=0.5, _ts=3.25),
    "a key that is no text": lambda topic: topic.append(**{1: 2}, _ts=3.25),  # type: ignore[misc]
}


def outcome(encoding: str, folder: Path, call: Callable[[Topic], Any]) -> tuple[str, list[Row]]:
    """What a call says, and the rows that are read back."""
    with Recorder(folder, RecorderOptions(encoding=encoding)) as recorder:
        topic = compiled(recorder, "a", {"x": 0.5}) if encoding == "protobuf" else recorder.topic("a")
        if encoding != "protobuf":
            for number in range(6):
                topic.append(n=number, x=0.5, _ts=0.001 * (number + 0.5))
        try:
            said = "itself" if call(topic) is topic else "another"
        except Exception as error:
            said = f"{type(error).__name__}: {error}"
    with Recording(folder) as recording:
        return said.replace(str(folder), ""), list(recording["a"].rows())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("call", CALLS)
def test_a_call_says_and_stores_what_it_does_in_json(tmp_path: Path, call: str) -> None:
    json, protobuf = (outcome(encoding, tmp_path / encoding, CALLS[call]) for encoding in ("json", "protobuf"))
    assert protobuf == json


@pytest.mark.parametrize("near", [0.0, 1.7e9, 9.2e9], ids=["zero", "today", "the end"])
def test_times_in_nanoseconds_are_those_of_the_clock(tmp_path: Path, near: float) -> None:
    chance = random.Random(5)
    times = [
        near + chance.choice((chance.random(), 20 * chance.random(), chance.randrange(50) / 4)) for _ in range(5000)
    ]
    times += [math.nextafter(near + 3, near), near + 3, math.nextafter(near + 3, math.inf), 0.999999999999, 5e-324]
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf")) as recorder:
        topic = compiled(recorder, "a", {})
        for number, time_s in enumerate(times, 10):
            topic.append(n=number, _ts=time_s)
        assert is_compiled(topic)
    expected = {(clock.to_nanoseconds(time_s), time_s) for time_s in times}
    assert expected <= {(time_ns, row["_ts"]) for time_ns, row in disk.timed_rows(tmp_path)["a"]}


def test_threads_may_append_to_one_topic_while_its_layout_grows(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(encoding="protobuf", chunk_bytes=65536))
    topic = compiled(recorder, "a", {"x": 0.5})
    kinds: list[Row] = [{"x": 0.5}, {"x": 1}, {"x": [0.5]}, {"s": "a"}, {"d": {"y": 1}}]
    expected: dict[float, Row] = {}
    errors: list[BaseException] = []

    def run(worker: int) -> None:
        try:
            for number in range(4000):
                extra = kinds[(number // 100 + worker) % len(kinds)] if number % 50 else {f"new{number % 400}": worker}
                row = {"n": number, **extra, "_ts": 1.0 + number + worker / 4}
                expected[row["_ts"]] = row
                assert topic.append(**row) is topic
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(worker,)) for worker in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    recorder.close()
    assert errors == []
    with Recording(tmp_path) as recording:
        rows = [row for row in recording["a"].rows() if row["_ts"] >= 1.0]
    assert rows == [expected[time_s] for time_s in sorted(expected)]


def test_an_append_that_was_kept_goes_on_when_the_layout_has_grown(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf")) as recorder:
        topic = recorder.topic("a")
        first = topic.append
        for number in range(4):
            first(n=number, x=1, _ts=0.5 + number)
        second = topic.append
        assert is_compiled(topic)
        topic.append(n=4, x=0.5, s="a", _ts=4.5)
        first(n=5, x=1, _ts=5.5)
        second(n=6, x=1, _ts=6.5)
        second(n=7, x=0.5, _ts=7.5)
    for append in (first, second):
        with pytest.raises(StateError):
            append(n=8, x=1, _ts=8.5)
    with Recording(tmp_path) as recording:
        rows = list(recording["a"].rows())
    assert [(row["n"], row["x"], type(row["x"])) for row in rows] == [
        *((number, 1, int) for number in range(4)),
        *((4, 0.5, float), (5, 1, int), (6, 1, int), (7, 0.5, float)),
    ]


def test_the_method_looks_as_it_does_uncompiled(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf")) as recorder:
        topic = compiled(recorder, "a", {"x": 0.5})
        plain = Topic.append.__get__(topic)
        assert inspect.signature(topic.append) == inspect.signature(plain)
        assert (topic.append.__doc__, topic.append.__qualname__) == (Topic.append.__doc__, "Topic.append")
        assert (repr(type(topic)), type(topic).__doc__) == (repr(Topic), Topic.__doc__)
        assert isinstance(topic, Topic)
        assert copy.copy(topic).append(n=7, x=0.5, _ts=9.5).name == "a"
    assert disk.rows(tmp_path)["a"][-1] == {"n": 7, "x": 0.5, "_ts": 9.5}


@pytest.mark.parametrize("on_full", ["drop", "raise", "block"])
def test_a_full_backlog_is_treated_as_the_option_says(tmp_path: Path, on_full: Any) -> None:
    options = RecorderOptions(encoding="protobuf", chunk_bytes=65536, backlog_bytes=2 * 65536, on_full=on_full)
    rows = Numbered(tmp_path, {"q": [0.5] * 60}, options)
    refused = 0
    for _ in range(3000):
        try:
            rows.append()
        except BacklogFullError:
            refused += 1
    dropped = rows.recorder.stats()["dropped"]
    counts = rows.counts()
    assert set(counts.values()) == {1}
    assert len(rows.taken) + refused == 3000
    assert (len(counts), dropped) == (3000 - refused - dropped * (on_full == "drop"), dropped)
    assert on_full != "block" or dropped == 0


def test_rows_are_written_at_once_where_the_options_say_so(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf", batch_rows=3)) as recorder:
        topic = compiled(recorder, "a", {"x": 0.5})
        before = recorder._journal._sealed_rows
        for number in range(7):
            topic.append(n=number, x=0.5, _ts=1.5 + number)
        assert recorder._journal._sealed_rows >= before + 6


def test_a_recorder_that_is_forgotten_is_collected_and_closed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, RecorderOptions(encoding="protobuf"))
    topic = compiled(recorder, "a", {"x": 0.5})
    gone = weakref.ref(recorder)
    del recorder, topic
    gc.collect()
    assert gone() is None
    assert len(disk.rows(tmp_path)["a"]) == 6


def test_the_tracks_of_an_experiment_are_compiled_and_refuse_a_field_timestamp(tmp_path: Path) -> None:
    with Experiment(prefix="a/b/c", root=tmp_path, encoding="protobuf").run as exp:
        track = exp.tracks("robot")
        for number in range(6):
            track.append(x=0.5, _ts=number + 0.5)
        assert is_compiled(track)
        assert repr(type(track)) == "<class 'ml_dash_mcap.run.tracks.Track'>"
        with pytest.raises(ValueError, match="'timestamp' is taken"):
            track.append(x=0.5, timestamp=1.0, _ts=7.5)
        assert track.append(x=1.5, _ts=8.5) is track
        assert track.read()["count"] == 7


def spelling(row: Row) -> str:
    """A row as text, which tells 1 from 1.0 and True."""
    return repr(sorted(row.items()))


def test_rows_of_random_kinds_come_back(tmp_path: Path) -> None:
    chance = random.Random(3)
    values: list[Callable[[], Any]] = [
        chance.random,
        lambda: chance.randrange(-5, 5),
        lambda: chance.choice(("", "a", "é" * 200)),
        lambda: [chance.random() for _ in range(chance.choice((3, 3, 3, 4)))],
        lambda: [chance.choice((1, 0.5)) for _ in range(3)],
        lambda: {"a": chance.random(), "b": chance.choice((1, None, "x"))},
        lambda: None,
        lambda: chance.random() < 0.5,
    ]
    expected: list[Row] = []
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf")) as recorder:
        topics = [recorder.topic(f"t{number}") for number in range(20)]
        kinds = [(chance.choice(values), chance.choice(values)) for _ in topics]
        for number in range(20_000):
            which = chance.randrange(20)
            first, second = kinds[which] if chance.random() < 0.98 else (chance.choice(values), chance.choice(values))
            row = {"n": number, "a": first(), "b": second(), "_ts": 0.5 + number / 1000}
            topics[which].append(**row)
            expected.append(row)
        assert any(map(is_compiled, topics))
    with Recording(tmp_path) as recording:
        rows = [row for topic in topics for row in recording[topic.name].rows()]
    assert sorted(rows, key=lambda row: row["n"]) == expected
    assert list(map(spelling, sorted(rows, key=lambda row: row["n"]))) == list(map(spelling, expected))


def test_rows_are_compiled_again_however_often_their_layout_has_grown(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding="protobuf")) as recorder:
        topic = recorder.topic("a")
        for number in range(40):
            for repetition in range(4):
                topic.append(state={f"s{number}": 0.5}, _ts=number + repetition / 8)
        assert is_compiled(topic)
