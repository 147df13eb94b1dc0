"""Copies a bag into a recording without decoding: bytes, times, types, definitions, and topics without messages.

Each file of the bag becomes an MCAP file, in ROS's own encoding, that ROS, Foxglove and every MCAP reader know. Chunks
of MCAP files are copied as they are.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...codecs.ros import distros
from ...errors import EncodingError
from ...file_names import BAG_RECORD, SEGMENT_SUFFIX, is_like_a_bomb
from ...mcap import records, stored_messages
from ...mcap.chunk_writer import PackedChunk, build_block, compressor, index_records
from ...mcap.file_output import FileOutput
from ...mcap.file_writer import MOST_CHANNELS, FileWriter
from ...mcap.message import Connection, MessageBlock
from ...mcap.message_records import index_entries
from ...mcap.record_layout import PREFIX_BYTES, Fields
from ...mcap.stored_messages import StoredChunk
from ...options import RecorderOptions
from ...store import read_ahead
from .bag_contents import Bag, BagFile
from .bag_mcap.read import McapBag
from .bag_sqlite.read import SqliteBag
from .bag_types import Types


class Carrier:
    """Copies the files of a bag into a recording's folder."""

    def __init__(
        self,
        src: Path,
        bag: Bag,
        folder: Path,
        prefix: str,
        types: Types,
        wanted: Collection[Connection],
        *,
        keeps_all_files: bool,
    ) -> None:
        """Prepare to copy.

        Args:
            src: Of the bag, for the errors.
            bag: What to copy.
            folder: Of the recording.
            prefix: What the names of its files start with.
            types: What is known of the bag's types.
            wanted: Which of the bag's channels to copy.
            keeps_all_files: Whether files without such channels are copied too, for their other contents.
        """
        self._src = src
        self._bag = bag
        self._folder = folder
        self._prefix = prefix
        self._keeps_all_files = keeps_all_files
        self._types = types
        self._wanted = wanted
        self._number = 0
        self._warned: set[str] = set()

    def copy(self, file: BagFile) -> Iterator[int]:
        """Copy a file of the bag; yields how many messages were copied, some at a time.

        Raises:
            DamagedFileError: The file is damaged.
            EncodingError: The type of a message is unknown, and `on_unknown` is "raise".
        """
        numbers = [number for number, channel in file.channels.items() if channel in self._wanted]
        if not numbers and not self._keeps_all_files:
            return
        keeps_ids = isinstance(file, McapBag)
        ids = {number: number if keeps_ids else at for at, number in enumerate(numbers, start=1)}
        if len(ids) > MOST_CHANNELS:
            raise EncodingError(f"{self._src}: it has {len(ids)} topics and connections; MCAP has {MOST_CHANNELS}")
        self._number += 1
        name = f"{self._prefix}_{self._number:06d}{SEGMENT_SUFFIX}"  # files are read in the order of their names
        output = FileOutput.create(self._folder / name)
        dest = FileWriter(output)
        try:
            dest.begin(profile=self._profile(file))
            self._begin(dest, file, ids)
            unknown = {number for number in numbers if self._types.is_unknown(file.channels[number])}
            for chunk in self._chunks(file, ids):
                self._name_unknown(file, unknown & self._sources(ids, chunk.counts))
                dest.add_chunk(chunk)
                yield sum(chunk.counts.values())
            self._end(dest, file)
            dest.write_end()
        finally:
            output.close()

    def _profile(self, file: BagFile) -> str:
        return (
            file.file.index.header.profile if isinstance(file, McapBag) else self._bag.format.replace("rosbag", "ros")
        )

    def _begin(self, dest: FileWriter[FileOutput], file: BagFile, ids: Mapping[int, int]) -> None:
        """Write schemas and channels; those of MCAP files keep their ids, because their chunks may repeat them."""
        described = {number: self._types.described(file.channels[number]) for number in ids}
        if isinstance(file, McapBag):
            for schema in file.file.index.schemas.values():
                if any(_has(described[number], schema) for number in ids):
                    dest.add_schema(schema)
        for number, channel_id in ids.items():
            schema_id = None
            if isinstance(file, McapBag):
                own_schema = file.file.index.schemas.get(file.file.index.channels[number].schema_id)
                if own_schema is not None and _has(described[number], own_schema):
                    schema_id = own_schema.id
            dest.add_connection(channel_id, described[number], schema_id)

    def _end(self, dest: FileWriter[FileOutput], file: BagFile) -> None:
        """Copy metadata records and attachments, and add a record that describes the bag."""
        values = {"format": self._bag.format, "file": file.name}
        names = set()
        if isinstance(file, McapBag):
            values["library"] = file.file.index.header.library
            for record in file.file.metadata():
                dest.add_metadata(record.name, record.values)
                names.add(record.name)
            for attachment, entry in stored_messages.attachments(file.file):
                dest.add_attachment(attachment, entry)
        text = self._bag.text
        if distros.RECORD not in names and self._bag.format == "rosbag2":
            inside = file.information if isinstance(file, SqliteBag) else ""
            values_of_rosbag2 = {distros.DISTRO_KEY: self._bag.distro, distros.TEXT_KEY: inside or text}
            if any(values_of_rosbag2.values()):
                dest.add_metadata(distros.RECORD, values_of_rosbag2)
        if text:
            values[distros.METADATA_FILE] = text
        dest.add_metadata(BAG_RECORD, values)

    def _chunks(self, file: BagFile, ids: Mapping[int, int]) -> Iterator[PackedChunk]:
        if isinstance(file, McapBag) and not file.is_packed:
            same = all(self._types.described(file.channels[number]) == file.channels[number] for number in ids)
            is_whole = same and set(ids) == set(file.channels)  # or else chunks may repeat what is not so any more
            stored = stored_messages.chunks(file.file, sorted(ids))
            return read_ahead.in_order(
                # The work ahead is bounded by bytes, not by a count, because chunks differ in size by orders of
                # magnitude.
                lambda chunk: _copied(chunk, is_whole),
                stored,
                weigh=lambda chunk: len(chunk.record),
            )
        blocks = (block.renumbered(ids) for block in file.blocks(ids.keys()))
        return read_ahead.in_order(_packed, blocks, weigh=lambda block: 2 * block.size)

    @staticmethod
    def _sources(ids: Mapping[int, int], present: Collection[int]) -> set[int]:
        return {number for number, channel_id in ids.items() if channel_id in present}

    def _name_unknown(self, file: BagFile, numbers: set[int]) -> None:
        for number in numbers:
            channel = file.channels[number]
            if channel.topic not in self._warned:
                self._warned.add(channel.topic)
                self._types.name_unknown(channel)


