"""What Eclipse CycloneDDS writes, in both versions of CDR, decodes to the row that was written, or is refused."""

from __future__ import annotations

import struct
import tracemalloc
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs.ros.message_decoder import decoder
from ml_dash_mcap.errors import EncodingError
from tests.support import dds
from tests.support.examples import examples

FEW = settings(max_examples=examples(60), deadline=None)


@pytest.mark.parametrize("version_2", [False, True], ids=["CDR", "XCDR2"])
@FEW
@given(data=st.data())
def test_structs_of_dds_decode_to_the_row_that_was_written(version_2: bool, data: st.DataObject) -> None:
    described = data.draw(dds.structs(version_2=version_2))
    value, row = data.draw(described.values())
    payload = value.serialize(use_version_2=version_2)
    decode = decoder(f"pkg::{described.name}", "omgidl", dds.idl(described))
    assert repr(decode(payload)) == repr(row)


@FEW
@given(data=st.data())
def test_what_is_cut_or_changed_in_xcdr2_is_a_value_error_or_another_row(data: st.DataObject) -> None:
    described = data.draw(dds.structs(version_2=True))
    value, _ = data.draw(described.values())
    payload = value.serialize(use_version_2=True)
    decode = decoder(f"pkg::{described.name}", "omgidl", dds.idl(described))
    if described.extensibility == "appendable" and len(payload) > 8:
        with pytest.raises(ValueError, match=r"\w"):
            decode(payload[: data.draw(st.integers(0, len(payload) - 1))])
    at = data.draw(st.integers(0, len(payload) - 1))
    try:
        decode(payload[:at] + bytes([payload[at] ^ 0xFF]) + payload[at + 1 :])
    except ValueError:
        pass


def head(number: int, *values: Any, layout: str) -> bytes:
    return bytes([0, number, 0, 0]) + struct.pack(layout, *values)


def test_numbers_of_eight_bytes_are_aligned_to_four_in_xcdr2_of_either_byte_order() -> None:
    decode = decoder("p/msg/A", "ros2msg", "uint8 a\nfloat64 b\nfloat64[] c")
    row = {"a": 1, "b": 2.5, "c": [3.5]}
    assert decode(head(7, 1, 2.5, 1, 3.5, layout="<BxxxdId")) == row
    assert decode(head(6, 1, 2.5, 1, 3.5, layout=">BxxxdId")) == row
    assert decode(head(1, 1, 2.5, 1, 3.5, layout="<B7xdI4xd")) == row
    assert decode(head(0, 1, 2.5, 1, 3.5, layout=">B7xdI4xd")) == row


def test_a_message_that_is_announced_as_delimited_begins_with_its_size() -> None:
    decode = decoder("p/msg/A", "ros2msg", "uint32 a")
    assert decode(head(9, 4, 7, layout="<II")) == {"a": 7}
    assert decode(head(8, 4, 7, layout=">II")) == {"a": 7}
    with pytest.raises(ValueError, match="a value ends at byte 12, and it says that it ends at byte 13"):
        decode(head(9, 5, 7, layout="<II"))


def test_where_the_definition_does_not_say_what_can_grow_the_only_way_that_fits_is_taken() -> None:
    decode = decoder("p::A", "omgidl", "module p { struct B { long x; }; @appendable struct A { B b; long y; }; };")
    assert decode(head(9, 8, 1, 2, layout="<III")) == {"b": {"x": 1}, "y": 2}
    assert decode(head(9, 12, 4, 1, 2, layout="<IIII")) == {"b": {"x": 1}, "y": 2}
    with pytest.raises(ValueError, match="announces a message that is final, and it is appendable"):
        decode(head(7, 1, 2, layout="<II"))


