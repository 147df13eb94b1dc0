"""The columns of a table that hold the numbers of each field, and the note in a file's header that records them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import orjson

from ...meaning.mocap_objects import Body, Joint, Marker, NumberSource, Path

NOTE_KEY = "ML Dash Note"
"""The key of the note in a header of pairs; its value is JSON."""

_VERSION = 1


@dataclass(frozen=True, slots=True)
class Placement:
    """A field of a topic, and the columns that hold its numbers."""

    topic: str
    path: Path
    shape: tuple[int, ...]
    columns: tuple[int, ...]
    """The column of each of its numbers, a matrix row by row. Columns count from 0, without those of frame and time."""


@dataclass(frozen=True, slots=True)
class Note:
    """The description of a recording in a file that was made of it, by which the file becomes the recording again."""

    origin: float
    """The time stamp at which the file's times start, in s."""
    up: str | None = None
    """The axis that points up in the file, if topics were turned. The metadata of each topic has the recording's
    axis."""
    placements: tuple[Placement, ...] = ()
    metadata: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Of the topics."""
    joints: str | None = None
    """The name of the file beside it that has the joint angles."""


def to_text(note: Note) -> str:
    """Spell a note as JSON of ASCII characters, on one line."""
    topics: dict[str, Any] = {}
    for placement in note.placements:
        about = topics.setdefault(
            placement.topic, {"fields": [], "metadata": dict(note.metadata.get(placement.topic, {}))}
        )
        about["fields"].append([list(placement.path), list(placement.shape), list(placement.columns)])
    parts = {"v": _VERSION, "origin": note.origin, "up": note.up, "topics": topics, "joints": note.joints}
    text = orjson.dumps(parts).decode()
    # The headers have no stated encoding and some tools rewrite them; ASCII survives all of them.
    return "".join(letter if " " <= letter <= "~" else _escape(letter) for letter in text)


def _escape(letter: str) -> str:
    units = letter.encode("utf-16-be")
    return "".join(f"\\u{units[at : at + 2].hex()}" for at in range(0, len(units), 2))


def from_text(text: str, columns: int) -> Note | None:
    """Return the note that a text spells; None if it does not, or speaks of columns that the file does not have.

    Args:
        text: JSON.
        columns: How many columns the file has, without those of frame and time.
    """
    try:
        parsed = orjson.loads(text)
        if parsed["v"] != _VERSION:
            return None
        placements = tuple(
            Placement(topic, tuple(map(str, path)), tuple(map(int, shape)), tuple(map(int, where)))
            for topic, about in parsed["topics"].items()
            for path, shape, where in about["fields"]
        )
        metadata = {topic: dict(about["metadata"]) for topic, about in parsed["topics"].items()}
        joints = None if parsed["joints"] is None else str(parsed["joints"])
        note = Note(
            float(parsed["origin"]), None if parsed["up"] is None else str(parsed["up"]), placements, metadata, joints
        )
    except (ValueError, TypeError, KeyError, AttributeError):
        return None
    is_sound = all(
        len(placement.columns) == math.prod(placement.shape)
        and placement.path
        and all(0 <= at < columns for at in placement.columns)
        for placement in placements
    )
    return note if is_sound and 0 <= note.origin < math.inf else None


class Placing:
    """Collects the columns to which the numbers of objects were written, and returns them by field."""

    def __init__(self) -> None:
        self._fields: dict[tuple[str, Path], tuple[tuple[int, ...], list[int]]] = {}
        self._parts: list[Placement] = []

    def add(self, thing: Body | Marker | Joint, columns: Mapping[str, Iterable[int]]) -> None:
        """Note one object's columns.

        Args:
            thing: What was written.
            columns: Of its `position`, `rotation` (x y z w), `error` or `value`, as far as they were written.
        """
        where = {name: list(places) for name, places in columns.items()}
        if isinstance(thing, Joint):
            self._put(thing.topic, thing.value, where.get("value", []))
        elif isinstance(thing, Marker):
            self._put(thing.topic, thing.position, where.get("position", []))
        elif thing.rotation is None:
            for name, size in (("position", 3), ("rotation", 4)):
                if name in where:
                    word = "pos" if name == "position" else "quat"
                    self._parts.append(Placement(thing.topic, (*thing.path, word), (size,), tuple(where[name])))
        else:
            self._put(thing.topic, thing.position, where.get("position", []))
            rotation = where.get("rotation", [])
            if thing.order == "wxyz" and rotation:
                # Files have x y z w; the placement gives the columns in the order that the field had.
                rotation = [rotation[3], *rotation[:3]]
            self._put(thing.topic, thing.rotation, rotation)
            if thing.error is not None:
                self._put(thing.topic, thing.error, where.get("error", []))

    def _put(self, topic: str, source: NumberSource, columns: list[int]) -> None:
        size = math.prod(source.shape)
        for number, column in enumerate(columns, source.start):
            path = source.fields[number // size]
            _, places = self._fields.setdefault((topic, path), (source.shape, [-1] * size))
            places[number % size] = column

    def placements(self) -> tuple[Placement, ...]:
        """Return the fields. If only a part of a field was written, that part is a vector below its name."""
        whole: list[Placement] = []
        for (topic, path), (shape, places) in self._fields.items():
            written = tuple(place for place in places if place >= 0)
            if len(written) == len(places):
                whole.append(Placement(topic, path, shape, written))
            else:
                whole.append(Placement(topic, (*path, "pos"), (len(written),), written))
        return (*whole, *self._parts)
