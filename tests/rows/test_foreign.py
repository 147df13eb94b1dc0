"""Each kind of Python's and of other libraries' values is stored as documented, or refused with what to pass."""

from __future__ import annotations

import array
import collections
import dataclasses
import datetime
import decimal
import enum
import fractions
import json
import types
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.errors import FieldError
from ml_dash_mcap.rows.json_text import exact
from tests.support.case_ids import stable_repr


class Text(str, enum.Enum):
    A = "a"


class Number(enum.IntEnum):
    SEVEN = 7


class Flags(enum.IntFlag):
    X = 1
    Y = 2


class Plain(enum.Enum):
    A = "plain"
    B = b"x"
    C = (1, 2.5)
    D = float("inf")


class Name(str):
    pass


class Count(int):
    pass


class Tensor:
    """Like a tensor of torch: a shape and lists, and perhaps an array."""

    def __init__(self, values: Any, *, has_array: bool = True) -> None:
        self._values = np.asarray(values)
        self.shape = self._values.shape
        if has_array:
            self.__class__ = TensorWithArray

    def size(self) -> tuple[int, ...]:
        return self.shape

    def tolist(self) -> Any:
        return self._values.tolist()


class TensorWithArray(Tensor):
    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return self._values


class OnDevice(Tensor):
    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise TypeError("can't convert a device tensor to numpy")


class Wrapped:
    def __init__(self, values: Any) -> None:
        self._values = values

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return self._values


@dataclasses.dataclass(slots=True)
class Pose:
    xyz: Any
    frame: str = "base"


RECORDS = np.array(
    [(1, (2.0, 3.0), "a", ((4, True),)), (5, (6.0, 7.0), "b", ((8, False),))],
    [("i", "i2"), ("v", ">f4", (2,)), ("t", "U2"), ("n", [("m", [("k", "u1"), ("ok", "?")])])],
)
RECORD_DICTS = [
    {"i": 1, "v": [2.0, 3.0], "t": "a", "n": {"m": {"k": 4, "ok": True}}},
    {"i": 5, "v": [6.0, 7.0], "t": "b", "n": {"m": {"k": 8, "ok": False}}},
]

