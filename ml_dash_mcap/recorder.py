"""The recorder of a run's folder: it opens topics, writes metadata, flushes, and closes."""

from __future__ import annotations

import datetime
import logging
import os
import socket
import threading
import uuid
import weakref
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NoReturn, TypeVar

from .capture.journal import Journal
from .capture.journal_files import JournalFiles
from .capture.metadata_texts import parameter_text, text_of, texts_of, write_metadata
from .capture.prepare_block import BlockPreparer
from .capture.segment_names import STAMP, stamp_after
from .capture.segment_sink import SegmentSink
from .capture.sink import SessionInfo, Sink
from .capture.sink_threads import SinkThreads
from .capture.stats import Stats
from .capture.topic_context import TopicContext
from .capture.topic_names import check_topic
from .capture.topic_registry import TopicAbout, TopicRegistry
from .capture.writer import Writer
from .codecs import codec_table
from .codecs.given.schema_source import SchemaSource, given_schema
from .errors import PrefixError, StorageError, TopicError, UsageError
from .file_names import PARAMETERS_RECORD, TRACK
from .inspect.earlier_run import own_clock_until
from .inspect.plain_words import seconds_text
from .meaning.annotations import NO_ANNOTATIONS, collect
from .options import RecorderOptions, arguments_of, check_options, misplaced
from .recovery import recover_folder
from .timestamps import stamper
from .topic import Topic, give_schema
from .version import LIBRARY

_log = logging.getLogger("ml_dash_mcap")

T = TypeVar("T", bound=Topic)

