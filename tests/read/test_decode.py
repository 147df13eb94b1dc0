"""A channel's messages are decoded by what it says of them, or given as bytes with a warning."""

from __future__ import annotations

import struct
import subprocess
import sys
import warnings

import pytest

from ml_dash_mcap.codecs.decode import decoder
from ml_dash_mcap.codecs.decoding import decoding
from ml_dash_mcap.errors import EncodingError, UndecodedWarning
from ml_dash_mcap.mcap.records import Channel, Schema
from tests.support import protobuf_messages


def channel(message_encoding: str, schema_id: int = 1) -> Channel:
    return Channel(1, schema_id, "/t", message_encoding, {})


def schema(encoding: str, data: bytes = b"", name: str = "p/msg/A") -> Schema:
    return Schema(1, name, encoding, data)


FLOAT = struct.pack("<f", 1.5)
IDL = b"module p { module msg { struct A { float x; }; }; };"


@pytest.mark.parametrize(
    ("message_encoding", "described", "payload"),
    [
        ("json", schema("jsonschema", b"{}"), b'{"x": 1.5}'),
        ("json", None, b'{"x": 1.5}'),
        ("json", schema("", b"", ""), b'{"x": 1.5}'),
        ("json", schema("jsonschema", b"no schema"), b'{"x": 1.5}'),
        ("cbor", schema("jsonschema", b"{}"), b"\xa1\x61x\xf9\x3e\x00"),
        ("cbor", None, b"\xa1\x61x\xf9\x3e\x00"),
        ("ros1", schema("ros1msg", b"float32 x"), FLOAT),
        ("cdr", schema("ros2msg", b"float32 x # \xe9t\xe9"), b"\0\1\0\0" + FLOAT),
        ("cdr", schema("ros2idl", IDL), b"\0\1\0\0" + FLOAT),
        ("cdr", schema("omgidl", IDL, "p::msg::A"), b"\0\1\0\0" + FLOAT),
        (
            "protobuf",
            schema("protobuf", protobuf_messages.descriptor_set(), "test.Everything.Inner"),
            b"\x09" + struct.pack("<d", 1.5),
        ),
    ],
    ids=lambda value: value.encoding if isinstance(value, Schema) else value if isinstance(value, str) else "",
)
def test_an_encoding_that_goes_with_its_schema_is_decoded(message_encoding, described, payload) -> None:
    assert decoder(channel(message_encoding), described)(payload) == {"x": 1.5}


@pytest.mark.parametrize(
    ("message_encoding", "described"),
    [
        ("", None),
        ("cdr", None),
        ("protobuf", None),
        ("protobuf", schema("jsonschema", b"{}")),
        ("cdr", schema("", b"")),
        ("cdr", schema("ros1msg", b"float32 x")),
        ("ros1", schema("ros2msg", b"float32 x")),
        ("flatbuffer", schema("flatbuffer", b"\0")),
        ("JSON", schema("jsonschema", b"{}")),
    ],
    ids=lambda value: value.encoding if isinstance(value, Schema) else repr(value),
)
def test_all_others_are_bytes_and_a_warning_says_which_topic_and_why(message_encoding, described) -> None:
    with pytest.warns(UndecodedWarning) as warned:
        decode = decoder(channel(message_encoding), described)
    assert decode(b"\0\1") == {"data": b"\0\1"}
    (said,) = (str(one.message) for one in warned)
    assert "topic '/t'" in said and repr(message_encoding) in said
    assert repr(described.encoding if described else "") in said


def test_the_warning_is_shown_once_a_channel() -> None:
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("default")
        for topic in ("/a", "/b", "/a", "/a", "/b"):
            decoder(Channel(1, 0, topic, "flatbuffer", {}), None)
    assert len(warned) == 2


@pytest.mark.parametrize(
    ("message_encoding", "described"),
    [
        ("cdr", schema("ros2msg", b"float32 x\nnonsense")),
        ("cdr", schema("ros2idl", b"float32 x")),
        ("ros1", schema("ros1msg", b"Point p")),
        ("protobuf", schema("protobuf", b"\xff")),
        ("cdr", schema("ros2msg", b"#" * 5_000_000)),
    ],
    ids=lambda value: value.encoding if isinstance(value, Schema) else value,
)
def test_messages_with_a_broken_schema_are_bytes_and_a_warning_names_topic_and_schema(
    message_encoding, described
) -> None:
    what = rf"topic '/t': its schema 'p/msg/A' is no {described.encoding} that can be"
    with pytest.warns(UndecodedWarning, match=what) as warned:
        assert decoder(channel(message_encoding), described)(b"\0\1") == {"data": b"\0\1"}
    assert ("pass definitions={'p/msg/A': " in str(warned[0].message)) == (message_encoding != "protobuf")
    with pytest.raises(EncodingError, match=what):
        decoder(channel(message_encoding), described, decoding(on_unknown="raise"))
    with pytest.warns(UndecodedWarning, match=what + ".*; it is left out"):
        assert decoder(channel(message_encoding), described, decoding(on_unknown="skip"))(b"\0\1") is None


PROGRAM = """
import sys
import ml_dash_mcap
from ml_dash_mcap.codecs.decode import decoder
from ml_dash_mcap.mcap.records import Channel, Schema
decoder(Channel(1, 1, "t", "json", {}), None)(b"{}")
text = b"int8 x"
decoder(Channel(1, 1, "t", "cdr", {}), Schema(1, "p/A", "ros2msg", text))(bytes([0, 1, 0, 0, 1]))
print(*sorted({name.partition(".")[0] for name in sys.modules} & {"google", "mcap_protobuf", "rosbags", "pyarrow"}))
"""


def test_reading_json_and_ros_loads_no_library_for_others() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
