"""A file that the container's writer makes is, byte for byte, the one that the specification lays out."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from ml_dash_mcap.mcap.chunk_writer import UNCOMPRESSED, build_block
from ml_dash_mcap.mcap.file_output import FileOutput, MemoryOutput
from ml_dash_mcap.mcap.file_writer import FileWriter
from ml_dash_mcap.mcap.message import Connection, MessageBlock
from ml_dash_mcap.mcap.records import AttachmentEntry

MAGIC = b"\x89MCAP0\r\n"


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def record(opcode: int, *fields: bytes) -> bytes:
    content = b"".join(fields)
    return struct.pack("<BQ", opcode, len(content)) + content


ATTACHMENT = record(
    0x09, struct.pack("<QQ", 7, 6), text("a.txt"), text("text/plain"), struct.pack("<Q", 2), b"hi", bytes(4)
)


def write(writer: FileWriter) -> None:
    """One of everything, with a schema that is not JSON."""
    writer.begin("tool", profile="ros2")
    writer.add_connection(1, Connection("/pose", "Pose", "ros2msg", b"float64 x\n", "cdr", (("k", "v"),)))
    one = np.array([1, 1])
    times = np.array([20, 10], np.uint64)
    block = MessageBlock(one, times, np.array([21, 11], np.uint64), np.array([5, 6], np.uint32), [b"ab", b"cde"])
    writer.add_chunk(build_block(block, UNCOMPRESSED))
    entry = AttachmentEntry("a.txt", "text/plain", 7, 6, 2, offset=0, length=0)
    writer.add_attachment([ATTACHMENT[:10], ATTACHMENT[10:]], entry)
    writer.add_metadata("about", {"a": "b"})
    writer.write_end()


def by_hand() -> bytes:
    schema = record(0x03, struct.pack("<H", 1), text("Pose"), text("ros2msg"), text("float64 x\n"))
    channel = record(
        0x04, struct.pack("<HH", 1, 1), text("/pose"), text("cdr"), struct.pack("<I", 10), text("k"), text("v")
    )
    messages = record(0x05, struct.pack("<HIQQ", 1, 5, 20, 21), b"ab")
    messages += record(0x05, struct.pack("<HIQQ", 1, 6, 10, 11), b"cde")
    chunk = record(
        0x06,
        struct.pack("<QQQI", 10, 20, len(messages), zlib.crc32(messages)),
        text(""),
        struct.pack("<Q", len(messages)),
        messages,
    )
    index = record(0x07, struct.pack("<HI", 1, 32), struct.pack("<QQQQ", 10, 33, 20, 0))
    metadata = record(0x0C, text("about"), struct.pack("<I", 10), text("a"), text("b"))
    data = MAGIC + record(0x01, text("ros2"), text("tool")) + schema + channel
    chunk_at, attachment_at = len(data), len(data + chunk + index)
    metadata_at = attachment_at + len(ATTACHMENT)
    data += chunk + index + ATTACHMENT + metadata + record(0x0F, bytes(4))
    groups = {
        0x03: schema,
        0x04: channel,
        0x0B: record(0x0B, struct.pack("<QHIIIIQQIHQ", 2, 1, 1, 1, 1, 1, 10, 20, 10, 1, 2)),
        0x08: record(
            0x08,
            struct.pack("<QQQQIHQQ", 10, 20, chunk_at, len(chunk), 10, 1, chunk_at + len(chunk), len(index)),
            text(""),
            struct.pack("<QQ", len(messages), len(messages)),
        ),
        0x0A: record(
            0x0A, struct.pack("<QQQQQ", attachment_at, len(ATTACHMENT), 7, 6, 2), text("a.txt"), text("text/plain")
        ),
        0x0D: record(0x0D, struct.pack("<QQ", metadata_at, len(metadata)), text("about")),
    }
    summary, offsets = b"", b""
    for opcode, group in groups.items():
        offsets += record(0x0E, struct.pack("<BQQ", opcode, len(data) + len(summary), len(group)))
        summary += group
    footer = struct.pack("<BQQQ", 0x02, 20, len(data), len(data) + len(summary))
    crc = zlib.crc32(summary + offsets + footer)
    return data + summary + offsets + footer + struct.pack("<I", crc) + MAGIC


def test_a_file_with_one_of_everything_is_the_bytes_that_are_laid_out_by_hand():
    writer = FileWriter(MemoryOutput())
    write(writer)
    assert writer.output.data() == by_hand()


def test_a_file_on_the_disk_is_the_same_as_one_in_memory(tmp_path: Path):
    path = tmp_path / "a.mcap"
    path.write_bytes(bytes(10_000))
    writer = FileWriter(FileOutput.create(path))
    write(writer)
    writer.output.close()
    assert path.read_bytes() == by_hand()


def test_the_reader_of_the_mcap_package_finds_everything():
    writer = FileWriter(MemoryOutput())
    write(writer)
    reader = make_reader(io.BytesIO(writer.output.data()), validate_crcs=True)
    read = [(message.log_time, message.sequence, message.data) for _, _, message in reader.iter_messages()]
    assert read == [(10, 6, b"cde"), (20, 5, b"ab")]
    assert [attachment.data for attachment in reader.iter_attachments()] == [b"hi"]
    assert [metadata.metadata for metadata in reader.iter_metadata()] == [{"a": "b"}]


def test_channels_of_one_type_share_a_schema_and_those_without_a_type_have_none():
    writer = FileWriter(MemoryOutput())
    writer.begin()
    for number, connection in enumerate((Connection("a", "T", "x", b"1"), Connection("b", "T", "x", b"1")), 1):
        writer.add_connection(number, connection)
    writer.add_connection(3, Connection("c"))
    writer.write_end()
    summary = make_reader(io.BytesIO(writer.output.data())).get_summary()
    assert summary is not None
    assert {channel.topic: channel.schema_id for channel in summary.channels.values()} == {"a": 1, "b": 1, "c": 0}
    assert len(summary.schemas) == 1
