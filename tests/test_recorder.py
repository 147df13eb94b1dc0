"""A recorder refuses bad input by name and value, and loses nothing beside it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap import clock, errors
from ml_dash_mcap.errors import (
    FieldError,
    OptionError,
    RecorderError,
    StateError,
    StorageError,
    TimestampError,
    TopicError,
    UsageError,
)
from ml_dash_mcap.recorder import Recorder, open_topic
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.topic import EventTopic
from tests.support import disk
from tests.support.case_ids import stable_repr

Row = dict[str, Any]


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    with Recorder(tmp_path / "run") as one:
        yield one


def rows(recorder: Recorder, topic: str) -> list[Row]:
    """Close, and read a topic as a user does."""
    recorder.close()
    with Recording(recorder.path) as recording:
        return list(recording[topic].rows()) if topic in recording else []


class Unstorable:
    pass


class Sneaky:
    """Fails when it is looked at, as a tensor on a lost device does."""

    def tolist(self) -> list[float]:
        raise RuntimeError("the device is gone")


LOOP: list[Any] = []
LOOP.append(LOOP)

NO_TIME = [
    ({}, ValueError, "'_ts' is required"),
    ({"_ts": None}, ValueError, "must be numeric"),
    ({"_ts": "abc"}, ValueError, "must be numeric"),
    ({"_ts": [1.0]}, ValueError, "must be numeric"),
    ({"_ts": np.array([1.0])}, ValueError, "must be numeric"),
    ({"_ts": {}}, ValueError, "must be numeric"),
    ({"_ts": b"1"}, ValueError, "must be numeric"),
    ({"_ts": 1j}, ValueError, "must be numeric"),
    ({"_ts": True}, ValueError, "must be numeric"),
    ({"_ts": np.True_}, ValueError, "must be numeric"),
    ({"_ts": math.nan}, ValueError, "nan"),
    ({"_ts": np.float32("nan")}, ValueError, "nan"),
    ({"_ts": math.inf}, ValueError, "inf"),
    ({"_ts": -math.inf}, ValueError, "inf"),
    ({"_ts": "nan"}, ValueError, "nan"),
    ({"_ts": 10**400}, ValueError, "finite"),
    ({"_ts": -0.5}, ValueError, "negative"),
    ({"_ts": -5}, ValueError, "negative"),
    ({"_ts": -1}, ValueError, 'timestamps="auto"'),
    ({"_ts": clock.END_S}, ValueError, "nanoseconds"),
    ({"_ts": 1e10}, ValueError, "nanoseconds"),
    ({"_ts": 1.7e18}, ValueError, "nanoseconds"),
]
BAD_FIELDS = [
    ({"q": object()}, TypeError, "'q'"),
    ({"q": Unstorable()}, TypeError, "Unstorable"),
    ({"q": [1, {"deep": Unstorable()}]}, TypeError, "'q'"),
    ({"q": Sneaky()}, TypeError, "'q'"),
    ({"q": {1, 2}}, TypeError, "'q'"),
    ({"q": 1j}, TypeError, "'q'"),
    ({"q": np.zeros(3, complex)}, TypeError, "'q'"),
    ({"q": lambda: 0}, TypeError, "'q'"),
    ({"q": {(1, 2): 3}}, TypeError, "'q'"),
    ({"q": LOOP}, TypeError, "nested"),
    ({"q": "\ud800"}, TypeError, "'q'"),
    ({"q": {"\ud800": 1}}, TypeError, "'q'"),
    ({"q": 2**64}, OverflowError, "'q'"),
    ({"q": -(2**63) - 1}, OverflowError, "'q'"),
    ({"q": [1, [2**70]]}, OverflowError, "'q'"),
    ({"q": 10**5000}, OverflowError, "'q'"),
    ({"_exact": 1}, TypeError, "reserved"),
]


def shortly(row: Row) -> str:
    return (
        ", ".join(f"{name}={hex(v) if isinstance(v, int) else stable_repr(v)}"[:40] for name, v in row.items())
        or "nothing"
    )


def named(cases: list[tuple[Row, type[BaseException], str]]) -> Any:
    return pytest.mark.parametrize(("bad", "builtin", "said"), cases, ids=[shortly(case[0]) for case in cases])


@named(NO_TIME)
def test_a_bad_time_stamp_is_refused_by_name_and_value(recorder: Recorder, bad: Row, builtin: type, said: str) -> None:
    topic = recorder.topic("robot/arm").append(q=1, _ts=1.0)
    with pytest.raises(TimestampError, match=said) as caught:
        topic.append(q=2, **bad)
    assert isinstance(caught.value, builtin)
    assert isinstance(caught.value, RecorderError)
    assert "robot/arm" in str(caught.value)
    topic.append(q=3, _ts=3.0)
    assert rows(recorder, "robot/arm") == [{"q": 1, "_ts": 1.0}, {"q": 3, "_ts": 3.0}]


@named(BAD_FIELDS)
def test_a_bad_field_is_refused_with_its_topic_and_costs_no_other_row(
    recorder: Recorder, bad: Row, builtin: type, said: str
) -> None:
    topic = recorder.topic("robot/arm").append(q=1, _ts=1.0)
    with pytest.raises(FieldError, match=said) as caught:
        topic.append(**bad, other=5, _ts=2.0)
    assert isinstance(caught.value, builtin)
    assert isinstance(caught.value, ValueError)
    assert "robot/arm" in str(caught.value)
    topic.append(q=3, _ts=3.0)
    assert rows(recorder, "robot/arm") == [{"q": 1, "_ts": 1.0}, {"q": 3, "_ts": 3.0}]


@named(NO_TIME + BAD_FIELDS)
def test_a_batch_with_a_bad_row_is_refused_as_a_whole_with_the_number_of_the_row(
    recorder: Recorder, bad: Row, builtin: type, said: str
) -> None:
    topic = recorder.topic("robot/arm")
    good = {"q": 1, "_ts": 1.0}
    wrong = bad if "_ts" in bad or not bad else {**bad, "_ts": 2.0}
    with pytest.raises(builtin, match="row 1") as caught:
        topic.append_batch([good, wrong, good])
    assert isinstance(caught.value, RecorderError)
    assert rows(recorder, "robot/arm") == []


@pytest.mark.parametrize("batch", [[5], [None], [["abc"]], [{"q": 1, "_ts": 1.0}, "text"]], ids=stable_repr)
def test_a_batch_of_what_are_no_rows_is_refused(recorder: Recorder, batch: Any) -> None:
    with pytest.raises(FieldError, match="row"):
        recorder.topic("a").append_batch(batch)
    assert rows(recorder, "a") == []


def test_positional_arguments_are_refused(recorder: Recorder) -> None:
    topic = recorder.topic("a")
    with pytest.raises(UsageError, match="by name") as caught:
        topic.append({"q": 1}, _ts=1.0)
    assert isinstance(caught.value, TypeError)
    with pytest.raises(UsageError, match="by name"):
        topic.append_columns([1.0], _ts=[1.0])
    assert rows(recorder, "a") == []


@pytest.mark.parametrize(
    ("name", "builtin"),
    [
        ("", ValueError),
        ("  ", ValueError),
        ("x" * 1025, ValueError),
        ("\u00e4" * 513, ValueError),
        ("a\0b", ValueError),
        ("\ud800", ValueError),
        ("ml_dash/log", ValueError),
        (None, TypeError),
        (5, TypeError),
        (b"a", TypeError),
        (["a"], TypeError),
    ],
    ids=lambda value: stable_repr(value)[:20],
)
def test_a_bad_topic_is_refused(recorder: Recorder, name: Any, builtin: type) -> None:
    with pytest.raises(RecorderError) as caught:
        recorder.topic(name)
    assert isinstance(caught.value, builtin)
    recorder.topic("good").append(x=1, _ts=1.0)
    recorder.close()
    assert disk.counts(recorder.path) == {"good": 1}


@pytest.mark.parametrize(
    "name",
    [
        "a",
        "/",
        "//",
        "..",
        "../x",
        "/abs/../../x",
        "a/b",
        "a_b",
        "a b",
        "a\nb",
        '"',
        "\\",
        "x" * 1024,
        "\U0001f916",
        "a/b/",
        ".",
    ],
)
def test_a_topic_is_a_name_and_not_a_path(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "deep" / "run"
    with Recorder(folder) as recorder:
        recorder.topic(name).append(x=1, _ts=1.0)
        recorder.topic("other").append(x=2, _ts=1.0)
    assert disk.rows(folder) == {name: [{"x": 1, "_ts": 1.0}], "other": [{"x": 2, "_ts": 1.0}]}
    assert [path.relative_to(folder).parts[0] for path in tmp_path.rglob("*.mcap")] == [disk.segments(folder)[0].name]


def test_topics_whose_names_a_file_system_would_mix_stay_apart(tmp_path: Path) -> None:
    names = ["a/b", "a_b", "a.b", "A/B", "a//b", "a/b/", "../a/b", "e\u0301", "\u00e9"]
    with Recorder(tmp_path) as recorder:
        for number, name in enumerate(names):
            recorder.topic(name).append(x=number, _ts=1.0)
    assert disk.rows(tmp_path) == {name: [{"x": number, "_ts": 1.0}] for number, name in enumerate(names)}


def test_the_same_name_is_the_same_topic_and_of_one_class(recorder: Recorder) -> None:
    assert recorder.topic("a") is recorder.topic("a")
    assert recorder.topic("a", description="later") is recorder.topic("a")
    assert recorder.topics() == ["a"]
    with pytest.raises(TopicError, match="open"):
        open_topic(recorder, "a", "track", EventTopic)


@pytest.mark.parametrize("path", ["file", "file/run", "file/deep/run"])
def test_a_root_that_is_a_file_is_refused(tmp_path: Path, path: str) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match="folder") as caught:
        Recorder(tmp_path / path)
    assert isinstance(caught.value, OSError)
    assert caught.value.errno
    assert sorted(tmp_path.iterdir()) == [tmp_path / "file"]


def test_a_root_that_cannot_be_written_is_refused() -> None:
    with pytest.raises(StorageError):
        Recorder("/proc/self/run")


def test_the_path_of_a_file_is_not_taken_for_a_folder(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="folder"):
        Recorder(tmp_path / "run.mcap")


@pytest.mark.parametrize("rule", ["", "Auto", None, 5])
def test_a_rule_for_time_stamps_that_is_not_there_is_refused(tmp_path: Path, rule: Any) -> None:
    with pytest.raises(OptionError, match="strict"):
        Recorder(tmp_path, timestamps=rule)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "use", ["append", "append_batch", "append_columns", "flush", "topic", "set_parameters", "metadata"]
)
def test_a_closed_recorder_takes_nothing_and_says_so(tmp_path: Path, use: str) -> None:
    recorder = Recorder(tmp_path)
    topic = recorder.topic("a").append(x=1, _ts=1.0)
    recorder.close()
    recorder.close()
    uses: dict[str, Callable[[], object]] = {
        "append": lambda: topic.append(x=2, _ts=2.0),
        "append_batch": lambda: topic.append_batch([{"x": 2, "_ts": 2.0}]),
        "append_columns": lambda: topic.append_columns(x=[2], _ts=[2.0]),
        "flush": lambda: topic.flush(),
        "topic": lambda: recorder.topic("new"),
        "set_parameters": lambda: recorder.set_parameters({"a": 1}),
        "metadata": lambda: recorder.write_metadata("x", {"a": "1"}),
    }
    with pytest.raises(StateError, match="closed") as caught:
        uses[use]()
    assert isinstance(caught.value, RuntimeError)
    assert (recorder.closed, recorder.stats()["accepted"]) == (True, 1)
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 1.0}]}


def test_an_exception_in_the_body_closes_the_recorder_and_passes(tmp_path: Path) -> None:
    def fail_while_recording() -> None:
        with Recorder(tmp_path) as recorder:
            recorder.topic("a").append(x=1 / recorder.topic("a").append(x=1, _ts=1.0).name.count("b"), _ts=2.0)

    with pytest.raises(ZeroDivisionError):
        fail_while_recording()
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "_ts": 1.0}]}


def test_every_error_is_of_our_tree_and_a_builtin_too() -> None:
    ours = [one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, RecorderError)]
    assert len(ours) > 10
    for one in ours:
        builtins = [
            base
            for base in one.__mro__
            if base.__module__ == "builtins" and base not in (Exception, BaseException, object)
        ]
        assert one is RecorderError or builtins
