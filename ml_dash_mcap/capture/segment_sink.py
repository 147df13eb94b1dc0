"""Writes prepared blocks into segments: chunks and compresses them, and begins a new segment when it is time."""

from __future__ import annotations

import datetime
import json
import time
from collections.abc import Mapping
from pathlib import Path

from ..codecs.codec import Codec
from ..file_names import ACTIVE_SUFFIX, DROPS_RECORD, PARAMETERS_RECORD, STEPS_RECORD
from ..mcap.chunk_writer import UNCOMPRESSED, Compressor, PackedChunk, build, compressor
from ..mcap.records import Metadata
from ..mcap.row_arrays import Rows, split
from ..mcap.segment import Segment
from ..options import RecorderOptions
from ..rows.shape import NOTHING, Shape
from .channels import ChannelInfo
from .event_clock import UNKNOWN_CLOCK
from .fallbacks import Fallbacks
from .prepared_block import PreparedBlock
from .segment_names import STAMP, segment_path, stamp_after
from .sink import SessionInfo

_SPARE_BYTES = 512
"""A schema has at least this much room to grow in place, and at least as much as it is long."""

_OWN_CHUNK_BYTES = 32 * 1024
"""A topic with so many bytes in a block gets a chunk of its own there, so that a reader of that topic unpacks nothing
else. For fewer bytes, the head and the index of a chunk and a read of their own cost more than that saves."""


