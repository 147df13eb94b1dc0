"""A finished file's index, from its footer and summary."""

from __future__ import annotations

from zlib import crc32

from ..errors import DamagedFileError
from . import records
from .fields import Fields
from .index import FileIndex
from .limits import Limits
from .records import Footer, Header, Opcode
from .source import Source

_TAIL_BYTES = records.FOOTER_BYTES + len(records.MAGIC)


def footer(source: Source, size: int) -> Footer | None:
    """Return a file's footer, or None if the file has no end: it is being recorded, or was cut."""
    if size < _TAIL_BYTES + len(records.MAGIC):
        return None
    start = size - _TAIL_BYTES
    tail = source.read(start, _TAIL_BYTES)
    if len(tail) < _TAIL_BYTES or not tail.endswith(records.MAGIC):
        return None
    opcode, length = records.prefix(tail, 0)
    if opcode != Opcode.FOOTER or length != records.FOOTER_BYTES - records.PREFIX_BYTES:
        return None
    return records.footer(Fields(tail, source.name, start, records.PREFIX_BYTES))


def read(source: Source, size: int, header: Header, found: Footer, limits: Limits) -> FileIndex | None:
    """Build the index from the summary.

    Returns:
        None where the summary does not say enough to find every message, channel and metadata record.

    Raises:
        DamagedFileError: The summary contradicts itself.
    """
    start, end = found.summary_start, size - _TAIL_BYTES
    if start == 0 or not 0 < end - start <= limits.summary_bytes:
        return None
    data = source.read(start, size - len(records.MAGIC) - start)
    if len(data) != end + records.FOOTER_BYTES - start:
        raise DamagedFileError(source.name, start, "the file was cut while its summary was read")
    if found.summary_crc and crc32(data[:-4]) != found.summary_crc:
        raise DamagedFileError(source.name, start, "a summary whose checksum (CRC-32) does not match its content")
    index = _collect(memoryview(data)[: end - start], source.name, header, start)
    return index if _is_sufficient(index) else None


def _collect(data: memoryview, path: str, header: Header, start: int) -> FileIndex:
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}
    chunks: list[records.Chunk] = []
    metadata: list[records.MetadataEntry] = []
    attachments: list[records.AttachmentEntry] = []
    statistics: records.Statistics | None = None
    for opcode, at, fields in records.split(data, path, start):
        if opcode == Opcode.SCHEMA:
            schema = records.schema(fields)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = records.channel(fields)
            channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            chunk = records.chunk_index(fields)
            _check(chunk, path, at, start)
            chunks.append(chunk)
        elif opcode == Opcode.METADATA_INDEX:
            metadata.append(records.metadata_index(fields))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            attachments.append(records.attachment_index(fields))
        elif opcode == Opcode.STATISTICS:
            statistics = records.statistics(fields)
    return FileIndex(
        path=path,
        header=header,
        schemas=schemas,
        channels=channels,
        chunks=tuple(sorted(chunks, key=lambda chunk: chunk.offset)),
        message_counts=statistics.channel_message_counts if statistics is not None else {},
        metadata=tuple(sorted(metadata, key=lambda entry: entry.offset)),
        attachments=tuple(attachments),
        finished=True,
        end=start,
        statistics=statistics,
    )


def _check(chunk: records.Chunk, path: str, at: int, summary_start: int) -> None:
    if not (len(records.MAGIC) <= chunk.offset and chunk.end + chunk.message_index_length <= summary_start):
        raise DamagedFileError(path, at, "a chunk index that points outside the data section")
    for offset in chunk.message_index_offsets.values():
        if not chunk.end <= offset <= chunk.end + chunk.message_index_length - records.PREFIX_BYTES:
            raise DamagedFileError(path, at, "a chunk index whose message indexes do not lie behind the chunk")


def _is_sufficient(index: FileIndex) -> bool:
    statistics = index.statistics
    if statistics is None:
        return False
    if statistics.message_count != sum(statistics.channel_message_counts.values()):
        return False
    if statistics.message_count and not index.chunks:
        return False
    if statistics.chunk_count != len(index.chunks) or statistics.metadata_count != len(index.metadata):
        return False
    named = set(statistics.channel_message_counts)
    for chunk in index.chunks:
        named.update(chunk.message_index_offsets)
    return named <= set(index.channels) and {c.schema_id for c in index.channels.values()} <= {0, *index.schemas}
