"""Records are read from bytes as the specification lays them out, and never beyond where they end."""

import struct
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.errors import DamagedFileError
from ml_dash_mcap.mcap import records
from ml_dash_mcap.mcap.message_records import (
    index_entries,
    message,
    message_heads,
    pack_message_index,
    read_message_index,
)
from ml_dash_mcap.mcap.record_layout import Fields, RecordLayout, record_at, split_records


def fields(data: bytes) -> Fields:
    return Fields(data, "file.mcap")


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


GOLDEN: list[tuple[RecordLayout[Any], Any, int, bytes]] = [
    (records.HEADER, records.Header("ros2", "tool"), 0x01, text("ros2") + text("tool")),
    (records.FOOTER, records.Footer(100, 0, 7), 0x02, struct.pack("<QQI", 100, 0, 7)),
    (
        records.SCHEMA,
        records.Schema(3, "arm", "protobuf", b"\x00{}"),
        0x03,
        struct.pack("<H", 3) + text("arm") + text("protobuf") + struct.pack("<I", 3) + b"\x00{}",
    ),
    (
        records.CHANNEL,
        records.Channel(7, 3, "robot", "json", {"kind": "track"}),
        0x04,
        struct.pack("<HH", 7, 3) + text("robot") + text("json") + struct.pack("<I", 17) + text("kind") + text("track"),
    ),
    (
        records.CHUNK_HEAD,
        records.ChunkHead(1, 2, 90, 5, "lz4", 20),
        0x06,
        struct.pack("<QQQI", 1, 2, 90, 5) + text("lz4") + struct.pack("<Q", 20),
    ),
    (
        records.CHUNK_INDEX,
        records.Chunk(
            offset=100,
            length=50,
            start_ns=1,
            end_ns=2,
            compression="zstd",
            compressed_size=20,
            uncompressed_size=90,
            message_index_offsets={7: 150},
            message_index_length=40,
        ),
        0x08,
        struct.pack("<QQQQ", 1, 2, 100, 50)
        + struct.pack("<IHQ", 10, 7, 150)
        + struct.pack("<Q", 40)
        + text("zstd")
        + struct.pack("<QQ", 20, 90),
    ),
    (
        records.ATTACHMENT_INDEX,
        records.AttachmentEntry("map.png", "image/png", 5, 4, 30, 100, 99),
        0x0A,
        struct.pack("<QQQQQ", 100, 99, 5, 4, 30) + text("map.png") + text("image/png"),
    ),
    (
        records.STATISTICS,
        records.Statistics(5, 1, 1, 4, 2, 3, 10, 20, {7: 5}),
        0x0B,
        struct.pack("<QHIIIIQQ", 5, 1, 1, 2, 3, 4, 10, 20) + struct.pack("<IHQ", 10, 7, 5),
    ),
    (
        records.METADATA,
        records.Metadata("about", {"a": "b", "": "\u00e9"}),
        0x0C,
        text("about") + struct.pack("<I", 20) + text("a") + text("b") + text("") + text("\u00e9"),
    ),
    (
        records.METADATA_INDEX,
        records.MetadataEntry("about", 100, 50),
        0x0D,
        struct.pack("<QQ", 100, 50) + text("about"),
    ),
    (records.SUMMARY_OFFSET, records.SummaryOffset(4, 100, 50), 0x0E, struct.pack("<BQQ", 4, 100, 50)),
    (records.DATA_END, records.DataEnd(9), 0x0F, struct.pack("<I", 9)),
    (records.BLOCK_END, records.BlockEnd(12), 0x8B, struct.pack("<Q", 12)),
]
"""A value of each kind of record, its opcode, and its content as the specification lays it out, written by hand."""


@pytest.mark.parametrize(("layout", "record", "opcode", "content"), GOLDEN, ids=lambda value: type(value).__name__)
def test_each_record_is_read_from_and_written_as_bytes_made_by_hand(layout, record, opcode, content):
    assert layout.read(fields(content)) == record
    assert layout.pack(record) == struct.pack("<BQ", opcode, len(content)) + content


@pytest.mark.parametrize(("layout", "record", "opcode", "content"), GOLDEN, ids=lambda value: type(value).__name__)
def test_fields_that_a_later_version_adds_at_the_end_do_not_matter(layout, record, opcode, content):
    assert layout.read(fields(content + b"more")) == record


