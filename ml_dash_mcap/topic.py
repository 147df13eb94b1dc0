"""One topic of a recorder: a control loop appends its rows here."""

from __future__ import annotations

import functools
import struct
import weakref
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from . import clock
from .capture.channel_choice import ChannelChoice, until_first_row
from .capture.channels import ChannelInfo
from .capture.event_times import WALL_STAMPED
from .capture.topic_context import TopicContext
from .codecs import json
from .codecs.given.given_schema import GivenCodec, GivenSchema
from .codecs.given.schema_source import schema_of_message
from .errors import FieldError, UsageError
from .mcap.message_records import MESSAGE_OPCODE
from .rows.plain_row import EXACT_KEY, TIME_KEY
from .timestamps import MISSING

if TYPE_CHECKING:
    from .codecs.proto.compiled_rows import AppendCode

# Bound here, because a global costs the hot path less than an attribute of a module.
_END_S = clock.END_S
# A Message record without its opcode, which is written last: length, channel id and sequence, log and publish time.
_pack_tail = struct.Struct("<Q6sQQ").pack
_OPCODE = bytes((MESSAGE_OPCODE,))

_MOST_MISSES = 1000
"""After so many rows unlike those before, a topic's `append` is not compiled any more."""

T = TypeVar("T", bound="Topic")


