"""Chunks are uncompressed within limits, checked, and cut into messages through their index."""

import struct
import zlib

import lz4.frame
import numpy as np
import pytest
import zstandard

from ml_dash_mcap.errors import DamagedFileError
from ml_dash_mcap.mcap import chunk_bytes, chunk_messages
from ml_dash_mcap.mcap.limits import DEFAULT, Limits
from ml_dash_mcap.mcap.message_records import MessageIndex
from ml_dash_mcap.mcap.records import LOOSE, Chunk


def message(channel_id: int, time_ns: int, payload: bytes) -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + len(payload), channel_id, 9, time_ns, time_ns) + payload


RAW = message(1, 10, b"{}") + message(2, 20, b"[1]") + message(1, 30, b'{"a":1}')


def record(
    packed: bytes, compression: str, *, size: int = len(RAW), crc: int = zlib.crc32(RAW), length: int | None = None
) -> bytes:
    name = compression.encode()
    content = struct.pack("<QQQI", 10, 30, size, crc)
    content += struct.pack("<I", len(name)) + name
    content += struct.pack("<Q", len(packed) if length is None else length) + packed
    return struct.pack("<BQ", 6, len(content)) + content


def entry(compression: str = "", packed: int = len(RAW), size: int = len(RAW)) -> Chunk:
    return Chunk(0, 0, 10, 30, compression, packed, size)


def unpack(packed: bytes, compression: str, limits: Limits = DEFAULT, *, size: int = len(RAW), **how: int) -> bytes:
    """Unpack a chunk with an index that agrees with it."""
    data = record(packed, compression, size=size, **how)
    return chunk_bytes.unpack(data, entry(compression, len(packed), size), "file.mcap", limits)


@pytest.mark.parametrize(
    ("compression", "packed"),
    [("", RAW), ("zstd", zstandard.compress(RAW)), ("lz4", lz4.frame.compress(RAW))],
)
def test_every_compression_of_the_specification_is_unpacked(compression, packed):
    assert unpack(packed, compression) == RAW


def test_zstd_without_a_content_size_is_unpacked():
    packed = zstandard.ZstdCompressor(write_content_size=False).compress(RAW)
    assert unpack(packed, "zstd") == RAW


def test_a_checksum_of_0_means_that_there_is_none():
    assert unpack(RAW, "", crc=0) == RAW


def test_messages_outside_chunks_are_taken_as_they_are():
    assert chunk_bytes.unpack(RAW, entry(LOOSE), "file.mcap", DEFAULT) == RAW


@pytest.mark.parametrize(
    ("packed", "compression", "how", "what"),
    [
        (RAW, "", {"crc": 1}, "checksum"),
        (RAW, "", {"size": 5}, "announces 5 bytes"),
        (RAW, "brotli", {}, "unknown compression 'brotli'"),
        (b"nonsense", "zstd", {}, "cannot be uncompressed"),
        (b"nonsense", "lz4", {}, "cannot be uncompressed"),
        (RAW, "", {"length": 3}, "a chunk of 3 bytes that announces"),
        (RAW, "", {"length": 2**64 - 1}, "content is longer than its record"),
    ],
)
def test_a_chunk_that_contradicts_itself_is_refused(packed, compression, how, what):
    with pytest.raises(DamagedFileError, match=what):
        unpack(packed, compression, **how)


@pytest.mark.parametrize("data", [record(RAW, "")[:-1], b""])
def test_what_is_no_chunk_is_refused(data):
    with pytest.raises(DamagedFileError, match="none does"):
        chunk_bytes.unpack(data, entry(), "file.mcap", DEFAULT)


@pytest.mark.parametrize("index", [entry("zstd"), entry(size=5), entry(packed=5)])
def test_a_chunk_counts_more_than_its_index_and_what_that_says_wrongly_is_noted(index):
    notes: list[str] = []
    assert chunk_bytes.unpack(record(RAW, ""), index, "file.mcap", DEFAULT, notes.append) == RAW
    assert len(notes) == 1


def test_a_chunk_whose_index_makes_it_small_is_held_against_the_limits_all_the_same():
    large = record(RAW, "", size=2 * 1024**3)
    with pytest.raises(DamagedFileError, match="limit"):
        chunk_bytes.unpack(large, entry(), "file.mcap", DEFAULT)


