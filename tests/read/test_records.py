"""Records are read from bytes as the specification lays them out, and never beyond where they end."""

import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.errors import DamagedFileError
from ml_dash_mcap.mcap import records
from ml_dash_mcap.mcap.record_fields import Fields


def fields(data: bytes) -> Fields:
    return Fields(data, "file.mcap")


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def test_a_channel_is_read_from_bytes_made_by_hand():
    data = (
        struct.pack("<HH", 7, 3) + text("robot") + text("json") + struct.pack("<I", 17) + text("kind") + text("track")
    )
    assert records.channel(fields(data)) == records.Channel(7, 3, "robot", "json", {"kind": "track"})


def test_a_schema_is_read_from_bytes_made_by_hand():
    data = struct.pack("<H", 3) + text("arm") + text("jsonschema") + struct.pack("<I", 2) + b"{}"
    assert records.schema(fields(data)) == records.Schema(3, "arm", "jsonschema", b"{}")


def test_a_chunk_index_is_read_from_bytes_made_by_hand():
    data = struct.pack("<QQQQ", 1, 2, 100, 50) + struct.pack("<IHQ", 10, 7, 150) + struct.pack("<Q", 40)
    data += text("zstd") + struct.pack("<QQ", 20, 90)
    assert records.chunk_index(fields(data)) == records.Chunk(
        offset=100,
        length=50,
        start_ns=1,
        end_ns=2,
        compression="zstd",
        compressed_size=20,
        uncompressed_size=90,
        message_index_offsets={7: 150},
        message_index_length=40,
    )


def test_a_message_index_is_read_as_two_arrays():
    read = records.message_index(fields(struct.pack("<HI", 7, 32) + struct.pack("<QQQQ", 10, 0, 20, 2**63)))
    assert (read.channel_id, read.times_ns.tolist(), read.offsets.tolist()) == (7, [10, 20], [0, 2**63])


def test_statistics_are_read_from_bytes_made_by_hand():
    data = struct.pack("<QHIIIIQQ", 5, 1, 1, 2, 3, 4, 10, 20) + struct.pack("<IHQ", 10, 7, 5)
    assert records.statistics(fields(data)) == records.Statistics(5, 1, 1, 4, 2, 3, 10, 20, {7: 5})


def test_a_text_that_is_longer_than_its_record_is_refused_with_the_place():
    with pytest.raises(DamagedFileError, match=r"file\.mcap, byte 4: a field of 4294967295 bytes"):
        fields(b"\xff\xff\xff\xff").text()


def test_a_text_that_is_not_utf_8_is_refused():
    with pytest.raises(DamagedFileError, match="not UTF-8"):
        fields(b"\x01\x00\x00\x00\xff").text()


def test_a_map_that_is_longer_than_its_record_is_refused():
    with pytest.raises(DamagedFileError, match="a map of 9 bytes"):
        fields(b"\x09\x00\x00\x00").texts()


@pytest.mark.parametrize("read", [Fields.numbers, Fields.texts])
def test_a_map_whose_last_entry_does_not_end_with_it_is_refused(read):
    with pytest.raises(DamagedFileError, match="behind it"):
        read(fields(struct.pack("<I", 5) + bytes(20)))


@pytest.mark.parametrize("read", [records.chunk_head, records.chunk_index])
def test_no_chunk_passes_itself_off_as_messages_outside_of_chunks(read):
    head = (
        struct.pack("<QQQI", 1, 2, 100, 0) if read is records.chunk_head else struct.pack("<QQQQIQ", 1, 2, 3, 4, 0, 5)
    )
    with pytest.raises(DamagedFileError, match="no chunk can have"):
        read(fields(head + text(records.LOOSE) + bytes(16)))


def test_a_record_that_ends_behind_its_section_is_refused():
    with pytest.raises(DamagedFileError, match="a record of 5 bytes where 2 are left"):
        records.one(struct.pack("<BQ", 5, 5) + b"ab", 0, "file.mcap", 0)


def test_records_that_do_not_end_where_the_section_ends_are_refused():
    with pytest.raises(DamagedFileError, match="a record of 5 bytes where 0 are left"):
        list(records.split(struct.pack("<BQ", 5, 5), "file.mcap", 0))


@given(st.binary(max_size=200))
def test_whatever_the_bytes_are_reading_them_gives_a_record_or_our_error(data):
    for read in (
        records.header,
        records.schema,
        records.channel,
        records.chunk_head,
        records.chunk_index,
        records.message_index,
        records.statistics,
        records.metadata,
        records.metadata_index,
        records.attachment_index,
        records.footer,
    ):
        with suppress(DamagedFileError):
            read(fields(data))
