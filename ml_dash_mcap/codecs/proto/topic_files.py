"""The .proto files of a topic, from the descriptors in its schemas."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError

from ...errors import EncodingError
from ...mcap.records import Schema
from . import descriptor, proto_text, row_comments
from .layout import Layout
from .row_comments import RowsAbout

_SHIPPED = "google/protobuf/"
"""Compilers bring these files."""


def texts(schemas: Iterable[Schema], about: RowsAbout) -> dict[str, str]:
    """Return the text of each .proto file by its name, that of the topic's own message first.

    Args:
        schemas: Of the topic's channels, in the order of writing, all in protobuf.
        about: The topic.

    Raises:
        EncodingError: A schema is broken, or the schemas contradict each other.
    """
    schema, layout = _widest(list(schemas), about.topic)
    files = _files(schema)
    main = _file_of_message(files, schema.name)
    if layout is not None:
        comments = row_comments.comments_of(main, about, layout.opaque)
        return {main.name: proto_text.write(main, files, comments)}
    others = [file for file in files if file is not main and not file.name.startswith(_SHIPPED)]
    return {file.name: proto_text.write(file, files, proto_text.comments_of(file)) for file in (main, *others)}


def _widest(schemas: Sequence[Schema], topic: str) -> tuple[Schema, Layout | None]:
    """Return the schema that describes the messages of all channels, with its layout if they are rows of ours."""
    distinct = list({(schema.name, schema.data): schema for schema in schemas}.values())
    layouts = [descriptor.decode(schema.data, schema.name) for schema in distinct]
    for schema, layout in zip(reversed(distinct), reversed(layouts), strict=True):
        if len(distinct) == 1 or (layout is not None and all(_covers(layout, other) for other in layouts)):
            opaque = [path for each in layouts if each is not None for path in each.opaque]
            return schema, None if layout is None else layout.with_opaque(opaque)
    raise EncodingError(
        f"topic {topic!r} has {len(distinct)} message types that contradict each other, because its segments were "
        "recorded apart; open one segment, as in Recording(rec.segments[0]), and ask it"
    )


def _covers(wide: Layout, narrow: Layout | None) -> bool:
    """Whether messages of one layout can be read by another one."""
    if narrow is None:
        return False
    for member in narrow.members:
        same = wide.by_number.get(member.number)
        if same is None or (same.key, same.slot) != (member.key, member.slot):
            return False
        if member.inner is not None and (same.inner is None or not _covers(same.inner, member.inner)):
            return False
    return True


def _files(schema: Schema) -> list[Any]:
    try:
        return list(descriptor_pb2.FileDescriptorSet.FromString(schema.data).file)
    except DecodeError as error:
        raise EncodingError(f"the schema {schema.name!r} is no set of file descriptors: {error}") from error


def _file_of_message(files: Sequence[Any], name: str) -> Any:
    for file in files:
        if name in _message_names(file.message_type, file.package):
            return file
    raise EncodingError(f"the schema {name!r} describes no message of that name")


def _message_names(messages: Iterable[Any], scope: str) -> Iterator[str]:
    for message in messages:
        full = f"{scope}.{message.name}" if scope else message.name
        yield full
        yield from _message_names(message.nested_type, full)
