"""What google's own classes write decodes to rows with the fields as the .proto file has them."""

from __future__ import annotations

import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf import descriptor_pb2, json_format
from hypothesis import given, settings

from ml_dash_mcap.codecs.protobuf_messages import decoder
from ml_dash_mcap.errors import EncodingError
from tests.support import protobuf_messages
from tests.support.examples import examples
from tests.support.protobuf_messages import FILE, NAME, descriptor_set, fill

MESSAGE = protobuf_messages.message_class()
DECODE = decoder(NAME, descriptor_set())


@settings(max_examples=examples(80), deadline=None)
@given(row=protobuf_messages.rows())
def test_a_message_decodes_to_the_row_that_was_written(row) -> None:
    found = DECODE(fill(MESSAGE(), row).SerializeToString())
    assert sort(found) == sort(row)


def sort(value):
    """The same with dicts in one order, as text, which tells 1 from 1.0 and True."""
    if isinstance(value, dict):
        return {name: sort(value[name]) for name in sorted(value)}
    return [sort(one) for one in value] if isinstance(value, list) else repr(value)


def test_fields_have_the_names_and_the_order_of_the_proto_file() -> None:
    fields = [field.name for field in FILE.message_type[0].field]
    assert [name for name in fields if name in DECODE(b"")] == list(DECODE(b""))


def test_what_was_not_set_is_absent_only_where_protobuf_can_tell() -> None:
    row = DECODE(b"")
    absent = {field.name for field in FILE.message_type[0].field} - set(row)
    assert absent == {"from", "stamp", "took", "number", "word", "perhaps"}
    assert (row["a_double"], row["a_string"], row["many_bytes"], row["class"], row["counts"]) == (
        0.0,
        "",
        [],
        "IDLE",
        {},
    )


def test_rows_agree_with_protobufs_own_json_but_for_its_spelling_of_numbers_and_bytes() -> None:
    cloud = PointCloud(frame_id="lidar", point_stride=12, data=bytes(range(24)))
    cloud.timestamp.FromNanoseconds(1_700_000_000_000_000_123)
    cloud.pose.orientation.w = 1.0
    cloud.fields.add(name="x", offset=0, type=7)
    decode = decoder("foxglove.PointCloud", described(PointCloud))
    row = decode(cloud.SerializeToString())
    theirs = json_format.MessageToDict(
        cloud, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
    )
    assert row["timestamp"] == {"seconds": 1_700_000_000, "nanos": 123}
    assert row["data"] == bytes(range(24))
    assert {**row, "timestamp": theirs["timestamp"], "data": theirs["data"]} == theirs
    assert row["fields"] == [{"name": "x", "offset": 0, "type": "FLOAT32"}]


def described(message: type) -> bytes:
    """The descriptors of a generated class with all that it needs."""
    files: dict[str, descriptor_pb2.FileDescriptorProto] = {}

    def add(file) -> None:
        for dependency in file.dependencies:
            add(dependency)
        if file.name not in files:
            files[file.name] = descriptor_pb2.FileDescriptorProto()
            file.CopyToProto(files[file.name])

    add(message.DESCRIPTOR.file)
    return descriptor_set(*files.values())


def test_a_message_inside_another_may_be_a_topics_own() -> None:
    assert decoder(f"{NAME}.Inner", descriptor_set())(b"\x09" + bytes(6) + b"\xf0\x3f") == {"x": 1.0}


def test_the_same_name_with_other_fields_is_another_message() -> None:
    other = descriptor_pb2.FileDescriptorProto(name=FILE.name, package=FILE.package, syntax="proto3")
    other.message_type.add(name="Everything").field.add(name="only", number=10, type=3, label=1)
    payload = MESSAGE(a_double=1.5).SerializeToString()
    assert decoder(NAME, descriptor_set(other))(b"\x50\x07") == {"only": 7}
    assert DECODE(payload)["a_double"] == 1.5


@pytest.mark.parametrize("payload", [b"\x09", b"\xff\xff", b"\x92\x05\x01", b"\x0b"])
def test_bytes_that_are_no_such_message_are_a_value_error(payload: bytes) -> None:
    with pytest.raises(ValueError, match="pars"):
        DECODE(payload)


def without_dependencies() -> bytes:
    return descriptor_set(FILE)


def of_unknown_type() -> bytes:
    broken = descriptor_pb2.FileDescriptorProto(name="a.proto", syntax="proto3")
    broken.message_type.add(name="A").field.add(name="b", number=1, type=11, label=1, type_name=".nobody.B")
    return descriptor_set(broken)


def in_a_circle() -> bytes:
    files = [descriptor_pb2.FileDescriptorProto(name=f"{n}", dependency=[f"{(n + 1) % 5}"]) for n in range(5)]
    return descriptor_set(*files)


def in_a_chain() -> bytes:
    files = [descriptor_pb2.FileDescriptorProto(name=f"{n}", dependency=[f"{n + 1}"]) for n in range(5000)]
    return descriptor_set(*files)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"\xff\xfe garbage", "DecodeError"),
        (b"", "missing that schema"),
        (without_dependencies(), "timestamp.proto"),
        (of_unknown_type(), "nobody"),
        (in_a_circle(), "."),
        (in_a_chain(), "."),
        (descriptor_set(FILE, FILE), "2 file descriptors"),
    ],
    ids=["no descriptors", "none at all", "a missing file", "an unknown type", "a circle", "a long chain", "one twice"],
)
def test_descriptors_that_cannot_be_used_are_an_error_that_says_why(data: bytes, why: str) -> None:
    with pytest.raises(EncodingError, match=why):
        decoder(NAME, data)


def test_messages_too_deep_in_each_other_are_a_value_error() -> None:
    payload = b""
    for _ in range(300):
        payload = b"\xd2\x04" + varint(len(payload)) + payload
    with pytest.raises(ValueError, match="pars"):
        DECODE(payload)


def varint(number: int) -> bytes:
    return bytes([number]) if number < 128 else bytes([number % 128 | 128]) + varint(number // 128)
