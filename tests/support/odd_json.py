"""MCAP files with odd JSON in them, read by every path that makes columns, beside `rows()` and `json.loads`.

python -m tests.support.odd_json FIRST_SEED COUNT

prints the seed of each file before it is read, so that one that kills the process is known.
"""

from __future__ import annotations

import io
import json
import math
import random
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
from mcap.writer import Writer

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import ConversionError, DamagedFileError
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.plain_row import encodable
from ml_dash_mcap.rows.typed_columns import ENCODING_KEY, Column, values_of
from ml_dash_mcap.topic_reader import TopicReader

Row = dict[str, Any]

TOPIC = "/odd"
START_NS = 1_000_000_000
STEP_NS = 250_000_000

NO_ROWS = [
    b'{"a":1}{"a":2}',
    b'{"a":1} {"a":2}',
    b'{"a":1}\n{"a":2}',
    b'{"a":1},',
    b'{"a":1,}',
    b'{"a":[1,]}',
    b'{"a":1}\0',
    b'{"a":"x\0y"}',
    b'{"a":"x\ny"}',
    b'{"a":01}',
    b'{"a":.5}',
    b'{"a":Inf}',
    b'{"a":tru}',
    b'{"a":1}\x0b',
    b'{"a":"\\x"}',
    b'{"a":"\xff"}',
    b'{"a":1',
    b"a",
    b"null null",
    b"{'a':1}",
]
"""What `json.loads` refuses."""

ROWS = [
    b"null",
    b"1",
    b"-0.5e3",
    b'"x"',
    b"true",
    b"[]",
    b"[null,1.5]",
    b'[{"a":1}]',
    b"",
    b" \n",
    b"\n null",
    b"{}",
    b"{ }",
    b"{\n}",
    b'{"a":1}\n',
    b'\n{"a":1}\r\n',
    b'{\n  "a": 1,\n  "q": [\n    1.5,\n    2\n  ]\n}',
    b'\xef\xbb\xbf{"a":1}',
    b'{"a":"\\ud800"}',
    b'{"a":["\\udc00",1.5]}',
    b'{"\\udc00":1}',
    b'{"a":[{"\\udc00":1}]}',
    b'{"a":{"\\udc00":"\\ud83d\\ude00"}}',
    b'{"a":"\xed\xa0\x80"}',
    b'{"a":"x\\u0000y"}',
    b'{"a\\u0000":1}',
    b'{"a":NaN}',
    b'{"a":[NaN,1]}',
    b'{"a":-Infinity,"q":1}',
    b'{"a":1e400}',
    b'{"a":1e-400}',
    b'{"a":1.7976931348623159e308}',
    b'{"a":-0.0}',
    b'{"a":9007199254740993}',
    b'{"a":18446744073709551615}',
    b'{"a":-9223372036854775808}',
    b'{"a":1,"a":2}',
    b'{"a":1,"a":"x"}',
    b'{"a":null,"a":2}',
    b'{"a":{"a":1,"a":2}}',
    b'{"\\u0061":1}',
    b'{"\\u0061":1,"a":2}',
    b'{"a":{\n}}',
    b'{"a":"{}","q":{"x":1}}',
    b'{"a":{"b":null}}',
    b'{"a":[{"b":null}]}',
    b'{"a":[{"b":null},{}]}',
    b'{"a":[{"b":[]},{"b":[null]}]}',
    b'{"a":[null,null,3.0]}',
    b'{"a":[null,"x"]}',
    b'{"a":[null,true]}',
    b'{"a":[null,[1]]}',
    b'{"a":[null,{"b":1}]}',
    b'{"a":[[null,1.0]]}',
    b'{"a":[[],[null,1.0]]}',
    b'{"a":"2024-01-02"}',
    b'{"a":"2024-01-02T03:04:05Z"}',
    b'{"a":["12:00:00",null]}',
    b'{"a.b":1,"a":{"b":2}}',
    b'{"":1}',
    b'{"a":' + b"[" * 150 + b"]" * 150 + b"}",
    b'{"_exact":5}',
    b'{"_ts":null,"a":1}',
    b'{"_ts":"now","a":1}',
    b'{"_ts":{"x":1},"a":1}',
    b'{"value":[1]}',
]
"""What `json.loads` reads, and nothing at all, which stands for a row without fields."""