@pytest.mark.parametrize(
    ("compression", "packed"),
    [
        ("zstd", zstandard.compress(bytes(100_000_000))),
        ("zstd", zstandard.ZstdCompressor(write_content_size=False).compress(bytes(100_000_000))),
        ("lz4", lz4.frame.compress(bytes(100_000_000))),
    ],
)
def test_a_bomb_that_hides_its_size_is_refused_without_unpacking_it(compression, packed):
    with pytest.raises(DamagedFileError):
        unpack(packed, compression)


@pytest.mark.parametrize(
    ("compression", "packed"),
    [("zstd", zstandard.compress(bytes(100_000_000))), ("lz4", lz4.frame.compress(bytes(100_000_000)))],
)
def test_a_bomb_that_admits_its_size_is_refused_by_the_ratio(compression, packed):
    with pytest.raises(DamagedFileError, match="the limit is 200 times"):
        unpack(packed, compression, size=100_000_000)


def test_a_black_picture_is_no_bomb():
    picture = bytes(3840 * 2160 * 4)
    assert unpack(zstandard.compress(picture), "zstd", size=len(picture), crc=zlib.crc32(picture)) == picture


def test_a_chunk_beyond_the_limit_is_refused():
    with pytest.raises(DamagedFileError, match="the limit is 10"):
        unpack(RAW, "", Limits(chunk_bytes=10))


def test_a_chunk_is_refused_by_what_the_index_announces_before_it_is_read():
    with pytest.raises(DamagedFileError, match="the limit is"):
        chunk_bytes.check_size(entry(size=2**63), "file.mcap", DEFAULT)


def test_scanning_finds_the_messages_of_every_channel():
    found = chunk_messages.scan(RAW, entry(), "file.mcap")
    assert {channel: index.times_ns.tolist() for channel, index in found.indexes.items()} == {1: [10, 30], 2: [20]}
    assert found.counts == {1: 2, 2: 1}


def test_gathering_cuts_out_what_the_index_points_to():
    index = chunk_messages.scan(RAW, entry(), "file.mcap").indexes[1]
    found = chunk_messages.gather(RAW, index, entry(), "file.mcap")
    assert found.payloads == [b"{}", b'{"a":1}']
    assert found.times_ns.tolist() == found.published_ns.tolist() == [10, 30]
    assert found.sequences.tolist() == [9, 9]


@pytest.mark.parametrize(
    ("channel", "time", "offset"), [(2, 10, 0), (1, 11, 0), (1, 10, 1), (1, 10, 10_000), (1, 10, 2**63)]
)
def test_an_index_that_points_elsewhere_is_refused(channel, time, offset):
    index = MessageIndex(channel, np.array([time], np.uint64), np.array([offset], np.uint64))
    with pytest.raises(DamagedFileError, match="message index"):
        chunk_messages.gather(RAW, index, entry(), "file.mcap")


def test_a_message_whose_length_leaves_the_chunk_is_refused():
    data = struct.pack("<BQHIQQ", 5, 2**63, 1, 0, 10, 10)
    index = MessageIndex(1, np.array([10], np.uint64), np.array([0], np.uint64))
    with pytest.raises(DamagedFileError, match="message index"):
        chunk_messages.gather(data, index, entry(), "file.mcap")


def test_an_index_that_points_to_one_message_twice_is_refused():
    index = MessageIndex(1, np.array([10, 10], np.uint64), np.array([0, 0], np.uint64))
    with pytest.raises(DamagedFileError, match="message index"):
        chunk_messages.gather(RAW, index, entry(), "file.mcap")


def test_messages_that_lie_in_each_other_are_refused():
    inner = message(1, 20, b"")
    data = message(1, 10, inner)
    index = MessageIndex(1, np.array([20, 10], np.uint64), np.array([31, 0], np.uint64))
    with pytest.raises(DamagedFileError, match="message index"):
        chunk_messages.gather(data, index, entry(), "file.mcap")


@pytest.mark.parametrize(("times", "within"), [([10, 30], True), ([10, 31], False), ([9, 30], False), ([], True)])
def test_messages_lie_within_their_chunks_time_or_not(times, within):
    index = MessageIndex(1, np.array(times, np.uint64), np.zeros(len(times), np.uint64))
    assert chunk_messages.are_within(index, entry()) is within


def test_both_ends_of_a_time_range_are_included():
    index = MessageIndex(1, np.array([10, 20, 30], np.uint64), np.array([0, 1, 2], np.uint64))
    assert chunk_messages.within(index, 10, 20).times_ns.tolist() == [10, 20]