_NOTHING_TOLD = TopicAbout()


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
        sinks: Iterable[Sink] = (),
        **unknown: NoReturn,
    ) -> None:
        """Open a recording's folder, making it if need be, and recover the leftovers of a crashed recorder there.

        Args:
            path: The run's folder.
            options: How to buffer, compress and split; by default the `ML_DASH_*` environment variables decide.
            prefix: The recording's prefix in the files' metadata; the folder's name by default.
            metadata: More entries for the `ml_dash` metadata record of each segment.
            timestamps: "strict": every row has its `_ts`. "auto": without it, a row has the time of the wall clock, and
                -1 is the time stamp used last.
            sinks: Objects that take the rows while they are recorded, besides the file; see `Sink`.

        Raises:
            StorageError: The folder cannot be made or written, or there is no room for the backlog.
            UsageError: An argument is unknown; the message tells where it belongs.

        Example:
            >>> with Recorder("runs/today") as recorder:
            ...     recorder.topic("robot").append(q=[0.1, 0.2], _ts=0.0)
        """
        if unknown:
            raise misplaced("Recorder", unknown, arguments_of(Recorder))
        check_options(options)
        self.options = options if options is not None else RecorderOptions.from_environment()
        codec_table.to_record(self.options.encoding)
        self.path = _make_folder(path)
        self.session = uuid.uuid4().hex[:16]
        """Names this opening of the recording; `run` in the metadata."""
        stamping = stamper(timestamps)
        recover_folder(self.path)
        _warn_of_earlier_run(self.path)
        about = self._about(prefix, metadata or {})
        self._journal = Journal(JournalFiles(self.path, self.session, self.options, about), self.options)
        stamping.journal = self._journal
        self._registry = TopicRegistry(self._journal, self.options.encoding)
        self._context = TopicContext(self, self._journal, stamping, self._registry.give_schema)
        try:
            self._start(SessionInfo(self.path, about), sinks)
        except BaseException:
            self._journal.remove()
            raise
        # It holds the parts, not the recorder, so that a forgotten recorder is collected, and closed then or at exit.
        self._finalizer = weakref.finalize(self, _close, self._journal, self._writer, os.getpid())

    def _start(self, session: SessionInfo, sinks: Iterable[Sink]) -> None:
        """Start the writer thread and the sinks."""
        self._preparer = BlockPreparer(self.path, session.about, self._registry.channels)
        self._segments = SegmentSink(self.options, self._preparer.fallbacks, self._journal.room.dropped)
        self._segments.open(session)
        self._sinks = SinkThreads(sinks, session, self.options.backlog_bytes)
        try:
            self._writer = Writer(self._journal, self._preparer, self._segments, self._sinks)
        except BaseException:
            self._sinks.close()
            raise
        self._journal.room.failure = _weak_failure(self._writer)
        if not self.options.buffered:
            self._journal.eager = self._writer.flush
        elif self.options.batch_rows is not None:
            self._journal.eager = self._journal.seal_at(self.options.batch_rows)

    def _about(self, prefix: str | None, metadata: Mapping[str, str]) -> dict[str, str]:
        return {
            **texts_of(metadata),
            "prefix": text_of("prefix", self.path.name if prefix is None else prefix),
            "run": self.session,
            "run_start": datetime.datetime.now(datetime.timezone.utc).isoformat(),
            "host": socket.gethostname(),
            "library": LIBRARY,
            STAMP: stamp_after(self.path),
        }

    # -- topics ------------------------------------------------------------------------------------------------------

    def topic(
        self,
        name: str,
        *,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        units: Mapping[str, str] | None = None,
        joint_names: Sequence[str] | None = None,
        frame_id: str | None = None,
        quat_order: str | None = None,
        encoding: str | None = None,
        schema: SchemaSource = None,
    ) -> Topic:
        """Return a topic, the same object for the same name.

        Args:
            name: Any text of 1 to 1024 bytes without NUL; `/` orders topics into a tree and means nothing else.
            description: What the topic holds.
            tags: Words to find it by.
            metadata: Anything else that JSON can hold.
            units: Dotted field name to its unit, such as `{"q": "rad"}`. Exports to ROS and mocap formats go by these
                and by the following; all are kept in the metadata.
            joint_names: The names of the joints, in the order of the elements of joint angles, velocities and torques.
            frame_id: The frame to which positions, orientations and vectors are relative.
            quat_order: "xyzw" or "wxyz", of all quaternions of the topic.
            encoding: The encoding of its rows, "json", "protobuf" or "cbor"; the recorder's option by default.
            schema: The schema of its rows, where it is not to be inferred from them: a class of protobuf messages, a
                JSON Schema as a dict, or the name of one of Foxglove's schemas, such as "foxglove.PoseInFrame". Each
                row is checked as it is appended, and is a message of its own: rows of one time stamp do not merge.

        Raises:
            TopicError: The name is empty, too long, or not text, or the topic is open in another encoding, with another
                schema, or has rows without one.
            FieldError: A description has a wrong type.
            OptionError: Rows cannot be recorded in that encoding, the schema is not known or of another encoding, or a
                package that it needs is missing.
            EncodingError: The schema is broken.
            StateError: The recorder is closed.

        Example:
            >>> pose = recorder.topic("tool", schema="foxglove.PoseInFrame")
            >>> pose.append(frame_id="base", timestamp=1.5, pose={"position": {"x": 0.4}}, _ts=1.5)
        """
        topic: Topic | None = self._registry.get(TRACK, name) if isinstance(name, str) else None
        told = (description, tags, metadata, units, joint_names, frame_id, quat_order)
        if topic is not None and told == NO_ANNOTATIONS and schema is None and encoding in (None, topic.encoding):
            return topic
        return open_track(self, name, Topic, told, encoding, schema)

    def topics(self) -> list[str]:
        """Return the names of the tracks opened so far, sorted."""
        return self._registry.names(TRACK)

    # -- metadata ----------------------------------------------------------------------------------------------------

    def set_parameters(self, parameters: Mapping[str, Any]) -> None:
        """Write parameters, name by name; a later value of a name wins.

        Raises:
            FieldError: A value cannot be stored; the message names it.
        """
        self.write_metadata(
            PARAMETERS_RECORD, {name: parameter_text(name, value) for name, value in parameters.items()}
        )

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record of a name of its own. It is as safe as a row when this returns."""
        write_metadata(self._journal, name, values)

    # -- the clock, the figures, the end -----------------------------------------------------------------------------

    def time(self) -> float:
        """Return the recording's time now, in seconds. Logs and metrics are written at this time.

        It is the wall clock where the tracks' time stamps are of now, or no track has one yet. Where they run on any
        other clock (of a simulation, of a recording that is played back, GPS time, a monotonic one), it is the latest
        time stamp of a track.
        """
        return self._journal.tracks_clock.time(self._journal.last_s)[0]

    def flush(self) -> None:
        """Wait until every row taken so far is in the file.

        Raises:
            StateError: The recorder is closed.
            StorageError: It cannot be written; the rows stay in the journal.
        """
        self._journal.check_open()
        self._writer.flush()

    def stats(self) -> Stats:
        """Return the recorder's figures; accepted = written + waiting + dropped at any moment."""
        written = self._writer.rows_written  # first: it grows only by rows that were taken
        with self._journal.lock:
            taken, dropped = self._journal.rows(), dict(self._journal.room.dropped)
        refused = sum(dropped.values())
        failure = self._writer.failure
        steps = {
            self._registry.channels[number].topic: counts.steps
            for number, counts in list(self._preparer.steps.totals.items())
        }
        return Stats(
            accepted=taken + refused,
            written=written,
            waiting=taken - written,
            dropped=refused,
            dropped_by_topic=dropped,
            merged=self._segments.rows_merged,
            steps_back=sum(steps.values()),
            steps_back_by_topic=steps,
            bytes_written=self._segments.bytes_written,
            segments=[str(path) for path in self._segments.finished],
            failure=None if failure is None else str(failure),
            fallbacks=dict(self._preparer.fallbacks.counts),
            sinks=self._sinks.stats(),
        )

    @property
    def closed(self) -> bool:
        """Whether the recorder takes no more rows."""
        return self._journal.is_shut

    def close(self) -> None:
        """Write everything, finish the files, and take no more rows. May be called twice.

        Raises:
            StorageError: Not everything could be written. The rows stay in the journal, and the next `Recorder` or
                `Recording` on this folder recovers them.
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


def open_topic(recorder: Recorder, name: str, kind: str, cls: type[T], about: TopicAbout = _NOTHING_TOLD) -> T:
    """Return a topic of any kind, registering it first if it is new. For the library's own topics and for imports.

    Args:
        recorder: Whose topic.
        name: Checked.
        kind: track, message, log, metric, file or episode.
        cls: The class of the topic's object.
        about: The description of the topic.

    Raises:
        TopicError: The topic is open with another class, with another schema, or in another encoding.
        OptionError: Rows cannot be recorded in its encoding.
        StateError: The recorder is closed.
    """
    topic = recorder._registry.open(name, kind, lambda info: cls(recorder._context, info), about)
    if not isinstance(topic, cls):
        raise TopicError(f"topic {name!r} is open as a {type(topic).__name__} already")
    if about.schema is not None:
        give_schema(topic, about.schema)
    if about.encoding not in (None, topic.encoding):
        raise TopicError(f"topic {name!r} is open in the encoding {topic.encoding!r} already, not {about.encoding!r}")
    return topic


def open_track(
    recorder: Recorder, name: str, cls: type[T], told: tuple[Any, ...], encoding: str | None, schema: SchemaSource
) -> T:
    """Return a track that a user asks for.

    Args:
        recorder: Whose topic.
        name: As the user gives it.
        cls: The class of the topic's object.
        told: The description, tags and metadata, and the arguments of `meaning.annotations.collect`.
        encoding: Of its rows; None for the recorder's option.
        schema: Of its rows; None to infer it.

    Raises:
        As `Recorder.topic`.
    """
    check_topic(name)
    description, tags, metadata, *annotations = told
    about = TopicAbout(
        description=description,
        tags=tags,
        metadata=metadata,
        more=collect(*annotations),
        encoding=encoding,
        schema=given_schema(schema, encoding),
    )
    return open_topic(recorder, name, TRACK, cls, about)


def _warn_of_earlier_run(folder: Path) -> None:
    """Log a warning if rows of this run may take the place of those of an earlier run."""
    end_s = own_clock_until(folder)
    if end_s is not None:
        _log.warning(
            "%s holds a run already, on a clock of its own (up to %s): rows of this run at the same times are merged"
            " with that run's when both are read; give each run a prefix of its own, or read one run with"
            " Recording(path, run=...)",
            folder,
            seconds_text(end_s),
        )


def _make_folder(path: str | Path) -> Path:
    try:
        folder = Path(path).expanduser().absolute()
        os.fsencode(folder)
    except TypeError as error:
        raise UsageError(f"a recording's path is text or a Path, not {path!r}") from error
    except UnicodeEncodeError as error:
        raise PrefixError(f"the path {path!r} is not valid Unicode") from error
    if "\0" in str(folder):
        raise PrefixError(f"the path {path!r} has a NUL in it")
    if folder.suffix == ".mcap":
        raise StorageError(
            f"{path}: a recording is a folder of .mcap files; pass a folder, such as {str(folder.with_suffix(''))!r}"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(error.errno, f"cannot make the recording's folder: {error.strerror}", str(folder)) from error
    return folder


def _weak_failure(writer: Writer) -> Any:
    # The writer refers to the journal already. A strong reference back would be a cycle, and only the garbage collector
    # would end the writer's thread.
    reference = weakref.ref(writer)

    def failure() -> BaseException | None:
        alive = reference()
        return None if alive is None else alive.failure

    return failure


def _close(journal: Journal, writer: Writer, pid: int) -> None:
    """Finish a recorder; in a forked child, do nothing."""
    if os.getpid() != pid or journal.is_shut:
        return
    if writer.is_here:  # the garbage collector found the recorder on this very thread
        threading.Thread(target=_close, args=(journal, writer, pid), name="ml_dash_mcap close").start()
        return
    journal.shut("the recorder is closed; open a new one on the same folder to add to the recording")
    try:
        writer.stop()
    except BaseException:
        journal.leave_behind()
        raise
    journal.remove()
