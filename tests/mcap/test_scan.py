"""Files without an end are read up to where they were cut, and on from there when they grow."""

import io
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.records import Message
from mcap.writer import CompressionType, Writer

from ml_dash_mcap.errors import DamagedFileError
from ml_dash_mcap.query import topic_rows
from ml_dash_mcap.query.file import File
from ml_dash_mcap.query.stored_topic import StoredTopic
from tests.support.assemble import MAGIC, Bundle, written
from tests.support.files import draft, finished, ns, payload, unfinished

CHUNKS = [
    {"robot": [{"q": [i, 0.5], "_ts": i / 30} for i in range(5)], "imu": [{"a": 1, "_ts": 0.1}]},
    {"robot": [{"q": [i, 0.5], "_ts": i / 30} for i in range(5, 9)]},
    {"imu": [{"a": 2, "_ts": 0.5}], "robot": [{"q": [9, 0.5], "_ts": 9 / 30}], "late": [{"b": 1, "_ts": 0.2}]},
]
NOTES = [("ml_dash", {"prefix": "a/b"}), ("ml_dash.run", {"status": "running"})]


def opened(path: Path, data: bytes) -> File:
    path.write_bytes(data)
    return File(path)


def read(file: File) -> dict[str, list]:
    topics = {channel.topic for channel in file.index.channels.values()}
    return {topic: list(topic_rows.read(StoredTopic([file], topic))) for topic in sorted(topics)}


def whole_rows(data: bytes) -> dict[str, list]:
    """The rows of all chunks that lie whole in a file's first bytes."""
    drafted = draft(CHUNKS, metadata=NOTES)
    expected: dict[str, list] = {}
    end = len(MAGIC + written([drafted.header]))
    for record in drafted.data:
        end += len(written([record]))
        if end > len(data):
            break
        if type(record).__name__ == "Channel":
            expected[record.topic] = []
        if isinstance(record, Bundle):
            for message in record.inside:
                topic = list(expected)[message.channel_id - 1] if isinstance(message, Message) else None
                for chunk in CHUNKS:
                    expected[topic] += [row for row in chunk.get(topic, []) if payload(row) == message.data]
    return {topic: sorted(found, key=lambda row: row["_ts"]) for topic, found in expected.items()}


@pytest.mark.breaks_files
def test_a_file_cut_at_any_byte_gives_the_rows_of_its_whole_chunks(tmp_path):
    data = unfinished(draft(CHUNKS, metadata=NOTES))
    header = len(MAGIC + written([draft([]).header]))
    for cut in range(header, len(data) + 1):
        with_cut = opened(tmp_path / "cut.mcap", data[:cut])
        assert read(with_cut) == whole_rows(data[:cut]), cut
        assert not with_cut.index.finished
        assert with_cut.index.end <= cut
        with_cut.close()


@pytest.mark.breaks_files
def test_a_file_that_is_cut_before_its_header_ends_is_refused_unless_its_recorder_may_just_be_creating_it(tmp_path):
    data = unfinished(draft([]))
    for cut in range(len(data)):
        with pytest.raises(DamagedFileError):
            opened(tmp_path / "cut.mcap", data[:cut])
        assert opened(tmp_path / "cut.mcap.active", data[:cut]).index.channels == {}


def test_a_file_that_grows_byte_by_byte_is_taken_in_as_it_grows(tmp_path):
    data = unfinished(draft(CHUNKS, metadata=NOTES))
    path = tmp_path / "growing.mcap.active"
    growing = opened(path, b"")
    for cut in range(0, len(data) + 1, 7):
        path.write_bytes(data[:cut])
        growing.refresh()
        assert read(growing) == (whole_rows(data[:cut]) if growing.index.end else {}), cut
    path.write_bytes(data)
    growing.refresh()
    assert growing.index.message_counts == {1: 10, 2: 2, 3: 1}
    assert [record.name for record in growing.metadata()] == ["ml_dash", "ml_dash.run"]


def test_taking_in_what_is_new_does_not_read_what_is_old(tmp_path):
    chunks = [{"robot": [{"q": [float(i)] * 500, "_ts": float(n * 1000 + i)} for i in range(30)]} for n in range(20)]
    path = tmp_path / "growing.mcap.active"
    growing = opened(path, unfinished(draft(chunks[:19])))
    before = growing.source.bytes_read
    path.write_bytes(unfinished(draft(chunks)))
    growing.refresh()
    assert len(growing.index.chunks) == 20
    assert growing.source.bytes_read - before < 0.08 * path.stat().st_size


def test_a_growing_file_that_gets_its_end_is_read_by_its_summary(tmp_path):
    path = tmp_path / "segment.mcap.active"
    growing = opened(path, unfinished(draft(CHUNKS)))
    before = read(growing)
    path.write_bytes(finished(draft(CHUNKS)))
    assert growing.refresh()
    assert growing.index.finished
    assert growing.index.statistics is not None
    assert read(growing) == before


