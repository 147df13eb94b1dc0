"""What cannot be recorded is refused with an error that says why, and harms nothing beside it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording, Session
from ml_dash_mcap.errors import (
    FieldError,
    IntegerRangeError,
    RecorderError,
    StateError,
    StorageError,
    TimestampError,
    TopicError,
    UsageError,
)
from tests.support import disk

END_S = 9_223_372_036.0

SMALL = RecorderOptions(backlog_bytes=4 * 1024 * 1024)

both = pytest.mark.parametrize("api", ["recorder", "experiment"])


@contextmanager
def recording(api: str, root: Path) -> Iterator[tuple[Callable[[str], Any], Path]]:
    """What opens a topic, and the folder that the rows come to."""
    if api == "recorder":
        with Recorder(root / "run", SMALL) as recorder:
            yield recorder.topic, recorder.path
    else:
        with Experiment("alice/run", root=root, options=SMALL).run as exp:
            yield exp.tracks, exp.path


def refused(call: Callable[[], object], kind: type[RecorderError], *builtins: type[Exception]) -> str:
    """Call what must be refused; returns the message."""
    with pytest.raises(kind) as caught:
        call()
    assert isinstance(caught.value, RecorderError)
    for builtin in builtins:
        assert isinstance(caught.value, builtin)
    return str(caught.value)


def nested(levels: int) -> list[Any]:
    value: list[Any] = []
    for _ in range(levels):
        value = [value]
    return value


# Time stamps


@both
@pytest.mark.parametrize(
    "given",
    [
        pytest.param(None, id="None"),
        pytest.param("soon", id="text"),
        pytest.param("", id="empty text"),
        pytest.param(b"1.5", id="bytes"),
        pytest.param([1.5], id="a list"),
        pytest.param({}, id="a dict"),
        pytest.param(1j, id="complex"),
        pytest.param(object(), id="an object"),
        pytest.param(np.array([1.5]), id="an array of one"),
        pytest.param(np.datetime64("2020-01-01"), id="a numpy date"),
        pytest.param(True, id="True"),
        pytest.param(False, id="False"),
        pytest.param(np.bool_(True), id="a numpy bool"),
        pytest.param(np.array(True), id="a 0-d bool array"),
        pytest.param(np.complex128(1.0), id="a numpy complex"),
        pytest.param(float("nan"), id="nan"),
        pytest.param("nan", id="nan as text"),
        pytest.param(np.float32("nan"), id="numpy nan"),
        pytest.param(float("inf"), id="inf"),
        pytest.param(float("-inf"), id="-inf"),
        pytest.param("inf", id="inf as text"),
        pytest.param(-1, id="-1"),
        pytest.param(-1.0, id="-1.0"),
        pytest.param(-0.001, id="a little negative"),
        pytest.param(np.int64(-5), id="negative numpy int"),
        pytest.param(END_S, id="the first too large"),
        pytest.param(1_700_000_000_000_000_000, id="nanoseconds"),
        pytest.param(10**400, id="an int beyond floats"),
        pytest.param("1e300", id="too large as text"),
    ],
)
def test_a_time_stamp_that_is_none_is_refused_and_the_rows_beside_it_are_kept(
    tmp_path: Path, api: str, given: Any
) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=1, _ts=0.5)
        message = refused(lambda: topic("arm").append(n=2, _ts=given), TimestampError, ValueError)
        topic("arm").append(n=3, _ts=1.5)
    assert "'arm'" in message and "_ts" in message
    assert disk.rows(folder)["arm"] == [{"n": 1, "_ts": 0.5}, {"n": 3, "_ts": 1.5}]


@both
def test_a_missing_time_stamp_is_refused_and_the_rows_beside_it_are_kept(tmp_path: Path, api: str) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=1, _ts=0.5)
        message = refused(lambda: topic("arm").append(n=2), TimestampError, ValueError)
        in_batch = refused(lambda: topic("arm").append_batch([{"n": 2}]), TimestampError, ValueError)
        in_columns = refused(lambda: topic("arm").append_columns(n=[2]), TimestampError, ValueError)
    assert message.startswith("Timestamp '_ts' is required for track.append() (topic 'arm')")
    assert in_batch == f"row 0 of the batch: {message}"
    assert "_ts" in in_columns and "'arm'" in in_columns
    assert disk.rows(folder)["arm"] == [{"n": 1, "_ts": 0.5}]


@both
@pytest.mark.parametrize(
    ("given", "seconds"),
    [
        (2, 2.0),
        (0, 0.0),
        (-0.0, 0.0),
        (np.array(-0.0), 0.0),
        ("1.5", 1.5),
        (" 2e1 ", 20.0),
        (np.float64(1.25), 1.25),
        (np.float32(0.5), 0.5),
        (np.float16(0.5), 0.5),
        (np.int32(7), 7.0),
        (np.uint64(7), 7.0),
        (np.array(1.5), 1.5),
        (np.array(3), 3.0),
        (np.str_("1.5"), 1.5),
        (float(np.nextafter(END_S, 0.0)), float(np.nextafter(END_S, 0.0))),
    ],
)
def test_every_number_and_numeric_text_is_a_time_stamp(tmp_path: Path, api: str, given: Any, seconds: float) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=1, _ts=given)
    assert [repr(row["_ts"]) for row in disk.rows(folder)["arm"]] == [repr(seconds)]


# Fields


class _Unlistable:
    def tolist(self) -> list[float]:
        raise KeyError("gone")


class _Unarrayable:
    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise AttributeError("gone")


_loop: list[Any] = []
_loop.append(_loop)

_UNSTORABLE = [
    pytest.param(object(), id="an object"),
    pytest.param({1.0, 2.0}, id="a set"),
    pytest.param(1j, id="complex"),
    pytest.param(np.array([1j]), id="a complex array"),
    pytest.param(np.array([object()]), id="an array of objects"),
    pytest.param(len, id="a function"),
    pytest.param(dict, id="a class"),
    pytest.param(threading.Lock(), id="a lock"),
    pytest.param((n for n in range(3)), id="a generator"),
    pytest.param([1.0, [2.0, object()]], id="an object in lists"),
    pytest.param({"a": {"b": {1.0}}}, id="a set in dicts"),
    pytest.param({(1, 2): 3}, id="a dict with a tuple as key"),
    pytest.param([float("nan"), object()], id="an object beside nan"),
    pytest.param(nested(300), id="nested too deep"),
    pytest.param(nested(50_000), id="nested far too deep"),
    pytest.param(_loop, id="a list that holds itself"),
    pytest.param("\ud800", id="a lone surrogate"),
    pytest.param(["a", {"b": "x\udfff"}], id="a lone surrogate in lists"),
    pytest.param({"\ud800": 1}, id="a lone surrogate in a key"),
    pytest.param([float("nan"), "\ud800"], id="a lone surrogate beside nan"),
    pytest.param(_Unlistable(), id="an object whose tolist fails"),
    pytest.param(_Unarrayable(), id="an object whose __array__ fails"),
]


@both
@pytest.mark.parametrize("value", _UNSTORABLE)
def test_a_field_that_cannot_be_stored_is_named_and_the_rows_beside_it_are_kept(
    tmp_path: Path, api: str, value: Any
) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=1, _ts=0.5)
        message = refused(
            lambda: topic("arm").append(before=0, grip=value, after=0, _ts=1.0), FieldError, TypeError, ValueError
        )
        topic("arm").append(n=3, _ts=1.5)
    assert "'arm'" in message and "'grip'" in message
    assert disk.rows(folder)["arm"] == [{"n": 1, "_ts": 0.5}, {"n": 3, "_ts": 1.5}]


@both
@pytest.mark.parametrize(
    "value", [2**64, -(2**63) - 1, 10**400, [1, [2**70]], {"a": -(2**80)}, np.array([2**70], dtype=object)]
)
def test_an_integer_beyond_64_bits_is_an_overflow_that_names_the_field(tmp_path: Path, api: str, value: Any) -> None:
    with recording(api, tmp_path) as (topic, folder):
        message = refused(
            lambda: topic("arm").append(ticks=value, _ts=1.0), IntegerRangeError, OverflowError, ValueError, TypeError
        )
        topic("arm").append(ticks=[2**64 - 1, -(2**63)], _ts=1.5)
    assert "'arm'" in message and "'ticks'" in message and "64 bits" in message
    assert disk.rows(folder)["arm"] == [{"ticks": [2**64 - 1, -(2**63)], "_ts": 1.5}]


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
@pytest.mark.parametrize("leaf", [1.5, 7, None, math.inf, b"\0", np.int64(7)], ids=repr)
@pytest.mark.parametrize("around", [lambda value: [value], lambda value: {"a": value}], ids=["lists", "dicts"])
def test_lists_and_dicts_of_253_levels_are_stored_whatever_they_hold_and_no_more(
    tmp_path: Path, encoding: str, leaf: Any, around: Callable[[Any], Any]
) -> None:
    value = leaf
    for _ in range(253):
        value = around(value)
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("arm", encoding=encoding)
        topic.append(a=value, _ts=1.0)
        message = refused(lambda: topic.append(a=around(value), _ts=2.0), FieldError)
    assert "field 'a' is nested deeper than 253 levels" in message
    with Recording(tmp_path) as rec:
        [row] = rec["arm"].rows()
    assert row == {"a": value, "_ts": 1.0}


@both
def test_a_field_name_with_a_lone_surrogate_is_refused(tmp_path: Path, api: str) -> None:
    with recording(api, tmp_path) as (topic, folder):
        message = refused(lambda: topic("arm").append(**{"\ud800": 1}, _ts=1.0), FieldError, TypeError, ValueError)
        topic("arm").append(n=1, _ts=1.5)
    assert "'arm'" in message and repr("\ud800") in message
    assert disk.rows(folder)["arm"] == [{"n": 1, "_ts": 1.5}]


@both
@pytest.mark.parametrize(
    "call",
    [
        pytest.param(lambda topic: topic.append(_exact={}, _ts=1.0), id="append"),
        pytest.param(lambda topic: topic.append(_exact=None, _ts=1.0), id="append None"),
        pytest.param(lambda topic: topic.append_batch([{"_exact": {}, "_ts": 1.0}]), id="append_batch"),
        pytest.param(lambda topic: topic.append_columns(_exact=[1], _ts=[1.0]), id="append_columns"),
    ],
)
def test_the_field_name_of_the_side_key_is_reserved(tmp_path: Path, api: str, call: Callable[[Any], object]) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=1, _ts=0.5)
        message = refused(lambda: call(topic("arm")), FieldError, TypeError, ValueError)
    assert "'arm'" in message and "'_exact'" in message and "reserved" in message
    assert disk.rows(folder)["arm"] == [{"n": 1, "_ts": 0.5}]


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(lambda topic: topic.append(timestamp=7, n=2, _ts=1.0), id="append"),
        pytest.param(lambda topic: topic.append_batch([{"timestamp": 7, "n": 2, "_ts": 1.0}]), id="append_batch"),
        pytest.param(lambda topic: topic.append_columns(timestamp=[7], n=[2], _ts=[1.0]), id="append_columns"),
    ],
)
def test_a_field_called_timestamp_is_a_field_of_a_recorder_and_reserved_in_an_experiment(
    tmp_path: Path, call: Callable[[Any], object]
) -> None:
    with recording("recorder", tmp_path) as (topic, folder):
        call(topic("arm"))
    assert disk.rows(folder)["arm"] == [{"timestamp": 7, "n": 2, "_ts": 1.0}]
    with recording("experiment", tmp_path) as (topic, folder):
        topic("arm").append(n=1, _ts=0.5)
        message = refused(lambda: call(topic("arm")), FieldError, TypeError, ValueError)
    assert "'arm'" in message and "'timestamp'" in message
    assert disk.rows(folder)["arm"] == [{"n": 1, "_ts": 0.5}]


@both
@pytest.mark.parametrize(
    "call",
    [
        pytest.param(lambda topic: topic.append({"n": 1}, _ts=1.0), id="append"),
        pytest.param(lambda topic: topic.append(1.0, 2.0, n=1, _ts=1.0), id="append two"),
        pytest.param(lambda topic: topic.append_columns([1.0], _ts=[1.0]), id="append_columns"),
    ],
)
def test_positional_arguments_are_refused(tmp_path: Path, api: str, call: Callable[[Any], object]) -> None:
    with recording(api, tmp_path) as (topic, folder):
        message = refused(lambda: call(topic("arm")), UsageError, TypeError)
        topic("arm").append(n=1, _ts=1.5)
    assert "'arm'" in message and "by name" in message
    assert disk.rows(folder)["arm"] == [{"n": 1, "_ts": 1.5}]


# What was appended is a snapshot


@both
def test_changing_values_after_append_does_not_change_the_rows(tmp_path: Path, api: str) -> None:
    small, big, column, times = np.array([1.0, 2.0]), np.ones(500), np.array([[5.0], [6.0]]), np.array([3.0, 4.0])
    listed, raw, inner = [1, 2], bytearray(b"ab"), {"a": [1]}
    row: dict[str, Any] = {"n": [9], "_ts": 2.0}
    with recording(api, tmp_path) as (topic, folder):
        arm = topic("arm")
        arm.append(small=small, big=big, listed=listed, inner=inner, _ts=0.0)
        arm.append(raw=raw, _ts=1.0)
        arm.append_batch([row])
        arm.append_columns(c=column, _ts=times)
        for array in (small, big, column, times):
            array[:] = -1.0
        listed.append(-1)
        raw[:] = b"zz"
        inner["a"].append(-1)
        row["n"].append(-1)
        row["_ts"] = -1.0
    assert disk.rows(folder)["arm"] == [
        {"small": [1.0, 2.0], "big": [1.0] * 500, "listed": [1, 2], "inner": {"a": [1]}, "_ts": 0.0},
        {"raw": "YWI=", "_exact": {"bytes": {"": ["raw"]}}, "_ts": 1.0},
        {"n": [9], "_ts": 2.0},
        {"c": [5.0], "_ts": 3.0},
        {"c": [6.0], "_ts": 4.0},
    ]


# Batches and columns


@both
@pytest.mark.parametrize(
    ("bad", "kind", "builtin"),
    [
        pytest.param({"n": 2}, TimestampError, ValueError, id="no time stamp"),
        pytest.param({"n": 2, "_ts": float("nan")}, TimestampError, ValueError, id="nan as time stamp"),
        pytest.param({"n": 2, "_ts": -3.0}, TimestampError, ValueError, id="negative time stamp"),
        pytest.param({"n": object(), "_ts": 1.0}, FieldError, TypeError, id="an object"),
        pytest.param({"n": 2**70, "_ts": 1.0}, IntegerRangeError, OverflowError, id="a large integer"),
        pytest.param({"n": "\ud800", "_ts": 1.0}, FieldError, ValueError, id="a lone surrogate"),
        pytest.param({"_exact": 1, "_ts": 1.0}, FieldError, ValueError, id="a reserved name"),
        pytest.param({1: 2, "_ts": 1.0}, FieldError, TypeError, id="a name that is no text"),
        pytest.param(5, FieldError, TypeError, id="no dict"),
        pytest.param("row", FieldError, ValueError, id="text"),
        pytest.param(None, FieldError, TypeError, id="None"),
    ],
)
def test_a_batch_is_taken_whole_or_not_at_all_and_names_the_bad_row(
    tmp_path: Path, api: str, bad: Any, kind: type[RecorderError], builtin: type[Exception]
) -> None:
    good = [{"n": n, "_ts": float(n)} for n in range(2)]
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=9, _ts=9.0)
        message = refused(lambda: topic("arm").append_batch([*good, bad, {"n": 3, "_ts": 3.0}]), kind, builtin)
        topic("arm").append_batch([{"n": 10, "_ts": 10.0}])
    assert "row 2" in message and "'arm'" in message
    assert disk.rows(folder)["arm"] == [{"n": 9, "_ts": 9.0}, {"n": 10, "_ts": 10.0}]


@both
def test_a_batch_whose_iterator_fails_midway_is_not_taken(tmp_path: Path, api: str) -> None:
    def rows() -> Iterator[dict[str, Any]]:
        yield {"n": 1, "_ts": 1.0}
        raise LookupError("no more")

    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=0, _ts=0.0)
        with pytest.raises(LookupError, match="no more"):
            topic("arm").append_batch(rows())
    assert disk.rows(folder)["arm"] == [{"n": 0, "_ts": 0.0}]


@both
@pytest.mark.parametrize("rows", [pytest.param(5, id="int"), pytest.param(None, id="None")])
def test_a_batch_that_is_no_iterable_is_refused(tmp_path: Path, api: str, rows: Any) -> None:
    with recording(api, tmp_path) as (topic, _):
        refused(lambda: topic("arm").append_batch(rows), RecorderError, TypeError)


@both
@pytest.mark.parametrize(
    "times",
    [
        pytest.param([0.0, float("nan")], id="nan"),
        pytest.param(np.array([0.0, np.inf]), id="inf"),
        pytest.param([0.0, -1.0], id="negative"),
        pytest.param([0.0, END_S], id="too large"),
        pytest.param(["a", "b"], id="text"),
        pytest.param(["3", "4.5"], id="numbers as text"),
        pytest.param([None, 1.0], id="None"),
        pytest.param([1j, 1.0], id="complex"),
        pytest.param([[0.0], [1.0, 2.0]], id="ragged"),
        pytest.param(np.zeros((2, 2)), id="two-dimensional"),
        pytest.param(None, id="None alone"),
        pytest.param({}, id="a dict"),
        pytest.param([True, False], id="bools"),
        pytest.param(np.array([True, False]), id="a bool array"),
        pytest.param(np.array(["2020-01-01", "2020-01-02"], "M8[s]"), id="dates"),
        pytest.param(np.array([1j, 1.0]), id="a complex array"),
        pytest.param([0.0, 10**400], id="an int beyond floats"),
    ],
)
def test_columns_with_a_bad_time_stamp_are_refused_whole(tmp_path: Path, api: str, times: Any) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=9, _ts=9.0)
        message = refused(lambda: topic("arm").append_columns(_ts=times, n=[1, 2]), TimestampError, ValueError)
    assert "'arm'" in message and "_ts" in message
    assert disk.rows(folder)["arm"] == [{"n": 9, "_ts": 9.0}]


@both
def test_a_single_number_is_no_column_of_time_stamps(tmp_path: Path, api: str) -> None:
    with recording(api, tmp_path) as (topic, _):
        refused(lambda: topic("arm").append_columns(_ts=1.0, n=[1]), TimestampError, ValueError)


@both
@pytest.mark.parametrize(
    ("column", "builtin"),
    [
        pytest.param([1, 2, 3], ValueError, id="too long"),
        pytest.param([1], ValueError, id="too short"),
        pytest.param([], ValueError, id="empty"),
        pytest.param(np.zeros((3, 2)), ValueError, id="an array too long"),
        pytest.param(np.zeros((0, 2)), ValueError, id="an empty array"),
        pytest.param("ab", TypeError, id="text"),
        pytest.param(b"ab", TypeError, id="bytes"),
        pytest.param({"a": 1, "b": 2}, TypeError, id="a dict"),
        pytest.param(5, TypeError, id="a number"),
        pytest.param(None, TypeError, id="None"),
        pytest.param([1, object()], TypeError, id="an object"),
        pytest.param(["a", "\ud800"], ValueError, id="a lone surrogate"),
        pytest.param([1, 2**70], OverflowError, id="a large integer"),
        pytest.param(np.array([1j, 2j]), TypeError, id="complex"),
        pytest.param(np.array(1.0), TypeError, id="a 0-d array"),
        pytest.param({1.0, 2.0}, TypeError, id="a set"),
    ],
)
def test_columns_with_a_bad_column_are_refused_whole(
    tmp_path: Path, api: str, column: Any, builtin: type[Exception]
) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=9, _ts=9.0)
        message = refused(
            lambda: topic("arm").append_columns(_ts=[0.0, 1.0], good=[1, 2], bad=column), FieldError, builtin
        )
    assert "'arm'" in message and "'bad'" in message
    assert disk.rows(folder)["arm"] == [{"n": 9, "_ts": 9.0}]


@both
def test_a_bad_value_late_in_long_columns_is_found_before_any_row_is_taken(tmp_path: Path, api: str) -> None:
    values: list[Any] = ["a"] * 2000
    values[1999] = object()
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=9, _ts=9.0)
        refused(lambda: topic("arm").append_columns(_ts=np.arange(2000.0), a=values), FieldError, TypeError, ValueError)
    assert disk.rows(folder)["arm"] == [{"n": 9, "_ts": 9.0}]


@both
@pytest.mark.parametrize("column", [pytest.param([1], id="a list"), pytest.param(np.array([1]), id="an array")])
def test_a_column_name_with_a_lone_surrogate_is_refused(tmp_path: Path, api: str, column: Any) -> None:
    with recording(api, tmp_path) as (topic, _):
        refused(lambda: topic("arm").append_columns(_ts=[1.0], **{"\ud800": column}), FieldError, TypeError, ValueError)


@both
def test_columns_of_text_and_of_mixed_values_are_rows_like_any_other(tmp_path: Path, api: str) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append_columns(
            _ts=[0, 1.5, np.float32(2)],
            word=["a", "ü", ""],
            mixed=[1, "two", None],
            lists=[[1.0], [], [2, 3]],
            q=np.array([[1.0, 2.0], [3.0, 4.0], [5.0, np.nan]]),
            texts=np.array(["x", "y", "z"]),
        )
        topic("arm").append_columns(_ts=[3, 4])
        topic("arm").append_columns(_ts=[], n=[])
    nan = {"NaN": {"/q": [1]}}
    assert disk.rows(folder)["arm"] == [
        {"word": "a", "mixed": 1, "lists": [1.0], "q": [1.0, 2.0], "texts": "x", "_ts": 0.0},
        {"word": "ü", "mixed": "two", "lists": [], "q": [3.0, 4.0], "texts": "y", "_ts": 1.5},
        {"word": "", "mixed": None, "lists": [2, 3], "q": [5.0, None], "texts": "z", "_exact": nan, "_ts": 2.0},
        {"_ts": 3.0},
        {"_ts": 4.0},
    ]


# Topics


@both
@pytest.mark.parametrize(
    "name", ["", " ", "\t\n", "x" * 1025, "é" * 513, "a\0b", "\0", "ml_dash/x", "ml_dash/log", "a\ud800"]
)
def test_a_topic_name_that_cannot_be_is_refused(tmp_path: Path, api: str, name: str) -> None:
    with recording(api, tmp_path) as (topic, folder):
        message = refused(lambda: topic(name), TopicError, ValueError)
        topic("x" * 1024).append(n=1, _ts=1.0)
        topic("ml_dash").append(n=2, _ts=1.0)
    assert "topic" in message
    assert disk.counts(folder) == {"x" * 1024: 1, "ml_dash": 1}


@both
@pytest.mark.parametrize("name", [None, 5, b"arm", ["arm"], ("arm",)])
def test_a_topic_name_that_is_no_text_is_a_type_error(tmp_path: Path, api: str, name: Any) -> None:
    with recording(api, tmp_path) as (topic, _):
        assert "text" in refused(lambda: topic(name), UsageError, TypeError)


@both
def test_topics_that_look_alike_stay_apart_and_nothing_is_written_outside_the_folder(tmp_path: Path, api: str) -> None:
    names = [
        "a/b",
        "a_b",
        "a//b",
        "/a/b",
        "a/b/",
        "../x",
        "../../x",
        "/x",
        "x",
        "..",
        ".",
        "a\\b",
        "~",
        "A/B",
        "a b",
        "a\nb",
        "\u00e9",
        "e\u0301",
    ]
    inside = tmp_path / "deep" / "inside"
    with recording(api, inside) as (topic, folder):
        for number, name in enumerate(names):
            topic(name).append(n=number, _ts=1.0)
    assert disk.rows(folder) == {name: [{"n": number, "_ts": 1.0}] for number, name in enumerate(names)}
    made = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert made == disk.segments(folder) and len(made) == 1


@both
@pytest.mark.parametrize(
    "said",
    [
        pytest.param({"description": "\ud800"}, id="a lone surrogate"),
        pytest.param({"tags": [{1}]}, id="a set as tag"),
        pytest.param({"tags": 5}, id="a number as tags"),
        pytest.param({"metadata": 5}, id="a number as metadata"),
    ],
)
def test_what_cannot_be_said_about_a_topic_is_refused(tmp_path: Path, api: str, said: dict[str, Any]) -> None:
    with recording(api, tmp_path) as (topic, _):
        call: Any = topic
        refused(lambda: call("arm", **said), RecorderError)


@pytest.mark.parametrize(
    "parameters",
    [
        pytest.param({"lr": {1}}, id="a set"),
        pytest.param({"lr": "\ud800"}, id="a lone surrogate"),
        pytest.param({"lr": 2**70}, id="a large integer"),
        pytest.param({"\ud800": 1}, id="a lone surrogate in the name"),
        pytest.param({1: 1}, id="a name that is no text"),
    ],
)
def test_a_parameter_that_cannot_be_stored_is_refused(tmp_path: Path, parameters: Any) -> None:
    with Recorder(tmp_path) as recorder:
        message = refused(lambda: recorder.set_parameters(parameters), FieldError, TypeError, ValueError)
    assert repr(next(iter(parameters))) in message


@pytest.mark.parametrize("given", [{"metadata": {"a": "\ud800"}}, {"metadata": {"\ud800": "a"}}, {"prefix": "\ud800"}])
def test_what_cannot_be_said_about_a_recording_is_refused_at_once(tmp_path: Path, given: dict[str, Any]) -> None:
    refused(lambda: Recorder(tmp_path / "run", **given), FieldError, TypeError, ValueError)


# Folders


def _recorder_at(path: Path) -> None:
    Recorder(path)


def _experiment_at(path: Path) -> None:
    Experiment("run", root=path).run.start()


def _session_at(path: Path) -> None:
    Session(name="run", workspace="lab", local_path=path).open()


starters = pytest.mark.parametrize("start", [_recorder_at, _experiment_at, _session_at])


@starters
@pytest.mark.parametrize("where", ["file", "file/deeper", "file/deeper/still"])
def test_a_root_that_is_a_file_or_lies_in_one_is_an_error_at_start(
    tmp_path: Path, start: Callable[[Path], None], where: str
) -> None:
    (tmp_path / "file").write_bytes(b"mine")
    message = refused(lambda: start(tmp_path / where), StorageError, OSError)
    assert str(tmp_path / "file") in message
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("file", b"mine")]


@pytest.mark.parametrize(
    "start",
    [
        _recorder_at,
        lambda path: Experiment(path.name, root=path.parent).run.start(),
        lambda path: Session(name=path.name, workspace="lab", local_path=path.parent).open(),
    ],
    ids=["recorder", "experiment", "session"],
)
def test_a_folder_that_is_called_like_a_file_is_an_error_at_start(
    tmp_path: Path, start: Callable[[Path], object]
) -> None:
    message = refused(lambda: start(tmp_path / "run.mcap"), StorageError, OSError)
    assert "run.mcap" in message and "folder" in message
    assert list(tmp_path.rglob("*.mcap")) == []


def test_a_folder_whose_name_is_too_long_is_an_error_at_start(tmp_path: Path) -> None:
    refused(lambda: Recorder(tmp_path / ("x" * 300)), StorageError, OSError)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "path",
    [
        pytest.param("a\0b", id="NUL"),
        pytest.param("a\ud800b", id="a lone surrogate"),
        pytest.param(5, id="a number"),
    ],
)
def test_a_path_that_cannot_be_is_an_error_of_ours(tmp_path: Path, path: Any) -> None:
    refused(lambda: Recorder(tmp_path / path if isinstance(path, str) else path), RecorderError)


# After the end


def test_a_closed_recorder_takes_nothing_and_says_so(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        arm = recorder.topic("arm").append(n=1, _ts=1.0)
    calls: list[Callable[[], object]] = [
        lambda: arm.append(n=2, _ts=2.0),
        lambda: arm.append(n=2, _ts=2.0, big="x" * 3_000_000),
        lambda: arm.append_batch([{"n": 2, "_ts": 2.0}]),
        lambda: arm.append_columns(n=[2], _ts=[2.0]),
        arm.flush,
        recorder.flush,
        lambda: recorder.topic("new"),
        lambda: recorder.topic("arm", description="late"),
        lambda: recorder.set_parameters({"a": 1}),
        lambda: recorder.write_metadata("a", {}),
    ]
    for call in calls:
        assert "closed" in refused(call, StateError, RuntimeError)
    recorder.close()
    assert disk.rows(tmp_path) == {"arm": [{"n": 1, "_ts": 1.0}]}


def test_an_experiment_that_is_not_started_or_has_ended_takes_and_reads_nothing(tmp_path: Path) -> None:
    experiment = Experiment("alice/run", root=tmp_path)
    assert "not started" in refused(lambda: experiment.tracks, StateError, RuntimeError)
    with experiment.run as exp:
        arm = exp.tracks("arm").append(n=1, _ts=1.0)
        piece = arm.slice()
    calls: list[Callable[[], object]] = [
        lambda: arm.append(n=2, _ts=2.0),
        lambda: arm.append_batch([{"n": 2, "_ts": 2.0}]),
        lambda: arm.append_columns(n=[2], _ts=[2.0]),
        arm.flush,
        arm.read,
        arm.list_entries,
        lambda: piece.findByTime(1.0),
        lambda: experiment.tracks,
        lambda: experiment.metrics,
        lambda: experiment.params,
        lambda: experiment.logs,
        lambda: experiment.files,
        lambda: experiment.log("late"),
        experiment.flush,
    ]
    for call in calls:
        refused(call, StateError, RuntimeError)
    assert disk.rows(exp.path)["arm"] == [{"n": 1, "_ts": 1.0}]


def test_a_session_that_is_not_open_or_has_ended_takes_and_reads_nothing(tmp_path: Path) -> None:
    session = Session(name="run", workspace="lab", local_path=tmp_path)
    refused(lambda: session.track("arm"), StateError, RuntimeError)
    with session:
        arm = session.track("arm").append(n=1, _ts=1.0)
    calls: list[Callable[[], object]] = [
        lambda: arm.append(n=2, _ts=2.0),
        lambda: arm.append(n=2),
        lambda: arm.append_batch([{"n": 2}]),
        arm.flush,
        arm.read,
        lambda: session.track("arm"),
        lambda: session.tracks,
        session.parameters,
        session.files,
        session.stats,
        lambda: session.log("late"),
    ]
    for call in calls:
        refused(call, StateError, RuntimeError)
    session.close()
    assert disk.rows(session.path)["arm"] == [{"n": 1, "_ts": 1.0}]


@both
def test_looking_for_what_is_not_there_is_a_key_error_of_ours(tmp_path: Path, api: str) -> None:
    with recording(api, tmp_path) as (topic, folder):
        topic("arm").append(n=1, _ts=1.0)
    with Recording(folder) as found:
        assert "'arn'" in refused(lambda: found["arn"], RecorderError, KeyError)
    missing = refused(lambda: Recording(tmp_path / "nowhere"), RecorderError, FileNotFoundError, OSError)
    assert "nowhere" in missing