def _has(channel: Connection, schema: records.Schema) -> bool:
    """Whether a channel's type is what a schema says."""
    type_of_channel = (channel.type, channel.schema_encoding, channel.definition)
    return type_of_channel == (schema.name, schema.encoding, schema.data)


def _packed(block: MessageBlock) -> PackedChunk:
    return build_block(block, compressor(RecorderOptions()))


def _copied(chunk: StoredChunk, is_whole: bool) -> PackedChunk:
    """Return a chunk as it was, or built again.

    That is needed where some of its messages stay behind, it says a wrong time, or nobody would read it without raising
    a limit.
    """
    start_ns = min(int(messages.times_ns.min()) for messages in chunk.messages if len(messages))
    end_ns = max(int(messages.times_ns.max()) for messages in chunk.messages if len(messages))
    if is_whole and chunk.record:
        fields = Fields(chunk.record, "", 0, PREFIX_BYTES)
        head = records.CHUNK_HEAD.read(fields)
        begin = PREFIX_BYTES + head.records_at
        is_plain = begin + head.records_length == len(chunk.record)
        if (
            (start_ns, end_ns) == (head.start_ns, head.end_ns)
            and is_plain
            and not is_like_a_bomb(head.uncompressed_size, head.records_length)
        ):
            return PackedChunk(
                bytes(chunk.record[:begin]),
                memoryview(chunk.record)[begin:],
                head.compression,
                head.uncompressed_size,
                start_ns,
                end_ns,
                *index_records(_entries(chunk)),
            )
    return _packed(stored_messages.block_of(chunk.messages))


def _entries(chunk: StoredChunk) -> dict[int, npt.NDArray[np.void]]:
    """Return the entries of each channel's message index, by time."""
    entries = {}
    for messages in chunk.messages:
        if len(messages):
            # Messages of one time keep the order of the file: the offset decides between them.
            order = np.lexsort((messages.offsets, messages.times_ns))
            entries[messages.channel_id] = index_entries(messages.times_ns[order], messages.offsets[order])
    return entries
