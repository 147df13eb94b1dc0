"""Damaged and hostile messages: rows, or their bytes with a warning, in a bounded time; never a crash."""

from __future__ import annotations

import time
import tracemalloc
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from ml_dash_mcap import Recording
from ml_dash_mcap.codecs.decode import decoder
from ml_dash_mcap.codecs.proto.row_decoder import RowDecoder
from ml_dash_mcap.codecs.protobuf import CODEC
from ml_dash_mcap.errors import UndecodedWarning
from ml_dash_mcap.mcap.records import Channel, Schema
from tests.codecs.proto.test_descriptors import varint
from tests.support.examples import examples

Row = dict[str, Any]

ROWS: list[Row] = [
    {"q": [0.5, 1.5], "n": 5, "s": "abc", "b": b"x", "ok": True, "d": {"x": 1, "in": {"y": [1, 2]}}, "m": [[1.0, 2.0]]},
    {"q": [1, 2.5], "n": 2.5, "list": [{"a": 1}, {"a": 2.5}], "texts": ["a", "b"], "odd": [1, None], "none": None},
    {"image": np.zeros(5000, "i2"), "n": "text", "s": 5, "q": 1.0, "texts": "a", "list": 5, "d": [1]},
]


def channel() -> tuple[Any, list[bytes]]:
    codec = CODEC.for_channel("t")
    return codec, [codec.encode({**row, "_ts": 1.5}, "t") for row in ROWS]


CHANNEL, PAYLOADS = channel()
SCHEMA = Schema(1, CHANNEL.schema_name("t"), "protobuf", CHANNEL.schema(None, "t"))


def number_of(key: str, kind: str) -> int:
    return next(
        member.number
        for member in CHANNEL.layout.members
        if member.key == key and member.slot.kind.value == kind and not member.slot.lengths
    )


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A payload with some bytes flipped, cut out, put in, or joined with another payload's."""
    payload = bytearray(draw(st.sampled_from(PAYLOADS))[:400])
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(payload)))
        match draw(st.sampled_from(["flip", "cut", "insert", "repeat", "other"])):
            case "flip" if at < len(payload):
                payload[at] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del payload[at : at + draw(st.integers(1, 20))]
            case "insert":
                payload[at:at] = draw(st.binary(max_size=12))
            case "repeat":
                payload[at:at] = payload[at : at + draw(st.integers(1, 40))]
            case _:
                payload += draw(st.sampled_from(PAYLOADS))[:300]
    return bytes(payload)


@given(payload=damaged() | st.binary(max_size=60))
@settings(deadline=None, max_examples=examples(2000))
def test_a_damaged_row_is_a_row_or_a_value_error(payload: bytes) -> None:
    try:
        row = RowDecoder(CHANNEL.layout)(payload)
    except ValueError:
        return
    assert isinstance(row, dict)


@given(payloads=st.lists(damaged() | st.sampled_from(PAYLOADS), min_size=1, max_size=5))
@settings(deadline=None, max_examples=examples(200))
def test_the_writer_takes_damaged_rows_apart_or_raises_a_value_error(payloads: list[bytes]) -> None:
    for call in (
        lambda: CHANNEL.join(payloads),
        lambda: CHANNEL.keys_of(payloads[0]),
        lambda: CHANNEL.cut(payloads),
        lambda: CHANNEL.with_time(payloads[0], 2.0),
    ):
        try:
            call()
        except (ValueError, IndexError, KeyError, TypeError):  # `merge_each` goes on with the next rows
            continue


