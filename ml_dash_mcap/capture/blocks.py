"""Sealed buffers to segments: infer, merge, number, chunk, write, and begin a new segment when it is time."""

from __future__ import annotations

import datetime
import json
import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.ma  # numpy.unique() would load it at the first block: 20 ms, beside a control loop
import numpy.typing as npt
from mcap.data_stream import ReadDataStream
from mcap.records import Metadata

from .. import clock
from ..codecs.json_skeleton import LONG_ROW_BYTES, UNKNOWN, Bones, Skeletons, guess
from ..file_names import ACTIVE_SUFFIX, DROPS_RECORD, PARAMETERS_RECORD, SEGMENT_SUFFIX, STEPS_RECORD, TRACK
from ..mcap import record_bytes
from ..mcap.chunk_writer import UNCOMPRESSED, Chunk, Compressor, build, compressor
from ..mcap.row_arrays import Block, Rows, pack, split, taken
from ..mcap.segment import Segment
from ..options import RecorderOptions
from ..rows import schema as schemas
from ..rows.schema import Shape
from . import event_times
from .channels import ChannelInfo
from .merge_block import merge_each, merge_same_time
from .time_steps import Steps

_log = logging.getLogger("ml_dash_mcap")

_SPARE_BYTES = 512
"""A schema has at least this much room to grow in place, and at least as much as it is long."""

_OWN_CHUNK_BYTES = 32 * 1024
"""A topic with so many bytes in a block gets a chunk of its own there: who wants that topic unpacks nothing else. For
fewer, the chunk's head and index and a read of their own cost more than that saves."""


_SKELETON_BYTES = 8 * 1024 * 1024
"""What is remembered of the forms of rows of all topics, in bytes, about; with more, all begin anew."""


@dataclass(slots=True)
class Prepared:
    """A block that is ready to be compressed and written."""

    extras: list[bytes]
    """Its metadata records; each is removed when it is in the file."""
    rows: Rows | None
    splits: bool
    """Whether a new segment begins with it."""
    merged: int = 0
    """How many rows became part of others."""


STAMP = "stamp"
"""In what a session says about itself: the first part of its segments' names."""


