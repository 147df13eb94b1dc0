"""Time stamps and values come back as they were given, one by one and in columns."""

from __future__ import annotations

import dataclasses
import datetime
import enum
import json
import math
import random
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import clock
from ml_dash_mcap.errors import FieldError, IntegerRangeError, TimestampError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.support import disk
from tests.support.case_ids import stable_repr
from tests.support.examples import examples

Row = dict[str, Any]

QUICK = settings(
    max_examples=examples(25),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=4 * 65536)


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    with Recorder(tmp_path / "run") as one:
        yield one


def rows(recorder: Recorder, topic: str) -> list[Row]:
    """Close, and read a topic as a user does."""
    recorder.close()
    with Recording(recorder.path) as recording:
        return list(recording[topic].rows()) if topic in recording else []


@pytest.mark.parametrize(
    ("given_", "meant"),
    [
        (0, 0.0),
        (-0.0, 0.0),
        (5, 5.0),
        ("1.5", 1.5),
        (np.float64(1.5), 1.5),
        (np.float32(1.5), 1.5),
        (np.int64(3), 3.0),
        (np.array(2.5), 2.5),
        (Fraction(1, 4), 0.25),
        (9e9, 9e9),
        (math.nextafter(clock.END_S, 0), math.nextafter(clock.END_S, 0)),
    ],
    ids=stable_repr,
)
def test_every_kind_of_number_is_a_time_stamp(tmp_path: Path, given_: Any, meant: float) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(x=1, _ts=given_)
        recorder.topic("a").append_batch([{"y": 1, "_ts": given_}])
    assert disk.rows(tmp_path) == {"a": [{"x": 1, "y": 1, "_ts": meant}]}
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"x": 1, "y": 1, "_ts": meant}]


def exact_ns(seconds: float) -> int:
    return math.floor(Fraction(seconds) * 10**9 + Fraction(1, 2))


def log_times(folder: Path) -> list[tuple[float, int]]:
    """The time stamp in the payload and the log time of each message."""
    found = []
    for path in disk.segments(folder):
        with path.open("rb") as file:
            for _, _, message in disk.make_reader(file).iter_messages(log_time_order=False):
                assert message.publish_time == message.log_time
                found.append((json.loads(message.data)["_ts"], message.log_time))
    return found


@pytest.mark.about_json
def test_log_times_are_the_exact_time_stamp_rounded_to_nanoseconds(tmp_path: Path) -> None:
    chance = random.Random(1)
    kinds: list[Callable[[], float]] = [
        lambda: chance.uniform(0, 1),
        lambda: chance.uniform(0, 1e5),
        lambda: chance.uniform(1.6e9, 1.9e9),
        lambda: chance.uniform(0, 9e9),
        lambda: chance.randrange(10**6) / 30.0,
        lambda: chance.randrange(10**6) / 1000.0,
        lambda: chance.randrange(10**9) / 1024,
        lambda: 2.0 ** chance.uniform(-80, 30),
    ]
    times = [0.0, 5e-324, 5e-10, 1e-9, 0.9999999999, 1 / 3, 1 / 1024] + [chance.choice(kinds)() for _ in range(5000)]
    with Recorder(tmp_path) as recorder:
        topic, columns = recorder.topic("a"), recorder.topic("b")
        for ts in times:
            topic.append(x=1, _ts=ts)
        columns.append_columns(_ts=np.array(times))
        recorder.topic("c").append_batch({"_ts": ts} for ts in times)
    found = log_times(tmp_path)
    assert len(found) > 2 * len(times)
    assert [(ts, ns) for ts, ns in found if ns != exact_ns(ts)] == []


@given(st.floats(0, 9e9))
@example(math.nextafter(5e-10, 0))
@example(math.nextafter(0.5, 1))
@settings(deadline=None, max_examples=examples(300))
def test_the_nanosecond_is_never_further_than_half_of_one_and_a_rounding_error_away(seconds: float) -> None:
    assert abs(clock.to_nanoseconds(seconds) - Fraction(seconds) * 10**9) <= Fraction(1, 2) + Fraction(1, 2**23)


