"""A finished file's index, from its footer and summary."""

from __future__ import annotations

from collections.abc import Iterator
from zlib import crc32

import numpy as np

from ..errors import DamagedFileError
from . import records
from .fields import Fields
from .index import FileIndex, Glance
from .limits import Limits
from .records import Footer, Header, Opcode
from .source import Source

_TAIL_BYTES = records.FOOTER_BYTES + len(records.MAGIC)

_SMALL_BYTES = 64 * 1024
"""A summary up to this size is read whole at once."""


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


def glance(source: Source, size: int, header: Header, found: Footer) -> Glance | None:
    """Read a long summary without its chunk indexes, so that opening a file costs the same however long it is.

    Returns:
        None where the summary is short, or does not say where its groups are: it is to be read as a whole.
    """
    start, end, groups_at = found.summary_start, size - _TAIL_BYTES, found.summary_offset_start
    if not 0 < start < groups_at <= end or end - start <= _SMALL_BYTES or end - groups_at > _SMALL_BYTES:
        return None
    try:
        groups = _groups(memoryview(source.read(groups_at, end - groups_at)), source.name, groups_at)
        wanted = [(at, length) for opcode, at, length in groups if opcode != Opcode.CHUNK_INDEX]
        if any(at < start or length > _SMALL_BYTES or at + length > groups_at for at, length in wanted):
            return None
        parts = [source.read(at, length) for at, length in wanted]
        index = _collect(memoryview(b"".join(parts)), source.name, header, start)
    except DamagedFileError:
        return None
    if index.statistics is None:
        return None
    return Glance(header, index.schemas, index.channels, index.metadata, index.attachments, index.statistics)


def _groups(data: memoryview, path: str, base: int) -> list[tuple[int, int, int]]:
    """Return the opcode, offset and length of each group of a summary."""
    return [
        (fields.raw(1)[0], fields.u64(), fields.u64())
        for opcode, _, fields in records.split(data, path, base)
        if opcode == Opcode.SUMMARY_OFFSET
    ]


def _collect(data: memoryview, path: str, header: Header, start: int) -> FileIndex:
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}
    chunks: list[records.Chunk] = []
    metadata: list[records.MetadataEntry] = []
    attachments: list[records.AttachmentEntry] = []
    statistics: records.Statistics | None = None
    for opcode, at, fields in _split(data, path, start, chunks):
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


def _split(data: memoryview, path: str, start: int, chunks: list[records.Chunk]) -> Iterator[tuple[int, int, Fields]]:
    """Walk a summary's records like `records.split`, but take runs of like chunk indexes at once into `chunks`."""
    at = 0
    while at < len(data):
        end = at + _take_run(data, at, start, chunks)
        if end == at:
            one = next(records.split(data[at:], path, start + at))
            yield one
            end = at + records.PREFIX_BYTES + records.prefix(data, at)[1]
        at = end


def _take_run(data: memoryview, at: int, summary_start: int, chunks: list[records.Chunk]) -> int:
    """Read the chunk indexes of one form that start here; returns how many bytes they take, 0 for none to speak of."""
    fixed = records.PREFIX_BYTES + 8 * 4 + 4
    if len(data) - at < fixed or data[at] != Opcode.CHUNK_INDEX:
        return 0
    channels, rest = divmod(int.from_bytes(data[at + fixed - 4 : at + fixed], "little"), 10)
    size = records.PREFIX_BYTES + records.prefix(data, at)[1]
    letters = size - fixed - 10 * channels - 8 - 4 - 8 - 8
    if rest or letters < 0 or len(data) - at < 2 * size:
        return 0
    form = np.dtype(
        [
            ("prefix", f"S{records.PREFIX_BYTES}"),
            ("times", "<u8", (2,)),
            ("place", "<u8", (2,)),
            ("map_bytes", "<u4"),
            ("map", np.dtype([("channel", "<u2"), ("offset", "<u8")]), (channels,)),
            ("index_bytes", "<u8"),
            ("letters", "<u4"),
            ("compression", np.uint8, (letters,)),
            ("sizes", "<u8", (2,)),
        ]
    )
    run = np.frombuffer(data, form, (len(data) - at) // size, at)
    alike = (run["prefix"] == run["prefix"][0]) & (run["map_bytes"] == 10 * channels) & (run["letters"] == letters)
    alike &= (run["compression"] == run["compression"][0]).all(axis=1)
    offset, length = run["place"].T
    sound = (offset >= len(records.MAGIC)) & (offset < summary_start) & (length < summary_start)
    sound &= run["index_bytes"] < summary_start
    ends = offset + length
    sound &= ends + run["index_bytes"] <= summary_start
    indexes = run["map"]["offset"]
    sound &= (indexes >= ends[:, None]).all(axis=1)
    sound &= (indexes + np.uint64(records.PREFIX_BYTES) <= (ends + run["index_bytes"])[:, None]).all(axis=1)
    good = alike & sound
    count = len(good) if good.all() else int(good.argmin())
    if count < 2:
        return 0
    run = run[:count]
    compression = bytes(run["compression"][0]).decode("utf-8", "replace")
    for (start_ns, end_ns), (place, bytes_), ids, places, index_bytes, (packed, unpacked) in zip(
        run["times"].tolist(),
        run["place"].tolist(),
        run["map"]["channel"].tolist(),
        run["map"]["offset"].tolist(),
        run["index_bytes"].tolist(),
        run["sizes"].tolist(),
        strict=True,
    ):
        chunks.append(
            records.Chunk(
                offset=place,
                length=bytes_,
                start_ns=start_ns,
                end_ns=end_ns,
                compression=compression,
                compressed_size=packed,
                uncompressed_size=unpacked,
                message_index_offsets=dict(zip(ids, places, strict=True)),
                message_index_length=index_bytes,
                indexed=channels > 0,
            )
        )
    return count * size


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
