"""The way in: topics, append, flush, close."""

from __future__ import annotations

import datetime
import json
import os
import socket
import struct
import threading
import time
import uuid
import weakref
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypeVar

from . import clock, timestamps
from .errors import FieldError, StateError, StorageError, TopicError, UsageError
from .options import RecorderOptions
from .recovery import recover_leftovers
from .rows.encode import EXACT_KEY, TIME_KEY, dumps, exact, plain
from .timestamps import MISSING
from .version import LIBRARY
from .write import records
from .write.blocks import PARAMETERS, BlockWriter
from .write.channels import TRACK, ChannelInfo
from .write.journal import Journal
from .write.writer import Writer

TOPIC_METADATA = "ml_dash.topic"
OWN_TOPICS = "ml_dash/"
"""Topics that begin so are the library's own."""

_MAX_TOPIC_BYTES = 1024
_MAX_TOPICS = 65_535

_UNSET: Any = object()
_END_S = clock.END_S
_pack_tail = struct.Struct("<Q6sQQ").pack
_OPCODE = bytes((records.MESSAGE_OPCODE,))

T = TypeVar("T", bound="Topic")


class Topic:
    """One topic of a recorder: a stream of rows, each a set of named fields at a time.

    Any thread may call any method. Made by `Recorder.topic`.
    """

    __slots__ = ("__weakref__", "_channel", "_head", "_journal", "_probe", "_recorder", "name")

    def __init__(self, recorder: Recorder, channel: ChannelInfo) -> None:
        self.name = channel.topic
        self._recorder = recorder
        self._channel = channel
        self._journal = recorder._journal
        self._head = struct.pack("<HI", channel.number, 0)
        self._probe = b"n"[0]

    def append(
        self: T, /, *positional: Any, _ts: Any = MISSING, timestamp: Any = _UNSET, _exact: Any = _UNSET, **fields: Any
    ) -> T:
        """Take one row. Its values are copied: changing an array afterwards changes nothing.

        Args:
            _ts: The row's time stamp, in seconds. Rows of one topic and one time stamp merge into one; later fields win.
            **fields: Numbers, text, bytes, None, lists, dicts, numpy arrays of any shape, dataclasses, datetimes,
                enums, and anything with `tolist` or `__array__`.

        Returns:
            The topic itself.

        Raises:
            TimestampError: `_ts` is missing, not a number, not finite, negative, or beyond the year 2554.
            FieldError: A field cannot be stored, or its name is reserved.
            IntegerRangeError: An integer needs more than 64 bits.
            StateError: The recorder is closed, or this is a forked child of its process.
            BacklogFullError: The backlog is full and `on_full="raise"`.
            StorageError: The backlog is full and nothing can be written.

        Example:
            >>> recorder.topic("robot").append(q=[0.1, 0.2], gripper=0.04, _ts=1.5)
        """
        # The hot path: every line here is measured by tools/bench_append.py. It is `encode`, `clock.to_nanoseconds`
        # and `Journal.add` written out; closed and forked recorders fail the room check, so they cost nothing here.
        if positional or timestamp is not _UNSET or _exact is not _UNSET:
            fields = self._accept(positional, timestamp, _exact, fields)
        if _ts.__class__ is not float or not 0.0 <= _ts < _END_S:
            _ts = self._time(_ts)
        fields[TIME_KEY] = _ts
        try:
            payload = dumps(fields, plain)
        except Exception:
            payload = exact(fields, self.name)
        else:
            if self._probe in payload:
                payload = self._recheck(payload, fields)
        whole = int(_ts)
        time_ns = whole * 1_000_000_000 + int((_ts - whole) * 1e9 + 0.5)
        length = len(payload) + 22
        tail = _pack_tail(length, self._head, time_ns, time_ns) + payload
        journal = self._journal
        with journal.lock:
            buffer = journal.active
            start = buffer.end
            end = start + length + 9
            if end <= buffer.limit:
                # No call stands between these lines, so neither a signal handler nor another thread comes between.
                memory = buffer.map
                memory[start + 1 : end] = tail
                memory[start] = 5
                buffer.end = end
                journal.last_s = _ts
                buffer.starts.append(start)
                if journal.eager is None:
                    return self
        if end > buffer.limit:
            journal.add(_OPCODE + tail, self.name, _ts)
        if journal.eager is not None:
            journal.eager()
        return self

    def append_batch(self: T, rows: Iterable[Mapping[str, Any]]) -> T:
        """Take several rows, each a dict of fields with its `_ts`. If one of them is bad, none is taken.

        Raises:
            As `append`; the message names the row's index.
        """
        tails = [self._encode_row(index, row) for index, row in enumerate(rows)]
        for tail, time_s in tails:
            self._put(tail, time_s)
        return self

    def append_columns(self: T, /, *positional: Any, _ts: Any = MISSING, **columns: Any) -> T:
        """Take many rows at once, given as columns: for simulators and logged arrays.

        Args:
            _ts: Time stamps, [N], s.
            **columns: One value a row each: arrays [N, ...] or sequences of length N.

        Returns:
            The topic itself.

        Raises:
            FieldError: A column has another length, or a value cannot be stored; no row is taken.
            As `append` otherwise.

        Example:
            >>> recorder.topic("robot").append_columns(_ts=times, q=q, gripper=width)  # [N], [N, 7], [N]
        """
        from .write import columns as bulk

        if positional or EXACT_KEY in columns:
            self._accept(positional, _UNSET, columns.get(EXACT_KEY, _UNSET), {})
        if "timestamp" in columns:
            columns = self._accept((), columns.pop("timestamp"), _UNSET, columns)
        for blob, starts, last_s in bulk.encode(_ts, columns, self.name, self._head):
            self._journal.add_many(blob, starts, self.name, last_s)
        if self._journal.eager is not None:
            self._journal.eager()
        return self

    def flush(self: T) -> T:
        """Wait until every row taken so far is in the file, and return the topic itself.

        Raises:
            StateError: The recorder is closed.
            StorageError: It cannot be written.
        """
        self._recorder.flush()
        return self

    def _put(self, tail: bytes, time_s: float) -> bool:
        """Put an encoded row; returns whether it was taken."""
        taken = self._journal.add(_OPCODE + tail, self.name, time_s)
        if self._journal.eager is not None:
            self._journal.eager()
        return taken

    def _encode(self, fields: dict[str, Any], time_s: float) -> bytes:
        """Return a Message record without its opcode; `fields` gets the time stamp."""
        fields[TIME_KEY] = time_s
        try:
            payload = dumps(fields, plain)
        except Exception:
            payload = exact(fields, self.name)
        else:
            if self._probe in payload:
                payload = self._recheck(payload, fields)
        time_ns = clock.to_nanoseconds(time_s)
        return _pack_tail(len(payload) + 22, self._head, time_ns, time_ns) + payload

    def _encode_row(self, index: int, row: Mapping[str, Any]) -> tuple[bytes, float]:
        try:
            fields = dict(row)
        except (TypeError, ValueError) as error:
            raise FieldError(f"append_batch() on topic {self.name!r}: row {index} is {row!r}, not a dict") from error
        try:
            time_s = self._time(fields.pop(TIME_KEY, MISSING))
            if "timestamp" in fields or EXACT_KEY in fields:
                fields = self._accept((), fields.pop("timestamp", _UNSET), fields.get(EXACT_KEY, _UNSET), fields)
            return self._encode(fields, time_s), time_s
        except (TypeError, ValueError) as error:
            raise type(error)(f"row {index} of the batch: {error}") from error

    def _time(self, given: Any) -> float:
        """Return the time stamp of a row, in seconds, by the recorder's rule for missing and inherited ones."""
        return self._recorder._stamper.resolve(given, self.name)

    def _accept(self, positional: tuple[Any, ...], timestamp: Any, exact_key: Any, fields: dict[str, Any]) -> dict[str, Any]:
        """Handle what an ordinary call does not have: positional arguments, a field `timestamp`, a reserved name."""
        if positional:
            raise UsageError(
                f"append() on topic {self.name!r} takes its fields by name, as in append(q=..., _ts=...); got"
                f" {len(positional)} positional argument(s)"
            )
        if exact_key is not _UNSET:
            raise FieldError(f"append() on topic {self.name!r}: the field name {EXACT_KEY!r} is reserved; rename it")
        return self._with_timestamp_field(timestamp, fields)

    def _with_timestamp_field(self, timestamp: Any, fields: dict[str, Any]) -> dict[str, Any]:
        """Take a field that is called `timestamp`; users of an Experiment may not have one."""
        return {"timestamp": timestamp, **fields}

    def _recheck(self, payload: bytes, fields: dict[str, Any]) -> bytes:
        """Look closer at a payload that may have a null in it, where orjson writes None but also NaN and infinities.

        Searching for `null` takes longer than encoding a row, for one byte a fiftieth of that. So a byte of `null`
        that the topic's rows do not have otherwise is looked for, and changed when a row has it.
        """
        if b"null" in payload:
            return exact(fields, self.name)
        self._probe = next((byte for byte in b"nul" if byte not in payload), self._probe)
        return payload