@pytest.mark.about_json
def test_append_converts_time_stamps_as_the_clock_does(tmp_path: Path) -> None:
    chance = random.Random(2)
    times = [chance.uniform(0, 10 ** chance.uniform(-12, 9.9)) for _ in range(3000)]
    with Recorder(tmp_path) as recorder:
        for ts in times:
            recorder.topic("a").append(_ts=ts)
    assert [ns for _, ns in log_times(tmp_path)] == [clock.to_nanoseconds(ts) for ts in times]


def test_with_auto_a_missing_time_stamp_is_the_wall_clock_and_never_twice_the_same(tmp_path: Path) -> None:
    with Recorder(tmp_path, timestamps="auto") as recorder:
        before = time.time()
        for number in range(2000):
            recorder.topic("ab"[number % 2]).append(n=number)
    found = sorted((row for listed in disk.rows(tmp_path).values() for row in listed), key=lambda row: row["n"])
    times = [row["_ts"] for row in found]
    assert times == sorted(set(times))
    assert len(times) == 2000
    assert before <= times[0] <= time.time() + 1


def test_with_auto_minus_one_is_the_last_time_stamp_used_on_any_topic(tmp_path: Path) -> None:
    with Recorder(tmp_path, timestamps="auto") as recorder:
        a, b = recorder.topic("a"), recorder.topic("b")
        a.append(x=1, _ts=5.0)
        b.append(x=2, _ts=-1)
        b.append_batch([{"x": 3, "_ts": 6.0}, {"y": 4, "_ts": -1}])
        a.append(z=5, _ts=-1)
        a.append_columns(x=[6, 7], _ts=[7.0, 8.0])
        b.append(x=8, _ts=-1.0)
    assert disk.rows(tmp_path) == {
        "a": [{"x": 1, "_ts": 5.0}, {"z": 5, "_ts": 6.0}, {"x": 6, "_ts": 7.0}, {"x": 7, "_ts": 8.0}],
        "b": [{"x": 2, "_ts": 5.0}, {"x": 3, "y": 4, "_ts": 6.0}, {"x": 8, "_ts": 8.0}],
    }


@dataclasses.dataclass
class Pose:
    x: float
    name: str
    _hidden: int = 3


class Mode(enum.Enum):
    FAST = "fast"


class Level(enum.IntEnum):
    HIGH = 7


NOON = datetime.datetime(2026, 3, 1, 12, 0, tzinfo=datetime.timezone.utc)

VALUES: dict[str, tuple[Any, Any]] = {
    "integers": ([0, -(2**63), 2**64 - 1], [0, -(2**63), 2**64 - 1]),
    "floats": ([0.1, 5e-324, 1.7976931348623157e308, 1e22], [0.1, 5e-324, 1.7976931348623157e308, 1e22]),
    "bool": (True, True),
    "none": (None, None),
    "text": ('\u00e4\U0001f916"\\\n\0/', '\u00e4\U0001f916"\\\n\0/'),
    "bytes": (b"\0\xff", b"\0\xff"),
    "bytearray": (bytearray(b"ab"), b"ab"),
    "memoryview": (memoryview(b"ab"), b"ab"),
    "tuple": ((1, (2, 3)), [1, [2, 3]]),
    "nested": ({"a": {"b": [{"c": None}]}}, {"a": {"b": [{"c": None}]}}),
    "keys": ({2: "a", 1.5: "b", None: "c", True: "d"}, {"2": "a", "1.5": "b", "null": "c", "true": "d"}),
    "array": (np.arange(6.0).reshape(2, 3), [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]),
    "big array": (np.arange(200) / 7, (np.arange(200) / 7).tolist()),
    "float32": (np.full(100, 0.1, np.float32), [float(np.float32(0.1))] * 100),
    "float16": (np.full(3, 0.1, np.float16), [float(np.float16(0.1))] * 3),
    "fortran": (np.asfortranarray(np.arange(200.0).reshape(2, 100)), np.arange(200.0).reshape(2, 100).tolist()),
    "strided": (np.arange(400.0)[::2], np.arange(400.0)[::2].tolist()),
    "scalar": (np.float32(0.5), 0.5),
    "numpy integer": (np.uint64(2**64 - 1), 2**64 - 1),
    "numpy bool": (np.array([True, False]), [True, False]),
    "0-d": (np.array(5), 5),
    "empty": (np.zeros((0, 3)), []),
    "dataclass": (Pose(1.5, "a"), {"x": 1.5, "name": "a"}),
    "enum": (Mode.FAST, "fast"),
    "int enum": (Level.HIGH, 7),
    "datetime": (NOON, "2026-03-01T12:00:00+00:00"),
    "path": (Path("a/b"), "a/b"),
    "numpy time": (np.datetime64("2020-01-01T00:00:00.000000001"), "2020-01-01T00:00:00.000000001"),
}


