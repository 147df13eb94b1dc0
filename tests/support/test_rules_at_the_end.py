"""The judge finds what is wrong with the end of a file: summary, offsets, footer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from tests.support.assemble import written
from tests.support.samples import CHANNEL, NOTE, SCHEMA, draft, found, swap, the


@pytest.mark.parametrize(
    ("kind", "change", "sentence"),
    [
        (Statistics, {"message_count": 5}, "has message_count 5, but the file has 4"),
        (Statistics, {"schema_count": 5}, "has schema_count 5, but the file has 1"),
        (Statistics, {"channel_count": 5}, "has channel_count 5, but the file has 1"),
        (Statistics, {"attachment_count": 5}, "has attachment_count 5, but the file has 1"),
        (Statistics, {"metadata_count": 5}, "has metadata_count 5, but the file has 1"),
        (Statistics, {"chunk_count": 5}, "has chunk_count 5, but the file has 2"),
        (Statistics, {"message_start_time": 5}, "has message_start_time 5, but the file has 10"),
        (Statistics, {"message_end_time": 5}, "has message_end_time 5, but the file has 30"),
        (Statistics, {"channel_message_counts": {1: 3}}, "counts 3 messages on channel 1, but the file has 4"),
        (Statistics, {"channel_message_counts": {1: 4, 2: 1}}, "counts 1 messages on channel 2, but the file has 0"),
        (ChunkIndex, {"message_start_time": 5}, "has message_start_time 5, but its target has 10"),
        (ChunkIndex, {"message_end_time": 5}, "has message_end_time 5, but its target has 20"),
        (ChunkIndex, {"chunk_start_offset": 9}, "points to byte 9, where no chunk starts"),
        (ChunkIndex, {"chunk_length": 5}, "has chunk_length 5"),
        (ChunkIndex, {"message_index_offsets": {1: 5}}, "has message_index_offsets {1: 5}"),
        (ChunkIndex, {"message_index_length": 5}, "has message_index_length 5"),
        (ChunkIndex, {"compression": "lz4"}, "has compression 'lz4', but its target has ''"),
        (ChunkIndex, {"compressed_size": 5}, "has compressed_size 5"),
        (ChunkIndex, {"uncompressed_size": 5}, "has uncompressed_size 5"),
        (AttachmentIndex, {"offset": 9}, "points to byte 9, where no attachment starts"),
        (AttachmentIndex, {"length": 5}, "has attachment_length 5"),
        (AttachmentIndex, {"log_time": 6}, "has log_time 6, but its target has 5"),
        (AttachmentIndex, {"create_time": 6}, "has create_time 6, but its target has 0"),
        (AttachmentIndex, {"data_size": 5}, "has data_size 5, but its target has 3"),
        (AttachmentIndex, {"name": "b"}, "has name 'b', but its target has 'a.txt'"),
        (AttachmentIndex, {"media_type": "b"}, "has media_type 'b'"),
        (MetadataIndex, {"offset": 9}, "points to byte 9, where no metadata starts"),
        (MetadataIndex, {"length": 5}, "has metadata_length 5"),
        (MetadataIndex, {"name": "b"}, "has name 'b', but its target has 'ml_dash'"),
        (Schema, {"name": "leg"}, "differs from the Schema at byte 0 in the chunk at byte"),
        (Channel, {"metadata": {"a": "b"}}, "differs from the Channel at byte"),
        (Channel, {"id": 2}, "is in the summary, but not in the data section"),
    ],
)
def test_a_wrong_field_in_the_summary_is_found(
    tmp_path: Path, kind: type[McapRecord], change: dict[str, object], sentence: str
) -> None:
    file = draft().summarise()
    record = the(kind, file.summary)
    swap(file.summary, record, replace(record, **change))
    assert any(sentence in problem for problem in found(tmp_path, file))


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        (Schema, "is in the summary twice"),
        (Channel, "is in the summary twice"),
        (Statistics, "is one Statistics too many"),
        (ChunkIndex, "is a second index of the chunk"),
        (AttachmentIndex, "is a second index of the attachment"),
        (MetadataIndex, "is a second index of the metadata"),
    ],
)
def test_a_record_twice_in_the_summary_is_found(tmp_path: Path, kind: type[McapRecord], sentence: str) -> None:
    file = draft().summarise()
    record = the(kind, file.summary)
    swap(file.summary, record, record, record)
    [problem] = found(tmp_path, file)
    assert sentence in problem


def test_a_record_apart_from_its_group_is_found(tmp_path: Path) -> None:
    file = draft().summarise()
    index = the(ChunkIndex, file.summary)
    file.summary.remove(index)
    file.summary.append(index)
    assert any("stands apart from its group" in problem for problem in found(tmp_path, file))


def test_a_channel_before_its_schema_or_after_the_statistics_is_found(tmp_path: Path) -> None:
    file = draft().summarise()
    file.summary[0:3] = [CHANNEL, the(Statistics, file.summary), SCHEMA]
    assert "comes before its schema 1" in found(tmp_path, file)[0]
    file.summary[0:3] = [SCHEMA, the(Statistics, file.summary), CHANNEL]
    [problem] = found(tmp_path, file)
    assert "comes after the Statistics" in problem


def test_summary_offsets_that_are_wrong_missing_double_or_of_empty_groups_are_found(tmp_path: Path) -> None:
    file = draft().summarise().locate()
    schemas, channels, statistics, *others = file.offsets
    empty = SummaryOffset(Opcode.HEADER, schemas.group_start, 0)
    file.offsets = [replace(schemas, group_length=schemas.group_length + 1), statistics, statistics, empty, *others]
    listed = "\n".join(found(tmp_path, file.close().bytes()))
    assert f"for the group 0x03, which is at bytes {schemas.group_start} to {channels.group_start}" in listed
    assert f"The group 0x04 at byte {channels.group_start} has no summary offset" in listed
    assert "is a second offset of the group 0x0b" in listed
    assert "is for the group 0x01, which is empty" in listed


def test_a_record_after_the_summary_offsets_or_foreign_to_the_summary_is_found(tmp_path: Path) -> None:
    file = draft().summarise()
    misplaced = written([SummaryOffset(Opcode.SCHEMA, len(file.front), len(written([SCHEMA]))), NOTE, SCHEMA])
    whole = file.finish()
    listed = "\n".join(found(tmp_path, whole.replace(written([file.footer]), misplaced + written([file.footer]))))
    assert "Metadata at byte" in listed
    assert "is not allowed in the summary" in listed
    assert "follows a SummaryOffset" in listed


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"summary_start": 0}, "has summary_start 0, but the DataEnd ends at byte"),
        ({"summary_offset_start": 0}, "has summary_offset_start 0, but the first SummaryOffset is at byte"),
        ({"summary_crc": 0}, "has no summary CRC"),
        ({"summary_crc": 1}, "has the summary CRC 0x00000001"),
    ],
)
def test_a_wrong_field_of_the_footer_is_found(tmp_path: Path, change: dict[str, int], sentence: str) -> None:
    file = draft().summarise().locate().close()
    file.footer = replace(file.footer, **change)
    assert any(sentence in problem for problem in found(tmp_path, file.bytes()))


@pytest.mark.parametrize(
    ("data_end", "sentence"),
    [
        ([], "has no DataEnd"),
        ([DataEnd(0), DataEnd(0)], "(opcode 0x0f) is not allowed in the summary"),
        ([DataEnd(0), NOTE], "has summary_start"),
        ([DataEnd(1)], "has the CRC 0x00000001, but the data section has"),
    ],
)
def test_a_wrong_end_of_the_data_section_is_found(tmp_path: Path, data_end: list[McapRecord], sentence: str) -> None:
    file = draft().summarise()
    file.data_end = data_end
    assert any(sentence in problem for problem in found(tmp_path, file))


def test_a_file_with_trailing_bytes_or_without_its_last_magic_is_found(tmp_path: Path) -> None:
    whole = draft().summarise().finish()
    assert found(tmp_path, whole + b"\0\0") == [f"The file has 2 trailing bytes after its end at byte {len(whole)}."]
    assert found(tmp_path, whole[:-3]) == [f"The magic is missing at byte {len(whole) - 8}, after the Footer."]