class SegmentSink:
    """The sink that writes the blocks of one session into its folder. Used by one thread at a time.

    Unlike other sinks it is called by the writer thread itself, which waits for it. A block that could not be written
    changes nothing, so that it can be written again, and so can `close`.
    """

    folder: Path
    """The run's folder."""

    def __init__(
        self, options: RecorderOptions, fallbacks: Fallbacks, drops: Mapping[str, int], next_block: int = 0
    ) -> None:
        """Prepare for a session.

        Args:
            options: The options of the recorder.
            fallbacks: Counts work that failed and was done a slower way.
            drops: Rows refused so far, by topic, to be written at the end; others may add to it meanwhile.
            next_block: Number of the first block with rows, where a recovery goes on.
        """
        self.finished: list[Path] = []
        self.bytes_written = 0
        self.rows_merged = 0
        """Rows that became part of others of the same topic and time before they were written."""
        self.compress: Compressor = compressor(options)
        self._next_block = next_block
        """Number of the next block with rows; recovery tells by it which blocks are in a file."""
        self._options = options
        # With small buffers no topic would ever reach 32 KiB in a block; a sixteenth of a buffer counts as much there.
        self._own_chunk_bytes = min(_OWN_CHUNK_BYTES, options.chunk_bytes // 16)
        self._about: dict[str, str] = {}
        self._fallbacks = fallbacks
        self._clock = UNKNOWN_CLOCK
        self._parameters: dict[str, str] = {}
        self._stamp = ""
        self._number = 0
        self._segment: Segment | None = None
        self._segment_opened = 0.0
        self._begun: PreparedBlock | None = None
        """The block that is being written, or whose writing failed."""
        self._begins_segment = False
        self._metadata: list[Metadata] = []
        """The metadata records of `_begun` that are not in the file yet."""
        self._set_aside: list[Segment] = []
        self._litter: list[Path] = []
        """Files of segments that could not be begun, and that may still have to be deleted."""
        self._drops = drops
        self._drops_written: dict[str, int] = {}

    def open(self, session: SessionInfo) -> None:
        """Begin a session; its first segment is made with the first block."""
        self.folder = session.folder
        self._about = dict(session.about)
        self._stamp = self._about.pop(STAMP, "") or stamp_after(session.folder)

    # -- one block ---------------------------------------------------------------------------------------------------

    def write(self, block: PreparedBlock) -> None:
        """Compress and write a prepared block.

        Raises:
            OSError: It could not be written; none of its rows is in the file. It may be tried again.
        """
        if self._begun is not block:
            self._begun, self._metadata = block, list(block.metadata)
            self._begins_segment = block.begins_segment
            self._clock = block.clock
        if self._has_chunks() and (self._begins_segment or (block.rows is not None and self._is_time_to_split())):
            self.finish_segment()
        self._begins_segment = False
        while self._metadata:
            self._write_metadata(self._metadata[0])
            # Removed only after it was written, so that a retry writes the rest and none twice.
            del self._metadata[0]
        if block.rows is not None:
            self._write_rows(block, block.rows)
            self.rows_merged += block.merged
        self._begun = None  # the memory of a large row goes with its block

    def _write_metadata(self, metadata: Metadata) -> None:
        self._ensure_segment().add_metadata(metadata.name, metadata.values)
        if metadata.name == PARAMETERS_RECORD:
            self._parameters.update(metadata.values)

    def _write_rows(self, block: PreparedBlock, rows: Rows) -> None:
        segment = self._ensure_channels(block)
        chunks = [self._build(part) for part in split(rows, self._own_chunk_bytes)]
        previous_size = segment.size
        segment.add_block(chunks, block.number, STEPS_RECORD, block.time_steps)
        self.bytes_written += segment.size - previous_size
        self._next_block = block.number + 1

    def _build(self, rows: Rows) -> PackedChunk:
        try:
            return build(rows, self.compress)
        except OSError:
            raise
        except Exception as error:
            self._fallbacks.note("compressing a chunk", error)
        return build(rows, UNCOMPRESSED)

    # -- channels and schemas ----------------------------------------------------------------------------------------

    def _ensure_channels(self, block: PreparedBlock) -> Segment:
        """Return a segment that has a channel and a wide enough schema for each row, a new one if need be."""
        segment = self._ensure_segment()
        grown = {number: self._schema_record(block, number, segment.schema_space(number)) for number in block.channels}
        # Readers take the first schema of a channel in a file. So a schema grows where it lies, or in the next file.
        if any(space < len(record) for number, record in grown.items() if (space := segment.schema_space(number))):
            self.finish_segment()
            segment = self._ensure_segment()
        for number, info in block.channels.items():
            if segment.schema_space(number):
                if info.codec is not None and not info.codec.follows_shapes:  # its rows are not decoded without it
                    segment.announce_schema(number, grown[number])
                segment.rewrite_schema(number, grown[number])
            else:
                segment.add_topic(number, self._schema_record(block, number, 0), info.channel_record())
        return segment

    def _schema_record(self, block: PreparedBlock, number: int, space: int) -> bytes:
        """Return a topic's Schema record: exactly `space` bytes if it fits, with room to grow if there is none yet."""
        info, shape = block.channels[number], block.shapes.get(number)
        if info.schema is not None or info.codec is None:
            return info.schema_record(info.schema or b"")
        schema = self._schema(info, info.codec, shape)
        if shape is None and info.codec.follows_shapes:
            return info.schema_record(schema)
        try:
            return info.padded_schema_record(schema, space, _SPARE_BYTES)
        except Exception as error:
            self._fallbacks.note("padding a topic's schema", error, "has no room to grow in its segment")
            return info.schema_record(schema)

    def _schema(self, info: ChannelInfo, codec: Codec, shape: Shape | None) -> bytes:
        """Return the schema of rows of a shape. If a full schema cannot be made, the schema describes fewer fields."""
        for part in (None,) if shape is None else (shape, NOTHING, None):
            try:
                return codec.schema(part, info.topic)
            except Exception as error:
                self._fallbacks.note("making a topic's schema", error, "the schema says less")
        return b""

    # -- segments ----------------------------------------------------------------------------------------------------

    def _has_chunks(self) -> bool:
        return self._segment is not None and bool(self._segment.contents.chunks)

    def _is_time_to_split(self) -> bool:
        too_long = time.monotonic() - self._segment_opened >= self._options.segment_duration_s
        return too_long or (self._segment is not None and self._segment.size >= self._options.segment_bytes)

    def _ensure_segment(self) -> Segment:
        while self._segment is None:
            self._number += 1
            # Another recorder of this folder may have begun in the same microsecond and have the name.
            path = segment_path(self.folder, self._stamp, self._number)
            try:
                self._segment = Segment.create(path, self._about["library"], self._describe())
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
            "clock": self._clock,
            "first_block": str(self._next_block),
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
        """Wait until all written bytes would survive a power cut."""
        if self._segment is not None:
            self._segment.output.sync()

    def finish_segment(self) -> None:
        """Write the end of the segment in progress, if there is one."""
        if self._segment is not None:
            path = self._segment.finish(self._options.sync_interval_s > 0)
            self._segment = None
            self.finished.append(path)

    def close(self) -> None:
        """Finish everything, making sure that there is at least one segment."""
        if self._drops != self._drops_written or not (self.finished or self._segment):
            drops = dict(self._drops)
            segment = self._ensure_segment()
            if drops:
                segment.add_metadata(DROPS_RECORD, {topic: str(count) for topic, count in drops.items()})
            self._drops_written = drops
        self.finish_segment()
        while self._set_aside:  # a failed sync may have lost data; syncing again could falsely succeed
            self.finished.append(self._set_aside[-1].finish(sync=False))
            self._set_aside.pop()
        while self._litter:
            self._litter.pop().unlink(missing_ok=True)