class BlockWriter:
    """Writes blocks of one recorder session into its folder. Used by one thread at a time.

    A block that could not be written changes nothing, so that it can be written again.
    """

    def __init__(
        self,
        folder: Path,
        options: RecorderOptions,
        about: Mapping[str, str],
        channels: Mapping[int, ChannelInfo],
        first_block: int = 0,
        sequences: Mapping[int, int] | None = None,
        last_ns: Mapping[int, int] | None = None,
    ) -> None:
        """Prepare; the first segment is made with the first block.

        Args:
            folder: The run's folder.
            options: The recorder's.
            about: The constant part of the `ml_dash` metadata record; `library` is also the header's.
            channels: The topics by number; others may add to it while this writes.
            first_block: Number of the first block with rows, where a recovery goes on.
            sequences: Rows that each topic has already, where a recovery goes on.
            last_ns: The last time appended to each topic, in ns, where a recovery goes on.
        """
        self.folder = folder
        self.finished: list[Path] = []
        self.bytes_written = 0
        self.rows_merged = 0
        """Rows that became part of others of the same topic and time before they were written."""
        self.steps = Steps(last_ns)
        """What time stepping back did to each topic."""
        self.clock = "unknown"
        """epoch, relative (starts near 0), mixed or unknown: how the tracks' time stamps look."""
        self.first_block = first_block
        """Number of the next block with rows; recovery tells by it which blocks are in a file."""
        self._begun: tuple[Block, Rows, bool] | None = None
        """A block whose times were looked at, should the rest of its preparation have to be tried again."""
        self.fallbacks: dict[str, int] = {}
        """How often what is done for many rows at once failed, by what it was, and a slower way was taken."""
        self._options = options
        self._own_chunk_bytes = min(_OWN_CHUNK_BYTES, options.chunk_bytes // 16)
        self._about = dict(about)
        self._last_event_ns = _begin_ns(about)
        """A time of the wall clock at which there was no row of a track yet, until there is one."""
        self._channels = channels
        self.compress: Compressor = compressor(options)
        self._skeletons: dict[int, Skeletons] = {}
        self._sequences: dict[int, int] = dict(sequences or {})
        self._parameters: dict[str, str] = {}
        self._stamp = self._about.pop(STAMP, "") or stamp_after(folder)
        self._number = 0
        self._segment: Segment | None = None
        self._segment_opened = 0.0
        self._set_aside: list[Segment] = []
        self._litter: list[Path] = []
        """Segments that could not be begun, and perhaps not be deleted either."""
        self._drops_said: dict[str, int] = {}

    # -- one block ---------------------------------------------------------------------------------------------------

    def prepare(self, block: Block) -> Prepared:
        """Infer, merge and number what a sealed buffer holds; nothing is written yet.

        Its sequence numbers are changed. Blocks are prepared and committed in order, one after the other. One whose
        preparation failed, for want of memory, may be prepared again.
        """
        extras = [block.data[start:end].tobytes() for start, end in block.extras]
        if not block.starts:
            return Prepared(extras, None, False)
        tracks = self._tracks()
        if self._begun is None or self._begun[0] is not block:
            rows, splits = self._follow_clock(pack(block), tracks)
            self.steps.look(rows, tracks)
            self._begun = (block, rows, splits)
        _, rows, splits = self._begun
        merged = self._merge(rows, tracks, self._forms(rows))
        merged.number(self._next_sequence(merged))
        self._begun = None
        return Prepared(extras, merged, splits, len(rows) - len(merged))

    def commit(self, prepared: Prepared) -> None:
        """Compress and write a prepared block.

        Raises:
            OSError: It could not be written; none of its rows is in the file. It may be tried again.
        """
        if prepared.splits or (prepared.rows is not None and self._is_time_to_split()):
            self.finish_segment()
            prepared.splits = False
        while prepared.extras:
            self._write_metadata(prepared.extras[0])
            del prepared.extras[0]
        if prepared.rows is not None:
            self._write_rows(prepared.rows)
            self.rows_merged += prepared.merged

    def _tracks(self) -> npt.NDArray[np.bool_]:
        """Return, by channel id, whether it is a track, whose rows of the same time merge."""
        channels = list(self._channels.items())
        tracks = np.zeros(max(number for number, _ in channels) + 1, np.bool_)
        for number, info in channels:
            tracks[number] = info.kind == TRACK
        return tracks

    # -- what is done for many rows at once, and for each of them where that fails ------------------------------------

    def _fall_back(self, what: str, error: Exception) -> None:
        """Count and tell that something failed; none of it may stop the writer, which has a slower way."""
        if what not in self.fallbacks:
            _log.warning(
                "%s failed in %s, and is done a slower way; stats()['fallbacks'] counts how often",
                *(what, self.folder),
                exc_info=error,
            )
        self.fallbacks[what] = self.fallbacks.get(what, 0) + 1

    def _merge(self, rows: Rows, tracks: npt.NDArray[np.bool_], forms: npt.NDArray[np.int32]) -> Rows:
        notes: list[tuple[int, list[int], bool]] = []
        try:
            merged = merge_same_time(rows, tracks, forms, self._keys_of, lambda *note: notes.append(note))
        except Exception as error:
            self._fall_back("merging the rows of a block", error)
            notes = []
            on_failure = lambda error: self._fall_back("merging rows of one time", error)  # noqa: E731
            merged = merge_each(rows, tracks, on_failure, lambda *note: notes.append(note))
        for note in notes:
            self.steps.note_merged(*note)
        return merged

    def _forms(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Find the form of each row, [N], and widen the schemas of topics that have rows of a new one."""
        is_too_much = sum([skeletons.size for skeletons in self._skeletons.values()]) > _SKELETON_BYTES
        for skeletons in self._skeletons.values():
            skeletons.forget() if is_too_much else skeletons.begin_block()
        inferred = [number for number, info in list(self._channels.items()) if info.schema is None]
        is_inferred = np.isin(rows.channels, inferred)
        try:
            return self._classify(rows, is_inferred)
        except Exception as error:
            self._fall_back("telling the forms of a block's rows", error)
        for skeletons in self._skeletons.values():
            skeletons.forget()
        return self._learn_each(rows, np.flatnonzero(is_inferred))

    def _learn_each(self, rows: Rows, which: npt.NDArray[np.intp]) -> npt.NDArray[np.int32]:
        """Decode some of the rows one by one; fields of one that cannot be decoded may be missing in the schema."""
        forms = np.full(len(rows), UNKNOWN, np.int32)
        for row in which.tolist():
            try:
                forms[row] = self._skeletons_of(int(rows.channels[row])).learn(rows.payload(row))
            except Exception as error:
                self._fall_back("decoding a row", error)
        return forms

    def _classify(self, rows: Rows, is_inferred: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        forms = np.full(len(rows), UNKNOWN, np.int32)
        is_pending = is_inferred
        for first, last in rows.uniform:
            forms[first:last] = self._skeletons_of(int(rows.channels[first])).learn(rows.payload(first))
            is_pending[first:last] = False
        is_long = is_pending & (rows.ends - rows.starts >= LONG_ROW_BYTES)
        if is_long.any():
            long = np.flatnonzero(is_long)
            forms[long] = self._learn_each(rows, long)[long]
            is_pending &= ~is_long
        which = np.flatnonzero(is_pending)
        if len(which):
            forms[which] = self._classify_short(rows if len(which) == len(rows) else taken(rows, which))
        return forms

    def _classify_short(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Find the forms of rows that are none of them long, by their skeletons."""
        bones = Bones(rows.data, rows.starts + record_bytes.MESSAGE_HEAD, rows.ends, record_bytes.MESSAGE_HEAD)
        forms = guess(bones, rows.channels, self._skeletons)
        if forms is None:
            forms = np.full(len(rows), UNKNOWN, np.int32)
            for mine in _by_channel(rows):
                forms[mine] = self._skeletons_of(int(rows.channels[mine[0]])).classify(bones, mine)
        return forms

    def _skeletons_of(self, number: int) -> Skeletons:
        """Return what is known of the forms of a topic."""
        skeletons = self._skeletons.get(number)
        if skeletons is None:
            skeletons = self._skeletons[number] = Skeletons()
        return skeletons

    def _keys_of(self, number: int, form: int) -> frozenset[str]:
        """Return the top-level keys of a channel's form, which is not `UNKNOWN`."""
        return self._skeletons[number].forms[form].keys

    def _write_rows(self, rows: Rows) -> None:
        segment = self._ensure_channels(rows)
        chunks = [self._build(part) for part in split(rows, self._own_chunk_bytes)]
        before = segment.size
        segment.add_block(chunks, self.first_block, STEPS_RECORD, self._steps_record(rows))
        self.bytes_written += segment.size - before
        self.first_block += 1
        for chunk in chunks:
            for number, count in chunk.counts.items():
                self._sequences[number] = self._sequences.get(number, 0) + count
        self.steps.commit()

    def _steps_record(self, rows: Rows) -> bytes:
        """Return what a block's metadata record tells about time that stepped back in it; empty if it did not."""
        numbers, counts = np.unique(rows.channels, return_counts=True)
        added = zip(numbers.tolist(), counts.tolist(), strict=True)
        ends = {number: self._sequences.get(number, 0) + count for number, count in added}
        topics = {number: self._channels[number].topic for number in ends}
        return self.steps.record(self.first_block, topics, rows, ends)

    def _build(self, rows: Rows) -> Chunk:
        try:
            return build(rows, self.compress)
        except OSError:
            raise
        except Exception as error:
            self._fall_back("compressing a chunk", error)
        return build(rows, UNCOMPRESSED)

    def _next_sequence(self, rows: Rows) -> npt.NDArray[np.uint32]:
        """Number each topic's rows on from its last one."""
        sequence = np.zeros(len(rows), np.int64)
        for mine in _by_channel(rows):
            sequence[mine] = self._sequences.get(int(rows.channels[mine[0]]), 0) + np.arange(len(mine))
        return sequence.astype(np.uint32)

    def _ensure_channels(self, rows: Rows) -> Segment:
        """Return a segment that has a channel and a wide enough schema for each row, a new one if need be."""
        numbers = np.unique(rows.channels).tolist()
        segment = self._ensure_segment()
        grown = {number: self._schema_record(number, segment.schema_space(number)) for number in numbers}
        if any(space < len(record) for number, record in grown.items() if (space := segment.schema_space(number))):
            self.finish_segment()
            segment = self._ensure_segment()
        for number in numbers:
            if segment.schema_space(number):
                segment.rewrite_schema(number, grown[number])
            else:
                segment.add_channel(number, self._schema_record(number, 0), self._channels[number].channel_record())
        return segment

    def _schema_record(self, number: int, space: int) -> bytes:
        """Return a topic's Schema record: exactly `space` bytes if it fits, with room to grow if there is none yet."""
        info = self._channels[number]
        skeletons = self._skeletons.get(number)
        schema = self._schema(skeletons.shape, info.topic) if skeletons else None
        record = info.schema_record(schema)
        if not space:
            text = len(schemas.to_bytes(dict(schema or info.schema or {})))
            return info.schema_record(schema, 0 if skeletons is None else 2 * text + _SPARE_BYTES)
        bare = len(record) - len(
            schemas.to_bytes(dict(schema or info.schema or {"type": "object", "title": info.topic}))
        )
        return record if len(record) > space else info.schema_record(schema, space - bare)

    def _schema(self, shape: Shape, topic: str) -> dict[str, Any]:
        try:
            return schemas.to_json(shape, topic)
        except Exception as error:
            self._fall_back("making a topic's schema", error)
        return schemas.to_json(Shape(), topic)

    def _write_metadata(self, record: bytes) -> None:
        parsed = Metadata.read(ReadDataStream(BytesIO(record[9:])))
        self._ensure_segment().add_metadata(parsed.name, record)
        if parsed.name == PARAMETERS_RECORD:
            self._parameters.update(parsed.metadata)

    # -- the tracks' clock -------------------------------------------------------------------------------------------

    def _follow_clock(self, rows: Rows, tracks: npt.NDArray[np.bool_]) -> tuple[Rows, bool]:
        """Keep logs and metrics that were made before the tracks' first row on the clock of the tracks.

        A viewer refuses a file whose times span from one clock to another. So where the tracks turn out not to run on
        the wall clock, what was logged before their first row takes its time, or stays behind in a segment of its own.

        Returns:
            The rows, and whether a new segment is to begin with them.
        """
        is_track = tracks[rows.channels]
        before = self.clock
        if is_track.any():
            self._look_at_clock(rows.times[is_track])
        if before != "unknown":
            return rows, False
        is_stamped = event_times.stamped(rows, is_track)
        if self.clock == "unknown":
            self._last_event_ns = max(self._last_event_ns, *rows.times[is_stamped].tolist(), 0)
            return rows, False
        if not event_times.are_elsewhere(rows, is_track, is_stamped, self._last_event_ns, time.time_ns()):
            return rows, False
        splits = self._segment is not None and bool(self._segment.contents.chunks)
        return event_times.follow(rows, is_track, is_stamped), splits

    def _look_at_clock(self, times: npt.NDArray[np.int64]) -> None:
        """Note how the time stamps of tracks look, [N], ns."""
        epoch_like = times >= int(clock.EPOCH_LIKE_S * clock.NS_PER_S)
        now = "epoch" if epoch_like.all() else "mixed" if epoch_like.any() else "relative"
        before = self.clock
        self.clock = now if before in ("unknown", now) else "mixed"
        if self.clock == "mixed" != before:
            _log.warning(
                "the tracks in %s mix wall-clock times and times near 0; viewers refuse such a file", self.folder
            )

    # -- segments ----------------------------------------------------------------------------------------------------

    def _is_time_to_split(self) -> bool:
        segment = self._segment
        if segment is None or not segment.contents.chunks:
            return False
        too_long = time.monotonic() - self._segment_opened >= self._options.segment_duration_s
        return too_long or segment.size >= self._options.segment_bytes

    def _ensure_segment(self) -> Segment:
        while self._segment is None:
            self._number += 1
            path = self.folder / f"{self._stamp}_{self._number:06d}{SEGMENT_SUFFIX}"
            try:
                self._segment = Segment(path, self._about["library"], self._describe())
            except FileExistsError:
                continue
            except OSError:
                self._litter.append(path.with_name(path.name + ACTIVE_SUFFIX))
                raise
            self._segment_opened = time.monotonic()
            self.bytes_written += self._segment.size
        return self._segment

    def _describe(self) -> dict[str, str]:
        return {
            **self._about,
            "segment": str(self._number),
            "start": datetime.datetime.now(datetime.timezone.utc).isoformat(),
            "clock": self.clock,
            "first_block": str(self.first_block),
            "parameters": json.dumps({name: json.loads(text) for name, text in self._parameters.items()}),
        }

    def set_aside(self) -> None:
        """Leave the segment in progress, on which a write failed, and go on in a new one."""
        segment, self._segment = self._segment, None
        if segment is not None and segment.contents.chunks:
            self._set_aside.append(segment)
        elif segment is not None:
            segment.discard()

    def sync(self) -> None:
        """Wait until what was written would survive a power cut."""
        if self._segment is not None:
            self._segment.sync()

    def finish_segment(self) -> None:
        """Write the end of the segment in progress, if there is one."""
        if self._segment is not None:
            path = self._segment.finish(self._options.sync_interval_s > 0)
            self._segment = None
            self.finished.append(path)

    def finish(self, drops: Mapping[str, int]) -> None:
        """Finish everything, making sure that there is at least one segment.

        Args:
            drops: Rows refused, by topic, to be written into the file.
        """
        if drops != self._drops_said or not (self.finished or self._segment):
            said = {topic: str(count) for topic, count in drops.items()}
            segment = self._ensure_segment()
            if said:
                segment.add_metadata(DROPS_RECORD, record_bytes.metadata(DROPS_RECORD, said))
            self._drops_said = dict(drops)
        self.finish_segment()
        while self._set_aside:  # what a failed sync did to them is unknown; it is not asked for again
            self.finished.append(self._set_aside[-1].finish(sync=False))
            self._set_aside.pop()
        while self._litter:
            self._litter.pop().unlink(missing_ok=True)


def _begin_ns(about: Mapping[str, str]) -> int:
    """Return when a recorder was opened, by the wall clock, in ns; 0 where it does not say."""
    try:
        return int(datetime.datetime.fromisoformat(about["run_start"]).timestamp() * clock.NS_PER_S)
    except (KeyError, ValueError):
        return 0


def _by_channel(rows: Rows) -> list[npt.NDArray[np.intp]]:
    """Return the numbers of each channel's rows, in order."""
    order = np.argsort(rows.channels.astype(np.uint16), kind="stable")  # of 16 bits numpy sorts in linear time
    return np.split(order, np.flatnonzero(np.diff(rows.channels[order])) + 1)


def stamp_after(folder: Path) -> str:
    """Return now, in UTC, as the first part of a segment's name; never before a name that the folder has already.

    Segments are read in the order of their names, and a robot's clock may have been reset since the last run.
    """
    now = datetime.datetime.now(datetime.timezone.utc).strftime("%Y%m%dT%H%M%S.%fZ")
    names = [
        path.name
        for pattern in (f"*{SEGMENT_SUFFIX}", f"*{SEGMENT_SUFFIX}{ACTIVE_SUFFIX}")
        for path in folder.glob(pattern)
    ]
    stamps = [name.split("_")[0] for name in names if name.split("_")[0].endswith("Z")]
    return max([now, *stamps])