@pytest.mark.breaks_files
@pytest.mark.parametrize("victim", [-20, -100])
def test_a_last_chunk_with_a_bad_checksum_is_left_out_of_an_unfinished_file(tmp_path, victim):
    drafted = draft(CHUNKS)
    last = max(n for n, record in enumerate(drafted.data) if isinstance(record, Bundle))
    data = bytearray(MAGIC + written([drafted.header, *drafted.data[: last + 1]]))
    data[victim] ^= 0x10
    cut = opened(tmp_path / "cut.mcap", bytes(data))
    assert ["checksum" in loss.what for loss in cut.index.losses] == [True]
    assert len(cut.index.chunks) == 2
    assert [row["q"][0] for row in read(cut)["robot"]] == list(range(9))


@pytest.mark.breaks_files
def test_zeros_behind_the_last_record_are_no_records(tmp_path):
    cut = opened(tmp_path / "cut.mcap", unfinished(draft(CHUNKS)) + bytes(100_000))
    assert ["no record" in loss.what for loss in cut.index.losses] == [True]
    assert len(read(cut)["robot"]) == 10


@pytest.mark.breaks_files
def test_messages_outside_chunks_are_read(tmp_path):
    drafted = draft(CHUNKS)
    loose = [inner for record in drafted.data for inner in (record.inside if isinstance(record, Bundle) else [record])]
    loose = [record for record in loose if type(record).__name__ != "MessageIndex"]
    data = MAGIC + written([drafted.header, *loose])
    journal = opened(tmp_path / "journal.mcap", data + bytes(1000))
    assert read(journal) == read(opened(tmp_path / "chunked.mcap", finished(draft(CHUNKS))))
    assert journal.index.message_counts == {1: 10, 2: 2, 3: 1}


def foreign(**options) -> bytes:
    output = io.BytesIO()
    writer = Writer(output, chunk_size=300, **options)
    writer.start("", "someone else")
    schema = writer.register_schema("robot", "jsonschema", b'{"type":"object"}')
    channel = writer.register_channel("robot", "json", schema, {"kind": "track"})
    for i in range(50):
        row = {"q": [i, 0.5], "_ts": i / 30}
        writer.add_message(channel, ns(i / 30), payload(row), ns(i / 30))
    writer.add_metadata("note", {"a": "b"})
    writer.finish()
    return output.getvalue()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"use_statistics": False},
        {"use_summary_offsets": False},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"enable_crcs": False},
    ],
    ids=str,
)
def test_files_of_the_mcap_package_are_read_whatever_their_summary_leaves_out(tmp_path, options):
    file = opened(tmp_path / "foreign.mcap", foreign(**options))
    assert file.index.finished
    assert [row["q"][0] for row in read(file)["robot"]] == list(range(50))
    assert file.index.message_counts == {1: 50}
    assert [(record.name, dict(record.values)) for record in file.metadata()] == [("note", {"a": "b"})]


def test_files_whose_channels_stand_inside_the_chunks_are_read_when_cut(tmp_path):
    data = foreign()
    counts = []
    for cut in range(100, len(data), 97):
        found = read(opened(tmp_path / "cut.mcap", data[:cut])).get("robot", [])
        assert found == [{"q": [i, 0.5], "_ts": i / 30} for i in range(len(found))]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[-1] == 50


@pytest.mark.breaks_files
def test_a_damaged_summary_is_replaced_by_a_walk(tmp_path):
    good = finished(draft(CHUNKS, metadata=NOTES))
    expected = read(opened(tmp_path / "good.mcap", good))
    footer = len(good) - 8 - 29
    start = int.from_bytes(good[footer + 9 : footer + 17], "little")
    for at in range(start, footer, 11):
        data = bytearray(good)
        data[at] ^= 0xFF
        file = opened(tmp_path / "damaged.mcap", bytes(data))
        assert read(file) == expected
        assert [record.name for record in file.metadata()] == ["ml_dash", "ml_dash.run"]
        file.close()


@pytest.mark.breaks_files
def test_a_finished_file_with_damaged_data_is_an_error_with_the_place(tmp_path):
    good = finished(draft(CHUNKS))
    file = opened(tmp_path / "good.mcap", good)
    chunk = file.index.chunks[1]
    data = bytearray(good)
    data[chunk.offset + 80] ^= 1
    with pytest.raises(DamagedFileError, match="checksum") as caught:
        read(opened(tmp_path / "damaged.mcap", bytes(data)))
    assert (caught.value.path.name, caught.value.offset) == ("damaged.mcap", chunk.offset)


@pytest.mark.breaks_files
def test_whatever_byte_is_flipped_reading_gives_rows_or_our_error(tmp_path):
    good = finished(draft(CHUNKS, metadata=NOTES))
    for at in range(8, len(good), 5):
        data = bytearray(good)
        data[at] ^= 0x41
        with suppress(DamagedFileError):
            file = opened(tmp_path / "flipped.mcap", bytes(data))
            read(file)
            file.metadata()