def test_a_struct_without_members_takes_no_bytes_in_dds_and_one_in_ros() -> None:
    text = "module p { module msg { struct E { }; struct A { E e; octet x; }; }; };"
    assert decoder("p::msg::A", "omgidl", text)(b"\0\1\0\0\7") == {"e": {}, "x": 7}
    assert decoder("p/msg/A", "ros2idl", text)(b"\0\1\0\0\0\7") == {"e": {}, "x": 7}
    for payload in (b"\0\1\0\0", b"\0\1\0\0\0", b"\0\1\0\0\0\0\0\0", b"\0\7\0\0"):
        assert decoder("p::msg::E", "omgidl", text)(payload) == {}
    for payload in (b"\0\1\0\0", b"\0\1\0\0\0", b"\0\1\0\0\0\0\0\0"):
        assert decoder("p/msg/E", "ros2idl", text)(payload) == {}


def test_enumerations_have_as_many_bytes_as_their_bit_bound_asks_for() -> None:
    text = "@bit_bound(8) enum E { a }; @bit_bound(16) enum F { b }; enum G { c }; struct A { E e; F f; G g; };"
    assert decoder("A", "omgidl", text)(head(1, 1, 2, 3, layout="<BxHI")) == {"e": 1, "f": 2, "g": 3}


def test_types_of_one_name_in_modules_of_one_name_are_told_apart() -> None:
    text = "module p { module x { struct T { long a; }; }; module y { struct T { float b; }; }; };"
    assert decoder("p::x::T", "omgidl", text)(head(1, 7, layout="<i")) == {"a": 7}
    assert decoder("p::y::T", "omgidl", text)(head(1, 1.5, layout="<f")) == {"b": 1.5}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("@mutable struct A { long x; };", "A is @mutable"),
        ("@mutable struct B { long x; }; struct A { B b; };", "B is @mutable"),
        ("@extensibility(MUTABLE) struct A { long x; };", "A is @mutable"),
        ("union A switch(long) { case 1: long x; };", "does not define A"),
        ("union U switch(long) { case 1: long x; }; struct A { sequence<U> x; };", "the type 'union U'"),
        ("bitmask M { a, b }; struct A { M m; };", "the type 'bitmask M'"),
    ],
)
def test_what_cannot_be_decoded_is_refused_with_a_reason(text: str, why: str) -> None:
    with pytest.raises(EncodingError, match=why):
        decoder("A", "omgidl", text)


def test_a_member_that_may_be_absent_is_not_decoded_in_the_first_version_of_cdr() -> None:
    decode = decoder("A", "omgidl", "struct A { @optional long x; @optional(FALSE) long y; };")
    assert decode(head(7, 0, 5, layout="<Bxxxi")) == {"x": None, "y": 5}
    with pytest.raises(EncodingError, match="an @optional member, which is not decoded in this version of CDR"):
        decode(head(1, 4, 5, layout="<ii"))
    broken = "struct A { long x; }; struct B { wstring w; map<string, long> m; };"
    assert decoder("A", "omgidl", broken)(head(1, 4, layout="<i")) == {"x": 4}, "types that are not used cost nothing"


@pytest.mark.parametrize("number", [6, 7, 8, 9])
def test_lengths_that_lie_take_no_memory(number: int) -> None:
    lines = (
        "double x",
        "sequence<octet> x",
        "sequence<string> x",
        "string x",
        "sequence<B> x",
        "B x[1000][1000][1000]",
    )
    for line in lines:
        text = f"struct B {{ string s; @optional long y; }}; struct A {{ {line}; }};"
        decode = decoder("A", "omgidl", text)
        for payload in (
            b"\xff" * 4,
            b"\xff" * 64,
            b"\0" * 4,
            struct.pack("<II", 4, 2**31),
            struct.pack(">II", 4, 2**31),
        ):
            tracemalloc.start()
            with suppress(ValueError):
                decode(bytes([0, number, 0, 0]) + payload)
            _, peak = tracemalloc.get_traced_memory()
            tracemalloc.stop()
            assert peak < 4_000_000
