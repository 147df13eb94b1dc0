"""The dicts that reads return, in ml-dash's and dreamlake's shapes."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

BytesFormat = Literal["jsonl", "parquet", "mcap"]
"""What `read(format=...)` returns as bytes."""


class Entries(TypedDict):
    """`read()` of a track or a recording, as ml-dash has it."""

    entries: list[dict[str, Any]]
    """Rows under dotted names, each with its time stamp (s) as `timestamp`."""
    count: int
    """How many."""


class TakeMetadata(TypedDict):
    """What `read(format="mocap")` says of all frames."""

    topic: str
    description: str | None
    tags: list[str]
    fps: float
    """Frames a second."""
    duration: float
    """In s."""
    frameCount: int
    startTime: float
    """In s."""
    endTime: float
    """In s."""


class Take(TypedDict):
    """`read(format="mocap")`."""

    version: str
    metadata: TakeMetadata
    channels: list[str]
    """The names of all fields, sorted."""
    frames: list[dict[str, Any]]
    """Rows under dotted names, each with its time stamp (s) as `time`."""


class Point(TypedDict):
    """One point of a session's track or of a metric."""

    index: int
    data: dict[str, Any]
    """The row as it was given, with its time stamp (s) as `_ts`."""
    createdAt: str
    """ISO 8601, UTC."""


class Page(TypedDict):
    """`read()` of a session's track or of a metric: points by index."""

    data: list[Point]
    startIndex: int
    endIndex: int
    """Of the last point; one less than `startIndex` where there is none."""
    total: int
    """How many points were returned."""
    hasMore: bool


class TimePage(TypedDict):
    """`read_by_time()` of a session's track."""

    data: list[Point]
    startTime: float | None
    endTime: float | None
    total: int
    """How many points were returned."""
    hasMore: bool
