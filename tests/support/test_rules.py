"""The judge finds what is wrong with a file, and nothing in a file that is right."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.records import (
    Chunk,
    Header,
    McapRecord,
    MessageIndex,
    Statistics,
)
from mcap.writer import CompressionType, IndexType, Writer

from tests.support.assemble import MAGIC, Draft, bundle, written
from tests.support.rules import problems
from tests.support.samples import CHANNEL, NOTE, PICTURE, SCHEMA, draft, found, row, the


def with_plain_writer(
    path: Path, *, payload: bytes = b'{"q": [1.0]}', chunk_size: int = 200, **options: object
) -> list[str]:
    """Judge a file of 20 messages by the plain `mcap` writer."""
    path = path / "plain.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, **options)  # type: ignore[arg-type]
        writer.start(library="plain")
        schema_id = writer.register_schema("arm", "jsonschema", SCHEMA.data)
        channel_id = writer.register_channel("arm", "json", schema_id)
        for time_ns in range(20):
            writer.add_message(channel_id, time_ns, payload, time_ns)
        writer.add_attachment(0, 0, "a.txt", "text/plain", b"abc")
        writer.add_metadata("ml_dash", {"a": "b"})
        writer.finish()  # type: ignore[no-untyped-call]
    return problems(path)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_correct_file_of_the_plain_writer_has_no_problems(tmp_path: Path, compression: CompressionType) -> None:
    assert with_plain_writer(tmp_path, compression=compression) == []


def test_a_correct_file_with_a_data_section_crc_has_no_problems(tmp_path: Path) -> None:
    assert with_plain_writer(tmp_path, enable_data_crcs=True) == []


def test_a_correct_assembled_file_has_no_problems(tmp_path: Path) -> None:
    assert found(tmp_path, draft().summarise()) == []


def test_a_correct_file_without_messages_has_no_problems(tmp_path: Path) -> None:
    assert found(tmp_path, Draft([NOTE]).summarise()) == []


def test_a_schema_outside_the_chunks_with_blanks_to_spare_has_no_problems(tmp_path: Path) -> None:
    spare = replace(SCHEMA, data=SCHEMA.data + b" " * 100)
    assert found(tmp_path, Draft([spare, CHANNEL, *bundle([row(1)])]).summarise()) == []


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"use_statistics": False}, "has no Statistics"),
        ({"repeat_schemas": False}, "(schema 1) is not repeated in the summary"),
        ({"repeat_channels": False}, "(channel 1) is not repeated in the summary"),
        ({"use_summary_offsets": False}, "The group 0x08 at byte"),
        ({"index_types": IndexType.ALL & ~IndexType.CHUNK}, "has no chunk index"),
        ({"index_types": IndexType.ALL & ~IndexType.MESSAGE}, "has no message index for channel 1"),
        ({"index_types": IndexType.ALL & ~IndexType.ATTACHMENT}, "has no attachment index"),
        ({"index_types": IndexType.ALL & ~IndexType.METADATA}, "has no metadata index"),
        ({"use_chunking": False}, "is outside a chunk"),
        ({"enable_crcs": False}, "has no CRC"),
        ({"enable_crcs": False}, "has no summary CRC"),
        ({"payload": b" " * 300_000 + b"{}", "chunk_size": 10_000_000}, "is for a single message"),
    ],
)
def test_what_the_plain_writer_leaves_out_is_found(tmp_path: Path, options: dict[str, object], sentence: str) -> None:
    assert any(sentence in problem for problem in with_plain_writer(tmp_path, **options))  # type: ignore[arg-type]


def test_a_large_chunk_with_a_single_message_is_allowed(tmp_path: Path) -> None:
    assert found(tmp_path, draft(row(30, b" " * 5_000_000 + b"{}")).summarise()) == []


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b'{"q":[NaN]}', "the literal NaN"),
        (b'{"q":[-Infinity]}', "the literal -Infinity"),
        (b'{"q":[1e999]}', "reads as Infinity"),
        (b'{"q":[1.0]', "is not valid JSON"),
        (b"", "is not valid JSON"),
        (b'{"q":[1.0]} x', "is not valid JSON"),
        (b'{"q":"\xff"}', "is not valid JSON"),
        (b'{"q":[1],"q":[2]}', "the name 'q' twice"),
        (b"[1]", "is JSON, but not an object"),
        (b'{"q":1.0}', "$.q is 1.0, but its schema says array"),
        (b'{"q":[1.0,"a"]}', "$.q[1] is 'a', but its schema says number"),
    ],
)
def test_a_payload_that_is_no_good_row_is_found(tmp_path: Path, data: bytes, sentence: str) -> None:
    [problem] = found(tmp_path, draft(row(30, data)).summarise())
    assert sentence in problem
    assert problem.startswith("Message at byte 0 in the chunk at byte ")


@pytest.mark.parametrize(
    ("inside", "sentence"),
    [
        ([SCHEMA, row(30)], "repeats schema 1, already defined"),
        ([replace(SCHEMA, name="leg"), row(30)], "contradicts schema 1, already defined"),
        ([CHANNEL, row(30)], "repeats channel 1, already defined"),
        ([replace(CHANNEL, id=2), row(30)], "is a second channel of the topic 'arm', after channel 1"),
        ([replace(CHANNEL, id=2, topic="leg", schema_id=0), row(30)], "('leg') has no schema"),
        ([replace(CHANNEL, id=2, topic="leg", schema_id=7), row(30)], "has the unknown schema 7"),
        ([replace(CHANNEL, id=2, topic="leg", message_encoding=""), row(30)], "('leg') has no message encoding"),
        ([replace(SCHEMA, id=0), row(30)], "has the id 0, which is reserved"),
        ([replace(SCHEMA, id=2, encoding="", data=b""), row(30)], "is no schema"),
        ([replace(SCHEMA, id=2, data=b"{"), row(30)], "is not valid JSON"),
        ([replace(SCHEMA, id=2, data=b"{}"), row(30)], "loses its topic: $ has the type None"),
        ([row(30, channel_id=9)], "is on channel 9, which no Channel before it defines"),
        ([replace(row(30), publish_time=31)], "has publish_time 31 and log_time 30"),
        ([row(30), NOTE], "(opcode 0x0c) is not allowed in a chunk"),
        ([], "is empty: it holds no message"),
    ],
)
def test_a_wrong_record_in_a_chunk_is_found(tmp_path: Path, inside: list[McapRecord], sentence: str) -> None:
    file = draft()
    file.data[-2:] = bundle(inside)
    assert any(sentence in problem for problem in found(tmp_path, file.summarise()))


def test_a_channel_of_json_with_another_schema_encoding_is_found(tmp_path: Path) -> None:
    file = Draft(bundle([replace(SCHEMA, encoding="protobuf"), CHANNEL, row(1)])).summarise()
    [problem] = found(tmp_path, file)
    assert "holds json, but its schema's encoding is 'protobuf'" in problem


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"message_start_time": 9}, "has message_start_time 9, but its first log time is 15"),
        ({"message_end_time": 99}, "has message_end_time 99, but its last log time is 30"),
        ({"uncompressed_crc": 0}, "has no CRC"),
        ({"uncompressed_crc": 1}, "has the CRC 0x00000001"),
        ({"uncompressed_size": 7}, "has uncompressed_size 7, but holds"),
        ({"compression": "bz2"}, "'bz2' is not a compression that viewers know"),
        ({"compression": "zstd"}, "cannot be decompressed"),
        ({"compression": "lz4"}, "cannot be decompressed"),
    ],
)
def test_a_wrong_field_of_a_chunk_is_found(tmp_path: Path, change: dict[str, object], sentence: str) -> None:
    file = draft()
    chunk = file.data[-2]
    assert isinstance(chunk, Chunk)
    file.data[-2] = replace(chunk, **change)  # type: ignore[arg-type]
    assert sentence in found(tmp_path, file.summarise())[0]


@pytest.mark.parametrize(
    ("entries", "sentence"),
    [
        ([(15, 0)], "leaves out the message at byte"),
        ([(15, 0), (30, 47), (30, 47)], "points twice to the message at byte 47"),
        ([(15, 0), (31, 47)], "gives 31 for the message at byte 47 of the chunk, whose log time is 30"),
        ([(15, 0), (30, 47), (30, 48)], "points to byte 48 of the chunk, where no message of channel 1 starts"),
    ],
)
def test_a_wrong_message_index_is_found(tmp_path: Path, entries: list[tuple[int, int]], sentence: str) -> None:
    file = draft()
    file.data[-1] = MessageIndex(1, entries)
    [problem] = found(tmp_path, file.summarise())
    assert sentence in problem


def test_a_message_index_of_another_channel_a_second_one_and_one_without_a_chunk_are_found(tmp_path: Path) -> None:
    file = draft()
    index = file.data[-1]
    assert isinstance(index, MessageIndex)
    file.data += [index, MessageIndex(5, []), NOTE, index]
    listed = "\n".join(found(tmp_path, file.summarise()))
    assert "is a second message index of channel 1" in listed
    assert "is for channel 5, which has no message" in listed
    assert "does not follow a chunk" in listed


@pytest.mark.parametrize(
    ("header", "sentence"),
    [(Header("", ""), "names no library"), (Header("mine", "tests"), "has the profile 'mine'")],
)
def test_a_wrong_header_is_found(tmp_path: Path, header: Header, sentence: str) -> None:
    file = draft()
    file.header = header
    [problem] = found(tmp_path, file.summarise())
    assert sentence in problem


def test_the_profile_of_bags_is_no_problem(tmp_path: Path) -> None:
    file = draft()
    file.header = Header("ros2", "tests")
    assert found(tmp_path, file.summarise()) == []


def test_a_second_header_and_a_record_of_the_summary_in_the_data_section_are_found(tmp_path: Path) -> None:
    file = draft()
    file.data += [Header("", "tests"), the(Statistics, draft().summarise().summary)]
    listed = "\n".join(found(tmp_path, file.summarise()))
    assert "(opcode 0x01) is not allowed in the data section" in listed
    assert "(opcode 0x0b) is not allowed in the data section" in listed


def test_reserved_opcodes_are_found_and_private_ones_are_not(tmp_path: Path) -> None:
    whole = draft().finish()
    front = len(written([Header("", "tests")])) + len(MAGIC)

    def planted(opcode: int) -> str:
        return "\n".join(found(tmp_path, whole[:front] + struct.pack("<BQ", opcode, 0) + whole[front:]))

    assert f"Unknown at byte {front} (opcode 0x10) is not allowed in the data section" in planted(0x10)
    assert f"Unknown at byte {front}" not in planted(0x80)


def test_a_message_outside_a_chunk_is_found(tmp_path: Path) -> None:
    file = draft()
    file.data.append(row(30))
    [problem] = found(tmp_path, file.summarise())
    assert "is outside a chunk" in problem


def test_a_wrong_attachment_crc_is_found(tmp_path: Path) -> None:
    whole = draft().summarise().finish()
    crc = struct.pack("<I", zlib.crc32(written([PICTURE])[9:-4]))
    assert whole.count(crc) == 1
    [problem] = found(tmp_path, whole.replace(crc, b"\1\0\0\0"))
    assert problem.startswith("Attachment at byte ")
    assert "has the CRC 0x00000001" in problem


def test_a_record_with_bytes_after_its_last_field_is_found(tmp_path: Path) -> None:
    whole = draft().summarise().finish()
    note = written([NOTE])
    longer = struct.pack("<BQ", note[0], len(note) - 9 + 2) + note[9:] + b"\0\0"
    assert any(
        "should be a Metadata but has 2 bytes after its last field" in problem
        for problem in found(tmp_path, whole.replace(note, longer))
    )


def test_a_file_without_its_beginning_is_found(tmp_path: Path) -> None:
    assert "not with the magic" in found(tmp_path, draft().summarise().finish()[1:])[0]
    assert any("where the Header should be" in problem for problem in found(tmp_path, MAGIC + written([NOTE])))


def test_a_file_cut_off_anywhere_has_problems(tmp_path: Path) -> None:
    whole = draft().summarise().finish()
    for length in range(len(whole)):
        assert found(tmp_path, whole[:length]), f"cut off at {length}"


def test_one_flipped_bit_anywhere_is_found(tmp_path: Path) -> None:
    whole = draft().summarise().finish()
    unseen = [
        at for at in range(len(whole)) if not found(tmp_path, whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    ]
    assert _texts_without_a_crc(whole, unseen) == []


def _texts_without_a_crc(whole: bytes, positions: list[int]) -> list[int]:
    """Of these positions those outside the few texts and numbers that nothing in a file repeats or sums up."""
    free = [b"tests", *(text.encode() for pair in NOTE.metadata.items() for text in pair)]
    spans = [range(whole.index(text), whole.index(text) + len(text)) for text in free]
    return [at for at in positions if not any(at in span for span in spans)]
