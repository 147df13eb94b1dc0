"""Laws that rows hold to in every encoding: what is encoded comes back, alone, merged, at another time, and as columns."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from ml_dash_mcap import Recorder, RecorderOptions, Recording, clock
from ml_dash_mcap.codecs import cbor, json, protobuf
from ml_dash_mcap.codecs.codec import UNKNOWN_FORM, Codec
from ml_dash_mcap.codecs.decode import decoder
from ml_dash_mcap.errors import FieldError, IntegerRangeError
from ml_dash_mcap.mcap.message_records import MESSAGE_HEAD_BYTES, message_heads
from ml_dash_mcap.mcap.records import Channel, Schema
from ml_dash_mcap.mcap.row_arrays import Rows
from ml_dash_mcap.rows import table
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.merge import merge
from ml_dash_mcap.rows.schema import to_json
from ml_dash_mcap.rows.value_shapes import of_values
from tests.rows.test_json_text import inner, same, scalars
from tests.support.examples import examples

Row = dict[str, Any]


class Encoding(NamedTuple):
    """An encoding as one channel uses it."""

    CODEC: Codec
    schema_encoding: str
    plain_decode: Callable[[bytes], Row] | None

    def same(self, one: Row, other: Row) -> bool:
        """Whether two rows are the same; in protobuf, the keys that no field expresses come last."""
        return same_row(one, other) if self.plain_decode is None else same(one, other)

    def decode(self, payload: bytes) -> Row:
        """Decode a payload as a reader of a file does, which knows the schema."""
        if self.plain_decode is not None:
            return self.plain_decode(payload)
        schema = Schema(1, self.CODEC.schema_name("topic"), self.schema_encoding, self.CODEC.schema(None, "topic"))
        row = decoder(Channel(1, 1, "topic", self.CODEC.message_encoding, {}), schema)(payload)
        assert row is not None
        return row


def protobuf_channel() -> Encoding:
    return Encoding(protobuf.CODEC.for_channel("topic"), "protobuf", None)


BEGIN: dict[str, Callable[[], Encoding]] = {
    "json": lambda: Encoding(json.CODEC, "jsonschema", json.decode),
    "cbor": lambda: Encoding(cbor.CODEC, "jsonschema", cbor.decode),
    "protobuf": protobuf_channel,
}
"""What begins a channel, by encoding."""

Begin = Callable[[], Encoding]

TEXTS = st.text(max_size=5) | st.sampled_from(
    ['"_ts":', ',"_ts":5}', "}", "{", "\x63_ts\xfb", '\\"_ts\\":1', "\xff" * 16]
)
VALUES = st.recursive(
    scalars | TEXTS, lambda one: st.lists(one, max_size=4) | st.dictionaries(inner, one, max_size=3), max_leaves=8
)
NAMES = st.sampled_from(["a", "b", "q1", "q2", "a/b", "~", "~1", "", "0", 'say "hi"', "\u00e9", "joint[0]", "joint[1]"])
FIELDS = st.dictionaries(NAMES, VALUES, max_size=4)
SOME_FIELDS = st.lists(FIELDS, min_size=1, max_size=5)


@pytest.fixture(params=BEGIN, scope="module")
def begin(request: pytest.FixtureRequest) -> Begin:
    return BEGIN[request.param]


@pytest.fixture
def codec(begin: Begin) -> Codec:
    return begin().CODEC


def encode(codec: Codec, fields: Row, time_s: float = 1.5) -> bytes:
    return codec.encode({**fields, "_ts": time_s}, "topic")


def sorted_row(row: Row) -> Row:
    """Return a row with all keys in order, because protobuf puts those last that no field expresses."""
    return dict(sorted((name, in_order(value)) for name, value in row.items()))


def in_order(value: Any) -> Any:
    if isinstance(value, dict):
        return sorted_row(value)
    return list(map(in_order, value)) if isinstance(value, list) else value


def same_row(one: Row, other: Row) -> bool:
    """Whether two rows are the same to the bit and the type."""
    return same(sorted_row(one), sorted_row(other))


# Rows


@given(fields=FIELDS, time_s=st.floats(0, 9e9))
@settings(deadline=None, max_examples=examples(250))
@example(fields={"a": math.nan, "b": None, "c": [None, math.inf, {"d/~": -math.inf}], "": b""}, time_s=0.0)
@example(fields={"x": -0.0, "y": 5e-324, "z": 2**64 - 1, "w": -(2**63)}, time_s=1 / 3)
@example(fields={"small": [0, 23, 24, 255, 256, 65535, 65536, 2**32, -1, -24, -25, -256, -257]}, time_s=1.0)
def test_a_row_comes_back_as_it_was(begin: Begin, fields: Row, time_s: float) -> None:
    module = begin()
    row = {**fields, "_ts": time_s}
    assert module.same(module.decode(module.CODEC.encode(dict(row), "topic")), row)
    assert module.same(module.decode(module.CODEC.encode_exactly(row, "topic")), row)
    assert module.same(module.decode(module.CODEC.encode_read(row)), row)


@given(
    array=st.tuples(
        st.sampled_from(["u1", "i1", "?", "<u2", ">u2", "<i4", ">i4", "<u8", ">i8", "<f2", ">f2", "<f4", ">f8"]),
        st.sampled_from([(70_000,), (2, 40_000), (70, 20, 50), (70_000, 0)]),
    ).map(lambda drawn: (np.arange(math.prod(drawn[1])) % 251).astype(drawn[0]).reshape(drawn[1])),
    is_masked=st.booleans(),
)
@settings(deadline=None, max_examples=examples(60))
def test_a_large_array_keeps_its_type_shape_and_mask(begin: Begin, array: Any, is_masked: bool) -> None:
    module = begin()
    if is_masked and array.size:
        array = np.ma.MaskedArray(array, np.arange(array.size).reshape(array.shape) % 3 == 0)
    (back,) = (module.decode(encode(module.CODEC, {"image": array}))["image"],)
    assert (back.dtype, back.shape) == (array.dtype, array.shape)
    assert repr(back) == repr(array)
    assert np.ma.getdata(back).tobytes() == np.ma.getdata(array).tobytes()
    assert back.flags.writeable


@given(st.integers(max_value=-(2**63) - 1) | st.integers(min_value=2**64))
@example(2**64)
@example(-(2**63) - 1)
def test_an_integer_beyond_64_bits_is_refused_with_its_topic_and_field(begin: Begin, number: int) -> None:
    codec = begin().CODEC
    for value in (number, [number], {"deep": [{"er": number}]}):
        with pytest.raises(IntegerRangeError, match=r"'topic'.*'the field'"):
            encode(codec, {"good": 1, "the field": value})


@pytest.mark.parametrize("value", [{1, 2}, 1j, object(), "\ud800", ["\ud800"], {"\ud800": 1}], ids=range(6))
def test_what_cannot_be_stored_is_refused_with_its_topic_and_field(codec: Codec, value: Any) -> None:
    with pytest.raises(FieldError, match=r"'topic'.*'the field'"):
        encode(codec, {"good": 1, "the field": value})


# One row of several


@given(rows=SOME_FIELDS)
@settings(deadline=None, max_examples=examples(150))
@example(rows=[{"a": math.nan}, {"a": None}])
@example(rows=[{"a": None}, {"a": math.nan}])
@example(rows=[{"a": b"x"}, {"a": "eA=="}])
@example(rows=[{"": {"": math.nan}}, {"a/b": {"~": [b"x"]}}])
@example(rows=[{"a": [math.nan, None]}, {"a": [None, math.nan], "b": math.inf}])
def test_joining_encoded_rows_is_merging_rows(begin: Begin, rows: list[Row]) -> None:
    module = begin()
    joined = module.decode(module.CODEC.join([encode(module.CODEC, fields) for fields in rows]))
    assert same(sorted_row(joined), sorted_row(merge([{**fields, "_ts": 1.5} for fields in rows])))
    assert list(joined)[-1] == "_ts"


@given(rows=st.lists(FIELDS, min_size=3, max_size=3))
@settings(deadline=None)
def test_joining_encoded_rows_is_associative(begin: Begin, rows: list[Row]) -> None:
    module = begin()
    join = module.CODEC.join
    first, second, third = (encode(module.CODEC, fields) for fields in rows)
    left, right = join([join([first, second]), third]), join([first, join([second, third])])
    assert same(sorted_row(module.decode(left)), sorted_row(module.decode(right)))


@given(rows=st.lists(FIELDS, min_size=1, max_size=40))
@settings(deadline=None, max_examples=examples(150))
@example(rows=[{"a": {"_ts": 5}}, {"b": '"_ts":'}, {}])
@example(rows=[{str(number): number for number in range(first, first + 15)} for first in range(0, 300, 15)])
def test_rows_without_a_common_field_are_joined_by_cutting_their_bytes(begin: Begin, rows: list[Row]) -> None:
    module = begin()
    codec, seen, payloads = module.CODEC, set[str](), list[bytes]()
    for fields in rows:
        payload = encode(codec, {name: value for name, value in fields.items() if name not in seen}, 1 / 3)
        keys = codec.keys_of(payload) - {"_ts"}
        if not keys & seen and (codec.follows_shapes is False or "_exact" not in keys):
            payloads.append(payload)
            seen |= keys
    assume(payloads)
    joined = codec.join_disjoint(payloads, codec.cut(payloads))
    assert same(sorted_row(module.decode(joined)), sorted_row(module.decode(codec.join(payloads))))
    assert codec.time_of(joined) == 1 / 3


@given(fields=FIELDS, times=st.tuples(st.floats(0, 9e9), st.floats(0, 9e9)))
@settings(deadline=None)
def test_the_time_of_a_row_is_found_and_moved_without_decoding_it(begin: Begin, fields: Row, times: Any) -> None:
    module = begin()
    codec, payload = module.CODEC, encode(module.CODEC, fields, times[0])
    assert codec.time_of(payload) == times[0]
    moved = codec.with_time(payload, times[1])
    assert module.same(module.decode(moved), {**fields, "_ts": times[1]})
    assert codec.keys_of(payload) - {"_exact"} == {*fields, "_ts"}
    (at,) = codec.cut([payload])
    assert moved[:at] == payload[:at]


@pytest.mark.parametrize("payload", [b"", b"{}", b"\xa0", b"junk"])
def test_a_payload_without_a_time_stamp_is_a_value_error(codec: Codec, payload: bytes) -> None:
    for call in (codec.time_of, lambda one: codec.with_time(one, 1.0), lambda one: codec.cut([one])):
        with pytest.raises(ValueError):  # noqa: PT011 - whatever its text
            call(payload)


# What the writer learns


def laid_out(payloads: list[bytes], channel: int = 1) -> Rows:
    """Lay rows out as a block does."""
    lengths = np.array([len(payload) for payload in payloads], np.int64)
    heads = message_heads(lengths, channel, np.zeros(len(payloads), np.uint64)).tobytes()
    size = MESSAGE_HEAD_BYTES
    data = b"".join(heads[n * size : (n + 1) * size] + payload for n, payload in enumerate(payloads))
    ends = np.cumsum(lengths + size)
    channels = np.full(len(payloads), channel, np.int64)
    return Rows(
        np.frombuffer(bytearray(data), np.uint8),
        ends - lengths - size,
        ends,
        channels,
        np.zeros(len(payloads), np.int64),
    )


SIMILAR = st.one_of(
    FIELDS,
    st.fixed_dictionaries({"q": st.lists(st.floats(), min_size=3, max_size=3), "n": st.integers(0, 300)}),
    st.fixed_dictionaries({"q": st.lists(st.integers(-300, 300) | st.booleans(), min_size=2, max_size=2)}),
    st.fixed_dictionaries(
        {"q1": st.sampled_from(["", "a", "b", "cd"]), "d": st.fixed_dictionaries({"x": st.floats()})}
    ),
)


@settings(deadline=None, max_examples=examples(150))
@given(blocks=st.lists(st.lists(SIMILAR, min_size=1, max_size=6), min_size=1, max_size=4))
@example(blocks=[[{"q": 116}, {"q": 1e16}]])
@example(blocks=[[{"q": 1}, {"q": 24}, {"q": -1}]])
@example(blocks=[[{"n": 5, "s": "a"}, {"n": 24, "s": ""}]])
def test_the_forms_learned_from_bytes_tell_the_keys_and_the_shape_of_all_rows(
    begin: Begin, blocks: list[list[Row]]
) -> None:
    codec = begin().CODEC
    forms, every = codec.forms(), []
    forms.add_channel(1, codec)
    for rows in blocks:
        forms.begin_block()
        found = forms.of_rows(laid_out([encode(codec, row) for row in rows]))
        for row, form in zip(rows, found.tolist(), strict=True):
            every.append({**row, "_ts": 1.5})
            if form != UNKNOWN_FORM:
                assert forms.keys_of(1, form) - {"_exact"} == {*row, "_ts"}
    if not codec.follows_shapes:
        return
    shape = forms.shape_of(1)
    assert shape is not None
    assert to_json(shape, "t") == to_json(of_values(every), "t")


def test_a_schema_is_padded_without_changing_it(codec: Codec) -> None:
    codec = codec.for_channel("t")
    codec.encode({"q": [1.5], "_ts": 1.0}, "t")
    schema = codec.schema(of_values([{"q": [1.5], "_ts": 1.0}]), "t")
    padded = codec.padded(schema, len(schema) + 100)
    assert len(padded) == len(schema) + 100
    if codec.schema_encoding == "jsonschema":
        assert padded.strip() == schema
    for either in (schema, padded):
        channel = Channel(1, 1, "t", codec.message_encoding, {})
        decode = decoder(channel, Schema(1, codec.schema_name("t"), codec.schema_encoding, either))
        assert decode(codec.encode({"q": [1.5], "_ts": 1.0}, "t")) == {"q": [1.5], "_ts": 1.0}


# Columns


@settings(deadline=None, max_examples=examples(200))
@given(
    rows=st.lists(SIMILAR, min_size=1, max_size=8),
    columns=st.none() | st.lists(st.sampled_from(["q", "d.x", "n", "q1"])),
)
@example(rows=[{"n": 2**63}, {"n": 2**64 - 1}], columns=None)
@example(rows=[{"n": -(2**63)}, {"n": 2**63 - 1}], columns=None)
@example(rows=[{"n": -(2**63)}, {"n": 2**64 - 1}], columns=None)
@example(rows=[{"m": [[1.0, 2.0], [3.0, 4.0]]}] * 3, columns=None)
@example(rows=[{"m": [[[1], [2]], [[3], [4]]]}] * 3, columns=None)
@example(rows=[{"a.b": 1.0}, {"a.b": 2.0}], columns=None)
@example(rows=[{"s": "\u00e9"}, {"s": "ab"}], columns=None)
def test_columns_are_those_of_the_rows(begin: Begin, rows: list[Row], columns: list[str] | None) -> None:
    module = begin()
    encoded = [encode(module.CODEC, row, float(number)) for number, row in enumerate(rows)]
    reader = module.CODEC.column_reader(lambda: module.decode, columns)
    read = None if reader is None else reader.read(encoded)
    if read is None:  # the rows are decoded one by one
        return
    kept = [n for n in range(len(rows)) if n not in read.others.tolist()]
    expected = table.block_of([flatten({**rows[n], "_ts": float(n)}, "_ts") for n in kept])
    for name, column in expected.columns.items():
        top = name.split(".")[0]
        is_wanted = columns is None or top in {wanted.split(".")[0] for wanted in columns}
        if (name == "_ts" or is_wanted) and (columns is None or name in read.arrays):
            assert read.arrays[name].type == column.array.type
            assert repr(read.arrays[name].to_pylist()) == repr(column.array.to_pylist())
            assert not column.is_text
    assert read.arrays.keys() <= expected.columns.keys()


@settings(deadline=None, max_examples=examples(100))
@given(rows=st.lists(SIMILAR, min_size=1, max_size=8))
def test_columns_that_tell_all_are_the_rows_again(begin: Begin, rows: list[Row]) -> None:
    module = begin()
    rows = [{**row, "_ts": float(number)} for number, row in enumerate(rows)]
    reader = module.CODEC.column_reader(lambda: module.decode, None)
    read = None if reader is None else reader.read_exactly([module.CODEC.encode(dict(row), "t") for row in rows])
    if read is None:
        return
    names = list(read)
    flat = [
        dict(zip(names, cells, strict=True)) for cells in zip(*[read[name].to_pylist() for name in names], strict=True)
    ]
    assert [repr(sorted_row(flatten(row, "_ts"))) for row in rows] == [repr(sorted_row(row)) for row in flat]


def test_rows_of_one_layout_are_read_as_columns(begin: Begin, tmp_path: Path) -> None:
    module = begin()
    rows = [{"q": [n / 7, 0.5], "n": 100 + n, "s": "abc", "b": n % 2 == 0, "_ts": float(n)} for n in range(100)]
    with Recorder(tmp_path, RecorderOptions(encoding=module.CODEC.message_encoding)) as recorder:
        recorder.topic("t").append_batch(rows)
    with Recording(tmp_path) as recording:
        columns = recording["t"].to_arrow()
    assert sorted(columns.column_names) == sorted(rows[0])
    assert columns.select(list(rows[0])).to_pylist() == rows


def test_json_rows_of_one_layout_are_read_without_being_decoded_one_by_one() -> None:
    rows = [{"q": [n / 7, 0.5], "n": 100 + n, "s": "abc", "b": n % 2 == 0, "_ts": float(n)} for n in range(100)]
    payloads = [json.CODEC.encode(dict(row), "t") for row in rows]
    read = json.CODEC.column_reader(lambda: json.decode, None).read(payloads)
    assert read is not None
    assert pa.table(read.arrays).to_pylist() == rows
    assert not len(read.others)


NUMBER_COLUMNS = st.sampled_from(["f8", "f4", "f2", ">f8", "i8", "i1", "u8", "u1", "?"]).flatmap(
    lambda dtype: st.sampled_from([(5,), (5, 2), (5, 1, 30), (5, 300)]).flatmap(
        lambda shape: arrays.arrays(np.dtype(dtype), shape, fill=None)
    )
)


@settings(deadline=None, max_examples=examples(100))
@given(columns=st.dictionaries(NAMES, NUMBER_COLUMNS, max_size=3))
def test_columns_of_numbers_are_encoded_as_their_rows(begin: Begin, columns: dict[str, Any]) -> None:
    module = begin()
    times = np.arange(5) / 3
    encoded = module.CODEC.encode_columns(times, columns, "t", b"\7\0\0\0\0\0")
    if encoded is None:
        return
    rows = []
    for part in encoded:
        assert part.is_uniform or module.CODEC is json.CODEC
        for start, end in pairwise([*part.starts.tolist(), len(part.records)]):
            assert int.from_bytes(part.records[start + 15 : start + 23], "little") == clock.to_nanoseconds(
                times[len(rows)]
            )
            rows.append(module.decode(part.records[start + MESSAGE_HEAD_BYTES : end]))
    expected = [{**{name: column[n].tolist() for name, column in columns.items()}, "_ts": times[n]} for n in range(5)]
    assert repr(rows) == repr([{**row, "_ts": float(row["_ts"])} for row in expected])
