"""Rows of one time stamp are one row, whatever came between them: against a plain dictionary."""

from __future__ import annotations

import json
import math
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder, open_topic
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.topic import EventTopic
from tests.support import disk
from tests.support.examples import examples

Row = dict[str, Any]

QUICK = settings(
    max_examples=examples(25),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=4 * 65536)


FIELDS = ["q", "q1", "q2", "e", "a/b", "~", "gripper"]
values_ = st.one_of(
    st.integers(-3, 300),
    st.floats(),
    st.none(),
    st.booleans(),
    st.text(max_size=3),
    st.binary(max_size=3),
    st.lists(st.one_of(st.floats(), st.none(), st.integers(0, 9)), max_size=3),
    st.dictionaries(
        st.sampled_from(FIELDS), st.one_of(st.floats(), st.binary(max_size=2), st.integers(0, 99)), max_size=2
    ),
)
row_ = st.dictionaries(st.sampled_from(FIELDS), values_, max_size=4)
time_ = st.sampled_from(
    [0.0, 1 / 3, 1 / 30, 1.0, 1.0000000000000002, 1.0000000001, 2.5, 1e9 / 3, 1e9 / 3 + 1e-6, 2.0**33]
)
step_ = st.one_of(
    st.tuples(st.just("append"), st.sampled_from("ab"), row_, time_),
    st.tuples(st.just("batch"), st.sampled_from("ab"), st.lists(st.tuples(row_, time_), max_size=4)),
    st.tuples(st.just("metric"), st.integers(0, 9)),
    st.sampled_from([("flush",), ("reopen",), ("seal",), ("read",)]),
)


class Model:
    """A recorder and, beside it, what must be read: plain dictionaries."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.options = RecorderOptions(chunk_bytes=65536, backlog_bytes=131072, sync_interval_s=0, flush_interval_s=60)
        self.recorder = Recorder(folder, self.options)
        self.tracks: dict[str, dict[float, Row]] = {"a": {}, "b": {}}
        self.metrics: list[int] = []

    def append(self, topic: str, row: Row, ts: float) -> None:
        self.recorder.topic(topic).append(**row, _ts=ts)
        self.tracks[topic].setdefault(ts, {}).update(row)

    def batch(self, topic: str, listed: list[tuple[Row, float]]) -> None:
        self.recorder.topic(topic).append_batch([{**row, "_ts": ts} for row, ts in listed])
        for row, ts in listed:
            self.tracks[topic].setdefault(ts, {}).update(row)

    def metric(self, value: int) -> None:
        open_topic(self.recorder, "ml_dash/metrics/m", "metric", EventTopic).add({"v": value})
        self.metrics.append(value)

    def flush(self) -> None:
        self.recorder.flush()

    def seal(self) -> None:
        self.recorder._journal.seal()

    def reopen(self) -> None:
        self.recorder.close()
        self.recorder = Recorder(self.folder, self.options)

    def read(self) -> None:
        self.recorder.flush()
        with Recording(self.folder) as recording:
            for topic, times in self.tracks.items():
                found = list(recording[topic].rows()) if topic in recording else []
                expected = [{**times[ts], "_ts": ts} for ts in sorted(times)]
                assert repr([sorted(row.items()) for row in found]) == repr([sorted(row.items()) for row in expected])
            metrics = recording.metrics["m"] if self.metrics else []
            assert sorted(row["v"] for row in metrics) == sorted(self.metrics)


@given(st.lists(step_, max_size=25))
@settings(QUICK, max_examples=examples(120))
@example(
    [
        ("append", "a", {"q1": 1.5}, 1.0),
        ("append", "a", {"q2": 2.5}, 2.5),
        ("append", "a", {"q2": 3.5, "e": 1}, 0.0),
        ("append", "a", {"q2": 4.5}, 0.0),
    ]
)
def test_merging_does_not_depend_on_when_rows_were_flushed_closed_or_reopened(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[Any, ...]]
) -> None:
    model = Model(tmp_path_factory.mktemp("merge"))
    for name, *arguments in steps:
        getattr(model, name)(*arguments)
    model.read()
    model.recorder.close()
    for _, payload in disk.payloads(model.folder):
        json.loads(payload, object_pairs_hook=without_repetition)


def without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    assert len({key for key, _ in pairs}) == len(pairs), f"a key stands in a payload twice: {pairs}"
    return dict(pairs)


def test_rows_of_one_nanosecond_but_different_doubles_stay_apart(tmp_path: Path) -> None:
    one, other = 1.0, math.nextafter(1.0, 2)
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(x=1, _ts=one).append(y=2, _ts=other).append(z=3, _ts=one)
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"x": 1, "z": 3, "_ts": one}, {"y": 2, "_ts": other}]


def test_a_row_merged_from_many_is_one_message_in_the_file(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(flush_interval_s=60)) as recorder:
        for number in range(1000):
            recorder.topic("a").append(**{f"f{number % 7}": number}, _ts=1.0)
        assert recorder.stats()["accepted"] == 1000
    assert disk.rows(tmp_path) == {"a": [{**{f"f{n % 7}": n for n in range(1000)}, "_ts": 1.0}]}


def test_late_rows_are_read_in_the_order_of_time(tmp_path: Path) -> None:
    times = list(range(300))
    random.Random(3).shuffle(times)
    with Recorder(tmp_path, SMALL) as recorder:
        for number in times:
            recorder.topic("a").append(n=number, fill="x" * 900, _ts=float(number))
    with Recording(tmp_path) as recording:
        assert [row["n"] for row in recording["a"].rows()] == list(range(300))