STORED: dict[str, tuple[Any, Any]] = {
    "text enum": (Text.A, "a"),
    "number enum": (Number.SEVEN, 7),
    "flags": (Flags.X | Flags.Y, 3),
    "enum of bytes": (Plain.B, b"x"),
    "enum of a tuple": (Plain.C, [1, 2.5]),
    "enum of infinity": (Plain.D, float("inf")),
    "text of a class": (Name("a"), "a"),
    "number of a class": (Count(3), 3),
    "numpy text": (np.str_("a"), "a"),
    "numpy bytes": (np.bytes_(b"a"), b"a"),
    "numpy void": (np.void(b"ab"), b"ab"),
    "dataclass with an array": (Pose(np.array([1.5, 2.0])), {"xyz": [1.5, 2.0], "frame": "base"}),
    "bytearray": (bytearray(b"ab"), b"ab"),
    "memoryview of bytes": (memoryview(b"abcd")[::2], b"ac"),
    "memoryview of doubles": (memoryview(array.array("d", [0.5, 1.5])), [0.5, 1.5]),
    "memoryview of an image": (memoryview(np.arange(6, dtype=np.uint8).reshape(2, 3)), [[0, 1, 2], [3, 4, 5]]),
    "memoryview of booleans": (memoryview(np.array([True, False])), [True, False]),
    "array of doubles": (array.array("d", [0.5, 1.5]), [0.5, 1.5]),
    "array of bytes": (array.array("B", [1, 2]), [1, 2]),
    "structured": (RECORDS, RECORD_DICTS),
    "structured matrix": (RECORDS.reshape(2, 1), [[RECORD_DICTS[0]], [RECORD_DICTS[1]]]),
    "structured scalar": (RECORDS[1], RECORD_DICTS[1]),
    "structured 0-d": (np.array(RECORDS[1]), RECORD_DICTS[1]),
    "record array": (RECORDS.view(np.recarray), RECORD_DICTS),
    "structured and empty": (RECORDS[:0], []),
    "many records": (np.ones(500, [("a", "i4")]), [{"a": 1}] * 500),
    "masked records": (
        np.ma.array([(1, 2.0), (3, 4.0)], mask=[(0, 1), (0, 0)], dtype=[("a", "i4"), ("b", "f8")]),
        [{"a": 1, "b": None}, {"a": 3, "b": 4.0}],
    ),
    "masked": (np.ma.array([1.5, 2.0], mask=[0, 1]), [1.5, None]),
    "masked 0-d": (np.ma.array(1.5, mask=True), None),
    "masked constant": (np.ma.masked, None),
    "many masked": (
        np.ma.array(np.arange(200.0), mask=np.arange(200) % 2 == 0),
        [None if number % 2 == 0 else float(number) for number in range(200)],
    ),
    "many masked float32": (
        np.ma.array(np.full(100, 0.1, np.float32), mask=[1] + [0] * 99),
        [None] + [float(np.float32(0.1))] * 99,
    ),
    "many masked integers": (np.ma.array(np.arange(100), mask=[1] + [0] * 99), [None, *range(1, 100)]),
    "many, none masked": (np.ma.array(np.arange(100.0)), [float(number) for number in range(100)]),
    "masked times": (np.ma.array(["2020-01-01", "2021-01-01"], "M8[D]", mask=[0, 1]), ["2020-01-01", None]),
    "times": (np.array(["2020-01-01T00:00:00.5", "NaT"], "M8[ms]"), ["2020-01-01T00:00:00.500", None]),
    "a time": (np.datetime64("2020-01-01T00:00:00.000000001"), "2020-01-01T00:00:00.000000001"),
    "no time": (np.datetime64("NaT"), None),
    "spans": (np.array([5, 7], "m8[s]"), ["5 seconds", "7 seconds"]),
    "objects": (np.array([1, "a", None, {"x": np.int8(3)}], object), [1, "a", None, {"x": 3}]),
    "object 0-d": (np.array({"a": 1}, object), {"a": 1}),
    "what has an array of times": (Wrapped(np.array(["2020-01-01"], "M8[ns]")), ["2020-01-01T00:00:00.000000000"]),
    "what has an array of records": (Wrapped(RECORDS), RECORD_DICTS),
    "tensor": (Tensor([[1.0, 2.0]]), [[1.0, 2.0]]),
    "tensor without an array": (Tensor([[1.0, 2.0]], has_array=False), [[1.0, 2.0]]),
    "tensor on a device": (OnDevice([1.5], has_array=False), [1.5]),
    "named tuple": (collections.namedtuple("P", "x y")(1, 2), [1, 2]),
    "ordered dict": (collections.OrderedDict(a=1), {"a": 1}),
    "read-only dict": (types.MappingProxyType({"a": np.int64(1)}), {"a": 1}),
    "chained dicts": (collections.ChainMap({"a": 1}), {"a": 1}),
    "user's dict": (collections.UserDict({"a": 1}), {"a": 1}),
    "uuid": (uuid.UUID(int=1), "00000000-0000-0000-0000-000000000001"),
    "date": (datetime.date(2020, 1, 2), "2020-01-02"),
    "time of day": (datetime.time(1, 2, tzinfo=datetime.timezone.utc), "01:02:00+00:00"),
    "pandas time": (pd.Timestamp("2020-01-01T00:00:00.000000001"), "2020-01-01T00:00:00.000000001"),
    "pandas period": (pd.Period("2020-01"), "2020-01"),
    "pandas interval": (pd.Interval(0, 1), "(0, 1]"),
    "pyarrow scalar": (pa.scalar(5), 5),
    "pyarrow text": (pa.scalar("a"), "a"),
}

