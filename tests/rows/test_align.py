"""Several topics on one clock: each value is the one that a dictionary of rows, asked time by time, would give."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import AlignmentError, NotFoundError, UsageError
from ml_dash_mcap.rows.align import align, grid
from ml_dash_mcap.rows.align_methods import METHODS, Choice, Methods
from tests.support.examples import examples
from tests.support.tables import from_rows

Row = dict[str, Any]

# The model: one time and one field after the other


def expected(rows: list[Row], field: str, time: float, method: str, tolerance: float) -> Any:
    """What a row of the table has for a field: a value, or None."""
    samples = {row["_ts"]: row.get(field) for row in rows}  # of several rows of one time the last one counts
    before = max((one for one in samples if one <= time), default=None)
    after = min((one for one in samples if one >= time), default=None)
    if method == "nearest":
        near = [one for one in (before, after) if one is not None and abs(time - one) <= tolerance]
        return samples[min(near, key=lambda one: (abs(time - one), one))] if near else None
    # A column is one of numbers if any row has one there, also a row that a later one of its time hides.
    is_of_numbers = has_numbers(row.get(field) for row in rows)
    if method == "previous" or field in ("text", "flag", "ragged") or not is_of_numbers:
        return samples[before] if before is not None and time - before <= tolerance else None
    if before is None or after is None or after - before > tolerance:
        return None
    return between(samples[before], samples[after], 0.0 if before == after else (time - before) / (after - before))


def has_numbers(values: Iterable[Any]) -> bool:
    return any(has_numbers(value) if isinstance(value, list) else value is not None for value in values)


def between(first: Any, second: Any, weight: float) -> Any:
    if first is None or second is None:
        return None
    if isinstance(first, list):
        return [between(a, b, weight) for a, b in zip(first, second, strict=True)]
    return first + (second - first) * weight


EIGHTHS = st.integers(0, 24).map(lambda eighths: eighths / 8)
NUMBERS = st.integers(-4, 4)
VALUES = {
    "number": st.one_of(st.none(), NUMBERS, st.floats(-4, 4)),
    "vector": st.one_of(st.none(), st.lists(st.one_of(NUMBERS, st.none()), min_size=3, max_size=3)),
    "matrix": st.lists(st.lists(st.floats(-1, 1), min_size=2, max_size=2), min_size=2, max_size=2),
    "text": st.one_of(st.none(), st.text(max_size=2)),
    "flag": st.booleans(),
    "ragged": st.lists(st.integers(0, 3), max_size=3),
}
ROWS = st.lists(
    st.tuples(EIGHTHS, st.fixed_dictionaries({}, optional=VALUES)).map(lambda pair: {**pair[1], "_ts": pair[0]}),
    max_size=6,
).map(lambda rows: sorted(rows, key=lambda row: row["_ts"]))
TOLERANCES = st.one_of(st.just(math.inf), EIGHTHS)


@settings(max_examples=examples(60), deadline=None)
@given(ROWS, ROWS, st.lists(EIGHTHS, max_size=6).map(sorted), st.sampled_from(METHODS[:3]), TOLERANCES)
@example(
    # The only number is in a row that a later one of the same time hides.
    [],
    [{"vector": [None] * 3, "_ts": 0.0}, {"vector": [0, None, None], "_ts": 0.25}, {"_ts": 0.25}],
    [0.125],
    "linear",
    1.0,
)
def test_each_value_is_that_of_the_model(
    robot: list[Row], imu: list[Row], times: list[float], method: str, tolerance: float
) -> None:
    topics = {"robot": robot, "imu": imu}
    tables = {topic: from_rows(rows) for topic, rows in topics.items()}
    found = align(np.array(times, np.float64), tables, Methods(method), tolerance_s=tolerance)
    assert found.column("_ts").to_pylist() == times
    assert set(found.column_names) == {
        "_ts",
        *(f"{t}.{f}" for t, rows in topics.items() for row in rows for f in row),
    } - {
        "robot._ts",
        "imu._ts",
    }
    for name in found.column_names[1:]:
        topic, field = name.split(".")
        if field == "ragged" and len({len(row["ragged"]) for row in topics[topic] if "ragged" in row}) == 1:
            continue  # they are vectors of one length after all
        wanted = [expected(topics[topic], field, time, method, tolerance) for time in times]
        assert close(found.column(name).to_pylist(), wanted), name


def close(found: Any, wanted: Any) -> bool:
    if isinstance(found, list) and isinstance(wanted, list):
        return len(found) == len(wanted) and all(map(close, found, wanted))
    if isinstance(found, (int, float)) and isinstance(wanted, (int, float)):
        return math.isclose(found, wanted, abs_tol=1e-12)
    return bool(found == wanted)


@settings(max_examples=examples(60), deadline=None)
@given(ROWS, ROWS, st.sampled_from(METHODS[:3]))
def test_the_rows_that_the_clock_is_taken_from_come_back_as_they_are(
    robot: list[Row], imu: list[Row], method: str
) -> None:
    table = from_rows(robot)
    times = table.column("_ts").to_numpy()
    found = align(times, {"robot": table, "imu": from_rows(imu)}, Methods(method), tolerance_s=0.0, own="robot")
    for field in table.schema:
        name = field.name if field.name == "_ts" else f"robot.{field.name}"
        assert found.column(name).equals(table.column(field.name))
        assert found.schema.field(name).metadata == field.metadata


# Single rules


def robot(**columns: list[Any]) -> pa.Table:
    count = len(next(iter(columns.values())))
    return from_rows([{**{name: column[i] for name, column in columns.items()}, "_ts": float(i)} for i in range(count)])


def at(table: pa.Table, time: float, how: Any = "previous", **options: Any) -> Row:
    (row,) = align(np.array([time]), {"robot": table}, Methods(how), **options).to_pylist()
    return {name.removeprefix("robot."): value for name, value in row.items() if name != "_ts"}


def test_a_value_holds_for_ever_after_the_end_and_is_missing_before_the_beginning() -> None:
    table = robot(q=[1.0, 2.0])
    assert [at(table, time)["q"] for time in (-0.5, 0.0, 1.0, 1e9)] == [None, 1.0, 2.0, 2.0]
    assert [at(table, time, "nearest")["q"] for time in (-1e9, 0.5, 0.6, 1e9)] == [1.0, 1.0, 2.0, 2.0]
    assert [at(table, time, "linear")["q"] for time in (-0.5, 0.0, 0.25, 1.0, 1.5)] == [None, 1.0, 1.25, 2.0, None]


def test_a_value_is_not_taken_from_farther_than_the_tolerance() -> None:
    table = robot(q=[1.0, 2.0])
    assert [at(table, time, tolerance_s=0.25)["q"] for time in (0.25, 0.26, 1.26)] == [1.0, None, None]
    assert [at(table, time, "nearest", tolerance_s=0.25)["q"] for time in (-0.25, 0.5, 0.75)] == [1.0, None, 2.0]
    assert [at(table, time, "linear", tolerance_s=0.5)["q"] for time in (0.0, 0.1, 1.0)] == [1.0, None, 2.0]
    assert at(table, 0.1, "linear", tolerance_s=1.0)["q"] == 1.1


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_a_tolerance_of_one_period_covers_every_period_whatever_doubles_make_of_it(start: float) -> None:
    rows = [{"q": float(i), "_ts": start + i / 100} for i in range(1000)]
    times = np.array([row["_ts"] for row in rows[:-1]]) + 0.0099
    for how in ("previous", "linear"):
        found = align(times, {"robot": from_rows(rows)}, Methods(how), tolerance_s=0.01)
        assert found.column("robot.q").null_count == 0


def test_a_field_that_the_row_lacks_is_missing_there() -> None:
    table = robot(q=[1.0, None, 3.0], v=[None, [1.0, 2.0], [3.0, 4.0]])
    assert at(table, 1.5) == {"q": None, "v": [1.0, 2.0]}
    assert at(table, 1.5, "linear") == {"q": None, "v": [2.0, 3.0]}
    assert at(table, 1.0, "linear") == {"q": None, "v": [1.0, 2.0]}
    assert at(table, 0.5, "nearest") == {"q": 1.0, "v": None}


def test_nan_is_a_value_and_not_a_gap() -> None:
    table = robot(q=[1.0, math.nan, 3.0])
    assert math.isnan(at(table, 1.5)["q"])
    assert math.isnan(at(table, 0.5, "linear")["q"])
    assert at(table, 2.0, "linear")["q"] == 3.0


def test_integers_become_doubles_on_a_line_only() -> None:
    table = robot(n=[1, 2], v=[[1, 2], [3, 4]])
    assert [type(at(table, 0.0, how)["n"]) for how in METHODS[:3]] == [int, int, float]
    assert at(table, 0.5, "linear") == {"n": 1.5, "v": [2.0, 3.0]}


def test_vectors_keep_their_size_where_none_is_missing() -> None:
    table = robot(v=[[1, 2], [3, 4]], m=[[[1.0], [2.0]], [[3.0], [4.0]]])
    for how, element in (("previous", pa.int64()), ("linear", pa.float64())):
        found = align(np.array([0.0, 0.5]), {"robot": table}, Methods(how))
        assert found.column("robot.v").type == pa.list_(element, 2)
        assert found.column("robot.m").type == pa.list_(pa.list_(pa.float64(), 1))
        with_gaps = align(np.array([-1.0, 0.5]), {"robot": table}, Methods(how))
        assert with_gaps.column("robot.v").type == pa.list_(element)
        assert with_gaps.column("robot.v").null_count == with_gaps.column("robot.m").null_count == 1


def test_what_is_no_number_takes_the_previous_value_unless_it_was_named() -> None:
    table = robot(q=[1.0, 2.0], s=["a", "b"], b=[True, False], x=[[1], [1, 2]], d=[b"\0", b"\1"], mixed=[1, "x"])
    previous = {"s": "a", "b": True, "x": [1], "d": b"\0", "mixed": "1"}
    for how in ("linear", {"robot": "linear"}, {"*": "linear"}):
        assert at(table, 0.75, how) == {"q": 1.75, **previous}
    for field in previous:
        with pytest.raises(AlignmentError, match=f"'robot.{field}' holds values of .*, for which there is no 'linear'"):
            at(table, 0.75, {f"robot.{field}": "linear"})


def test_text_columns_stay_marked_as_json() -> None:
    table = robot(mixed=[1, "x"])
    found = align(np.array([0.5]), {"robot": table}, Methods("linear"))
    assert found.schema.field("robot.mixed").metadata == {b"ml_dash.encoding": b"json"}


def test_quaternions_turn_the_short_way() -> None:
    turned = [0.0, 0.0, math.sin(0.5), math.cos(0.5)]
    for sign in (1, -1):
        table = robot(quat=[[0.0, 0.0, 0.0, 1.0], [sign * one for one in turned]])
        found = at(table, 0.25, {"robot.quat": "slerp"})["quat"]
        assert found == pytest.approx([0.0, 0.0, math.sin(0.125), math.cos(0.125)], abs=1e-15)
        assert at(table, 1.0, "slerp")["quat"] == [sign * one for one in turned]


def test_a_quaternion_without_direction_leaves_a_gap() -> None:
    table = robot(quat=[[0, 0, 0, 1], [0, 0, 0, 0], [0.0, 0.0, 1.0, None], [0, 0, 0, 1]])
    found = align(np.arange(7) / 2, {"robot": table}, Methods("slerp")).column("robot.quat").to_pylist()
    assert found == [[0, 0, 0, 1], None, [0, 0, 0, 0], None, None, None, [0, 0, 0, 1]]


@pytest.mark.parametrize("values", [[1.0, 2.0], [[1.0, 2.0, 3.0]] * 2, [[[1.0] * 4] * 4] * 2, ["a", "b"]])
@pytest.mark.parametrize("how", ["slerp", {"robot": "slerp"}, {"robot.x": "slerp"}])
def test_slerp_is_for_4_vectors(values: list[Any], how: Any) -> None:
    with pytest.raises(AlignmentError, match=r"'robot\.x' holds values of type") as caught:
        at(robot(x=values), 0.5, how)
    assert isinstance(caught.value, ValueError)


def test_without_rows_everything_is_missing() -> None:
    empty = robot(q=[1.0], v=[[1.0, 2.0]], s=["a"]).slice(0, 0)
    for how in METHODS[:3]:
        found = align(np.array([0.0, 1.0]), {"robot": empty}, Methods(how))
        assert found.to_pylist() == [
            {"_ts": time, "robot.q": None, "robot.v": None, "robot.s": None} for time in (0.0, 1.0)
        ]
        assert align(np.empty(0), {"robot": robot(q=[1.0])}, Methods(how)).num_rows == 0


def test_topics_whose_columns_would_share_a_name_stay_apart() -> None:
    tables = {"a": from_rows([{"b.c": 1, "_ts": 0.0}]), "a.b": from_rows([{"c": 2, "_ts": 0.0}])}
    found = align(np.array([0.0]), tables, Methods("previous"))
    assert found.to_pylist() == [{"_ts": 0.0, "a.b.c": 1, "a.b.c#2": 2}]


# Which method


def test_the_most_specific_name_decides() -> None:
    how = Methods({"robot.cam.pos": "linear", "robot.cam": "nearest", "robot": "slerp", "*": "previous"})
    assert how.of("robot", "cam.pos") == Choice("linear", is_explicit=True)
    assert how.of("robot", "cam.pose") == Choice("nearest")
    assert how.of("robot", "q") == Choice("slerp")
    assert how.of("imu", "cam.pos") == Choice("previous")
    assert Methods({"imu": "linear"}).of("robot", "q") == Choice("previous")
    assert Methods("linear").of("robot", "q") == Choice("linear")


def test_a_name_that_stands_for_nothing_is_a_key_error_that_names_similar_ones() -> None:
    fields = {"robot": ["q", "cam.pos"], "imu": []}
    Methods(
        {"robot": "linear", "robot.cam": "linear", "robot.cam.pos": "linear", "imu": "linear", "*": "linear"}
    ).check_names(fields)
    with pytest.raises(NotFoundError, match=r"no column 'robot\.cam\.pso' .*did you mean 'robot\.cam\.pos'"):
        Methods({"robot.cam.pso": "linear"}).check_names(fields)


@pytest.mark.parametrize("how", ["cubic", {"robot": "cubic"}, {"robot": None}])
def test_an_unknown_method_is_a_value_error_that_names_the_methods(how: Any) -> None:
    with pytest.raises(AlignmentError, match="the methods are previous, nearest, linear, slerp") as caught:
        Methods(how)
    assert isinstance(caught.value, ValueError)
    with pytest.raises(UsageError):
        Methods(["linear"])  # type: ignore[arg-type]


# The grid


@settings(max_examples=examples(150), deadline=None)
@given(st.one_of(st.floats(0, 100), st.floats(1.6e9, 1.8e9)), st.integers(0, 500), st.floats(0.1, 1000))
def test_a_grid_has_its_end_where_it_falls_on_it(start: float, steps: int, hz: float) -> None:
    end = start + steps / hz
    times = grid(start, end, hz)
    if hz * np.spacing(end) < 1e-3:
        assert len(times) == steps + 1
    assert times[0] == start
    assert times[-1] == end
    assert np.array_equal(times[:-1], start + np.arange(len(times) - 1) / hz)


def test_a_grid_does_not_go_beyond_its_end() -> None:
    assert grid(0.0, 0.35, 10).tolist() == [0.0, 0.1, 0.2, 0.3]
    assert grid(0.1, 0.3, 10).tolist() == [0.1, 0.2, 0.3]  # 0.1 + 2 / 10 is a little more
    assert grid(1.0, 1.0, 10).tolist() == [1.0]
    assert grid(1.0, 0.5, 10).tolist() == []


@pytest.mark.parametrize("hz", [0, -1.0, math.nan, math.inf])
def test_a_rate_is_a_number_above_0(hz: float) -> None:
    with pytest.raises(AlignmentError, match="hz="):
        grid(0.0, 1.0, hz)


def test_a_grid_that_no_memory_holds_is_refused() -> None:
    with pytest.raises(AlignmentError, match=r"makes 1\.7e\+12 times; set start= and end="):
        grid(0.0, 1.7e9, 1000.0)
