"""Rows that differ in their values only are read as what JSON says of them, to the bit, or are left to other readers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs import json_row_pattern, payloads
from ml_dash_mcap.codecs.codec import Columns
from ml_dash_mcap.codecs.json import decode
from ml_dash_mcap.codecs.json_pattern_reader import PatternReader
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.field_choice import is_wanted, project
from ml_dash_mcap.rows.table import Block, block_of, to_table
from ml_dash_mcap.rows.typed_columns import Column
from tests.support.examples import examples

ENOUGH = 20
"""Rows of which one may be odd."""

TIME = "time"


def read(rows: Sequence[bytes], columns: list[str] | None = None) -> Columns | None:
    return PatternReader(columns).read(payloads.of_list(rows))


def check(rows: Sequence[bytes], result: Columns, columns: list[str] | None = None) -> None:
    """Compare columns with the rows, decoded one by one: types, values, and the bits of these."""
    left_out = set(result.others.tolist())
    decoded = [{**decode(row), "_ts": 0.0} for number, row in enumerate(rows) if number not in left_out]
    chosen = decoded if columns is None else [project(row, columns) for row in decoded]
    expected = block_of([flatten(row, TIME) for row in chosen])
    arrays = {
        name: Column(array) for name, array in result.arrays.items() if name != "_ts" and is_wanted(name, columns)
    }
    assert not any(column.is_text for column in expected.columns.values())
    table, own = (
        to_table([block], time_name=TIME)
        for block in (expected, Block(len(decoded), {TIME: expected.columns[TIME], **arrays}))
    )
    own.validate(full=True)
    assert own.schema == table.select(own.column_names).schema
    assert repr(own.to_pylist()) == repr(table.select(own.column_names).to_pylist())
    assert set(own.column_names) == set(table.column_names)


KEYS = st.text(st.sampled_from("abce_ 1[,:\u00e9"), min_size=1, max_size=3)
TEXTS = st.text(st.sampled_from('ab,:[]{}. e\u00e9\U0001f600"\\\n'), max_size=6)
NUMBERS = st.sampled_from(
    [
        "0",
        "-0",
        "1",
        "-1",
        "0.0",
        "-0.0",
        "1.0",
        "1.5",
        "-2.5",
        "1e5",
        "1E5",
        "1e-7",
        "-1.5e+300",
        "5e-324",
        "9007199254740993",
        "9007199254740992",
        "-9007199254740993",
        "9223372036854775807",
        "9223372036854775808",
        "18446744073709551615",
        "0.1",
        "1e16",
        "1.0e16",
        "2.00",
        "-0e0",
        "0e5",
        "1e400",
        "1e-400",
        "0.1000000000000000055511151231257827",
        "12345678901234567890123",
        "2.4703282292062328e-324",
    ]
)
FRACTIONS = st.floats(allow_nan=False, allow_infinity=False).map(repr)
INTEGERS = st.integers(-(2**63), 2**64 - 1).map(str) | st.integers(-9, 9).map(str)
WORDS = st.sampled_from(["true", "false", "null"])
LEAVES = st.sampled_from([NUMBERS, FRACTIONS, FRACTIONS, INTEGERS, WORDS, FRACTIONS | WORDS, TEXTS.map(json.dumps)])
LISTS = st.tuples(LEAVES, st.integers(1, 4)).map(lambda pair: [pair[0]] * pair[1])
MATRICES = st.tuples(LISTS, st.integers(1, 3)).map(lambda pair: [pair[0]] * pair[1])
FIELDS = st.recursive(LEAVES | LISTS | MATRICES, lambda inner: st.dictionaries(KEYS, inner, min_size=1, max_size=3))
SHAPES = st.dictionaries(KEYS, FIELDS, min_size=1, max_size=5)


def spelled(draw: st.DrawFn, shape: Any, comma: str, colon: str) -> str:
    if isinstance(shape, dict):
        fields = [f"{json.dumps(key)}{colon}{spelled(draw, inner, comma, colon)}" for key, inner in shape.items()]
        return "{" + comma.join(fields) + "}"
    if isinstance(shape, list):
        return "[" + comma.join(spelled(draw, inner, comma, colon) for inner in shape) + "]"
    return str(draw(shape))


@st.composite
def similar_rows(draw: st.DrawFn) -> list[bytes]:
    """Rows of one shape, with few values in turn, so that columns have numbers of one kind as well as of several."""
    shape = draw(SHAPES)
    comma, colon = draw(st.sampled_from([(",", ":"), (", ", ": "), (",\n ", ":")]))
    different = [spelled(draw, shape, comma, colon).encode() for _ in range(draw(st.integers(1, 4)))]
    return draw(st.lists(st.sampled_from(different), min_size=ENOUGH, max_size=ENOUGH))


@settings(deadline=None, max_examples=examples(600))
@given(rows=similar_rows(), data=st.data())
@example(rows=[b'{"a":1.5,"b":-0}'] * ENOUGH, data=None)
@example(rows=[b'{"a":[0.5,-0],"b":1}'] * ENOUGH, data=None)
@example(rows=[b'{"a":[0.5,9007199254740993]}'] * ENOUGH, data=None)
@example(rows=[b'{"a":[null,true],"b":null,"c":[null]}'] * ENOUGH, data=None)
@example(rows=[b'{"a":"x,y","b":", ,","c":"[{"}'] * ENOUGH, data=None)
def test_rows_of_one_shape_are_what_json_says(rows: list[bytes], data: st.DataObject | None) -> None:
    columns = None if data is None else data.draw(st.none() | st.lists(KEYS, min_size=1, max_size=2))
    result = read(rows, columns)
    if result is not None:
        check(rows, result, columns)


@settings(deadline=None, max_examples=examples(600))
@given(
    rows=similar_rows(),
    which=st.integers(0, ENOUGH - 1),
    at=st.integers(0, 300),
    cut=st.integers(0, 3),
    put=st.binary(max_size=2) | st.text(st.sampled_from('0.-+eE,:"[]{}\\ntf '), max_size=3).map(str.encode),
)
@example(rows=[b'{"a":1.5,"b":{"c":2}}'] * ENOUGH, which=0, at=5, cut=3, put=b"{")
def test_a_row_that_was_changed_anywhere_never_gives_other_values(
    rows: list[bytes], which: int, at: int, cut: int, put: bytes
) -> None:
    at = min(at, len(rows[which]))
    changed = [*rows]
    changed[which] = rows[which][:at] + put + rows[which][at + cut :]
    result = read(changed)
    if result is not None:
        check(changed, result)  # in which a row that is no JSON raises an error


FLOATS = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=ENOUGH, max_size=ENOUGH)


@settings(deadline=None, max_examples=examples(200))
@given(FLOATS)
def test_doubles_come_back_with_each_of_their_bits(values: list[float]) -> None:
    result = read([orjson.dumps({"x": value, "q": [value, 0.5]}) for value in values])
    assert result is not None and not len(result.others)
    assert result.arrays["x"].to_numpy().tobytes() == np.array(values).tobytes()
    assert result.arrays["q"].flatten().to_numpy()[::2].tobytes() == np.array(values).tobytes()


@settings(deadline=None, max_examples=examples(100))
@given(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=ENOUGH, max_size=ENOUGH))
def test_integers_of_64_bits_come_back(values: list[int]) -> None:
    result = read([orjson.dumps({"n": value, "q": [value]}) for value in values])
    assert result is not None and not len(result.others)
    assert result.arrays["n"].to_pylist() == values
    assert result.arrays["q"].to_pylist() == [[value] for value in values]


ROW = b'{"q":[0.25,-1.5],"n":3,"s":"x, y","b":true,"d":{"e":null},"_ts":1.5}'


def test_each_kind_of_value_has_its_type() -> None:
    result = read([ROW] * ENOUGH)
    assert result is not None and not len(result.others)
    assert {name: str(array.type) for name, array in result.arrays.items()} == {
        "q": "fixed_size_list<item: double>[2]",
        "n": "int64",
        "s": "string",
        "b": "bool",
        "d.e": "null",
        "_ts": "double",
    }
    assert pa.table(result.arrays).to_pylist() == [flatten(json.loads(ROW), "_ts")] * ENOUGH


@pytest.mark.parametrize(
    "number",
    [
        "01",
        "-01",
        "00",
        ".5",
        "-.5",
        "1.",
        "-1.",
        "+1",
        "0x1F",
        "1.e5",
        "1.E5",
        "nan",
        "inf",
        "-inf",
        "NaN",
        "Infinity",
        "-",
        "--",
        "1e",
        "1e+",
        "1_0",
        "1..5",
        "1-2",
        "tru",
        "nul",
    ],
)
@pytest.mark.parametrize("column", [b'{"a":%s,"b":1}', b'{"a":[2,%s],"b":1}'])
def test_what_is_no_number_of_json_is_not_read_as_one(number: str, column: bytes) -> None:
    odd = column % number.encode()
    for row in (column % b"0", column % b"1.5", column % b"null"):
        result = read([*[row] * ENOUGH, odd])
        assert result is None or ENOUGH in result.others.tolist()
        assert read([odd] * ENOUGH) is None


@pytest.mark.parametrize(
    "odd",
    [
        b'{"b":1,"a":0.5}',
        b'{"a":0.5}',
        b'{"a":0.5,"b":1,"c":2}',
        b'{"a":[0.5],"b":1}',
        b'{"a":"x","b":1}',
        b'{"a":0.5, "b":1}',
        b'{"a":0.5,"b":1} ',
        b'{"a":0.5,"b":1}{"a":0.5,"b":1}',
        b'{"a":0.5,"B":1}',
        b'{"a":0.5,"b":1,"b":2}',
        b'{"a":0.5,"\\u0062":1}',
        b'{"a":null,"b":1,"_exact":{"NaN":{"":["a"]}}}',
        b'{"a":0.5,"b":1',
        b"",
        b"null",
        b'\xef\xbb\xbf{"a":0.5,"b":1}',
    ],
)
@pytest.mark.parametrize("at", [0, 7, ENOUGH])
def test_a_row_of_another_shape_is_left_out(odd: bytes, at: int) -> None:
    rows = [b'{"a":%d.5,"b":%d}' % (number, number) for number in range(ENOUGH)]
    rows.insert(at, odd)
    result = read(rows)
    assert result is not None and result.others.tolist() == [at]
    assert result.arrays["a"].to_pylist() == [number + 0.5 for number in range(ENOUGH)]
    assert result.arrays["b"].to_pylist() == [*range(ENOUGH)]


@pytest.mark.parametrize("text", [b"\\n", b'\\"', b"\\\\", b"\\u0041", b"\n", b"\x00", b'x","b":"y', b'"'])
def test_a_text_with_escapes_or_none_of_json_is_left_out(text: bytes) -> None:
    result = read([*[b'{"a":"x","b":"y"}'] * ENOUGH, b'{"a":"' + text + b'","b":"y"}'])
    assert result is not None and result.others.tolist() == [ENOUGH]


def test_texts_that_are_not_unicode_are_left_to_other_readers() -> None:
    assert read([*[b'{"a":"x"}'] * ENOUGH, b'{"a":"\xff"}']) is None


@pytest.mark.parametrize("texts", [["a", "b, c"], ["a", ",1"], ['"a'.strip('"'), "[{}]"], ["\u00e9", ""], [",,", "],"]])
def test_texts_may_hold_what_separates_values(texts: list[str]) -> None:
    rows = [orjson.dumps({"s": texts[n % 2], "l": [texts[n // 2 % 2], "x"], "n": n}) for n in range(ENOUGH)]
    result = read(rows)
    assert result is not None and not len(result.others)
    check(rows, result)
    some = read(rows, ["n"])
    assert some is not None and some.arrays["n"].to_pylist() == [*range(ENOUGH)]


@pytest.mark.parametrize(
    "row",
    [
        b"{}",
        b'{"a":[]}',
        b'{"a":{}}',
        b'{"a":[{"b":1}]}',
        b'{"a":[[1],[1,2]]}',
        b'{"a":[1,"x"]}',
        b'{"a.b":1}',
        b'{"a":1,"a":2}',
        b'{"a":{"b":1,"b":2}}',
        b'{"":1}',
        b'{"_exact":{}}',
        b'{"\\u0061":1}',
        b'{"a":"\\""}',
        b'{"a":1}x',
        b"[1]",
        b"{" + b'"a":{' * 20 + b'"b":1' + b"}" * 21,
        b'{"a":' + b"[" * 20 + b"1" + b"]" * 20 + b"}",
        b'{"a":[' + b"1," * json_row_pattern.MOST_BYTES + b"1]}",
    ],
)
def test_rows_that_have_no_pattern_are_left_to_other_readers(row: bytes) -> None:
    assert read([row] * ENOUGH) is None


def test_a_column_of_many_is_the_same_as_among_all() -> None:
    rows = [orjson.dumps({"u": n / 3, "d": {"x": n / 7, "y": [n]}, "s": "a,b", "_ts": n / 1.0}) for n in range(ENOUGH)]
    everything = read(rows)
    assert everything is not None
    for name, array in everything.arrays.items():
        result = read(rows, [name])
        assert result is not None and result.arrays.keys() == {name, "_ts"}
        assert result.arrays[name].equals(array)


def test_values_of_other_columns_cannot_move_a_column() -> None:
    """In the last row `w` lies in `u`, and all texts between the values are where they are in the others."""
    rows = [b'{"u":{"a":1},"w":2,"z":3}'] * ENOUGH + [b'{"u":{"a":{},"w":2,"z":3}}']
    result = read(rows, ["w"])
    assert result is not None and result.others.tolist() == [ENOUGH]


def test_a_column_may_become_another_kind_from_block_to_block() -> None:
    reader = PatternReader(None)
    for values in ("1", "1.5", "1", "null", "true", "2.5", "9223372036854775807", "1.0"):
        rows = [b'{"a":%s,"b":[%s]}' % (values.encode(), values.encode())] * ENOUGH
        result = reader.read(payloads.of_list(rows))
        assert result is not None
        check(rows, result)


def test_rows_get_a_new_pattern_when_they_change() -> None:
    reader = PatternReader(None)
    for key in (b"a", b"b", b"c"):
        result = reader.read(payloads.of_list([b'{"%s":1.5}' % key] * ENOUGH))
        assert result is not None and result.arrays.keys() == {key.decode()}


def test_rows_without_a_pattern_are_tried_less_and_less(monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[bytes] = []
    learn = json_row_pattern.learn

    def counted(row: bytes) -> Any:
        tries.append(row)
        return learn(row)

    monkeypatch.setattr(json_row_pattern, "learn", counted)
    reader, rows = PatternReader(None), payloads.of_list([b'{"a":[]}'] * ENOUGH)
    for _ in range(1000):
        assert reader.read(rows) is None
    assert len(tries) < 50
    for _ in range(100):
        result = reader.read(payloads.of_list([b'{"a":1.5}'] * ENOUGH))
    assert result is not None