class EventTopic(Topic):
    """A topic of logs, metrics or files: at the recording's time, and never merged."""

    __slots__ = ()

    def add(self, fields: dict[str, Any]) -> bool:
        """Take one row, at the recording's time now; returns whether it was taken."""
        taken = self._journal.add(_OPCODE + self._encode(fields, self._recorder.time()), self.name, None)
        if self._journal.eager is not None:
            self._journal.eager()
        return taken


class Recorder:
    """Records topics into MCAP segments in a folder.

    Opening a folder that has segments already adds to it. Any thread may call any method.
    """

    def __init__(
        self,
        path: str | Path,
        options: RecorderOptions | None = None,
        *,
        prefix: str | None = None,
        metadata: Mapping[str, str] | None = None,
        timestamps: Literal["strict", "auto"] = "strict",
    ) -> None:
        """Open a recording's folder, making it if need be, and fold in what a crashed recorder left there.

        Args:
            path: The run's folder.
            options: How to buffer, compress and split; by default as the `ML_DASH_*` variables say.
            prefix: What the files name as the recording's prefix; the folder's name by default.
            metadata: More entries for the `ml_dash` metadata record of each segment.
            timestamps: "strict": every row has its `_ts`. "auto": a missing one is the wall clock, -1 the last one used.

        Raises:
            StorageError: The folder cannot be made or written, or there is no room for the backlog.

        Example:
            >>> with Recorder("runs/today") as recorder:
            ...     recorder.topic("robot").append(q=[0.1, 0.2], _ts=0.0)
        """
        self.path = _make_folder(path)
        self.options = options if options is not None else RecorderOptions.from_environment()
        self.session = uuid.uuid4().hex[:16]
        """Names this opening of the recording; `run` in the metadata."""
        self._stamper = _stamper(timestamps)
        recover_leftovers(self.path)
        self._channels: dict[int, ChannelInfo] = {}
        self._topics: dict[tuple[str, str], Topic] = {}
        self._topics_lock = threading.Lock()
        """Guards `_channels` and `_topics` while one is added."""
        about = self._about(prefix, metadata or {})
        self._journal = Journal(self.path, self.session, self.options, about)
        self._stamper.journal = self._journal
        blocks = BlockWriter(self.path, self.options, about, self._channels)
        self._blocks = blocks
        self._writer = Writer(self._journal, blocks)
        self._journal.failure = _weak_failure(self._writer)
        if not self.options.buffered:
            self._journal.eager = self._writer.flush
        elif self.options.batch_rows is not None:
            self._journal.eager = self._journal.seal_at(self.options.batch_rows)
        self._finalizer = weakref.finalize(self, _close, self._journal, self._writer, os.getpid())

    def _about(self, prefix: str | None, metadata: Mapping[str, str]) -> dict[str, str]:
        return {
            **metadata,
            "prefix": prefix if prefix is not None else self.path.name,
            "run": self.session,
            "run_start": datetime.datetime.now(datetime.timezone.utc).isoformat(),
            "host": socket.gethostname(),
            "library": LIBRARY,
        }

    # -- topics -----------------------------------------------------------------------------------------------------

    def topic(
        self,
        name: str,
        *,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> Topic:
        """Return a topic, the same object for the same name.

        Args:
            name: Any text of 1 to 1024 bytes without NUL; `/` orders topics into a tree and means nothing else.
            description: What the topic holds.
            tags: Words to find it by.
            metadata: Anything else, as JSON can say it.

        Raises:
            TopicError: The name is empty, too long, or not text.
            StateError: The recorder is closed.
        """
        found = self._topics.get((TRACK, name)) if isinstance(name, str) else None
        if found is not None and description is None and tags is None and metadata is None:
            return found
        check_topic(name)
        return self._open(name, TRACK, Topic, description=description, tags=tags, metadata=metadata)

    def topics(self) -> list[str]:
        """Return the names of the tracks opened so far, sorted."""
        return sorted(name for kind, name in list(self._topics) if kind == TRACK)

    def _open(
        self,
        name: str,
        kind: str,
        cls: type[T],
        *,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        schema: Mapping[str, Any] | None = None,
        schema_name: str | None = None,
    ) -> T:
        """Return a topic of any kind, registering it first; its description may come later."""
        said = _topic_metadata(description, tags, metadata)
        with self._topics_lock:
            topic = self._topics.get((kind, name))
            new = topic is None
            if topic is None:
                if len(self._channels) >= _MAX_TOPICS:
                    raise TopicError(f"topic {name!r}: a recording holds {_MAX_TOPICS} topics, and has them")
                info = ChannelInfo(len(self._channels) + 1, name, kind, said, schema, schema_name)
                self._channels[info.number] = info
                try:
                    self._journal.register(info.schema_record(None) + info.channel_record())
                except BaseException:
                    del self._channels[info.number]
                    raise
                topic = self._topics[(kind, name)] = cls(self, info)
        if said and not new:
            self.write_metadata(TOPIC_METADATA, {"topic": name, **said})
        if not isinstance(topic, cls):
            raise TopicError(f"topic {name!r} is open as a {type(topic).__name__} already")
        return topic

    # -- metadata ---------------------------------------------------------------------------------------------------

    def set_parameters(self, parameters: Mapping[str, Any]) -> None:
        """Write parameters, name by name; a later value of a name wins.

        Raises:
            FieldError: A value cannot be stored; the message names it.
        """
        self.write_metadata(PARAMETERS, {name: _parameter_text(name, value) for name, value in parameters.items()})

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record of a name of its own. It is as safe as a row when this returns."""
        self._journal.add_metadata(records.metadata(name, values))
        if self._journal.eager is not None:
            self._journal.eager()

    # -- the clock, the figures, the end ----------------------------------------------------------------------------

    def time(self) -> float:
        """Return the recording's time now, in seconds: what logs and metrics are written at.

        It is the wall clock, or the last time stamp of a track where those run on a clock that starts near 0.
        """
        last_s = self._journal.last_s
        return time.time() if last_s is None or clock.is_epoch_like(last_s) else last_s

    def flush(self) -> None:
        """Wait until every row taken so far is in the file.

        Raises:
            StateError: The recorder is closed.
            StorageError: It cannot be written; the rows stay in the journal.
        """
        self._journal.check_open()
        self._writer.flush()

    def stats(self) -> dict[str, Any]:
        """Return the recorder's figures; accepted = written + waiting + dropped at any moment.

        Returns:
            `accepted` (rows offered), `written` (rows in the file, as they were appended), `waiting` (rows in the
            journal), `dropped` (rows refused), `dropped_by_topic`, `bytes_written`, `segments` (finished ones),
            `failure` (why nothing can be written at the moment, or None).
        """
        with self._journal.lock:
            taken, written = self._journal.rows(), self._writer.rows_written
            dropped = dict(self._journal.dropped)
        refused = sum(dropped.values())
        failure = self._writer.failure
        return {
            "accepted": taken + refused,
            "written": written,
            "waiting": taken - written,
            "dropped": refused,
            "dropped_by_topic": dropped,
            "bytes_written": self._blocks.bytes_written,
            "segments": [str(path) for path in self._blocks.finished],
            "failure": None if failure is None else str(failure),
        }

    @property
    def closed(self) -> bool:
        """Whether it takes no more rows."""
        return self._journal.is_shut

    def close(self) -> None:
        """Write everything, finish the files, and take no more rows. May be called twice.

        Raises:
            StorageError: Not everything could be written. The rows stay in the journal, and the next `Recorder` or
                `Recording` on this folder folds them in.
        """
        if self._finalizer.detach():
            _close(self._journal, self._writer, os.getpid())

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Recorder {str(self.path)!r}, {'closed' if self.closed else 'recording'}>"


def check_topic(name: object) -> None:
    """Check the name of a user's topic.

    Raises:
        UsageError: It is no text.
        TopicError: It is empty, too long, has a NUL, cannot be encoded, or is reserved.
    """
    if not isinstance(name, str):
        raise UsageError(f"a topic's name is text, not {type(name).__name__}: {name!r}")
    try:
        size = len(name.encode())
    except UnicodeEncodeError as error:
        raise TopicError(f"topic {name!r} is not valid Unicode: {error}") from error
    if not name or name.isspace():
        raise TopicError(f"a topic needs a name; got {name!r}")
    if size > _MAX_TOPIC_BYTES:
        raise TopicError(f"topic {name[:40]!r}...: its name has {size} bytes; at most {_MAX_TOPIC_BYTES} are allowed")
    if "\0" in name:
        raise TopicError(f"topic {name!r} has a NUL in its name")
    if name.startswith(OWN_TOPICS):
        raise TopicError(f"topic {name!r}: names that begin with {OWN_TOPICS!r} are the library's own")


def _topic_metadata(
    description: str | None, tags: Iterable[str] | None, metadata: Mapping[str, Any] | None
) -> dict[str, str]:
    said: dict[str, str] = {}
    if description is not None:
        said["description"] = str(description)
    if tags is not None:
        said["tags"] = json.dumps([tags] if isinstance(tags, str) else list(tags))
    if metadata is not None:
        said["metadata"] = _parameter_text("metadata", dict(metadata))
    return said


def _parameter_text(name: str, value: Any) -> str:
    """Spell a parameter as JSON, with Python's `NaN` and `Infinity` where it has them."""
    try:
        text = dumps(value, plain)
        return text.decode() if b"null" not in text else json.dumps(value, default=plain)
    except (TypeError, ValueError) as error:
        raise FieldError(f"parameter {name!r} holds a {type(value).__qualname__}, which cannot be stored: {error}") from error


def _make_folder(path: str | Path) -> Path:
    folder = Path(path).expanduser().absolute()
    if folder.suffix == ".mcap":
        raise StorageError(
            f"{path}: a recording is a folder of .mcap segments; pass the folder, such as {str(folder.with_suffix(''))!r}"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(error.errno, f"cannot make the recording's folder: {error.strerror}", str(folder)) from error
    return folder


def _stamper(rule: str) -> timestamps.Stamper:
    return timestamps.stamper(rule)


def _weak_failure(writer: Writer) -> Any:
    reference = weakref.ref(writer)

    def failure() -> BaseException | None:
        alive = reference()
        return None if alive is None else alive.failure

    return failure


def _close(journal: Journal, writer: Writer, pid: int) -> None:
    """Finish a recorder; in a forked child, do nothing."""
    if os.getpid() != pid or journal.is_shut:
        return
    journal.shut("the recorder is closed; open a new one on the same folder to add to the recording")
    try:
        writer.stop()
    except BaseException:
        journal.leave_behind()
        raise
    journal.remove()


__all__ = ["OWN_TOPICS", "TOPIC_METADATA", "EventTopic", "Recorder", "StateError", "Topic", "check_topic"]