@pytest.mark.parametrize(
    "beside", [{}, {"other": None}, {"other": b"x"}], ids=["alone", "beside a None", "beside bytes"]
)
@pytest.mark.parametrize("kind", VALUES)
def test_a_value_is_kept_as_it_was_whatever_stands_beside_it(tmp_path: Path, kind: str, beside: Row) -> None:
    given_, meant = VALUES[kind]
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(v=given_, **beside, _ts=1.0)
    with Recording(tmp_path) as recording:
        (row,) = recording["a"].rows()
    assert row == {"v": meant, **beside, "_ts": 1.0}
    assert type(row["v"]) is type(meant)


NONFINITE = [
    math.nan,
    math.inf,
    -math.inf,
    np.float32("nan"),
    np.array([1, math.nan]),
    [math.inf, None],
    {"a": [[math.nan]]},
]


@pytest.mark.about_json
@pytest.mark.parametrize("value", NONFINITE, ids=stable_repr)
def test_what_is_not_finite_is_null_in_the_file_and_comes_back_exactly(tmp_path: Path, value: Any) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(v=value, after="null", _ts=1.0)
        recorder.topic("a").append(big=np.array([math.nan] * 100 + [1.0]), _ts=2.0)
    for _, payload in disk.payloads(tmp_path):
        json.loads(payload, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    with Recording(tmp_path) as recording:
        first, second = recording["a"].rows()
    plain = value.tolist() if hasattr(value, "tolist") else value
    assert repr(first) == repr({"v": plain, "after": "null", "_ts": 1.0})
    assert repr(second) == repr({"big": [math.nan] * 100 + [1.0], "_ts": 2.0})


@pytest.mark.parametrize(
    "name",
    [
        "self",
        "positional",
        "name",
        "topic",
        "fields",
        "timestamp",
        "time",
        "_ts2",
        "__class__",
        "",
        "a b",
        "a.b",
        "/",
        "~",
        "NaN",
        "bytes",
    ],
)
def test_any_name_but_the_reserved_ones_is_a_field(tmp_path: Path, name: str) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(**{name: math.nan}, _ts=1.0)
        recorder.topic("a").append_batch([{name: [b"x"], "_ts": 2.0}])
        recorder.topic("a").append_columns(**{name: [None, 1]}, _ts=[3.0, 4.0])
    with Recording(tmp_path) as recording:
        found = list(recording["a"].rows())
    expected = [
        {name: math.nan, "_ts": 1.0},
        {name: [b"x"], "_ts": 2.0},
        {name: None, "_ts": 3.0},
        {name: 1, "_ts": 4.0},
    ]
    assert repr(found) == repr(expected)


def test_changing_an_array_after_append_does_not_change_the_row(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("a")
        q, big, listed, nested = np.zeros(3), np.zeros(500), [0.0], {"a": [0]}
        for number in range(100):
            topic.append(q=q, big=big, listed=listed, nested=nested, _ts=float(number))
            q += 1
            big += 1
            listed[0] += 1.0
            nested["a"][0] += 1
        topic.append_columns(q=q[None, :], _ts=[100.0])
        q += 1
    with Recording(tmp_path) as recording:
        found = list(recording["a"].rows())
    for number, row in enumerate(found[:100]):
        assert row == {
            "q": [number] * 3,
            "big": [number] * 500,
            "listed": [number],
            "nested": {"a": [number]},
            "_ts": number,
        }
    assert found[100] == {"q": [100.0] * 3, "_ts": 100.0}


DTYPES = ["f8", "f4", "f2", "i8", "i4", "i2", "i1", "u8", "u4", "u2", "u1", "?", ">f8", ">i4", "U3", "S2", "O"]


@st.composite
def columns(draw: st.DrawFn) -> dict[str, Any]:
    count = draw(st.integers(0, 6))
    drawn: dict[str, Any] = {}
    for name in draw(
        st.lists(st.sampled_from(["q", "e1", "a b", "x/y", "timestamp", "\u00e4"]), max_size=3, unique=True)
    ):
        if draw(st.booleans()):
            dtype = np.dtype(draw(st.sampled_from(DTYPES)))
            shape = (count, *draw(st.lists(st.integers(1, 3), max_size=2)))
            drawn[name] = draw(arrays(dtype, shape))
        else:
            kind = st.one_of(
                st.none(),
                st.booleans(),
                st.integers(-(2**63), 2**64 - 1),
                st.floats(),
                st.text(max_size=3),
                st.binary(max_size=3),
                st.lists(st.floats(), max_size=2),
                st.dictionaries(st.text(max_size=2), st.floats(), max_size=2),
            )
            kind = draw(
                st.sampled_from(
                    [kind, st.floats(), st.integers(-(2**63), 2**64 - 1), st.booleans(), st.text(max_size=2)]
                )
            )
            drawn[name] = draw(st.lists(kind, min_size=count, max_size=count))
    times = draw(st.lists(st.floats(0, 9e9), min_size=count, max_size=count))
    drawn["_ts"] = draw(st.sampled_from([list, np.array, tuple]))(times)
    return drawn


def arrays(dtype: np.dtype[Any], shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    size = math.prod(shape)
    elements: st.SearchStrategy[Any]
    if dtype.kind == "f":
        elements = st.floats(width=dtype.itemsize * 8)  # type: ignore[arg-type]
    elif dtype.kind in "iu":
        info = np.iinfo(dtype)
        elements = st.integers(int(info.min), int(info.max))
    else:
        elements = {
            "b": st.booleans(),
            "U": st.text(max_size=3),
            "S": st.binary(max_size=2),
            "O": st.none() | st.integers(0, 9),
        }[dtype.kind]

    def make(values: list[Any]) -> Any:
        array = np.empty(size, dtype)
        for at, value in enumerate(values):
            array[at] = value
        return array.reshape(shape)

    return st.lists(elements, min_size=size, max_size=size).map(make)


@given(columns())
@settings(QUICK, max_examples=examples(120))
def test_columns_are_the_rows_that_append_would_have_taken(
    tmp_path_factory: pytest.TempPathFactory, drawn: dict[str, Any]
) -> None:
    folder = tmp_path_factory.mktemp("columns")
    times = drawn["_ts"]
    with Recorder(folder, RecorderOptions(chunk_bytes=65536, backlog_bytes=131072)) as recorder:
        recorder.topic("columns").append_columns(**drawn)
        for row in range(len(times)):
            recorder.topic("rows").append(**{name: column[row] for name, column in drawn.items()})
    with Recording(folder) as recording:
        found = {name: list(recording[name].rows()) if name in recording else [] for name in ("columns", "rows")}
    assert repr([dict(sorted(row.items())) for row in found["columns"]]) == repr(
        [dict(sorted(row.items())) for row in found["rows"]]
    )
    assert recorder.stats()["accepted"] == 2 * len(times)


@pytest.mark.parametrize(
    ("bad", "error"),
    [
        ({"_ts": [1.0, math.nan], "x": [1, 2]}, TimestampError),
        ({"_ts": [1.0, -1.0], "x": [1, 2]}, TimestampError),
        ({"_ts": [1.0, 1e18], "x": [1, 2]}, TimestampError),
        ({"_ts": [[1.0], [2.0]], "x": [1, 2]}, TimestampError),
        ({"_ts": ["a", "b"], "x": [1, 2]}, TimestampError),
        ({"_ts": [None, 1.0], "x": [1, 2]}, TimestampError),
        ({"x": [1, 2]}, TimestampError),
        ({"_ts": [1.0, 2.0], "x": [1]}, FieldError),
        ({"_ts": [1.0, 2.0], "x": np.zeros((3, 2))}, FieldError),
        ({"_ts": [1.0, 2.0], "x": 5}, FieldError),
        ({"_ts": [1.0, 2.0], "x": "ab"}, FieldError),
        ({"_ts": [1.0, 2.0], "x": np.float64(5)}, FieldError),
        ({"_ts": [1.0, 2.0], "x": np.array(5)}, FieldError),
        ({"_ts": [1.0, 2.0], "x": {0: 1, 1: 2}}, FieldError),
        ({"_ts": [1.0, 2.0], "x": [1, object()]}, FieldError),
        ({"_ts": [1.0, 2.0], "x": [1, 2**64]}, IntegerRangeError),
        ({"_ts": [1.0, 2.0], "_exact": [1, 2]}, FieldError),
        ({"_ts": [1.0, 2.0], "x": np.zeros(2, complex)}, FieldError),
    ],
    ids=lambda value: stable_repr(value)[:40],
)
def test_bad_columns_are_refused_as_a_whole(recorder: Recorder, bad: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error, match="'a'"):
        recorder.topic("a").append_columns(**bad)
    assert rows(recorder, "a") == []


def test_many_columns_go_through_many_buffers(tmp_path: Path) -> None:
    count = 20_000
    q = np.random.default_rng(0).normal(size=(count, 7))
    with Recorder(tmp_path, SMALL) as recorder:
        recorder.topic("a").append_columns(_ts=np.arange(count) / 1000, q=q, n=np.arange(count))
        assert recorder.stats()["accepted"] == count
    with Recording(tmp_path) as recording:
        found = list(recording["a"].rows())
    assert [row["n"] for row in found] == list(range(count))
    assert [row["q"] for row in found] == q.tolist()


@pytest.mark.parametrize("shared", [True, False], ids=["on shared topics", "each on its own topic"])
def test_eight_threads_lose_nothing(tmp_path: Path, shared: bool) -> None:
    count, threads = 5000, 8
    recorder = Recorder(tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=1 << 20))

    def work(number: int) -> None:
        for row in range(count):
            topic = recorder.topic(f"t{row % 3}" if shared else f"own{number}")
            topic.append(**{f"f{number}": row, "last": number}, _ts=row / 1000)

    running = [threading.Thread(target=work, args=(number,)) for number in range(threads)]
    for thread in running:
        thread.start()
    for thread in running:
        thread.join()
    assert recorder.stats()["accepted"] == threads * count
    recorder.close()
    found: list[tuple[int, int]] = []
    with Recording(tmp_path) as recording:
        for topic in recording.topics:
            for row in recording[topic].rows():
                found += [(int(name[1:]), value) for name, value in row.items() if name[0] == "f"]
    assert sorted(found) == [(number, row) for number in range(threads) for row in range(count)]


def test_topics_opened_by_many_threads_at_once_are_one_channel_each(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        barrier = threading.Barrier(8)

        def work() -> None:
            barrier.wait()
            for number in range(100):
                recorder.topic(f"t{number}").append(x=1, _ts=float(number))

        running = [threading.Thread(target=work) for _ in range(8)]
        for thread in running:
            thread.start()
        for thread in running:
            thread.join()
    assert disk.counts(tmp_path) == {f"t{number}": 1 for number in range(100)}
