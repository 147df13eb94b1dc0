"""Random ROS messages: their definitions, their bytes as rosbags writes them, and the rows that they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

NUMBERS = {
    "bool": st.booleans(),
    "float32": st.floats(width=32),
    "float64": st.floats(),
    **{
        f"{sign}int{bits}": st.integers(0, 2**bits - 1)
        if sign
        else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        for bits in (8, 16, 32, 64)
        for sign in ("", "u")
    },
}
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
WORDS = ["class", "from", "import", "a", "b", "lambda", "x_1", "data", "at", "run0", "value1"]
"""Names of fields, with those that a program that writes programs may stumble over."""


@dataclass(frozen=True)
class Field:
    name: str
    type: str
    """Of a number, "string", or a message's name."""
    length: int | None = None
    """Of a fixed array; 0 for a list of any length; None for one value."""

    @property
    def text(self) -> str:
        brackets = {None: "", 0: "[]"}.get(self.length, f"[{self.length}]")
        return f"{self.type}{brackets} {self.name}"


Messages = dict[str, list[Field]]
"""Messages to fields; the first is the one that is sent."""


@st.composite
def messages(draw: st.DrawFn, least: int = 0) -> Messages:
    """A message and two that it may be made of; `least` is how many fields they have at least."""
    types = [*NUMBERS, *NUMBERS, "string", "string"]
    inmost = draw(_fields(types, 1))
    inner = draw(_fields([*types, "pkg/Inmost"], least))
    outer = draw(_fields([*types, *["pkg/Inner", "pkg/Inmost"] * 4], 1))
    return {"pkg/Outer": outer, "pkg/Inner": inner, "pkg/Inmost": inmost}


def _fields(types: list[str], least: int) -> st.SearchStrategy[list[Field]]:
    lengths = st.sampled_from([None, None, 0, 0, 1, 3])
    field = st.builds(Field, st.sampled_from(WORDS), st.sampled_from(types), lengths)
    return st.lists(field, min_size=least, max_size=6, unique_by=lambda one: one.name)


def text(messages: Messages) -> str:
    """Their definitions as a recording carries them."""
    sections = ["\n".join(field.text for field in fields) for fields in messages.values()]
    headers = [f"MSG: {name}\n" for name in messages]
    headers[0] = ""
    return f"\n{'=' * 80}\n".join(header + section for header, section in zip(headers, sections, strict=True))


IDL_TYPES = {
    "bool": "boolean",
    "float32": "float",
    "float64": "double",
    "uint8": "octet",
    "int16": "short",
    "uint16": "unsigned short",
    "int32": "long",
    "uint32": "unsigned long",
    "int64": "long long",
    "uint64": "unsigned long long",
}


def idl(messages: Messages) -> str:
    """Their definitions in IDL, as rosidl writes it."""
    return "".join(
        f"{'=' * 80}\nIDL: {name.replace('/', '/msg/')}\n{_struct(name, fields)}" for name, fields in messages.items()
    )


def _struct(name: str, fields: list[Field]) -> str:
    package, _, last = name.partition("/")
    typedefs, members = [], []
    for field in fields:
        type_ = IDL_TYPES.get(field.type, field.type.replace("/", "::msg::"))
        if field.length:
            typedefs.append(
                f"typedef {type_} {type_.replace('::', '__').replace(' ', '_')}__{field.length}[{field.length}];"
            )
            type_ = f"{type_.replace('::', '__').replace(' ', '_')}__{field.length}"
        elif field.length == 0:
            type_ = f"sequence<{type_}>"
        members.append(f'@unit (value="[m], (; \\" /* ")\n      {type_} {field.name};')
    if not members:
        members.append("uint8 structure_needs_at_least_one_member;")
    newline = "\n      "
    return f"""// generated from rosidl_adapter/resource/msg.idl.em
#include "{package}/msg/Other.idl"

module {package} {{
  module msg {{
    {newline.join(dict.fromkeys(typedefs))}
    module {last}_Constants {{
      @verbatim (language="comment", text="one" "two")
      const uint8 MAX = 3;
      const string NAME = "a; b";
    }};
    @verbatim (language="comment", text=
      "A comment" "\\n"
      "}};")
    struct {last} {{
      {newline.join(members)}
    }};
  }};
}};
"""


def rows(messages: Messages, name: str = "pkg/Outer") -> st.SearchStrategy[dict[str, Any]]:
    """Rows of one of the messages."""
    fields = messages[name]
    values = st.tuples(*(_value(messages, field) for field in fields))
    return values.map(lambda values: {field.name: value for field, value in zip(fields, values, strict=True)})


def _value(messages: Messages, field: Field) -> st.SearchStrategy[Any]:
    if field.type in messages:
        one: st.SearchStrategy[Any] = rows(messages, field.type)
    else:
        one = TEXTS if field.type == "string" else NUMBERS[field.type]
    if field.length is None:
        return one
    least, most = (field.length, field.length) if field.length else (0, 4)
    if field.type == "uint8":
        return st.binary(min_size=least, max_size=most)
    return st.lists(one, min_size=least, max_size=most)


def typestore(messages: Messages) -> Typestore:
    """What rosbags makes of the definitions."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text(messages), next(iter(messages))))
    return store


def instance(store: Typestore, messages: Messages, row: dict[str, Any], name: str = "pkg/Outer") -> Any:
    """A row as rosbags' message object."""
    package, _, last = name.partition("/")
    values = [_instance(store, messages, field, row[field.name]) for field in messages[name]]
    return store.types[f"{package}/msg/{last}"](*values)


def _instance(store: Typestore, messages: Messages, field: Field, value: Any) -> Any:
    if field.type in messages:
        if field.length is None:
            return instance(store, messages, value, field.type)
        return [instance(store, messages, one, field.type) for one in value]
    if field.length is None or field.type == "string":
        return value
    return np.array(list(value), dtype=field.type)
