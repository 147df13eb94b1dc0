"""Copies an MCAP file of a recording: some of its topics, a time range, its rows in another encoding.

Each message has a message in the copy, with its times and its sequence number, in the order of writing. So what readers
merge stays for them to merge.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ... import clock
from ...codecs.encoded_channel import Decoder
from ...file_names import ACTIVE_SUFFIX
from ...mcap import audit, stored_messages
from ...mcap.chunk_messages import Messages
from ...mcap.chunk_writer import PackedChunk, build, compressor, rows_of_block
from ...mcap.file_output import FileOutput
from ...mcap.message import MessageBlock
from ...mcap.records import CHANNEL, Chunk
from ...mcap.row_arrays import Rows
from ...mcap.segment import Segment
from ...options import RecorderOptions
from ...query import topic_rows
from ...query.file import File
from ...query.time_order import TOLERANCE_NS
from ...query.topic_messages import MessageOrigin
from ...rows.plain_row import TIME_KEY
from ...store import read_ahead
from ..export_job import RestartableCounter
from .channel_plan import Codecs, NewChannel, plan
from .new_schemas import NewSchemas

_ROS_ENCODINGS = ("ros1", "cdr")


class Window(NamedTuple):
    """The time range of a copy, both ends included."""

    low: float
    """In s."""
    high: float
    start_ns: int
    """The log times that its rows can have; a little wider."""
    end_ns: int

    @classmethod
    def of(cls, low: float, high: float) -> Window:
        """Return the window of a range in seconds."""
        return cls(low, high, *topic_rows.to_ns_range(low, high))


class FileCopy:
    """One file and its copy."""

    def __init__(self, file: File, dest: Path, topics: Collection[str], codecs: Codecs, window: Window) -> None:
        """Plan the copy.

        Args:
            file: What to copy.
            dest: Where the copy is to be; nothing is there yet.
            topics: The names of the wanted topics.
            codecs: Of the topics whose rows are encoded anew.
            window: The wanted time range.

        Raises:
            EncodingError: The file has more channels than a copy can have.
        """
        if window.start_ns <= 0 and window.end_ns >= stored_messages.LAST_NS:
            audit.survey(file)  # a file whose summary is wrong has other channels than that says
        self._file = file
        self._dest = dest
        self._window = window
        self._channels = plan(file, topics, codecs)
        self._schemas = NewSchemas(self._channels.values(), dest.parent)
        self._decoders: dict[tuple[str, int], Decoder] = {}

    def write(self, counter: RestartableCounter) -> None:
        """Write the copy.

        A schema that outgrows the room that it was given is known by the end; then the copy is written once more.

        Raises:
            DamagedFileError: The file is damaged.
        """
        is_whole = False
        while not is_whole:
            counter.begin()
            active = self._dest.with_name(self._dest.name + ACTIVE_SUFFIX)
            segment = Segment(active, FileOutput.create(active))
            try:
                is_whole = self._fill(segment, counter)
                if is_whole:
                    segment.finish(sync=False)
            finally:
                if not is_whole:
                    segment.discard()

    def _fill(self, segment: Segment, counter: RestartableCounter) -> bool:
        """Write everything but the end; returns whether the schemas had room enough."""
        segment.begin(profile=self._profile())
        for record in self._file.metadata():
            segment.add_metadata(record.name, record.values)
        by_number = {each.number: each for each in self._channels.values()}
        for chunk in read_ahead.in_order(_packed, self._rows(), weigh=lambda rows: 2 * len(rows.data)):
            for number in chunk.counts:
                self._begin_channel(segment, by_number[number])
            segment.add_chunk(chunk)
            counter.add(sum(chunk.counts.values()))
        for each in by_number.values():
            self._begin_channel(segment, each)
        for attachment, entry in stored_messages.attachments(self._file):
            segment.add_attachment(attachment, entry)
        return self._finish_schemas(segment)

    def _profile(self) -> str:
        """Return the profile of the file, unless its messages are rows in the copy."""
        is_kept = all(each.codec is None for each in self._channels.values())
        return self._file.index.header.profile if is_kept else ""

    def _begin_channel(self, segment: Segment, each: NewChannel) -> None:
        """Write a channel, if it was not written before."""
        if each.number in segment.contents.channels:
            return
        channel = each.channel()
        if channel.schema_id:
            segment.add_topic(each.number, self._schemas.record(each), CHANNEL.pack(channel))
        else:
            segment.add_channel(channel)

    def _finish_schemas(self, segment: Segment) -> bool:
        for each in self._channels.values():
            if each.codec is not None:
                space = segment.schema_space(each.number)
                record = self._schemas.record(each, space)
                if len(record) != space:
                    return False
                segment.rewrite_schema(each.number, record)
        return True

    # -- messages ------------------------------------------------------------------------------------------------------

    def _rows(self) -> Iterator[Rows]:
        """Yield the messages of the copy, about a chunk at a time."""
        window = self._window
        stored = stored_messages.chunks(self._file, sorted(self._channels), window.start_ns, window.end_ns)
        for chunk, _, parts in stored:
            for block in stored_messages.in_pieces(self._block(chunk, [part for part in parts if len(part)])):
                rows = rows_of_block(block)
                self._schemas.learn(rows)
                yield rows

    def _block(self, chunk: Chunk, parts: list[Messages]) -> MessageBlock:
        """Return the wanted messages of a chunk in the order of writing."""
        blocks, offsets = [], []
        for part in parts:
            block, kept = self._part(chunk, part)
            blocks.append(block)
            offsets.append(part.offsets[kept])
        return MessageBlock.joined(blocks).pick(np.argsort(np.concatenate(offsets), kind="stable"))

    def _part(self, chunk: Chunk, part: Messages) -> tuple[MessageBlock, list[int]]:
        """Return the wanted messages of one channel, and which of the part's messages they are."""
        each, window = self._channels[part.channel_id], self._window
        payloads: list[bytes | memoryview] = []
        kept: list[int] = []
        if each.codec is None:
            kept = self._in_window(chunk, each, part)
            stored = part.payloads
            payloads += [stored[at] for at in kept]
        else:
            origin = MessageOrigin(self._file, each.source, chunk)
            for at, row in enumerate(topic_rows.decode(origin, part.payloads, part.times_ns, self._decoders)):
                if row is not None and window.low <= row[TIME_KEY] <= window.high:
                    kept.append(at)
                    payloads.append(each.codec.encode_read(row))
        numbers = np.full(len(kept), each.number, np.int64)
        block = MessageBlock(numbers, part.times_ns[kept], part.published_ns[kept], part.sequences[kept], payloads)
        return block, kept

    def _in_window(self, chunk: Chunk, each: NewChannel, part: Messages) -> list[int]:
        """Return which messages that stay as they are lie in the window: rows by their time stamps, others by log time.

        A row's time stamp and its log time differ by little, so only the rows near an end of the window are decoded.
        """
        window = self._window
        times_s = clock.to_seconds_each(part.times_ns.tolist())
        if each.has_rows:
            ends_ns = np.array([window.start_ns, window.end_ns], np.uint64)
            at_an_end = np.abs(part.times_ns[:, None].astype(np.float64) - ends_ns).min(axis=1) <= 4 * TOLERANCE_NS
            doubtful = np.flatnonzero(at_an_end)
            some = part.pick(doubtful)
            origin = MessageOrigin(self._file, each.source, chunk)
            rows = topic_rows.decode(origin, some.payloads, some.times_ns, self._decoders)
            for at, row in zip(doubtful.tolist(), rows, strict=True):
                times_s[at] = times_s[at] if row is None else row[TIME_KEY]
        return [at for at, time_s in enumerate(times_s) if window.low <= time_s <= window.high]


def _packed(rows: Rows) -> PackedChunk:
    return build(rows, compressor(RecorderOptions()))
