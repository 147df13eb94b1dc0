"""Comments for the .proto text of a topic's rows: keys, shapes, units, and what the exact text holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import orjson
from google.protobuf import descriptor_pb2

from . import names
from .descriptor import entries_of
from .layout import EXACT_NUMBER, TIME_NUMBER
from .proto_text import FIELDS, FILE, INNER_MESSAGES, MESSAGES, Path

_Field = descriptor_pb2.FieldDescriptorProto

_MOST_PATHS = 40
"""So many paths of values in the exact text are listed."""

_LETTERS = 110
"""Of a line of a comment."""


@dataclass(frozen=True, slots=True)
class RowsAbout:
    """What is known about a topic's rows besides their messages."""

    topic: str
    description: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    """By dotted field name."""
    shapes: Mapping[str, Sequence[int | None]] = field(default_factory=dict)
    """The shape of lists by dotted field name; None where lengths differ."""
    notes: Sequence[str] = ()
    """More sentences for the message."""


def comments_of(file: Any, about: RowsAbout, opaque: Sequence[str]) -> dict[Path, str]:
    """Return the comments of the file descriptor of a topic's rows, by path.

    Args:
        file: The `google.protobuf.FileDescriptorProto`.
        about: The topic.
        opaque: The dotted paths of values that some rows have in the exact text.
    """
    message: Path = (MESSAGES, 0)
    comments = {
        FILE: "Written by ml_dash_mcap from a recording's schema.",
        message: "\n".join(_about_rows(about)),
    }
    for index, described in enumerate(file.message_type[0].field):
        path = (*message, FIELDS, index)
        if described.number == TIME_NUMBER:
            comments[path] = "Time stamp, s."
        elif described.number == EXACT_NUMBER:
            comments[path] = "\n".join(_about_exact(opaque))
    comments.update(_of_fields(file.message_type[0], message, "", about))
    return comments


def _about_rows(about: RowsAbout) -> Iterator[str]:
    yield f"A row of the topic {_literal(about.topic)}. Lists of lists are written one after the other."
    if about.description:
        yield about.description
    yield from about.notes


def _about_exact(opaque: Sequence[str]) -> Iterator[str]:
    yield "What the other fields do not express, as JSON: values by JSON Pointer (RFC 6901). An integer here says"
    yield "that the double in its field was an integer."
    if not opaque:
        return
    yield "Some rows have here what no field expresses (None, mixed or empty lists, and the like):"
    line = ""
    for path in [*map(_literal, opaque[:_MOST_PATHS]), *(["..."] if len(opaque) > _MOST_PATHS else [])]:
        if line and len(line) + len(path) > _LETTERS:
            yield f"{line},"
            line = ""
        line = f"{line}, {path}" if line else path
    yield f"{line}."


def _of_fields(message: Any, path: Path, parent: str, about: RowsAbout) -> Iterator[tuple[Path, str]]:
    places = {inner.name: index for index, inner in enumerate(message.nested_type)}
    is_row = not parent
    for index, described in enumerate(message.field):
        if is_row and described.number in (TIME_NUMBER, EXACT_NUMBER):
            continue
        entries = entries_of(described.options)
        key = entries.get("key", described.name)
        text = ", ".join(_about_field(described, key, f"{parent}{key}", entries, about))
        if text:
            yield (*path, FIELDS, index), f"{text[0].upper()}{text[1:]}."
        inner_name = described.type_name.rpartition(".")[2]
        if inner_name in places and inner_name != names.ARRAY_NAME:
            inner_path = (*path, INNER_MESSAGES, places[inner_name])
            yield from _of_fields(message.nested_type[places[inner_name]], inner_path, f"{parent}{key}.", about)
    if names.ARRAY_NAME in places:
        yield from _of_array((*path, INNER_MESSAGES, places[names.ARRAY_NAME]))


def _about_field(described: Any, key: str, dotted: str, entries: Mapping[str, Any], about: RowsAbout) -> Iterator[str]:
    if key != described.name:
        yield f"key {_literal(key)}"
    if described.label == _Field.LABEL_REPEATED or described.type_name.endswith(f".{names.ARRAY_NAME}"):
        shape = _shape(about.shapes.get(dotted, ()), entries.get("lengths", []))
        if shape:
            yield f"shape [{', '.join(shape)}]"
    unit = about.units.get(dotted)
    if unit:
        yield f"unit {unit}"


def _shape(told: Sequence[int | None], inner_lengths: Sequence[int]) -> list[str]:
    """Return the lengths of all dimensions; N where the first one is not known or differs."""
    lengths = tuple(told) if tuple(told[1:]) == tuple(inner_lengths) or not inner_lengths else (None, *inner_lengths)
    return ["N" if length is None else str(length) for length in lengths]


def _of_array(path: Path) -> Iterator[tuple[Path, str]]:
    yield path, "A large array of numpy."
    yield (*path, FIELDS, 0), 'Its type and shape, such as "uint8[480,640,3]"; ">" before it says big-endian.'
    yield (*path, FIELDS, 1), "Its numbers in C order, little-endian."


def _literal(text: str) -> str:
    return orjson.dumps(text).decode()
