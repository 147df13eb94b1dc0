"""Fields of protobuf rows have names and types that no viewer refuses."""

from __future__ import annotations

import numpy as np
import pytest
from google.protobuf import descriptor_pb2

from ml_dash_mcap.codecs.protobuf import CODEC


def schema_of(**fields: object) -> descriptor_pb2.DescriptorProto:
    """The message of a row."""
    codec = CODEC.for_channel("robot")
    codec.encode_exactly({**fields, "_ts": 0.0}, "robot")
    files = descriptor_pb2.FileDescriptorSet.FromString(codec.schema(None, "robot"))
    return files.file[0].message_type[0]


@pytest.mark.parametrize("key", ["constructor", "toString", "__proto__", "hasOwnProperty"])
def test_no_field_has_the_name_of_what_every_object_of_javascript_has(key: str) -> None:
    names = [field.name for field in schema_of(**{key: {key: 1.0}}).field]
    assert names == ["_ts", "_exact", f"{key}_"]


def test_no_field_has_the_name_of_the_message_of_arrays() -> None:
    message = schema_of(Array=1.0, image=np.zeros((100, 100)))
    assert [inner.name for inner in message.nested_type] == ["Array"]
    assert [field.name for field in message.field] == ["_ts", "_exact", "Array_", "image"]


def test_a_list_of_bytes_has_no_field_because_viewers_refuse_a_topic_with_one() -> None:
    assert [field.name for field in schema_of(frames=[b"a", b"b"]).field] == ["_ts", "_exact"]


def test_no_message_has_the_name_that_a_compiler_gives_to_the_presence_of_a_field() -> None:
    message = schema_of(**{":": 1.5, "X": {"a": 1}})
    assert [oneof.name for oneof in message.oneof_decl] == ["X_ts", "X_exact", "X_"]
    assert [inner.name for inner in message.nested_type] == ["X2"]
