"""Random programs of append, flush, close and reopen, against a plain dictionary."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from tests.support.examples import examples
from tests.support.rules import problems

TIMES = st.sampled_from([0.0, 0.1, 0.1 + 1e-17, 1 / 3, 1.0, 1.0000000000000002, 2.5, 7.0])
VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 5), st.floats(), st.text(max_size=3), st.lists(st.floats(), max_size=3),
    st.binary(max_size=3), st.dictionaries(st.sampled_from(["x", "y1", "y2"]), st.integers(0, 3), max_size=2),
)  # fmt: skip
ROWS = st.dictionaries(st.sampled_from(["q", "q1", "q2", "v", "big"]), VALUES, max_size=3)
TOPICS = st.sampled_from(["a", "a/b", "a_b"])
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("append"), TOPICS, TIMES, ROWS),
        st.tuples(st.just("batch"), TOPICS, st.lists(st.tuples(TIMES, ROWS), min_size=1, max_size=4)),
        st.tuples(st.just("flush")),
        st.tuples(st.just("reopen")),
        st.tuples(st.just("large"), TOPICS, TIMES),
    ),
    max_size=25,
)


class Model:
    """What a recording is, assumed to be perfect: rows by topic and time, later fields winning."""

    def __init__(self) -> None:
        self.topics: dict[str, dict[float, dict[str, Any]]] = {}

    def append(self, topic: str, time_s: float, row: dict[str, Any]) -> None:
        self.topics.setdefault(topic, {}).setdefault(time_s, {}).update(row)

    def rows(self, topic: str) -> list[dict[str, str]]:
        return [canonical({**row, "_ts": time_s}) for time_s, row in sorted(self.topics[topic].items())]


def canonical(row: dict[str, Any]) -> dict[str, str]:
    return {name: repr(value) for name, value in row.items()}


@settings(max_examples=examples(120), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(steps=STEPS)
@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
def test_a_recording_is_what_was_appended_whatever_came_between(steps: list[tuple[Any, ...]], encoding: str) -> None:
    options = RecorderOptions(
        encoding=encoding, chunk_bytes=65_536, backlog_bytes=262_144, sync_interval_s=0, segment_bytes=65_536
    )
    model = Model()
    with tempfile.TemporaryDirectory() as name:
        recorder = Recorder(name, options)
        for step in steps:
            run(step, recorder, model)
            if step[0] == "reopen":
                recorder.close()
                recorder = Recorder(name, options)
        if steps and steps[-1][0] == "flush":  # read what is still being recorded
            compare(Path(name), model)
        recorder.close()
        compare(Path(name), model)
        assert [problem for path in Path(name).glob("*.mcap") for problem in problems(path)] == []


def run(step: tuple[Any, ...], recorder: Recorder, model: Model) -> None:
    match step:
        case ("append", topic, time_s, row):
            recorder.topic(topic).append(**row, _ts=time_s)
            model.append(topic, time_s, row)
        case ("batch", topic, rows):
            recorder.topic(topic).append_batch([{**row, "_ts": time_s} for time_s, row in rows])
            for time_s, row in rows:
                model.append(topic, time_s, row)
        case ("large", topic, time_s):
            recorder.topic(topic).append(big="x" * 100_000, _ts=time_s)
            model.append(topic, time_s, {"big": "x" * 100_000})
        case ("flush",):
            recorder.flush()


def compare(folder: Path, model: Model) -> None:
    with Recording(folder) as recording:
        assert sorted(recording.topics) == sorted(model.topics)
        for topic in model.topics:
            expected = model.rows(topic)
            assert [canonical(row) for row in recording[topic].rows()] == expected
            assert recording.topics[topic].count == len(expected)


ARRAYS = [
    np.arange(4.0),
    np.arange(4),
    np.arange(4, dtype=np.uint8),
    np.arange(4, dtype=np.float32) / 3,
    np.array([True, False, True, True]),
    np.arange(28.0).reshape(4, 7) / 7,
    np.arange(32, dtype=np.int16).reshape(4, 2, 4),
    np.zeros((4, 0)),
    np.asfortranarray(np.arange(8.0).reshape(4, 2)),
    np.arange(8.0)[::2],
    np.array([0.0, np.nan, np.inf, -0.0]),
    np.array([1e-7, 1e16, 5e-324, 1.7976931348623157e308]),
    ["a", "b", None, "d"],
    [1, 2.5, "x", None],
    [b"\x00", b"", b"x", b"yz"],
    [{"a": i} for i in range(4)],
    (2**64 - 1, 0, -1, 5),
]


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
@pytest.mark.parametrize("column", ARRAYS, ids=range(len(ARRAYS)))
def test_columns_are_the_rows_that_append_would_have_taken(tmp_path: Path, column: Any, encoding: str) -> None:
    times = np.array([0.0, 1 / 3, 1.7e9 + 1 / 7, 2.5])
    with Recorder(tmp_path / "columns", RecorderOptions(encoding=encoding)) as recorder:
        recorder.topic("a").append_columns(_ts=times, value=column, timestamp=np.arange(4))
    with Recorder(tmp_path / "rows") as recorder:
        for i in range(4):
            recorder.topic("a").append(value=column[i], timestamp=int(i), _ts=float(times[i]))
    with Recording(tmp_path / "columns") as columns, Recording(tmp_path / "rows") as rows:
        assert [canonical(row) for row in columns["a"].rows()] == [canonical(row) for row in rows["a"].rows()]
        assert columns.topics["a"].fields == rows.topics["a"].fields


def test_many_columns_fill_many_buffers(tmp_path: Path) -> None:
    times = np.arange(20_000) / 1e3
    q = np.random.default_rng(7).normal(size=(20_000, 7))
    with Recorder(tmp_path, RecorderOptions(chunk_bytes=65_536, backlog_bytes=262_144)) as recorder:
        recorder.topic("a").append_columns(_ts=times, q=q, n=np.arange(20_000)).append_columns(_ts=[], q=[])
    with Recording(tmp_path) as recording:
        rows = list(recording["a"].rows())
        assert [row["_ts"] for row in rows] == times.tolist()
        assert [row["q"] for row in rows] == q.tolist()
        assert str(recording.topics["a"].fields["n"]) == "integer"
