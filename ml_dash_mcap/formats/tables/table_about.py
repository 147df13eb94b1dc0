"""The description that this library writes into its tables, so that their rows come back as they were."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import orjson

from ...rows.plain_row import TIME_KEY

ABOUT_KEY = "ml_dash"
"""The key of a file's metadata whose value is the JSON."""

UNIT_KEY = b"ml_dash.unit"
"""Metadata of a column: its unit, if the topic's metadata has one under `units`."""

WALL_CLOCK, OTHER_CLOCK = "timestamp", "timestamp_ns"
"""The column that says the same as that of time stamps, for other readers: as instants in UTC of a clock that shows
wall-clock time, or in ns of other clocks."""

_SHAPE_KEY = b"ml_dash.shape"
_ANNOTATIONS = ("units", "joint_names", "quat_order", "frame_id")
"""Keys of a topic's metadata that stand at the top of the JSON."""


@dataclass(frozen=True, slots=True)
class TableAbout:
    """The description of a table of this library. With its default values it describes a CSV file."""

    time_name: str = TIME_KEY
    """The column of time stamps, in s."""
    topic: str | None = None
    kind: str | None = None
    """That of the topic. Rows of one time merge in a track alone. Null is None in messages, and elsewhere no field."""
    is_flat: bool = True
    """Whether vectors are a column an element, `q.0`, `q.1`, and nested fields columns with dotted names."""
    is_ragged: bool = False
    """Whether lists end where the rest of their columns is null."""
    schema: Mapping[str, Any] = field(default_factory=dict)
    """The schema of the rows, as JSON Schema."""
    schema_name: str = ""
    encoding: str = ""
    """The encoding of the rows in the recording, such as "json"."""
    description: str | None = None
    tags: Sequence[str] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """The metadata of the topic, its annotations included."""
    run: Mapping[str, Any] = field(default_factory=dict)
    """The description of the run, its `params` included."""
    source: Mapping[str, str] = field(default_factory=dict)
    """Who recorded it."""

    def to_json(self) -> bytes:
        """Return the JSON that stands in the file."""
        annotations = {key: self.metadata[key] for key in _ANNOTATIONS if key in self.metadata}
        about = {
            "topic": self.topic,
            "time": self.time_name,
            **annotations,
            "schema": self.schema,
            "schema_name": self.schema_name,
            "encoding": self.encoding,
            "description": self.description,
            "tags": self.tags,
            "metadata": {key: value for key, value in self.metadata.items() if key not in annotations},
            "run": self.run,
            "source": self.source,
            "kind": self.kind,
            "flatten": self.is_flat,
        }
        try:
            return orjson.dumps(about)
        except TypeError:  # a foreign recording's parameter needs more than 64 bits
            return json.dumps(about).encode()

    @classmethod
    def from_json(cls, text: bytes) -> TableAbout | None:
        """Return what the JSON of a file says; None if it is not that of this library."""
        try:
            about = orjson.loads(text)
        except orjson.JSONDecodeError:
            return None
        if not isinstance(about, dict) or not isinstance(about.get("time"), str):
            return None
        annotations = {key: about[key] for key in _ANNOTATIONS if about.get(key)}
        run = about.get("run")
        return cls(
            time_name=about["time"],
            topic=about.get("topic"),
            kind=about.get("kind"),
            is_flat=bool(about.get("flatten")),
            schema=properties_of({"properties": about.get("schema")}),
            description=about.get("description"),
            tags=about.get("tags") or (),
            metadata={**(about.get("metadata") or {}), **annotations},
            run=run if isinstance(run, Mapping) else {},
        )


def properties_of(schema: Any) -> Mapping[str, Any]:
    """Return the properties of a JSON Schema; empty for a value that is no schema."""
    properties = schema.get("properties") if isinstance(schema, Mapping) else None
    return properties if isinstance(properties, Mapping) else {}


def shape_metadata(shape: Sequence[int]) -> dict[bytes, bytes]:
    """Return the metadata of a column of vectors or matrices, such as `[4, 4]`, whose values lie row by row."""
    return {_SHAPE_KEY: orjson.dumps(shape)} if shape else {}


def shape_in(metadata: Mapping[bytes, bytes]) -> tuple[int, ...]:
    """Return the shape that `shape_metadata` put into a column's metadata; () if there is none."""
    try:
        shape = orjson.loads(metadata.get(_SHAPE_KEY, b"[]"))
    except orjson.JSONDecodeError:
        return ()
    is_shape = isinstance(shape, list) and all(type(length) is int and length > 0 for length in shape)
    return tuple(shape) if is_shape else ()
