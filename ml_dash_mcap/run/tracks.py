"""The tracks of a run, with ml-dash's names: topics that can be appended to and read while they are recorded."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Generic, Literal, TypeVar, overload

from ..codecs.given.schema_source import SchemaSource
from ..errors import EntryNotFoundError, FieldError, RangeError
from ..meaning.annotations import NO_ANNOTATIONS
from ..recorder import Recorder, open_track
from ..rows.result_dicts import BytesFormat, Entries, Take
from ..topic import Topic
from ..topic_reader import Columns, Json, Seconds
from .readback import Readback
from .track_formats import render_track

Entry = dict[str, Any]
"""A row under flat, dotted names, its time stamp (s) under `timestamp`."""


class BoundTopic(Topic):
    """A topic that knows where its rows are read back."""

    __slots__ = ("_readback",)

    _readback: Readback

    def bind(self, readback: Readback) -> None:
        """Set the place where rows are read; called by the code that opens the topic."""
        self._readback = readback

    def note_flush(self) -> None:
        """Learn that everything appended so far was flushed together with other topics."""


class Track(BoundTopic):
    """One topic of an experiment.

    `append`, `append_batch`, `append_columns` and `flush` are the topic's own, and any thread may call them; reading
    flushes first.

    Example:
        >>> exp.tracks("robot").append(q=[0.1, 0.2], _ts=0.0).append(q=[0.2, 0.3], _ts=0.1)
        >>> exp.tracks("robot").read(start_timestamp=0.0, end_timestamp=0.05)
        {'entries': [{'timestamp': 0.0, 'q': [0.1, 0.2]}], 'count': 1}
    """

    __slots__ = ()

    @overload
    def read(
        self,
        start_timestamp: Seconds = None,
        end_timestamp: Seconds = None,
        columns: Columns = None,
        format: Json = "json",
    ) -> Entries: ...
    @overload
    def read(
        self,
        start_timestamp: Seconds = None,
        end_timestamp: Seconds = None,
        columns: Columns = None,
        *,
        format: BytesFormat,
    ) -> bytes: ...
    @overload
    def read(
        self,
        start_timestamp: Seconds = None,
        end_timestamp: Seconds = None,
        columns: Columns = None,
        *,
        format: Literal["mocap"],
    ) -> Take: ...
    @overload
    def read(
        self,
        start_timestamp: Seconds = None,
        end_timestamp: Seconds = None,
        columns: Columns = None,
        format: str = "json",
    ) -> Any: ...
    def read(
        self,
        start_timestamp: Seconds = None,
        end_timestamp: Seconds = None,
        columns: Columns = None,
        format: str = "json",
    ) -> Any:
        """Return the rows of a time range, merged and sorted by time, earlier runs under this prefix included.

        Args:
            start_timestamp: The first time wanted, in seconds, included; None is the beginning.
            end_timestamp: The last time wanted, in seconds, included; None is the end.
            columns: The fields wanted; nested ones under dotted names, of which a part such as "camera" takes all
                below it. None and an empty list are all.
            format: What to return:

                - "json": `{"entries": [{"timestamp": s, field: value, ...}, ...], "count": rows}`
                - "jsonl": bytes, an entry a line
                - "parquet", "mcap": bytes of such a file
                - "mocap": a dict of metadata, channels and frames

        Raises:
            FormatError: ml-dash's "Unsupported format"; a ValueError.
            RangeError: A time is no number, or the end lies before the start.
            StateError: The run has ended; `Recording(path)` reads it.
        """
        return render_track(self._readback.part(self.name, start_timestamp, end_timestamp, columns), format)

    def list_entries(self) -> list[Entry]:
        """Return all rows, as `read()["entries"]`."""
        return self.read()["entries"]

    def slice(self, start_timestamp: float | None = None, end_timestamp: float | None = None) -> TrackSlice:
        """Return the rows of a time range, both ends included, for iterating and for finding by time."""
        return TrackSlice(self, start_timestamp, end_timestamp)

    def _with_timestamp_field(self, timestamp: Any, fields: dict[str, Any]) -> dict[str, Any]:
        raise FieldError(
            f"append() on topic {self.name!r}: the field name 'timestamp' is taken, rows are read back with their time"
            " under it; rename the field, or pass the row's time as _ts="
        )


class TrackSlice:
    """The rows of a time range as they were when the slice was first used."""

    __slots__ = ("_end_timestamp", "_entries", "_start_timestamp", "_times_s", "_track")

    def __init__(self, track: Track, start_timestamp: float | None, end_timestamp: float | None) -> None:
        self._track = track
        self._start_timestamp = start_timestamp
        self._end_timestamp = end_timestamp
        self._entries: list[Entry] | None = None
        self._times_s: list[float] = []

    def __repr__(self) -> str:
        return f"TrackSlice({self._track.name!r}, start={self._start_timestamp}, end={self._end_timestamp})"

    def __len__(self) -> int:
        return len(self._load())

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._load())

    @overload
    def findByTime(self, timestamp: float) -> Entry: ...

    @overload
    def findByTime(self, timestamp: Iterable[float]) -> list[Entry]: ...

    def findByTime(  # noqa: N802 - the name that ml-dash gave it
        self, timestamp: float | Iterable[float]
    ) -> Entry | list[Entry]:
        """Return the last entry at or before a time, or a list of such entries for a list of times.

        Args:
            timestamp: In seconds.

        Raises:
            EntryNotFoundError: All entries are later, or there is none; a KeyError.
            RangeError: A time is no number.
        """
        if isinstance(timestamp, Iterable) and not isinstance(timestamp, str) and getattr(timestamp, "ndim", None) != 0:
            return [self._find(time) for time in timestamp]
        return self._find(timestamp)

    def _find(self, timestamp: Any) -> Entry:
        entries = self._load()
        if not entries:
            raise EntryNotFoundError("No entries in track slice")
        try:
            seconds = float(timestamp)
        except (TypeError, ValueError):
            seconds = math.nan
        if math.isnan(seconds):
            raise RangeError(f"findByTime({timestamp!r}): a time is a number of seconds")
        place = bisect_right(self._times_s, seconds)
        if place == 0:
            raise EntryNotFoundError(
                f"No entry found with timestamp <= {timestamp}. Earliest timestamp: {self._times_s[0]}"
            )
        return entries[place - 1]

    def _load(self) -> list[Entry]:
        entries = self._entries
        if entries is None:
            entries = self._track.read(self._start_timestamp, self._end_timestamp)["entries"]
            self._times_s = [entry["timestamp"] for entry in entries]
            self._entries = entries
        return entries


TrackT = TypeVar("TrackT", bound=BoundTopic)


class Tracks(Generic[TrackT]):
    """Gives the tracks of a run by topic; any thread may call it.

    Example:
        >>> exp.tracks("robot/pose").append(q=[0.1, -0.22, 0.45], _ts=0.0)
        >>> exp.tracks.flush()
        >>> exp.tracks.list()
        ['robot/pose']
    """

    __slots__ = ("_kind", "_opened", "_readback", "_recorder")

    def __init__(self, recorder: Recorder, readback: Readback, kind: type[TrackT]) -> None:
        """Make the tracks of a run.

        Args:
            recorder: Where the rows go.
            readback: Where they are read.
            kind: The class of the tracks.
        """
        self._recorder = recorder
        self._readback = readback
        self._kind = kind
        self._opened: dict[str, TrackT] = {}

    def __repr__(self) -> str:
        """Name the tracks that were opened so far; `list` finds those of earlier runs, too."""
        return f"<Tracks: {', '.join(map(repr, list(self._opened))) or 'none yet'}>"

    def __call__(
        self,
        topic: str,
        description: str | None = None,
        tags: Sequence[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        *,
        units: Mapping[str, str] | None = None,
        joint_names: Sequence[str] | None = None,
        frame_id: str | None = None,
        quat_order: str | None = None,
        encoding: str | None = None,
        schema: SchemaSource = None,
    ) -> TrackT:
        """Return the track of a topic, the same object each time.

        Args:
            topic: Such as "robot/pose".
            description: Kept with the topic, as are `tags` and `metadata`; they may come at any call.
            units: Dotted field name to its unit, such as `{"q": "rad"}`. Exports to ROS and mocap formats go by these
                and by the following; all are kept in the metadata.
            joint_names: Of the elements of joint angles, velocities and torques.
            frame_id: What positions, orientations and vectors are relative to.
            quat_order: "xyzw" or "wxyz", of all quaternions of the topic.
            encoding: The encoding of its rows, "json", "protobuf" or "cbor"; the recorder's option by default.
            schema: The schema of its rows, as `Recorder.topic` takes it.

        Raises:
            TopicError: The topic is empty, too long, or one of the library's own, or is open in another encoding, with
                another schema, or has rows without one.
            UsageError: It is no text.
            OptionError: Rows cannot be recorded in that encoding, or the schema is not known.
            EncodingError: The schema is broken.
            StateError: The run has ended.
        """
        track = self._opened.get(topic) if isinstance(topic, str) else None
        given = (description, tags, metadata, units, joint_names, frame_id, quat_order)
        # The usual call in a control loop: one lookup and one comparison, no checks.
        if track is not None and given == NO_ANNOTATIONS and encoding is None and schema is None:
            return track
        track = open_track(self._recorder, topic, self._kind, given, encoding, schema)
        track.bind(self._readback)
        self._opened[topic] = track
        return track

    def flush(self) -> None:
        """Write all rows appended so far to the file before returning."""
        self._recorder.flush()
        for track in list(self._opened.values()):
            track.note_flush()

    def list(self) -> list[str]:
        """Return the topics of all tracks with rows, sorted, earlier runs included; flushed first."""
        self.flush()
        return self._readback.tracks()
