"""A finished file cut into header, data section, summary, summary offsets and footer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from tests.support.chunks import OpenChunk, open_chunk
from tests.support.records import (
    MAGIC,
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MalformedError,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Record,
    Schema,
    Statistics,
    SummaryOffset,
    Unreadable,
    walk,
)

PRIVATE_OPCODES = range(0x80, 0x100)
"""Left to applications by the specification; readers skip them."""

IN_DATA = (Schema, Channel, Message, Chunk, MessageIndex, Attachment, Metadata)
IN_SUMMARY = (Schema, Channel, Statistics, ChunkIndex, AttachmentIndex, MetadataIndex)


@dataclass(slots=True)
class Sections:
    """The records of a file by the section that they stand in."""

    data: bytes
    """The whole file."""
    header: Header | None = None
    body: list[Record] = field(default_factory=list)
    """The data section without its DataEnd."""
    chunks: list[OpenChunk] = field(default_factory=list)
    data_end: DataEnd | None = None
    summary: list[Record] = field(default_factory=list)
    offsets: list[SummaryOffset] = field(default_factory=list)
    footer: Footer | None = None
    faults: list[str] = field(default_factory=list)
    """What is missing, out of place or unreadable."""

    def contents(self) -> Iterator[Record]:
        """The data section in the order of the file, each chunk followed by the records in it."""
        opened = {chunk.chunk.offset: chunk.records for chunk in self.chunks}
        for record in self.body:
            yield record
            if isinstance(record, Chunk):
                yield from opened[record.offset]


def cut(data: bytes) -> Sections:
    """Walk a file and put each of its records where it belongs."""
    sections = Sections(data)
    if not data.startswith(MAGIC):
        sections.faults.append(f"The file starts with {data[: len(MAGIC)]!r} at byte 0, not with the magic {MAGIC!r}.")
        return sections
    try:
        for record in walk(data, start=len(MAGIC)):
            _place(sections, record)
    except MalformedError as error:
        sections.faults.append(f"The file is cut off or damaged: {error}.")
    sections.faults.extend(_end_faults(sections))
    _open_chunks(sections)
    return sections


def _place(sections: Sections, record: Record) -> None:
    if isinstance(record, Unreadable):
        sections.faults.append(f"{record.where} {record.reason}.")
    elif record.offset == len(MAGIC):
        _place_first(sections, record)
    elif isinstance(record, Footer):
        sections.footer = record
    elif record.opcode in PRIVATE_OPCODES:
        return
    elif sections.data_end is None:
        _place_in_data(sections, record)
    else:
        _place_in_summary(sections, record)


def _place_first(sections: Sections, record: Record) -> None:
    if isinstance(record, Header):
        sections.header = record
    else:
        sections.faults.append(f"{record.where} is the first record, where the Header should be.")


def _place_in_data(sections: Sections, record: Record) -> None:
    if isinstance(record, DataEnd):
        sections.data_end = record
    elif isinstance(record, IN_DATA):
        sections.body.append(record)
    else:
        sections.faults.append(f"{record.where} (opcode {record.opcode:#04x}) is not allowed in the data section.")


def _place_in_summary(sections: Sections, record: Record) -> None:
    if isinstance(record, SummaryOffset):
        sections.offsets.append(record)
    elif isinstance(record, IN_SUMMARY):
        sections.summary.append(record)
        if sections.offsets:
            sections.faults.append(f"{record.where} follows a SummaryOffset; summary offsets come last.")
    else:
        sections.faults.append(f"{record.where} (opcode {record.opcode:#04x}) is not allowed in the summary.")


def _end_faults(sections: Sections) -> Iterator[str]:
    size = len(sections.data)
    if sections.data_end is None:
        yield f"The file has no DataEnd up to its last byte, {size}."
    if sections.footer is None:
        yield f"The file has no Footer up to its last byte, {size}."
        return
    end = sections.footer.end
    if sections.data[end : end + len(MAGIC)] != MAGIC:
        yield f"The magic is missing at byte {end}, after the Footer."
    elif size > end + len(MAGIC):
        yield f"The file has {size - end - len(MAGIC)} trailing bytes after its end at byte {end + len(MAGIC)}."


def _open_chunks(sections: Sections) -> None:
    """Open each chunk together with the run of message indexes directly after it."""
    runs: dict[int, list[MessageIndex]] = {}
    chunk: Chunk | None = None
    for record in sections.body:
        if isinstance(record, Chunk):
            chunk = record
            runs[chunk.offset] = []
        elif not isinstance(record, MessageIndex):
            chunk = None
        elif chunk is None:
            sections.faults.append(f"{record.where} does not follow a chunk.")
        else:
            runs[chunk.offset].append(record)
    sections.chunks = [open_chunk(record, runs[record.offset]) for record in sections.body if isinstance(record, Chunk)]