@given(payloads=st.lists(damaged() | st.sampled_from(PAYLOADS), min_size=1, max_size=6))
@settings(deadline=None, max_examples=examples(40), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_with_damaged_rows_is_read_row_by_row_and_as_columns(tmp_path: Path, payloads: list[bytes]) -> None:
    write(tmp_path / "a.mcap", payloads)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with Recording(tmp_path / "a.mcap") as recording:
            rows = list(recording["t"].rows())
            table = recording["t"].to_arrow()
    assert {warning.category for warning in told} <= {UndecodedWarning}
    assert len(rows) == len(table) == len(payloads)
    for row, payload in zip(rows, payloads, strict=True):
        assert row.get("_data", payload) == payload
    decode = RowDecoder(CHANNEL.layout)
    for row, payload in zip(rows, payloads, strict=True):
        if payload in PAYLOADS:
            assert repr({**row, "_ts": 1.5}) == repr(decode(payload))


def write(path: Path, payloads: list[bytes]) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(SCHEMA.name, SCHEMA.encoding, SCHEMA.data)
        number = writer.register_channel("t", "protobuf", schema)
        for at, payload in enumerate(payloads):
            writer.add_message(number, at, payload, at)
        writer.finish()


def delimited(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


HOSTILE: dict[str, bytes] = {
    "a length of 2**31": varint(number_of("s", "string") << 3 | 2) + varint(2**31) + b"x",
    "a length of 2**63": varint(number_of("s", "string") << 3 | 2) + varint(2**63) + b"x",
    "a varint without end": b"\xff" * 50,
    "one field as a value and as a list": varint(number_of("list", "sfixed64") << 3 | 1)
    + bytes(8)
    + delimited(number_of("list", "message"), b""),
    "a matrix of half a row": delimited(number_of("q", "double") + 90, bytes(8)),
    "an array of more elements than there are": delimited(
        number_of("image", "Array"), delimited(1, b"int16[9999999999999999999]") + delimited(2, b"")
    ),
    "an array of no elements and many dimensions": delimited(
        number_of("image", "Array"), delimited(1, b"int16[" + b"0," * 99 + b"0]") + delimited(2, b"")
    ),
    "an array of no elements and long ones": delimited(
        number_of("image", "Array"), delimited(1, b"int16[0,9999999999999999999]") + delimited(2, b"")
    ),
    "an exact text that is no JSON": delimited(2, b"{"),
    "an exact text that is a list": delimited(2, b"[1]"),
    "an exact text that leads nowhere": delimited(2, b'{"/a/b/c":1}'),
    "an exact text of an element that is not there": PAYLOADS[0][:-9] + delimited(2, b'{"/q/99999999999999999999":1}'),
    "an exact text with odd indices": PAYLOADS[0][:-9] + delimited(2, '{"/q/\u00b2":1}'.encode()),
    "an exact text into a text": PAYLOADS[0][:-9] + delimited(2, b'{"/s/0":1}'),
    "an exact text without a pointer": delimited(2, b'{"":1}'),
    "an exact text that is no Unicode": delimited(2, b'{"/a":"\xff"}'),
    "an exact text too deep": delimited(2, b'{"/a":' + b"[" * 100_000 + b"]" * 100_000 + b"}"),
    "a text that is no Unicode": delimited(number_of("s", "string"), b"\xff"),
    "field number 0": b"\x00\x00",
    "a group": b"\x1b\x1c",
    "a time stamp of another type": b"\x08\x05",
    "an exact text of another type": b"\x10\x05",
}


@pytest.mark.parametrize("payload", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_hostile_message_is_carried_as_its_bytes(payload: bytes) -> None:
    decode = decoder(Channel(1, 1, "t", "protobuf", {}), SCHEMA)
    with pytest.warns(UndecodedWarning, match=r"'t' has a message of \d+ bytes"):
        assert decode(payload) == {"_data": payload}
    assert decode(PAYLOADS[0])


def test_megabytes_of_tiny_fields_take_a_bounded_time_and_memory() -> None:
    payload = delimited(number_of("texts", "string"), b"") * 700_000
    tracemalloc.start()
    start = time.process_time()
    try:
        RowDecoder(CHANNEL.layout)(payload)
    except ValueError:
        pass
    assert time.process_time() - start < 30
    assert tracemalloc.get_traced_memory()[1] < 100 * len(payload)
    tracemalloc.stop()


def test_a_foreign_topic_whose_layout_changes_in_mid_file_has_the_right_values(tmp_path: Path) -> None:
    def descriptors(fields: list[tuple[str, int, int]]) -> bytes:
        file = descriptor_pb2.FileDescriptorProto(name="p.proto", package="p", syntax="proto3")
        message = file.message_type.add(name="M")
        for name, number, type_ in fields:
            message.field.add(name=name, number=number, type=type_, label=1)
        return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()

    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        layouts = [[("x", 1, 1), ("n", 2, 6)], [("n", 1, 1), ("x", 2, 6)], [("x", 1, 1), ("n", 2, 6), ("s", 3, 9)]]
        for number, fields in enumerate(layouts):
            schema = writer.register_schema("p.M", "protobuf", descriptors(fields))
            channel_id = writer.register_channel("t", "protobuf", schema)
            payload = b"\x09" + np.float64(number + 0.5).tobytes() + b"\x11" + np.int64(number).tobytes()
            payload += b"\x1a\x01a" if number == 2 else b""
            for at in range(3):
                writer.add_message(channel_id, number * 10 + at, payload, number * 10 + at)
        writer.finish()
    with Recording(path) as recording:
        rows = [{key: value for key, value in row.items() if key != "_ts"} for row in recording["t"].rows()]
        columns = recording["t"].to_arrow()
    first, second, third = {"x": 0.5, "n": 0}, {"n": 1.5, "x": 1}, {"x": 2.5, "n": 2, "s": "a"}
    assert rows == [first] * 3 + [second] * 3 + [third] * 3
    assert [float(value) for value in columns["x"].to_pylist()] == [0.5] * 3 + [1] * 3 + [2.5] * 3
    assert [float(value) for value in columns["n"].to_pylist()] == [0] * 3 + [1.5] * 3 + [2] * 3
