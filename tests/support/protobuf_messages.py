"""A protobuf message with every kind of field, made without a compiler, and rows that it can hold."""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, duration_pb2, message_factory, text_format, timestamp_pb2
from google.protobuf.message import Message
from hypothesis import strategies as st

NAME = "test.Everything"

_SCALARS = {
    "double": st.floats(allow_nan=False),
    "float": st.floats(width=32, allow_nan=False),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "uint64": st.integers(0, 2**64 - 1),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "fixed64": st.integers(0, 2**64 - 1),
    "fixed32": st.integers(0, 2**32 - 1),
    "bool": st.booleans(),
    "string": st.text(st.characters(codec="utf-8"), max_size=5),
    "bytes": st.binary(max_size=5),
    "uint32": st.integers(0, 2**32 - 1),
    "sfixed32": st.integers(-(2**31), 2**31 - 1),
    "sfixed64": st.integers(-(2**63), 2**63 - 1),
    "sint32": st.integers(-(2**31), 2**31 - 1),
    "sint64": st.integers(-(2**63), 2**63 - 1),
}

_HEAD = """
name: "test.proto" package: "test" syntax: "proto3"
dependency: "google/protobuf/timestamp.proto" dependency: "google/protobuf/duration.proto"
enum_type { name: "Mode" value { name: "IDLE" number: 0 } value { name: "RUN" number: 7 } }
message_type { name: "Everything"
  nested_type { name: "Inner" field { name: "x" number: 1 type: TYPE_DOUBLE label: LABEL_OPTIONAL } }
  nested_type { name: "CountsEntry" options { map_entry: true }
    field { name: "key" number: 1 type: TYPE_STRING label: LABEL_OPTIONAL }
    field { name: "value" number: 2 type: TYPE_INT64 label: LABEL_OPTIONAL } }
  nested_type { name: "ByNumberEntry" options { map_entry: true }
    field { name: "key" number: 1 type: TYPE_INT32 label: LABEL_OPTIONAL }
    field { name: "value" number: 2 type: TYPE_MESSAGE type_name: ".test.Everything.Inner" label: LABEL_OPTIONAL } }
  nested_type { name: "ByTruthEntry" options { map_entry: true }
    field { name: "key" number: 1 type: TYPE_BOOL label: LABEL_OPTIONAL }
    field { name: "value" number: 2 type: TYPE_ENUM type_name: ".test.Mode" label: LABEL_OPTIONAL } }
  oneof_decl { name: "choice" }
  oneof_decl { name: "_perhaps" }
"""


def _field(number: int, name: str, type_: str, label: str = "OPTIONAL", of: str = "", more: str = "") -> str:
    type_name = f'type_name: ".{of}"' if of else ""
    return f'field {{ name: "{name}" number: {number} type: TYPE_{type_} label: LABEL_{label} {type_name} {more} }}\n'


_FIELDS = [
    *(_field(10 + at, f"a_{name}", name.upper()) for at, name in enumerate(_SCALARS)),
    *(_field(40 + at, f"many_{name}", name.upper(), "REPEATED") for at, name in enumerate(_SCALARS)),
    _field(70, "class", "ENUM", of="test.Mode"),
    _field(71, "modes", "ENUM", "REPEATED", "test.Mode"),
    _field(72, "from", "MESSAGE", of="test.Everything.Inner"),
    _field(73, "inners", "MESSAGE", "REPEATED", "test.Everything.Inner"),
    _field(74, "children", "MESSAGE", "REPEATED", "test.Everything"),
    _field(75, "stamp", "MESSAGE", of="google.protobuf.Timestamp"),
    _field(76, "took", "MESSAGE", of="google.protobuf.Duration"),
    _field(77, "number", "DOUBLE", more="oneof_index: 0"),
    _field(78, "word", "STRING", more="oneof_index: 0"),
    _field(79, "perhaps", "INT32", more="oneof_index: 1 proto3_optional: true"),
    _field(80, "counts", "MESSAGE", "REPEATED", "test.Everything.CountsEntry"),
    _field(81, "by_number", "MESSAGE", "REPEATED", "test.Everything.ByNumberEntry"),
    _field(82, "by_truth", "MESSAGE", "REPEATED", "test.Everything.ByTruthEntry"),
]

