"""Sealed buffers to segments: infer, merge, number, chunk, write, and begin a new segment when it is time."""

from __future__ import annotations

import contextlib
import datetime
import json
import time
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
import orjson
from mcap.data_stream import ReadDataStream
from mcap.records import Metadata

from .. import clock
from ..options import RecorderOptions
from ..rows import schema as schemas
from ..rows.encode import TIME_KEY
from ..rows.skeleton import Block, Form, Skeletons
from . import chunk as chunks
from . import records
from .channels import TRACK, ChannelInfo
from .merging import merge_same_time
from .rows import Bytes, Rows, of_buffer, replaced
from .segment import ACTIVE_SUFFIX, Segment

PARAMETERS = "ml_dash.parameters"
DROPS = "ml_dash.drops"

_SPARE_BYTES = 512
"""A schema has at least this much room to grow in place, and at least as much as it is long."""


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
        first_chunk: int = 0,
        sequences: Mapping[int, int] | None = None,
    ) -> None:
        """Prepare; the first segment is made with the first block.

        Args:
            folder: The run's folder.
            options: The recorder's.
            about: The constant part of the `ml_dash` metadata record; `library` is also the header's.
            channels: The topics by number; others may add to it while this writes.
            first_chunk: Number of the first block with rows, where a recovery goes on.
            sequences: Rows that each topic has already, where a recovery goes on.
        """
        self.folder = folder
        self.finished: list[Path] = []
        self.bytes_written = 0
        self.clock = "unknown"
        """epoch, relative (starts near 0), mixed or unknown: how the tracks' time stamps look."""
        self.first_chunk = first_chunk
        """Number of the next block with rows; recovery tells by it which blocks are in a file."""
        self._options = options
        self._about = dict(about)
        self._channels = channels
        self._compress = chunks.compressor(options)
        self._skeletons: dict[int, Skeletons] = {}
        self._sequences: dict[int, int] = dict(sequences or {})
        self._parameters: dict[str, str] = {}
        self._stamp = _stamp_after(folder)
        self._number = 0
        self._segment: Segment | None = None
        self._segment_opened = 0.0
        self._set_aside: list[Segment] = []

    # -- one block --------------------------------------------------------------------------------------------------

    def write(self, data: Bytes, starts: list[int], extras: list[tuple[int, int]]) -> None:
        """Write the rows and metadata records of a sealed buffer.

        Args:
            data: The buffer's bytes; the sequence numbers in it are changed.
            starts: Where its Message records start.
            extras: Start and end of its Metadata records.

        Raises:
            OSError: It could not be written; nothing of it is in the file.
        """
        rows = self._prepare(of_buffer(data, starts)) if starts else None
        if self._is_time_to_split(rows):
            self.finish_segment()
        for start, end in extras:
            self._write_metadata(data[start:end].tobytes())
        if rows is not None:
            self._write_rows(rows)

    def _prepare(self, rows: Rows) -> Rows:
        rows = self._follow_clock(rows.packed())
        forms = self._classify(rows)
        mergeable = np.zeros(max(self._channels) + 1, np.bool_)
        for number, info in list(self._channels.items()):
            mergeable[number] = info.kind == TRACK

        def form_of(row: int) -> Form:
            return self._skeletons[int(rows.channels[row])].forms[int(forms[row])]

        return merge_same_time(rows, mergeable, form_of).packed()

    def _classify(self, rows: Rows) -> npt.NDArray[np.int32]:
        """Find the form of each row and widen the schemas of topics whose rows have a new one."""
        block = Block(rows.data, rows.starts + records.MESSAGE_HEAD, rows.ends)
        forms = np.full(len(rows), -1, np.int32)
        for number in np.unique(rows.channels).tolist():
            info = self._channels[number]
            if info.schema is not None and info.kind != TRACK:
                continue
            mine = np.flatnonzero(rows.channels == number)
            skeletons = self._skeletons.setdefault(number, Skeletons())
            forms[mine], _ = skeletons.classify(block, mine)
        return forms

    def _write_rows(self, rows: Rows) -> None:
        segment = self._ensure_channels(rows)
        sequence = self._next_sequence(rows)
        chunk = chunks.build(rows.number(sequence), self._options, self._compress)
        before = segment.size
        segment.add_chunk(chunk)
        self.bytes_written += segment.size - before
        self.first_chunk += 1
        for number, count in chunk.counts.items():
            self._sequences[number] = self._sequences.get(number, 0) + count

    def _next_sequence(self, rows: Rows) -> npt.NDArray[np.uint32]:
        """Number each topic's rows on from its last one."""
        sequence = np.zeros(len(rows), np.int64)
        for number in np.unique(rows.channels).tolist():
            mine = rows.channels == number
            sequence[mine] = self._sequences.get(number, 0) + np.arange(np.count_nonzero(mine))
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
        schema = schemas.to_json(skeletons.shape, info.topic) if skeletons else None
        record = info.schema_record(schema)
        if not space:
            text = len(schemas.to_bytes(dict(schema or info.schema or {})))
            return info.schema_record(schema, 0 if skeletons is None else 2 * text + _SPARE_BYTES)
        bare = len(record) - len(schemas.to_bytes(dict(schema or info.schema or {"type": "object", "title": info.topic})))
        return record if len(record) > space else info.schema_record(schema, space - bare)

    def _write_metadata(self, record: bytes) -> None:
        parsed = Metadata.read(ReadDataStream(BytesIO(record[9:])))
        self._ensure_segment().add_metadata(parsed.name, record)
        if parsed.name == PARAMETERS:
            self._parameters.update(parsed.metadata)

    # -- the tracks' clock ------------------------------------------------------------------------------------------

    def _follow_clock(self, rows: Rows) -> Rows:
        """Keep logs and metrics, made at wall-clock times, on the clock of the tracks.

        A viewer refuses a file whose times span from near 0 to today. So where the tracks turn out to run on a clock
        that starts near 0, what was logged before their first row takes its time, or stays behind in a segment of
        its own.
        """
        track_numbers = [number for number, info in list(self._channels.items()) if info.kind == TRACK]
        is_track = np.isin(rows.channels, track_numbers)
        if not is_track.any():
            return rows
        epoch_like = rows.times >= int(clock.EPOCH_LIKE_S * clock.NS_PER_S)
        seen = {"epoch" if epoch else "relative" for epoch in np.unique(epoch_like[is_track])}
        before, self.clock = self.clock, seen.pop() if len(seen) == 1 else "mixed"
        if before == "unknown" and self.clock == "relative":
            if self._segment is not None and self._segment.contents.chunks:
                self.finish_segment()
            return _retime(rows, np.flatnonzero(~is_track & epoch_like), int(rows.times[is_track][0]))
        if before not in ("unknown", self.clock):
            self.clock = "mixed"
        return rows

    # -- segments ---------------------------------------------------------------------------------------------------

    def _is_time_to_split(self, rows: Rows | None) -> bool:
        segment = self._segment
        if segment is None or rows is None or not segment.contents.chunks:
            return False
        too_long = time.monotonic() - self._segment_opened >= self._options.segment_duration_s
        return too_long or segment.size >= self._options.segment_bytes

    def _ensure_segment(self) -> Segment:
        while self._segment is None:
            self._number += 1
            path = self.folder / f"{self._stamp}_{self._number:06d}.mcap"
            with contextlib.suppress(FileExistsError):
                self._segment = Segment(path, self._about["library"], self._describe())
                self._segment_opened = time.monotonic()
                self.bytes_written += self._segment.size
        return self._segment

    def _describe(self) -> dict[str, str]:
        return {
            **self._about,
            "segment": str(self._number),
            "start": datetime.datetime.now(datetime.timezone.utc).isoformat(),
            "clock": self.clock,
            "first_chunk": str(self.first_chunk),
            "parameters": json.dumps({name: orjson.loads(text) for name, text in self._parameters.items()}),
        }

    def set_aside(self) -> None:
        """Leave the segment in progress, on which a write failed, and go on in a new one."""
        if self._segment is not None:
            self._set_aside.append(self._segment)
            self._segment = None

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
        segment = self._ensure_segment() if drops or not self.finished else self._segment
        if drops and segment is not None:
            segment.add_metadata(DROPS, records.metadata(DROPS, {topic: str(count) for topic, count in drops.items()}))
        self.finish_segment()
        while self._set_aside:
            self.finished.append(self._set_aside[-1].finish())
            self._set_aside.pop()


def _retime(rows: Rows, which: npt.NDArray[np.intp], time_ns: int) -> Rows:
    """Give some rows another time, in their payload too."""
    if not len(which):
        return rows
    payloads: dict[int, tuple[int, bytes]] = {}
    for row in which.tolist():
        fields = orjson.loads(rows.payload(row))
        fields[TIME_KEY] = clock.to_seconds(time_ns)
        payloads[row] = (time_ns, orjson.dumps(fields))
    return replaced(rows, np.ones(len(rows), np.bool_), payloads)


def _stamp_after(folder: Path) -> str:
    """Return now, in UTC, as the first part of a segment's name; never before a name that the folder has already.

    Segments are read in the order of their names, and a robot's clock may have been reset since the last run.
    """
    now = datetime.datetime.now(datetime.timezone.utc).strftime("%Y%m%dT%H%M%S.%fZ")
    names = [path.name for pattern in ("*.mcap", f"*.mcap{ACTIVE_SUFFIX}") for path in folder.glob(pattern)]
    stamps = [name.split("_")[0] for name in names if name.split("_")[0].endswith("Z")]
    return max([now, *stamps])