def test_the_head_of_an_attachment_is_read_from_and_written_as_bytes_made_by_hand():
    content = struct.pack("<QQ", 5, 4) + text("map.png") + text("image/png") + struct.pack("<Q", 30)
    entry = records.AttachmentEntry("map.png", "image/png", 5, 4, 30, 100, 99)
    assert records.ATTACHMENT_HEAD.read(fields(content), offset=100, length=99) == entry
    assert records.ATTACHMENT_HEAD.content(entry) == content


def test_a_message_is_written_as_bytes_made_by_hand():
    expected = struct.pack("<BQHIQQ", 0x05, 22 + 2, 7, 0, 10, 10) + b"{}"
    assert message(7, 10, b"{}") == expected
    heads = message_heads(np.array([2, 3]), np.array([7, 8]), np.array([10, 11], np.uint64))
    assert heads[0].tobytes() + b"{}" == expected
    assert heads[1].tobytes() == struct.pack("<BQHIQQ", 0x05, 22 + 3, 8, 0, 11, 11)


def test_a_message_index_is_written_as_bytes_made_by_hand():
    expected = struct.pack("<BQHI", 0x07, 38, 7, 32) + struct.pack("<QQQQ", 10, 0, 20, 2**63)
    assert pack_message_index(7, index_entries(np.array([10, 20]), np.array([0, 2**63], np.uint64))) == expected


def test_a_file_starts_with_the_magic_bytes_and_its_header():
    expected = b"\x89MCAP0\r\n" + struct.pack("<BQ", 0x01, 12) + text("") + text("tool")
    assert records.file_start("tool") == expected


def test_a_message_index_is_read_as_two_arrays():
    read = read_message_index(fields(struct.pack("<HI", 7, 32) + struct.pack("<QQQQ", 10, 0, 20, 2**63)))
    assert (read.channel_id, read.times_ns.tolist(), read.offsets.tolist()) == (7, [10, 20], [0, 2**63])


def test_a_text_that_is_longer_than_its_record_is_refused_with_the_place():
    with pytest.raises(DamagedFileError, match=r"file\.mcap, byte 4: a field of 4294967295 bytes"):
        fields(b"\xff\xff\xff\xff").text()


def test_a_text_that_is_not_utf_8_is_refused():
    with pytest.raises(DamagedFileError, match="not UTF-8"):
        fields(b"\x01\x00\x00\x00\xff").text()


def test_a_map_that_is_longer_than_its_record_is_refused():
    with pytest.raises(DamagedFileError, match="a map of 9 bytes"):
        fields(b"\x09\x00\x00\x00").text_map()


@pytest.mark.parametrize("read", [Fields.number_map, Fields.text_map])
def test_a_map_whose_last_entry_does_not_end_with_it_is_refused(read):
    with pytest.raises(DamagedFileError, match="behind it"):
        read(fields(struct.pack("<I", 5) + bytes(20)))


@pytest.mark.parametrize("read", [records.CHUNK_HEAD.read, records.CHUNK_INDEX.read])
def test_no_chunk_passes_itself_off_as_messages_outside_of_chunks(read):
    head = (
        struct.pack("<QQQI", 1, 2, 100, 0)
        if read == records.CHUNK_HEAD.read
        else struct.pack("<QQQQIQ", 1, 2, 3, 4, 0, 5)
    )
    with pytest.raises(DamagedFileError, match="no chunk can have"):
        read(fields(head + text(records.LOOSE) + bytes(16)))


def test_a_record_that_ends_behind_its_section_is_refused():
    with pytest.raises(DamagedFileError, match="a record of 5 bytes where 2 are left"):
        record_at(struct.pack("<BQ", 5, 5) + b"ab", 0, "file.mcap", 0)


def test_records_that_do_not_end_where_the_section_ends_are_refused():
    with pytest.raises(DamagedFileError, match="a record of 5 bytes where 0 are left"):
        list(split_records(struct.pack("<BQ", 5, 5), "file.mcap", 0))


@given(st.binary(max_size=200))
def test_whatever_the_bytes_are_reading_them_gives_a_record_or_our_error(data):
    reads = [layout.read for layout, *_ in GOLDEN]
    for read in (*reads, read_message_index):
        with suppress(DamagedFileError):
            read(fields(data))