REFUSED: dict[str, tuple[Any, str]] = {
    "set": ({1}, "list("),
    "frozenset": (frozenset({1}), "list("),
    "deque": (collections.deque([1]), "list("),
    "range": (range(3), "list("),
    "generator": ((one for one in "ab"), "list("),
    "dict keys": ({"a": 1}.keys(), "list("),
    "decimal": (decimal.Decimal("1.1"), "float("),
    "fraction": (fractions.Fraction(1, 3), "float("),
    "complex": (1j, "z.real"),
    "numpy complex": (np.complex64(1j), "z.real"),
    "complex array": (np.zeros(3, complex), "z.real"),
    "large complex array": (np.zeros(9000, complex), "z.real"),
    "long double": (np.longdouble("0.1"), "float"),
    "long doubles": (np.ones(3, np.longdouble), "float"),
    "large long doubles": (np.ones(9000, np.longdouble), "float"),
    "span": (datetime.timedelta(seconds=1), "total_seconds"),
    "function": (len, "__name__"),
    "class": (dict, "__name__"),
    "numpy class": (np.float64, "__name__"),
    "module": (json, "pass numbers"),
    "object": (object(), "pass numbers"),
    "iterator": (iter([1]), "pass numbers"),
    "data frame of polars": (pl.DataFrame({"a": [1]}), "pass numbers"),
    "grouped frame": (pd.DataFrame({"a": [1]}).groupby("a"), "pass numbers"),
    "what has an array of itself": (Wrapped(np.array(object(), object)), "pass numbers"),
}


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
@pytest.mark.parametrize("inside", ["alone", "beside NaN", "in a list", "in a dict", "in a batch", "in columns"])
def test_what_can_be_stored_comes_back_as_documented(tmp_path: Path, inside: str, encoding: str) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding=encoding)) as recorder:
        for number, name in enumerate(STORED):
            value, topic = STORED[name][0], recorder.topic(name)
            time_s = float(number)
            if inside == "alone":
                topic.append(v=value, _ts=time_s)
            elif inside == "beside NaN":
                topic.append(v=value, nan=float("nan"), _ts=time_s)
            elif inside == "in a list":
                topic.append(v=[None, value], _ts=time_s)
            elif inside == "in a dict":
                topic.append(v={"x": value, "nan": float("nan")}, _ts=time_s)
            elif inside == "in a batch":
                topic.append_batch([{"v": value, "_ts": time_s}])
            else:
                topic.append_columns(v=[value, None], _ts=[time_s, time_s + 1])
    with Recording(tmp_path) as recording:
        found = {name: next(iter(recording[name].rows()))["v"] for name in STORED}
    unwrap = {"in a list": lambda value: value[1], "in a dict": lambda value: value["x"]}.get(
        inside, lambda value: value
    )
    assert {name: repr(unwrap(value)) for name, value in found.items()} == {
        name: repr(meant) for name, (_, meant) in STORED.items()
    }


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("inside", ["alone", "in a list", "beside NaN"])
@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
def test_what_cannot_be_stored_is_refused_with_what_to_pass(
    tmp_path: Path, name: str, inside: str, encoding: str
) -> None:
    value, advice = REFUSED[name]
    with Recorder(tmp_path, RecorderOptions(encoding=encoding)) as recorder:
        fields = {
            "alone": {"v": value},
            "in a list": {"v": [{"x": value}]},
            "beside NaN": {"n": float("nan"), "v": value},
        }
        with pytest.raises(FieldError) as caught:
            recorder.topic("arm").append(**fields[inside], _ts=1.0)
        assert recorder.stats()["accepted"] == 0
    assert "'arm'" in str(caught.value)
    assert "'v'" in str(caught.value)
    assert advice in str(caught.value)


# Keys