class Topic:
    """One topic of a recorder: a stream of rows, each a set of named fields at a time.

    Any thread may call any method. Made by `Recorder.topic`.
    """

    __slots__ = (
        *("__weakref__", "_choice", "_codec", "_context", "_default", "_dumps", "_head", "_journal", "_misses"),
        *("_probe", "name"),
    )

    def __init__(self, context: TopicContext, channel: ChannelInfo) -> None:
        self.name = channel.topic
        self._context = context
        self._journal = context.journal
        self._choice = ChannelChoice(channel, context.journal, context.give_schema)
        self._use(channel)
        if self._choice.is_open:
            self._dumps = until_first_row(self._encode_first)
        self._misses = 0
        """How often arguments came that the compiled `append` is not for."""
        if type(self).append is Topic.append:
            if self.encoding == "protobuf":
                from . import compiled_append  # noqa: F401 - so that no append waits for it
            specialise = weakref.WeakMethod(self._specialise)
            self._codec.on_compiled(lambda code: _call(specialise(), code))

    def _use(self, channel: ChannelInfo) -> None:
        """Record into a channel."""
        self._head = struct.pack("<HI", channel.number, 0)
        self._codec = channel.codec or json.CODEC
        self._dumps, self._default = self._codec.dumps, self._codec.default
        self._probe = self._codec.probe

    @property
    def encoding(self) -> str:
        """The encoding of its rows."""
        return self._codec.message_encoding

    def __repr__(self) -> str:
        state = "closed" if self._context.recorder.closed else "recording"
        return f"<{type(self).__name__} {self.name!r} in {str(self._context.recorder.path)!r}, {state}>"

    def append(
        self: T, /, *positional: Any, _ts: Any = MISSING, timestamp: Any = MISSING, _exact: Any = MISSING, **fields: Any
    ) -> T:
        """Take one row. Its values are copied: changing an array afterwards changes nothing.

        Args:
            _ts: The row's time stamp, in seconds. Rows of one time stamp merge into one; later fields win.
            timestamp: A field like the others; the tracks of an Experiment refuse it, as they read times under it.
            _exact: Refused: the library has a field of that name itself.
            **fields: Numbers, text, bytes, None, lists, dicts, numpy arrays of any shape, dataclasses, datetimes,
                enums, and anything with `tolist` or `__array__`.

        Returns:
            The topic itself.

        Raises:
            TimestampError: `_ts` is missing, not a number, not finite, negative, or beyond the year 2262.
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
        if positional or timestamp is not MISSING or _exact is not MISSING:
            fields = self._accept(positional, timestamp, _exact, fields)
        if _ts.__class__ is not float or not 0.0 < _ts < _END_S:  # 0.0 is checked, for it may be -0.0
            _ts = self._time(_ts)
        fields[TIME_KEY] = _ts
        try:
            payload = self._dumps(fields, self._default)
        except Exception:
            payload = self._codec.encode_exactly(fields, self.name)
        else:
            if self._probe in payload:
                payload, self._probe = self._codec.recheck(payload, fields, self.name, self._probe)
        # Whole seconds apart from the fraction: as a double, a time of today in ns is rounded to a multiple of 256.
        whole = int(_ts)
        time_ns = whole * 1_000_000_000 + int((_ts - whole) * 1e9 + 0.5)
        # 22 bytes of fixed fields; the record has 9 more, its opcode and length.
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
        # Outside the lock, since this may wait for the writer, which needs the lock.
        if end > buffer.limit:
            journal.add(_OPCODE + tail, self.name, _ts)
        if journal.eager is not None:
            journal.eager()
        return self

    def _specialise(self, code: AppendCode | None) -> None:
        """Give the topic an `append` of this code in a class of its own; for None, go back to the plain class."""
        plain = self._plain_class()
        if code is None or self._misses >= _MOST_MISSES:
            self.__class__ = plain
            return
        from .compiled_append import compile_append

        append = compile_append(code, self._head, _END_S)
        if append is not None:
            names = {name: getattr(plain, name) for name in ("__doc__", "__module__", "__qualname__")}
            append = functools.update_wrapper(append, Topic.append)
            self.__class__ = type(plain.__name__, (plain,), {**names, "__slots__": (), "append": append})

    def _plain_class(self: T) -> type[T]:
        """Return the class without a compiled `append`."""
        own = type(self)
        return own if own.append is Topic.append else own.__bases__[0]

    def _append_otherwise(
        self: T, positional: tuple[Any, ...], variables: dict[str, Any], keys: Iterable[str], others: dict[str, Any]
    ) -> T:
        """Append a row whose arguments the compiled `append` is not for; if these are many, it is given up."""
        self._misses += 1
        if self._misses >= _MOST_MISSES:  # other threads count, too
            self.__class__ = self._plain_class()
        return Topic.append(self, *positional, **_present(variables, keys), **others)

    def _append_slowly(self: T, variables: dict[str, Any], keys: Iterable[str]) -> T:
        """Append a row that the compiled `append` found no room for."""
        return Topic.append(self, **_present(variables, keys))

    def append_batch(self: T, rows: Iterable[Mapping[str, Any]]) -> T:
        """Take several rows, each a dict of fields with its `_ts`. If one of them is bad, none is taken.

        Raises:
            As `append`; the message names the row's index.
        """
        if isinstance(rows, Mapping) or not isinstance(rows, Iterable):
            instead = "; one row is append(**row)" if isinstance(rows, Mapping) else ""
            raise UsageError(f"append_batch() on topic {self.name!r} takes a list of dicts, not {rows!r}{instead}")
        tails: list[tuple[bytes, float]] = []
        for index, row in enumerate(rows):
            tails.append(self._encode_row(index, row, tails[-1][1] if tails else None))
        for tail, time_s in tails:
            self._put(tail, time_s)
        return self

    def append_columns(self: T, /, *positional: Any, _ts: Any = MISSING, **columns: Any) -> T:
        """Take many rows at once, given as columns: for simulators and logged arrays.

        Args:
            _ts: Time stamps, [N], s.
            **columns: One value a row each: arrays [N, ...] or sequences of length N. A row that is masked in a masked
                array lacks that field; a dict of columns is a dict in each row.
                Columns of pandas, polars and pyarrow are taken by position; values missing in them are None (`NaN` too
                where a pandas column holds no numbers of numpy's).

        Returns:
            The topic itself.

        Raises:
            FieldError: A column has another length, or a value cannot be stored; no row is taken.
            As `append` otherwise.

        Example:
            >>> recorder.topic("robot").append_columns(_ts=times, q=q, gripper=width)  # [N], [N, 7], [N]
            >>> recorder.topic("table").append_columns(_ts=frame["time"], **frame.drop(columns="time"))  # of pandas
        """
        from .capture import column_input as bulk

        channel = self._choice.settle()
        if channel.codec is not self._codec:  # another thread gives the topic its schema just now
            self._use(channel)
        if positional or EXACT_KEY in columns:
            self._accept(positional, MISSING, columns.get(EXACT_KEY, MISSING), {})
        if "timestamp" in columns:
            columns = self._accept((), columns.pop("timestamp"), MISSING, columns)
        for rows in bulk.encode(_ts, columns, self.name, self._head, self._codec):
            self._journal.add_many(rows.records, rows.starts, self.name, rows.last_s, is_uniform=rows.is_uniform)
        if self._journal.eager is not None:
            self._journal.eager()
        return self

    def append_message(self: T, message: Any, /, *, _ts: Any = MISSING) -> T:
        """Take one protobuf message, as it serialises itself; returns the topic itself.

        A topic without rows and without a schema takes the schema of its first message. Messages of one time stamp stay
        apart, and have it to the nanosecond. No field of a message is read for `_ts`, which is in seconds.

        Raises:
            UsageError: It is no protobuf message, or one of another type than the topic's schema.
            FieldError: It lacks a required field, or is larger than the whole backlog.
            TopicError: The topic has rows without a schema.
            As `append` otherwise.

        Example:
            >>> recorder.topic("tool").append_message(PoseInFrame(frame_id="base"), _ts=1.5)
        """
        time_s = _ts if _ts.__class__ is float and 0.0 < _ts < _END_S else self._time(_ts)
        if not isinstance(self._codec, GivenCodec):
            channel = self._choice.channel  # perhaps with a schema that another thread gave just now
            self._use(channel if channel.schema else self._choice.give(schema_of_message(message, self.name)))
        codec = self._codec
        if not isinstance(codec, GivenCodec):
            raise UsageError(f"append_message() on topic {self.name!r}: its rows are the library's own")
        self._put(self._record(codec.encode_message(message, self.name), time_s), time_s)
        return self

    def _encode_first(self, fields: dict[str, Any], default: Any) -> bytes:
        """Encode the first row."""
        self._use(self._choice.settle())
        return self._codec.dumps(fields, default)

    def flush(self: T) -> T:
        """Wait until every row taken so far is in the file, and return the topic itself.

        Raises:
            StateError: The recorder is closed.
            StorageError: It cannot be written.
        """
        self._context.recorder.flush()
        return self

    def _put(self, tail: bytes, time_s: float) -> bool:
        """Put an encoded row; returns whether it was taken."""
        taken = self._journal.add(_OPCODE + tail, self.name, time_s)
        if self._journal.eager is not None:
            self._journal.eager()
        return taken

    def _encode(
        self, fields: dict[str, Any], time_s: float, head: bytes | None = None, time_ns: int | None = None
    ) -> bytes:
        """Return a Message record without its opcode; `fields` gets the time stamp."""
        fields[TIME_KEY] = time_s
        try:
            payload = self._dumps(fields, self._default)
        except Exception:
            payload = self._codec.encode_exactly(fields, self.name)
        else:
            if self._probe in payload:
                payload, self._probe = self._codec.recheck(payload, fields, self.name, self._probe)
        return self._record(payload, time_s, head, time_ns)

    def _record(self, payload: bytes, time_s: float, head: bytes | None = None, time_ns: int | None = None) -> bytes:
        """Return a Message record without its opcode."""
        time_ns = clock.to_nanoseconds(time_s) if time_ns is None else time_ns
        return _pack_tail(len(payload) + 22, self._head if head is None else head, time_ns, time_ns) + payload

    def _encode_row(self, index: int, row: Mapping[str, Any], last_s: float | None) -> tuple[bytes, float]:
        try:
            fields = dict(row)
        except (TypeError, ValueError) as error:
            raise FieldError(f"append_batch() on topic {self.name!r}: row {index} is {row!r}, not a dict") from error
        try:
            time_s = self._time(fields.pop(TIME_KEY, MISSING), last_s)
            if "timestamp" in fields or EXACT_KEY in fields:
                fields = self._accept((), fields.pop("timestamp", MISSING), fields.get(EXACT_KEY, MISSING), fields)
            return self._encode(fields, time_s), time_s
        except (TypeError, ValueError) as error:
            raise type(error)(f"row {index} of the batch: {error}") from error

    def _time(self, given: Any, last_s: float | None = None) -> float:
        """Return the time stamp of a row, in seconds, by the recorder's rule for missing and inherited ones."""
        return self._context.stamper.resolve(given, self.name, last_s)

    def _accept(
        self, positional: tuple[Any, ...], timestamp: Any, exact_key: Any, fields: dict[str, Any]
    ) -> dict[str, Any]:
        """Handle arguments that ordinary calls do not have: positional ones, a field `timestamp`, a reserved name."""
        if positional:
            instead = "; spread a dict: append(**row)" if isinstance(positional[0], Mapping) else ""
            raise UsageError(
                f"append() on topic {self.name!r} takes its fields by name, as in append(q=..., _ts=...); got"
                f" {len(positional)} positional argument(s){instead}"
            )
        if exact_key is not MISSING:
            raise FieldError(f"append() on topic {self.name!r}: the field name {EXACT_KEY!r} is reserved; rename it")
        if isinstance(self._codec, GivenCodec):  # the schema says what the field is
            return {"timestamp": timestamp, **fields}
        return self._with_timestamp_field(timestamp, fields)

    def _with_timestamp_field(self, timestamp: Any, fields: dict[str, Any]) -> dict[str, Any]:
        """Take a field that is called `timestamp`; users of an Experiment may not have one."""
        return {"timestamp": timestamp, **fields}


class EventTopic(Topic):
    """A topic of logs, metrics, files or episodes: at the recording's time, and never merged."""

    __slots__ = ("_wall_head",)

    def __init__(self, context: TopicContext, channel: ChannelInfo) -> None:
        super().__init__(context, channel)
        self._wall_head = struct.pack("<HI", channel.number, WALL_STAMPED)

    @property
    def last_s(self) -> float | None:
        """The last time stamp that a track was given, in seconds."""
        return self._journal.last_s

    def now(self) -> float:
        """Return the recording's time now, in seconds."""
        return self._context.recorder.time()

    def time_of(self, given: Any) -> float:
        """Return a time that a user gave, in seconds.

        Raises:
            TimestampError: It is no time stamp.
        """
        return self._time(given)

    def add(self, fields: dict[str, Any], time_s: float | None = None) -> bool:
        """Take one row; returns whether it was taken.

        Args:
            fields: The row's fields. The time stamp is added to them.
            time_s: Its time stamp, in seconds; the recording's time now by default.
        """
        head = self._head
        if time_s is None:
            time_s, is_wall = self._journal.tracks_clock.time(self._journal.last_s)
            head = self._wall_head if is_wall else head
        taken = self._journal.add(_OPCODE + self._encode(fields, time_s, head), self.name, None)
        if self._journal.eager is not None:
            self._journal.eager()
        return taken


def _present(variables: dict[str, Any], keys: Iterable[str]) -> dict[str, Any]:
    """Return the arguments that were given."""
    return {key: variables[key] for key in keys if variables[key] is not MISSING}


def _call(install: Callable[[AppendCode | None], None] | None, code: AppendCode | None) -> None:
    if install is not None:
        install(code)


def give_schema(topic: Topic, schema: GivenSchema) -> None:
    """Set the schema of all rows of a topic; the same one may be set again. Users pass it to `Recorder.topic`.

    Raises:
        TopicError: The topic has another schema, or rows without one.
        StateError: The recorder is closed.
    """
    topic._use(topic._choice.give(schema))
