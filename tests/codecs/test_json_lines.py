"""Lines of JSON are read as what `json.loads` says of them, whatever the lines before had, or are left to Python."""

from __future__ import annotations

import json
import random
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs.json_lines import LineReader, joined
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.field_choice import project
from ml_dash_mcap.rows.table import Block, block_of, to_table
from ml_dash_mcap.rows.typed_columns import Column, values_of
from tests.support.examples import examples
from tests.support.odd_json import random_payloads

TIME = "time"


def read(reader: LineReader, *payloads: bytes) -> dict[str, pa.Array] | None:
    lines = joined(payloads)
    return None if lines is None else reader.read(lines)


def values(block: Block) -> dict[str, list[str]]:
    """The columns of a block by name, as a table has them, with integers among doubles as such."""
    table = to_table([block], time_name=TIME)
    table.validate(full=True)
    columns = {name: values_of(Column(table.column(name), block.columns[name].is_text)) for name in table.column_names}
    return {name: [repr(canonical(value)) for value in column] for name, column in columns.items()}


def is_wanted(name: str, columns: list[str] | None) -> bool:
    if columns is None:
        return name.split(".")[0] != "_ts"  # which tells the time
    return any(name == column or name.startswith(f"{column}.") for column in columns)


def canonical(value: Any) -> Any:
    if type(value) is int and abs(value) <= 2**53:
        return float(value)
    if isinstance(value, list):
        return [canonical(element) for element in value]
    if isinstance(value, dict):
        return {key: canonical(value[key]) for key in sorted(value)}
    return value


@pytest.mark.parametrize(
    "payload",
    [
        b'{"a":[null,3.0]}',
        b'{"a":[null,null,3.0,4.0]}',
        b'{"a":[null,"x"]}',
        b'{"a":[null,true]}',
        b'{"a":[null,[1]]}',
        b'{"a":[null,{"b":1}]}',
        b'{"a":[[null,1.0],[2.0]]}',
        b'{"a":[[],[null]]}',
        b'{"a":[null,null]}',
        b'{"a":[]}',
        b'{"a":[{"b":[null,1]}]}',
        b'{"a":18446744073709551615}',
        b'{"a":"2024-01-02T03:04:05"}',
        b'{"a":["2024-01-02",null]}',
        b'{"a":[{"b":"2024-01-02"}]}',
    ],
)
@pytest.mark.parametrize("before", [b"", b'{"a":null}', b'{"a":[]}', b'{"a":[null]}', b'{"a":[1.5]}', b'{"a":"x"}'])
def test_what_pyarrow_reads_wrongly_by_itself_is_read_right(payload: bytes, before: bytes) -> None:
    reader = LineReader()
    if before:
        assert read(reader, before) is not None
    flat = read(reader, payload, payload)
    assert flat is not None
    flat["a"].validate(full=True)
    assert flat["a"].to_pylist() == [json.loads(payload)["a"]] * 2


@pytest.mark.parametrize("first", range(0, 400, 50))
@pytest.mark.parametrize("columns", [None, ["a"], ["a.b", "q"]])
def test_any_blocks_of_rows_are_what_json_says_or_are_left_to_python(first: int, columns: list[str] | None) -> None:
    kept = 0
    for seed in range(10_000 + first, 10_000 + first + 50):
        reader, payloads = LineReader(columns), random_payloads(seed)
        rng = random.Random(seed)
        while payloads:
            count = rng.randint(1, 5)
            block, payloads = payloads[:count], payloads[count:]
            flat = read(reader, *block)
            if flat is None:
                continue
            kept += 1
            rows = [{**json.loads(payload), "_ts": 0.0} for payload in block]
            chosen = rows if columns is None else [project(row, columns) for row in rows]
            found = {TIME: pa.array([0.0] * len(block)), **{n: one for n, one in flat.items() if is_wanted(n, columns)}}
            expected = block_of([flatten(row, TIME) for row in chosen])
            assert values(Block(len(block), {name: Column(array) for name, array in found.items()})) == values(expected)
    assert kept > 20


NUMBERS = st.one_of(st.none(), st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**52), 2**52))


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.lists(st.lists(NUMBERS, max_size=3), min_size=1, max_size=4), min_size=1, max_size=4))
def test_vectors_with_gaps_are_read_without_python_whatever_came_first(blocks: list[list[list[Any]]]) -> None:
    reader = LineReader()
    for vectors in blocks:
        flat = read(reader, *[json.dumps({"q": vector}).encode() for vector in vectors])
        assert flat is not None
        flat["q"].validate(full=True)
        assert flat["q"].to_pylist() == vectors


@pytest.mark.parametrize("payload", [b"null", b"1", b"[]", b'"x"', b"", b" ", b'\xef\xbb\xbf{"a":1}', b'{"a":"\xff"}'])
@pytest.mark.parametrize("others", [[], [b'{"a":1}']])
def test_what_is_no_object_in_utf8_is_kept_from_pyarrow(payload: bytes, others: list[bytes]) -> None:
    assert joined([payload, *others]) is None
    assert joined([*others, payload]) is None


@pytest.mark.parametrize("payload", [b'{"a":1}{"a":2}', b'{"a":1}\n{"a":2}', b'{"a":1},{"a":2}', b"{}null{}"])
def test_several_values_in_a_payload_are_not_taken_for_rows(payload: bytes) -> None:
    assert read(LineReader(), payload) is None
    assert read(LineReader(), payload, b'{"a":3}') is None
    assert read(LineReader(), b"{", payload, b"}") is None


def test_objects_in_several_lines_are_read_without_python() -> None:
    flat = read(LineReader(), b'{\n "a": [\n1, 2]\n}\n', b'\t{"a":[3,4]}\r\n')
    assert flat is not None and flat["a"].to_pylist() == [[1, 2], [3, 4]]


def test_a_key_spelled_with_escapes_is_not_passed_over() -> None:
    reader = LineReader(["\u00e9"])
    assert read(reader, b'{"\\u00e9":1,"b":0}') is not None
    flat = read(reader, b'{"b":1}', b'{"\\u00e9":2}')
    assert flat is not None and flat["\u00e9"].to_pylist() == [None, 2]


@pytest.mark.parametrize("blank", ["", " ", "  ", "\n", "\t\r"])
def test_an_empty_dict_is_not_passed_over_however_it_is_written(blank: str) -> None:
    reader = LineReader()
    assert read(reader, b'{"d":{"x":1}}') is not None
    assert read(reader, b'{"d":{"x":1}}', f'{{"d":{{{blank}}}}}'.encode()) is None