_KEYS = ["a", "b", "q", "a.b", "\u00e9", "x/y", 'k"', ""]
_TEXTS = [
    "",
    "x",
    "2024-01-01",
    "2024-01-02T03:04:05",
    "12:00",
    "{}",
    "a.b",
    '"a":1',
    "\U0001f600",
    "null",
    "\\",
    "1.5",
]
_NUMBERS = [0, 1, -1, 0.5, -0.5, 2.0, 2**53, 2**53 + 1, 2**63, 2**64 - 1, -(2**63), 1e300, 5e-324, 1e16]


def write(path: Path, payloads: Sequence[bytes], chunk_size: int = 2**20) -> None:
    """Write a file with a topic of JSON, as the `mcap` package does."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size)
        writer.start()
        channel = writer.register_channel(TOPIC, "json", 0)
        for number, payload in enumerate(payloads):
            time_ns = START_NS + number * STEP_NS
            writer.add_message(channel, time_ns, payload, time_ns, number)
        writer.finish()


def expected(payloads: Sequence[bytes]) -> list[Row] | None:
    """Return what `json.loads` says of the payloads, as rows; None where it refuses one."""
    try:
        return [_row(payload, number) for number, payload in enumerate(payloads)]
    except ValueError:
        return None


def _row(payload: bytes, number: int) -> Row:
    value = json.loads(payload) if payload.strip() else {}
    row = value if isinstance(value, dict) else {"value": value}
    return {**{key: inner for key, inner in row.items() if key != "_exact"}, "_ts": (START_NS + number * STEP_NS) / 1e9}


def random_payloads(seed: int) -> list[bytes]:
    """Return payloads of rows of mostly one form, in which odd ones stand."""
    rng = random.Random(seed)
    odd = rng.choice([0, 0, 0.1, 0.5])
    changes = rng.choice([0, 0, 0.05, 0.2])
    indent = rng.choice([None, None, None, 1])
    base = _dict(rng, 3)
    payloads = []
    for _ in range(rng.randint(1, 14)):
        if rng.random() < odd:
            payloads.append(rng.choice(ROWS if rng.random() < 0.97 else NO_ROWS))
            continue
        base = _dict(rng, 3) if rng.random() < 0.1 else base
        text = json.dumps(_like(base, rng, changes), ensure_ascii=rng.random() < 0.5, indent=indent)
        payloads.append(text.encode())
    return payloads


def _value(rng: random.Random, depth: int) -> Any:
    kind = rng.random()
    if kind < 0.25:
        return None
    if not depth or kind < 0.5:
        return rng.choice(
            [rng.random(), rng.randint(-5, 5), rng.choice(_NUMBERS), rng.choice(_TEXTS), rng.random() < 0.5]
        )
    if kind < 0.65:
        return _dict(rng, depth - 1)
    first = _value(rng, depth - 1)
    return [_like(first, rng, 0.1) if rng.random() < 0.8 else None for _ in range(rng.randint(0, 3))]


def _dict(rng: random.Random, depth: int) -> Row:
    return {rng.choice(_KEYS): _value(rng, depth) for _ in range(rng.randint(0, 4))}


def _like(value: Any, rng: random.Random, changes: float) -> Any:
    """Return a value of the same form as another, or of any with some probability."""
    if rng.random() < changes:
        return _value(rng, 2)
    if isinstance(value, dict):
        return {key: _like(inner, rng, changes) for key, inner in value.items() if rng.random() >= changes}
    if isinstance(value, list):
        size = len(value) if rng.random() < 0.8 else rng.randint(0, 3)
        return [_like(rng.choice(value), rng, changes) if value and rng.random() < 0.9 else None for _ in range(size)]
    if type(value) is float:
        return rng.choice([rng.random(), rng.random(), rng.random(), 1, None])
    if type(value) is int:
        return rng.choice([rng.randint(-9, 9), rng.randint(-9, 9), rng.choice(_NUMBERS)])
    return rng.choice(_TEXTS) if isinstance(value, str) else value


def readings(recording: Recording) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield every way to have a topic's rows that goes over columns, by name."""
    reader: TopicReader = recording[TOPIC]
    yield "arrow", reader.to_arrow
    yield "batches", lambda: list(reader.batches(rows=3))
    yield "numpy", reader.to_numpy
    yield "pandas", reader.to_pandas
    yield "pandas, flat", lambda: reader.to_pandas(flatten=True)
    yield "polars", lambda: reader.to_polars(flatten=True)
    yield (
        "column",
        lambda: reader.to_arrow(columns=[name for name in reader.to_arrow().column_names if name in _KEYS][:1]),
    )
    for name in ("json", "jsonl", "parquet"):
        yield f"read {name}", lambda name=name: reader.read(format=name)
    for name in ("csv", "jsonl"):
        yield f"write {name}", lambda name=name: reader.write(io.BytesIO(), format=name)
    yield "align", lambda: recording.align([TOPIC], hz=4.0)


