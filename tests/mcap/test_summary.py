"""A summary is read as its records say: many at once or one by one, as a whole or only what opening a file needs."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import DamagedFileError
from ml_dash_mcap.mcap import chunk_indexes, chunk_table, records
from ml_dash_mcap.mcap.file_reader import McapFile
from ml_dash_mcap.mcap.record_layout import split_records
from ml_dash_mcap.mcap.records import SUMMARY_OFFSET, Chunk, Opcode
from tests.support import raw
from tests.support.examples import examples

SUMMARY_START = 1_000_000

# -- chunk indexes, many at once ---------------------------------------------------------------------------------------


def one_by_one(data: bytes) -> list[Chunk]:
    """What a summary's chunk indexes say, each read and checked on its own, by where the chunks lie."""
    found: list[Chunk] = []
    for opcode, at, fields in split_records(data, "file", SUMMARY_START):
        if opcode == Opcode.CHUNK_INDEX:
            chunk = records.CHUNK_INDEX.read(fields)
            chunk_indexes.check(chunk, "file", at, SUMMARY_START)
            found.append(chunk)
    return sorted(found, key=lambda chunk: chunk.offset)


def at_once(data: bytes) -> list[Chunk]:
    """The same, as a summary is really read."""
    indexes = chunk_indexes.ChunkIndexes("file")
    try:
        for opcode, _, _ in indexes.split(memoryview(data), SUMMARY_START):
            assert opcode != Opcode.CHUNK_INDEX
    except DamagedFileError:
        indexes.table(SUMMARY_START)  # what comes before the damage is told first
        raise
    return list(indexes.table(SUMMARY_START))


def outcome(read, data: bytes) -> object:
    try:
        return read(data)
    except DamagedFileError as error:
        return error.offset, error.what


SOUND = st.integers(8, 900_000)
HOSTILE = st.sampled_from((0, 7, 999_991, 999_992, SUMMARY_START, 2**63, 2**64 - 10**6, 2**64 - 9, 2**64 - 1))
NUMBER = st.one_of(SOUND, SOUND, SOUND, HOSTILE)


@st.composite
def sound_index(draw: st.DrawFn) -> bytes:
    """A chunk index that points where it may: one of few forms, so that runs come about."""
    offset, length = draw(st.integers(8, 400_000)), draw(st.integers(1, 400_000))
    channels = draw(st.sampled_from(((), (1,), (1, 7), (3, 3))))
    room = draw(st.integers(9, 100_000))
    places = {number: offset + length + draw(st.integers(0, room - 9)) for number in channels}
    return raw.chunk_index(
        offset,
        length,
        indexes=places,
        index_length=room,
        compression=draw(st.sampled_from(("", "zstd", "lz4", "zst\xe9"))),
        sizes=(draw(NUMBER), draw(NUMBER)),
        times=(draw(NUMBER), draw(NUMBER)),
    )


@st.composite
def any_index(draw: st.DrawFn) -> bytes:
    """A chunk index of which any number may be anything."""
    numbers = draw(st.lists(st.tuples(st.integers(0, 3), NUMBER), max_size=2))
    data = raw.chunk_index(
        draw(NUMBER),
        draw(NUMBER),
        indexes=dict(numbers),
        index_length=draw(NUMBER),
        compression=draw(st.sampled_from((b"", b"zstd", b"\xff\xfe\xfd\xfc", b"\0loose"))),
    )
    if draw(st.integers(0, 9)):
        return data
    at = draw(st.integers(0, len(data) - 1))  # a length inside it, perhaps
    return data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]


SUMMARIES = st.lists(
    st.one_of(
        st.tuples(sound_index(), st.integers(1, 40)),
        st.tuples(sound_index(), st.just(1)),
        st.tuples(st.sampled_from((raw.schema(), raw.statistics({1: 1}), raw.record(0x80, b""))), st.just(1)),
    ),
    max_size=12,
)


@given(SUMMARIES)
def test_chunk_indexes_read_at_once_are_those_read_one_by_one(parts):
    data = b"".join(part * times for part, times in parts)
    assert at_once(data) == one_by_one(data)


@given(st.lists(st.tuples(st.one_of(sound_index(), any_index()), st.integers(1, 12)), max_size=8))
@settings(max_examples=examples(300))
def test_chunk_indexes_that_lie_give_the_same_chunks_or_the_same_error(parts):
    data = b"".join(part * times for part, times in parts)
    assert outcome(at_once, data) == outcome(one_by_one, data)


@given(SUMMARIES, st.sets(st.integers(0, 8), max_size=3), st.tuples(NUMBER, NUMBER))
def test_chunks_are_picked_by_their_arrays_as_they_would_be_one_by_one(parts, channels, times):
    data = b"".join(part * times for part, times in parts)
    indexes = chunk_indexes.ChunkIndexes("file")
    for _ in indexes.split(memoryview(data), SUMMARY_START):
        pass
    table = indexes.table(SUMMARY_START)
    for wanted in (None, channels):
        assert list(table.holding(wanted, *times)) == list(chunk_table.holding(one_by_one(data), wanted, *times))
    assert table[:3] == list(table)[:3]
    assert table.channels() == {channel for chunk in table for channel in chunk.message_index_offsets}


