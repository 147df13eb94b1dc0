"""The records of a summary, held against the data section that they describe."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TypeVar

from tests.support.chunks import OpenChunk
from tests.support.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    Metadata,
    MetadataIndex,
    Record,
    Schema,
    Statistics,
)
from tests.support.sections import Sections

R = TypeVar("R", bound=Record)


def _only(kind: type[R], records: Iterable[Record]) -> Iterator[R]:
    return (record for record in records if isinstance(record, kind))


def problems(sections: Sections) -> Iterator[str]:
    """Every violation in what a summary says about the rest of its file."""
    yield from _repeated_schema_problems(sections)
    yield from _repeated_channel_problems(sections)
    yield from _statistics_problems(sections)
    yield from _chunk_index_problems(sections)
    yield from _attachment_index_problems(sections)
    yield from _metadata_index_problems(sections)


def _repeated_schema_problems(sections: Sections) -> Iterator[str]:
    defined = {record.id: record for record in _only(Schema, sections.contents())}
    repeated: dict[int, Schema] = {}
    for record in _only(Schema, sections.summary):
        yield from _copy_problems(record, defined.get(record.id), again=record.id in repeated)
        repeated[record.id] = record
    for missing in defined.keys() - repeated.keys():
        yield f"{defined[missing].where} (schema {missing}) is not repeated in the summary."


def _repeated_channel_problems(sections: Sections) -> Iterator[str]:
    defined = {record.id: record for record in _only(Channel, sections.contents())}
    repeated: dict[int, Channel] = {}
    schemas: set[int] = {0}
    for record in sections.summary:
        if isinstance(record, Schema):
            schemas.add(record.id)
        elif isinstance(record, Channel):
            if record.schema_id not in schemas:
                yield f"{record.where} comes before its schema {record.schema_id} in the summary."
            yield from _copy_problems(record, defined.get(record.id), again=record.id in repeated)
            repeated[record.id] = record
    for missing in defined.keys() - repeated.keys():
        yield f"{defined[missing].where} (channel {missing}) is not repeated in the summary."


def _copy_problems(copy: Record, original: Record | None, *, again: bool) -> Iterator[str]:
    if again:
        yield f"{copy.where} is in the summary twice."
    if original is None:
        yield f"{copy.where} is in the summary, but not in the data section."
    elif copy.content != original.content:
        yield f"{copy.where} differs from the {original.where} that it repeats."


def _statistics_problems(sections: Sections) -> Iterator[str]:
    found = list(_only(Statistics, sections.summary))
    if not found:
        yield f"The summary up to byte {len(sections.data)} has no Statistics."
        return
    for extra in found[1:]:
        yield f"{extra.where} is one Statistics too many."
    statistics, actual = found[0], _counted(sections)
    for name, value in actual.items():
        if getattr(statistics, name) != value:
            yield f"{statistics.where} has {name} {getattr(statistics, name)}, but the file has {value}."
    yield from _channel_count_problems(statistics, sections)
    for channel in _only(Channel, sections.summary):
        if channel.offset > statistics.offset:
            yield f"{channel.where} comes after the Statistics at byte {statistics.offset}; channels come before."


def _counted(sections: Sections) -> dict[str, int]:
    contents = list(sections.contents())
    times = [message.log_time for message in _only(Message, contents)]
    return {
        "message_count": len(times),
        "schema_count": len({schema.id for schema in _only(Schema, contents)} - {0}),
        "channel_count": len({channel.id for channel in _only(Channel, contents)}),
        "attachment_count": len(list(_only(Attachment, contents))),
        "metadata_count": len(list(_only(Metadata, contents))),
        "chunk_count": len(sections.chunks),
        "message_start_time": min(times, default=0),
        "message_end_time": max(times, default=0),
    }


def _channel_count_problems(statistics: Statistics, sections: Sections) -> Iterator[str]:
    """A channel without messages may be counted as 0 or be left out."""
    actual = Counter(message.channel_id for message in _only(Message, sections.contents()))
    stated = statistics.channel_message_counts
    for channel_id in sorted(actual.keys() | stated.keys()):
        if stated.get(channel_id, 0) != actual[channel_id]:
            yield (
                f"{statistics.where} counts {stated.get(channel_id, 0)} messages on channel {channel_id}, but the file has "
                f"{actual[channel_id]}."
            )


def _chunk_index_problems(sections: Sections) -> Iterator[str]:
    chunks = {opened.chunk.offset: opened for opened in sections.chunks}
    indexed: set[int] = set()
    for index in _only(ChunkIndex, sections.summary):
        if index.chunk_start_offset not in chunks:
            yield f"{index.where} points to byte {index.chunk_start_offset}, where no chunk starts."
        elif index.chunk_start_offset in indexed:
            yield f"{index.where} is a second index of the chunk at byte {index.chunk_start_offset}."
        else:
            yield from _field_problems(index, _expected_chunk_index(chunks[index.chunk_start_offset]))
        indexed.add(index.chunk_start_offset)
    for offset in sorted(chunks.keys() - indexed):
        yield f"Chunk at byte {offset} has no chunk index."


def _expected_chunk_index(opened: OpenChunk) -> dict[str, object]:
    chunk: Chunk = opened.chunk
    return {
        "message_start_time": chunk.message_start_time,
        "message_end_time": chunk.message_end_time,
        "chunk_length": chunk.size,
        "message_index_offsets": {index.channel_id: index.offset for index in opened.indexes},
        "message_index_length": sum(index.size for index in opened.indexes),
        "compression": chunk.compression,
        "compressed_size": len(chunk.data),
        "uncompressed_size": chunk.uncompressed_size,
    }


def _attachment_index_problems(sections: Sections) -> Iterator[str]:
    attachments = {record.offset: record for record in _only(Attachment, sections.body)}
    indexed: set[int] = set()
    for index in _only(AttachmentIndex, sections.summary):
        target = attachments.get(index.attachment_offset)
        if target is None:
            yield f"{index.where} points to byte {index.attachment_offset}, where no attachment starts."
        elif index.attachment_offset in indexed:
            yield f"{index.where} is a second index of the attachment at byte {target.offset}."
        else:
            yield from _field_problems(index, _expected_attachment_index(target))
        indexed.add(index.attachment_offset)
    for offset in sorted(attachments.keys() - indexed):
        yield f"Attachment at byte {offset} has no attachment index."


def _expected_attachment_index(attachment: Attachment) -> dict[str, object]:
    return {
        "attachment_length": attachment.size,
        "log_time": attachment.log_time,
        "create_time": attachment.create_time,
        "data_size": len(attachment.data),
        "name": attachment.name,
        "media_type": attachment.media_type,
    }


def _metadata_index_problems(sections: Sections) -> Iterator[str]:
    records = {record.offset: record for record in _only(Metadata, sections.body)}
    indexed: set[int] = set()
    for index in _only(MetadataIndex, sections.summary):
        target = records.get(index.metadata_offset)
        if target is None:
            yield f"{index.where} points to byte {index.metadata_offset}, where no metadata starts."
        elif index.metadata_offset in indexed:
            yield f"{index.where} is a second index of the metadata at byte {target.offset}."
        else:
            yield from _field_problems(index, {"metadata_length": target.size, "name": target.name})
        indexed.add(index.metadata_offset)
    for offset in sorted(records.keys() - indexed):
        yield f"Metadata at byte {offset} has no metadata index."


def _field_problems(record: Record, expected: dict[str, object]) -> Iterator[str]:
    for name, value in expected.items():
        if getattr(record, name) != value:
            yield f"{record.where} has {name} {getattr(record, name)!r}, but its target has {value!r}."