FILE = text_format.Parse(_HEAD + "".join(_FIELDS) + "}", descriptor_pb2.FileDescriptorProto())


def descriptor_set(*files: descriptor_pb2.FileDescriptorProto) -> bytes:
    """Serialised descriptors, as a recording carries them: of `FILE` and what it needs by default."""
    described = descriptor_pb2.FileDescriptorSet()
    if files:
        described.file.extend(files)
    else:
        for module in (timestamp_pb2, duration_pb2):
            module.DESCRIPTOR.CopyToProto(described.file.add())
        described.file.append(FILE)
    return described.SerializeToString()


def message_class() -> type[Message]:
    """Google's own class for the message."""
    pool = descriptor_pool.DescriptorPool()
    for module in (timestamp_pb2, duration_pb2):
        pool.AddSerializedFile(module.DESCRIPTOR.serialized_pb)
    pool.Add(FILE)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(NAME))


_MODES = st.sampled_from(["IDLE", "RUN", 3])
_INNERS = st.fixed_dictionaries({"x": st.floats(allow_nan=False)})
_TIMES = st.fixed_dictionaries({"seconds": st.integers(0, 2**40), "nanos": st.integers(0, 10**9 - 1)})
_CHILDREN = st.deferred(lambda: st.lists(rows(), max_size=1))


def rows() -> st.SearchStrategy[dict[str, Any]]:
    """Rows of the message: fields without presence are always there."""
    always = {
        **{f"a_{name}": values for name, values in _SCALARS.items()},
        **{f"many_{name}": st.lists(values, max_size=3) for name, values in _SCALARS.items()},
        "class": _MODES,
        "modes": st.lists(_MODES, max_size=3),
        "inners": st.lists(_INNERS, max_size=2),
        "children": st.just([]) | _CHILDREN,
        "counts": st.dictionaries(_SCALARS["string"], _SCALARS["int64"], max_size=2),
        "by_number": st.dictionaries(_SCALARS["int32"].map(str), _INNERS, max_size=2),
        "by_truth": st.dictionaries(st.sampled_from(["true", "false"]), _MODES),
    }
    either = st.sampled_from(["number", "word", ""])
    optional = {"from": _INNERS, "stamp": _TIMES, "took": _TIMES, "perhaps": _SCALARS["int32"]}
    choices = {"number": 1.5, "word": "", "": None}
    plain = st.fixed_dictionaries(always, optional=optional)
    return st.builds(lambda row, which: {**row, which: choices[which]} if which else row, plain, either)


def fill(message: Any, row: dict[str, Any]) -> Any:
    """Set a message's fields to those of a row."""
    for name, value in row.items():
        field = message.DESCRIPTOR.fields_by_name[name]
        if isinstance(value, dict) and field.is_repeated:
            _fill_map(getattr(message, name), field, value)
        elif isinstance(value, dict):
            getattr(message, name).SetInParent()
            fill(getattr(message, name), value)
        elif isinstance(value, list) and field.message_type is not None:
            for one in value:
                fill(getattr(message, name).add(), one)
        elif isinstance(value, list):
            getattr(message, name).extend(_number(field, one) for one in value)
        else:
            setattr(message, name, _number(field, value))
    return message


def _fill_map(target: Any, field: Any, values: dict[str, Any]) -> None:
    key, inner = (field.message_type.fields_by_name[name] for name in ("key", "value"))
    for name, value in values.items():
        real = {"true": True, "false": False}[name] if key.type == key.TYPE_BOOL else name
        real = int(name) if key.type == key.TYPE_INT32 else real
        if inner.message_type is not None:
            fill(target[real], value)
        else:
            target[real] = _number(inner, value)


def _number(field: Any, value: Any) -> Any:
    return field.enum_type.values_by_name[value].number if field.enum_type and isinstance(value, str) else value
