"""The fields of rows that were recorded as protobuf messages, as the descriptors of a topic's segments have them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from ..mcap.records import Channel
from ..query.file import File
from ..rows.shape import NOTHING, Shape
from . import field_shapes
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
    shapes: dict[str, dict[Slot, Shape]] = {}
    for layout in layouts:
        for name, slot, values in _walk(layout, ""):
            of_name = shapes.setdefault(name, {})
            of_name[slot] = of_name.get(slot, NOTHING) | values
    exact = dict.fromkeys(path for layout in layouts for path in layout.opaque)
    fields = {name: _field(list(map(field_shapes.of_shape, of_name.values()))) for name, of_name in shapes.items()}
    return MessageFields(fields, tuple(exact))


def _layouts(channels: Iterable[tuple[File, Channel]]) -> Iterator[Layout]:
    for file, channel in channels:
        schema = file.index.schema_of(channel)
        if schema is None or schema.encoding != "protobuf" or channel.message_encoding != "protobuf":
            continue
        from ..codecs.proto import descriptor  # protobuf, which other recordings do not need

        layout = descriptor.decode(schema.data, schema.name)
        if layout is not None:
            yield layout


def _walk(layout: Layout, parent: str) -> Iterator[tuple[str, Slot, Shape]]:
    """Yield the fields by dotted name, each with the shape of its values."""
    from ..codecs.proto import layout_shape

    for member in layout.members:
        dotted = f"{parent}{member.key}"
        if member.inner is not None and member.inner.members and not member.slot.is_list:
            yield from _walk(member.inner, f"{dotted}.")
        else:
            yield dotted, member.slot, layout_shape.of_member(member)


def _field(fields: list[Field]) -> Field:
    """Return the type of values that lie in some fields of one key."""
    types, ranks = {field.type for field in fields}, {len(field.shape) for field in fields}
    if types == {"integer", "number"}:
        types = {"number"}
    if len(types) > 1 or len(ranks) > 1:
        return _ANY
    lengths = map(set, zip(*(field.shape for field in fields), strict=True))
    return Field(types.pop(), tuple(each.pop() if len(each) == 1 else None for each in lengths))
