"""The fields of rows that were recorded as protobuf messages, as the descriptors of a topic's segments have them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from ..mcap.records import Channel
from ..query.file import File
from .field_shapes import Field

if TYPE_CHECKING:
    from ..codecs.proto.layout import Layout, Slot

_ANY = Field("any")


class MessageFields(NamedTuple):
    """What the descriptors say."""

    fields: dict[str, Field]
    """By dotted name; of lists, the first length is not known."""
    exact: tuple[str, ...]
    """The dotted names of values that some rows have in the exact text, because no field expresses them."""


def read(channels: Iterable[tuple[File, Channel]]) -> MessageFields:
    """Return the fields of a topic's rows; none of messages of others, or in other encodings."""
    layouts = list(_layouts(channels))
    slots: dict[str, list[Slot]] = {}
    for layout in layouts:
        for name, slot in _walk(layout, ""):
            slots.setdefault(name, []).append(slot)
    exact = dict.fromkeys(path for layout in layouts for path in layout.opaque)
    return MessageFields({name: _field(set(of_name)) for name, of_name in slots.items()}, tuple(exact))


def _layouts(channels: Iterable[tuple[File, Channel]]) -> Iterator[Layout]:
    for file, channel in channels:
        schema = file.index.schema_of(channel)
        if schema is None or schema.encoding != "protobuf" or channel.message_encoding != "protobuf":
            continue
        from ..codecs.proto import descriptor  # protobuf, which other recordings do not need

        layout = descriptor.decode(schema.data, schema.name)
        if layout is not None:
            yield layout


def _walk(layout: Layout, parent: str) -> Iterator[tuple[str, Slot]]:
    for member in layout.members:
        dotted = f"{parent}{member.key}"
        if member.inner is not None and member.inner.members and not member.slot.is_list:
            yield from _walk(member.inner, f"{dotted}.")
        else:
            yield dotted, member.slot


_TYPES = {
    "DOUBLE": "number",
    "INT": "integer",
    "UINT": "integer",
    "BOOL": "boolean",
    "TEXT": "string",
    "BYTES": "bytes",
    "DICT": "object",
    "ARRAY": "array",
}
"""By the name of the kind of a protobuf field."""


def _field(slots: set[Slot]) -> Field:
    """Return the type of values that lie in some fields of one key."""
    types = {_TYPES[slot.kind.name] for slot in slots}
    lengths = {slot.lengths for slot in slots}
    if types == {"integer", "number"}:
        types = {"number"}
    if len(types) > 1 or len({None if inner is None else len(inner) for inner in lengths}) > 1:
        return _ANY
    ranks = [inner for inner in lengths if inner is not None]
    if not ranks:
        return Field(types.pop())
    shape = (None, *(each.pop() if len(each) == 1 else None for each in map(set, zip(*ranks, strict=True))))
    return Field(types.pop(), shape)
