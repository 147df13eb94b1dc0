"""IDL, as rosidl and others write it, describes the same messages as the .msg language."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs.ros import definitions, idl
from ml_dash_mcap.codecs.ros.message_decoder import decoder
from ml_dash_mcap.codecs.ros.message_types import PLACEHOLDER, Array, Basic, Named
from ml_dash_mcap.errors import EncodingError
from tests.support import ros_messages
from tests.support.examples import examples


@settings(max_examples=examples(100), deadline=None)
@given(messages=ros_messages.messages())
def test_idl_says_what_the_msg_language_says(messages) -> None:
    by_msg = definitions.parse("pkg/msg/Outer", ros_messages.text(messages))
    by_idl = idl.parse("pkg/msg/Outer", ros_messages.idl(messages))
    assert by_idl.root == by_msg.root
    for name, fields in by_msg.messages.items():
        assert by_idl.messages[name] == (fields or {PLACEHOLDER: Basic("uint8")})


@settings(max_examples=examples(10), deadline=None)
@given(messages=ros_messages.messages(), data=st.data())
def test_messages_described_by_idl_decode(messages, data) -> None:
    row = data.draw(ros_messages.rows(messages))
    store = ros_messages.typestore(messages)
    payload = bytes(store.serialize_cdr(ros_messages.instance(store, messages, row), "pkg/msg/Outer"))
    assert repr(decoder("pkg/msg/Outer", "ros2idl", ros_messages.idl(messages))(payload)) == repr(row)


def fields(body: str, before: str = "") -> dict[str, object]:
    text = f"module p {{ module msg {{ {before} struct A {{ {body} }}; }}; }};"
    return dict(idl.parse("p/msg/A", text).messages["p/A"])


def test_bounds_change_nothing_and_lengths_may_be_constants() -> None:
    found = fields(
        "string<5> s; sequence<string<N>, 3> ss; double m[N][2]; octet o[p::msg::N], q[0x10]; sequence<sequence<float>> d;",
        "const long N = 3;",
    )
    double, octet = Basic("float64"), Basic("uint8")
    assert found == {
        "s": Basic("string"),
        "ss": Array(Basic("string"), None),
        "m": Array(Array(double, 2), 3),
        "o": Array(octet, 3),
        "q": Array(octet, 16),
        "d": Array(Array(Basic("float32"), None), None),
    }


def test_a_matrix_is_a_list_of_lists() -> None:
    decode = decoder(
        "p/msg/A", "ros2idl", "module p { module msg { struct A { double m[2][3]; sequence<sequence<float>> d; }; }; };"
    )
    payload = b"\0\1\0\0" + struct.pack("<6dIIfIff", *range(6), 2, 1, 7, 2, 8, 9)
    assert decode(payload) == {"m": [[0, 1, 2], [3, 4, 5]], "d": [[7], [8, 9]]}


def test_names_are_looked_up_from_the_inside_out_and_enums_are_numbers() -> None:
    text = """
    module other { module msg { typedef float Real; enum Mode { IDLE, RUN }; }; };
    struct Loose { long n; };
    module p { module msg {
        typedef double Real;
        typedef Real Pair[2];
        struct B { Real x; };
        struct A { Real x; other::msg::Real y; Pair z; B b; ::p::msg::B c; Loose d; other::msg::Mode e; };
    }; };
    """
    found = idl.parse("p/msg/A", text).messages["p/A"]
    double = Basic("float64")
    assert found == {
        "x": double,
        "y": Basic("float32"),
        "z": Array(double, 2),
        "b": Named("p/B"),
        "c": Named("p/B"),
        "d": Named("Loose"),
        "e": Basic("uint32", is_enum=True),
    }


def test_time_need_not_be_defined() -> None:
    found = idl.parse("p/msg/A", "module p { module msg { struct A { builtin_interfaces::msg::Time stamp; }; }; };")
    assert found.messages["builtin_interfaces/Time"] == {"sec": Basic("int32"), "nanosec": Basic("uint32")}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "does not define p/A"),
        ("module p { struct B { long x; }; };", "does not define p/A"),
        ("module p { struct A { long x; long x; }; };", "two fields 'x'"),
        ("module p { struct A { wstring x; }; };", "the type 'wstring', which cannot be decoded"),
        ("module p { struct A { long double x; }; };", "the type 'long double'"),
        ("module p { union U switch(long) { case 1: long x; }; struct A { U u; }; };", "the type 'union p::U', which cannot"),
        ("module p { struct A { map<string, sequence<long>> x; }; };", "the type 'map', which cannot"),
        ("module p { bitmask M { @position(0) a }; struct A { sequence<M> x; }; };", "the type 'bitmask p::M'"),
        ("module p { struct A : B { long x; }; };", "does not define p/B"),
        ("module p { struct A : A { long x; }; };", "itself for a base"),
        ("module p { enum E { a }; struct A : E { long x; }; };", "a base that is no struct"),
        ("module p { struct B { long x; }; struct A : B { long x; }; };", "two fields 'x'"),
        ("module p { struct A { long x; }; struct A { long y; }; };", "p/A more than once"),
        ("module p { struct A { double x[N]; }; };", "the length N"),
        ("module p { struct A { other::B b; }; };", "does not define other/B"),
        ("module p { struct A { long x }; };", "'}' where ';' should be"),
        ("module p { struct A { long x;", "its end"),
        ("module p { interface A { }; };", "a 'interface'"),
        ("@a(" * 9, "ends where"),
        ("module a {" * 99, "modules in modules"),
        ("struct A { " + "sequence<" * 99, "sequences of sequences"),
        ("\x80\x02 garbage", "where a name should be"),
    ],
)  # fmt: skip
def test_idl_that_cannot_be_used_is_an_error_that_says_why(text: str, why: str) -> None:
    with pytest.raises(EncodingError, match=why):
        idl.parse("p/msg/A", text)


def test_nested_parentheses_cost_nothing() -> None:
    text = f"module p {{ const long X = {'(' * 5000}1{')' * 5000}; struct A {{ long x; }}; }};"
    assert idl.parse("p/A", text).messages["p/A"] == {"x": Basic("int32")}


def test_a_service_in_idl_has_an_event() -> None:
    text = "module p { module srv { struct Add_Request { long a; }; struct Add_Response { long b; }; }; };"
    found = idl.parse("p/srv/Add_Event", text).messages
    assert found["p/Add_Event"] == {
        "info": Named("service_msgs/ServiceEventInfo"),
        "request": Array(Named("p/Add_Request"), None),
        "response": Array(Named("p/Add_Response"), None),
    }
    assert found["p/Add_Request"] == {"a": Basic("int32")}
    payload = b"\0\1\0\0" + struct.pack("<BxxxiI16s4xq", 1, 2, 3, bytes(16), 4) + struct.pack("<IiI", 1, 7, 0)
    row = decoder("p/srv/Add_Event", "ros2idl", text)(payload)
    assert (row["info"]["sequence_number"], row["request"], row["response"]) == (4, [{"a": 7}], [])


@pytest.mark.timeout(20)
def test_long_idl_takes_a_time_that_grows_with_its_length_alone() -> None:
    structs = "".join(f"struct M{number} {{ long x; }};" for number in range(10_000))
    members = "".join(f"q::M{number} a{number};" for number in range(10_000))
    text = f"module q {{ module odd {{ {structs} }}; }}; module p {{ struct A {{ {members} }}; }};"
    assert len(idl.parse("p::A", text).messages) == 10_001