json_keys = st.one_of(
    st.text(max_size=3),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.booleans(),
    st.none(),
    st.sampled_from([Text.A, Number.SEVEN, Flags.X | Flags.Y, Name("n"), Count(5)]),
    st.floats(width=32).map(np.float64),
    st.text(max_size=2).map(np.str_),
)


@given(st.dictionaries(json_keys, st.integers(0, 3), max_size=4))
def test_keys_are_spelled_as_json_spells_them_and_two_never_become_one(nested: dict[Any, int]) -> None:
    try:
        meant = json.loads(json.dumps(nested), object_pairs_hook=_pairs)
    except KeyError:
        with pytest.raises(FieldError, match=r"'arm'.*'v'.*both"):
            exact({"v": {"x": [nested]}, "_ts": 1.0}, "arm")
        return
    assert json.loads(exact({"v": {"x": [nested]}, "_ts": 1.0}, "arm"))["v"] == {"x": [meant]}


def _pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len({key for key, _ in pairs}) < len(pairs):
        raise KeyError(pairs)
    return dict(pairs)


@pytest.mark.parametrize(
    ("key", "text"),
    [
        (np.int64(3), "3"),
        (np.uint8(3), "3"),
        (np.bool_(True), "true"),
        (np.float64(1.5), "1.5"),
        (np.float32(0.5), "0.5"),
        (np.str_("a"), "a"),
        (Plain.A, "plain"),
        (Text.A, "a"),
        (Number.SEVEN, "7"),
        (float("nan"), "NaN"),
        (-float("inf"), "-Infinity"),
    ],
    ids=stable_repr,
)
def test_a_key_of_numpy_or_of_an_enum_is_what_it_stands_for(tmp_path: Path, key: Any, text: str) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(v={key: 1, "other": {key: [{key: None}]}}, _ts=1.0)
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"v": {text: 1, "other": {text: [{text: None}]}}, "_ts": 1.0}]


@pytest.mark.parametrize("key", [b"a", (1, 2), Plain.B, datetime.date(2020, 1, 1), np.datetime64("2020"), 1j, object()])
def test_a_key_that_json_has_no_text_for_is_refused(tmp_path: Path, key: Any) -> None:
    with Recorder(tmp_path) as recorder, pytest.raises(FieldError, match=r"'arm'.*'v'.*key"):
        recorder.topic("arm").append(v={"x": [{key: 1}]}, _ts=1.0)


@pytest.mark.parametrize(
    "keys",
    [(1, "1"), (True, "true"), (None, "null"), (1.5, "1.5"), (np.int64(2), "2"), (Plain.A, "plain"), (Text.A, "a")],
    ids=stable_repr,
)
def test_two_keys_of_one_text_are_refused(tmp_path: Path, keys: tuple[Any, Any]) -> None:
    with Recorder(tmp_path) as recorder:
        for nested in ({keys[0]: 2, keys[1]: 3}, {keys[1]: 2, keys[0]: 3}):
            if len(nested) == 2:
                with pytest.raises(FieldError, match=r"'arm'.*'v'.*both"):
                    recorder.topic("arm").append(v=nested, _ts=1.0)


def test_names_of_fields_may_be_texts_of_a_class_but_not_stand_for_reserved_ones(tmp_path: Path) -> None:
    class Reserved(str, enum.Enum):
        EXACT = "_exact"

    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("arm")
        topic.append(**{np.str_("a"): 1, Name("b"): 2}, _ts=1.0)  # type: ignore[arg-type]
        topic.append_batch([{Text.A: 3, "_ts": 2.0}])
        for row in ({Reserved.EXACT: 1}, {1: 2}):
            with pytest.raises(FieldError, match="'arm'"):
                topic.append_batch([{**row, "_ts": 3.0}])
    with Recording(tmp_path) as recording:
        assert list(recording["arm"].rows()) == [{"a": 1, "b": 2, "_ts": 1.0}, {"a": 3, "_ts": 2.0}]
