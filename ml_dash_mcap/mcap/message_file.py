"""An MCAP file of other people's messages, written a chunk at a time: their bytes, times and channels as they came."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Header, Schema
from mcap.records import Channel as ChannelRecord

from ..version import LIBRARY
from . import record_bytes
from .chunk_writer import Chunk, Compressor, build
from .message import Connection, MessageBlock, Payload
from .row_arrays import Rows
from .segment import Contents

MOST_CHANNELS = 2**16 - 1
"""MCAP numbers channels with 16 bits, and 0 is kept free."""


class MessageFile:
    """A file that takes chunks until it is finished. The caller gives it its name when it is whole."""

    def __init__(self, path: Path, profile: str, library: str = LIBRARY) -> None:
        """Begin a file.

        Args:
            path: Where to.
            profile: What the header says of the messages: "ros1", "ros2" or nothing.
            library: What the header names as the writer.
        """
        self._file: BinaryIO = path.open("wb")
        self.size = 0
        """Bytes so far."""
        self.contents = Contents()
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}
        self._write(record_bytes.MAGIC + record_bytes.to_bytes(Header(profile=profile, library=library)))

    def add_schema(self, number: int, name: str, encoding: str, data: bytes) -> None:
        """Write a schema."""
        self._schema_ids.setdefault((name, encoding, data), number)
        self.contents.schemas[number] = record_bytes.to_bytes(
            Schema(id=number, name=name, encoding=encoding, data=data)
        )
        self._write(self.contents.schemas[number])

    def add_channel(self, number: int, channel: Connection, schema_id: int | None = None) -> None:
        """Write a channel, and its schema if none before it is the same.

        Args:
            number: Its id.
            channel: What it is. Without a type it has no schema.
            schema_id: Of its schema, if that was added under an id of its own; None to look for it.
        """
        key = (channel.type, channel.schema_encoding, channel.definition)
        if schema_id is None and any(key) and key not in self._schema_ids:
            self.add_schema(max(self.contents.schemas, default=0) + 1, *key)
        record = ChannelRecord(
            id=number,
            schema_id=self._schema_ids.get(key, 0) if schema_id is None else schema_id,
            topic=channel.topic,
            message_encoding=channel.message_encoding,
            metadata=dict(channel.metadata),
        )
        self.contents.channels[number] = record_bytes.to_bytes(record)
        self.contents.counts.setdefault(number, 0)
        self._write(self.contents.channels[number])

    def add_chunk(self, chunk: Chunk) -> None:
        """Write a chunk with its message indexes."""
        at = self.size
        self._write(chunk.head, chunk.data, *chunk.indexes.values())
        self.contents.add_chunk(chunk, at)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        at = self.size
        self._write(record_bytes.metadata(name, values))
        self.contents.add_metadata(name, at, self.size - at)

    def add_attachment(self, record: Iterator[bytes], index: Mapping[str, Any]) -> None:
        """Copy an Attachment record.

        Args:
            record: Its bytes, some at a time.
            index: What the summary says of it besides its place: the fields of an AttachmentIndex.
        """
        at = self.size
        for part in record:
            self._write(part)
        self.contents.attachments.append(AttachmentIndex(offset=at, length=self.size - at, **index))

    def finish(self) -> None:
        """Write the file's end, and close it."""
        self._write(record_bytes.data_end())
        self._write(self.contents.summary(self.size))
        self._file.flush()
        self.close()

    def close(self) -> None:
        """Close the file, finished or not. May be called twice."""
        self._file.close()

    def _write(self, *parts: Any) -> None:
        for part in parts:
            self._file.write(part)
            self.size += len(part)


def pack(block: MessageBlock, compress: Compressor) -> Chunk:
    """Return messages, one or more, as a chunk in which they lie in their order; the channels' numbers are the ids."""
    count = len(block)
    sizes = np.fromiter(map(len, block.payloads), np.int64, count)
    heads = np.empty(count, record_bytes.MESSAGE_HEAD_DTYPE)
    heads["opcode"] = Opcode.MESSAGE
    heads["length"] = sizes + record_bytes.MESSAGE_LENGTH_EXCESS
    heads["channel"] = block.channels
    heads["sequence"] = block.sequences
    heads["log_time"] = block.times_ns
    heads["publish_time"] = block.published_ns
    size = record_bytes.MESSAGE_HEAD
    if (sizes == sizes[0]).all():
        data = _side_by_side(heads, block.payloads, int(sizes[0]))
    else:
        text = heads.tobytes()
        parts: list[Any] = [None] * (2 * count)
        parts[0::2] = [text[at : at + size] for at in range(0, count * size, size)]
        parts[1::2] = block.payloads
        data = np.frombuffer(b"".join(parts), np.uint8)
    ends = np.cumsum(sizes + size)
    times: Any = block.times_ns  # beyond the year 2262 they do not fit into signed numbers
    return build(Rows(data, ends - sizes - size, ends, block.channels, times), compress)


def _side_by_side(heads: np.ndarray, payloads: list[Payload], size: int) -> np.ndarray:
    """Join heads and payloads of one size: as the columns of a matrix, in a third of the time."""
    whole = np.empty((len(heads), record_bytes.MESSAGE_HEAD + size), np.uint8)
    whole[:, : record_bytes.MESSAGE_HEAD] = heads.view(np.uint8).reshape(len(heads), -1)
    whole[:, record_bytes.MESSAGE_HEAD :] = np.frombuffer(b"".join(payloads), np.uint8).reshape(len(heads), size)
    return whole.reshape(-1)