@pytest.mark.parametrize("field", range(6))
@pytest.mark.parametrize("value", [2**64 - 1, 2**64 - 9, 2**64 - 400_000, 2**63])
def test_a_number_so_large_that_sums_overflow_is_refused_wherever_it_stands(field, value):
    numbers = {"offset": 400_000, "length": 1000, "place": 401_000, "room": 100, "packed": 10, "size": 10}
    good = dict(numbers)
    numbers[list(numbers)[field]] = value

    def index(of: dict[str, int]) -> bytes:
        return raw.chunk_index(
            of["offset"],
            of["length"],
            indexes={1: of["place"]},
            index_length=of["room"],
            sizes=(of["packed"], of["size"]),
        )

    for position in (0, 1, 20):
        data = index(good) * position + index(numbers) + index(good) * 20
        assert outcome(at_once, data) == outcome(one_by_one, data)
        assert isinstance(outcome(at_once, data), tuple) == (field < 4)


# -- a long file -------------------------------------------------------------------------------------------------------

CHUNKS = 5000


@pytest.fixture(scope="module")
def long_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 5,000 chunks of one message each."""
    output = io.BytesIO()
    writer = Writer(output, chunk_size=1, compression=CompressionType.NONE)
    writer.start("", "tests")
    schema = writer.register_schema("robot", "jsonschema", b'{"type":"object","properties":{"q":{"type":"number"}}}')
    channel = writer.register_channel("robot", "json", schema)
    writer.add_metadata("note", {"a": "b"})
    for i in range(CHUNKS):
        writer.add_message(channel, i * 1000, b'{"q":%d}' % i, i * 1000)
    writer.finish()
    path = tmp_path_factory.mktemp("long") / "file.mcap"
    path.write_bytes(output.getvalue())
    return path


def bytes_read(rec: Recording) -> int:
    return sum(file.source.bytes_read for file in rec._opened())  # type: ignore[attr-defined]


def test_a_long_file_opens_without_its_chunk_indexes(long_file):
    with Recording(long_file) as rec:
        assert bytes_read(rec) < 10_000
        assert list(rec.topics) == ["robot"]
        assert "robot" in rec
        assert (rec.start, rec.end) == (0.0, (CHUNKS - 1) * 1e-6)
        assert rec.metadata == [("note", {"a": "b"})]
        assert bytes_read(rec) < 20_000
        assert rec["robot"].at(1e-3)["q"] == 1000
        assert rec["robot"].info.count == CHUNKS


def test_what_is_known_at_a_glance_is_what_the_index_says(long_file):
    file = McapFile(long_file)
    glance = file.glance
    assert glance == file.index.glance
    assert file.glance == glance
    file.close()


def footer_of(data: bytes) -> tuple[int, int]:
    start, offsets_at = struct.unpack_from("<QQ", data, len(data) - 8 - 20)
    return start, offsets_at


def damaged(long_file: Path, tmp_path: Path, at: int) -> Path:
    data = bytearray(long_file.read_bytes())
    data[at] ^= 0x40
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    return path


def test_a_long_file_whose_index_turns_out_to_be_damaged_is_walked(long_file, tmp_path):
    start, offsets_at = footer_of(long_file.read_bytes())
    path = damaged(long_file, tmp_path, (start + offsets_at) // 2)
    expected = McapFile(long_file).index
    for on_damage in ("raise", "skip"):
        with Recording(path, on_damage=on_damage) as rec:
            assert bytes_read(rec) < 10_000  # nobody knows yet
            assert [row["q"] for row in rec["robot"].rows(1e-3, 1.002e-3)] == [1000, 1001, 1002]
            [file] = rec._opened()
            assert [chunk.offset for chunk in file.index.chunks] == [chunk.offset for chunk in expected.chunks]
            assert dict(file.index.message_counts) == dict(expected.message_counts)
            assert rec.losses == []


def test_a_long_file_whose_index_and_data_are_damaged_is_an_error_whenever_it_is_asked(long_file, tmp_path):
    start, offsets_at = footer_of(long_file.read_bytes())
    path = damaged(long_file, tmp_path, (start + offsets_at) // 2)
    data = bytearray(path.read_bytes())
    tenth = McapFile(long_file).index.chunks[10]
    data[tenth.offset + 1 : tenth.offset + 9] = b"\xff" * 8
    path.write_bytes(data)
    with Recording(path) as rec:
        for _ in range(2):
            with pytest.raises(DamagedFileError) as caught:
                list(rec["robot"].rows())
            assert caught.value.offset == tenth.offset
    with Recording(path, on_damage="skip") as rec:
        assert len(list(rec["robot"].rows())) == CHUNKS - 1
        assert [(loss.offset, loss.messages) for loss in rec.losses] == [(tenth.offset, 1)]


@pytest.mark.parametrize("group", [Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.METADATA_INDEX])
def test_a_long_file_with_a_damaged_group_opens_and_is_read(long_file, tmp_path, group):
    data = long_file.read_bytes()
    _, offsets_at = footer_of(data)
    offsets = [SUMMARY_OFFSET.read(fields) for _, _, fields in split_records(data[offsets_at:-37], "", offsets_at)]
    groups = {offset.opcode: offset.start for offset in offsets}
    path = damaged(long_file, tmp_path, groups[group])  # the group's first record is of another kind now
    with Recording(path) as rec:
        assert rec["robot"].info.count == CHUNKS
        assert len(rec.metadata) == 1


def test_a_topic_whose_name_is_damaged_at_a_glance_is_found_in_the_index(long_file, tmp_path):
    data = long_file.read_bytes()
    path = damaged(long_file, tmp_path, data.rindex(b"robot", 0, data.rindex(b"json")))
    with Recording(path) as rec:
        assert "robot" in rec
        assert rec["robot"].last()["q"] == CHUNKS - 1
        assert list(rec.topics) == ["robot"]