def exports(recording: Recording, folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield every export that goes over columns, by name."""
    for name in ("parquet", "csv", "jsonl", "rosbag1", "rosbag2"):
        yield f"export {name}", lambda name=name: recording.export(folder / name, format=name)


def compare(payloads: Sequence[bytes], chunk_size: int = 2**20, *, with_exports: bool = True) -> None:
    """Read payloads in every way.

    Raises:
        AssertionError: One says something else than `json.loads` and `rows()`, or raises something else.
    """
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "odd.mcap"
        write(path, payloads, chunk_size)
        rows = expected(payloads)
        with Recording(path) as recording:
            ways = [*readings(recording), *(exports(recording, Path(name)) if with_exports else [])]
            if rows is None:
                _compare_refusals([("rows", lambda: list(recording[TOPIC].rows())), *ways])
                return
            assert _same(list(recording[TOPIC].rows()), rows), payloads
            tables = {what: _outcome(read) for what, read in ways}
        for what, found in tables.items():
            refuses = isinstance(found, ConversionError) and what.split()[0] in ("align", "export")
            assert refuses or not isinstance(found, Exception), (what, payloads, found)
        _compare_table(tables["arrow"], rows)
        assert sum(map(len, tables["batches"])) == len(rows)
        at = 0
        for batch in tables["batches"]:
            _compare_table(batch, rows[at : at + len(batch)])
            at += len(batch)
        assert {len(column) for column in tables["numpy"].values()} == {len(rows)}


def _compare_refusals(ways: list[tuple[str, Callable[[], Any]]]) -> None:
    for what, read in ways:
        found = _outcome(read)
        assert isinstance(found, DamagedFileError), (what, found)


def _outcome(read: Callable[[], Any]) -> Any:
    try:
        return read()
    except Exception as error:
        return error


def _compare_table(table: pa.Table, rows: list[Row]) -> None:
    table.validate(full=True)
    flat = [{encodable(name): value for name, value in flatten(row, "_ts").items()} for row in rows]
    assert {name for row in flat for name, value in row.items() if value is not None} <= set(table.column_names)
    for field in table.schema:
        is_text = ENCODING_KEY in (field.metadata or {})
        found = values_of(Column(table.column(field.name), is_text))
        assert _same(found, [row.get(field.name) for row in flat]), (field, found, flat)


def _same(found: Any, wanted: Any) -> bool:
    """Whether values are the same, integers among doubles as such, those beyond 64 bits as the nearest."""
    if isinstance(wanted, dict):
        return (
            found is not None
            and found.keys() == wanted.keys()
            and all(_same(found[key], wanted[key]) for key in wanted)
        )
    if isinstance(wanted, list):
        return isinstance(found, list) and len(found) == len(wanted) and all(map(_same, found, wanted))
    if isinstance(wanted, float) and math.isnan(wanted):
        return isinstance(found, float) and math.isnan(found)
    return bool(found == wanted) and isinstance(found, bool) == isinstance(wanted, bool)


def fixed() -> list[list[bytes]]:
    """Return each odd payload alone, and in front of and behind others."""
    plain = [b'{"a":0.5,"q":[1,2]}', b'{"a":1.5,"q":[3,4]}']
    cases = [[odd] for odd in [*ROWS, *NO_ROWS]]
    return cases + [[odd, *plain] for odd in ROWS] + [[*plain, odd] for odd in ROWS]


def main(first: int, count: int) -> None:
    """Compare the fixed payloads, and those of some seeds; one in four is exported too."""
    warnings.simplefilter("ignore")
    cases = [*(fixed() if first == 0 else []), *map(random_payloads, range(first, first + count))]
    for number, payloads in enumerate(cases):
        print(number, payloads, flush=True)
        chunk_size = random.Random(number).choice([1, 60, 2**20])
        compare(payloads, chunk_size, with_exports=number % 4 == 0)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
