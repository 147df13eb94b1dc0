"""Damage takes no more than it must: what is whole is read, what is not is counted, and nothing wrong comes out."""

from __future__ import annotations

import errno
import io
import json
import os
import pickle
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap import records as mcap_records
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from ml_dash_mcap import Limits, Loss, Recorder, RecorderOptions, Recording
from ml_dash_mcap.errors import DamagedFileError, EncodingError, OptionError, UndecodedWarning
from ml_dash_mcap.mcap.records import Chunk
from ml_dash_mcap.store import read_ahead
from tests.support import raw
from tests.support.assemble import Draft, bundle
from tests.support.every_read import everything
from tests.support.examples import examples
from tests.support.files import draft, finished, save

Rows = dict[str, list[dict[str, Any]]]

TIMES = [i / 8 for i in range(4)]


def small(compression: CompressionType, **options: bool) -> bytes:
    """A file of some chunks, one after the other."""
    output = io.BytesIO()
    writer = Writer(output, chunk_size=100, compression=compression, **options)  # type: ignore[arg-type]
    writer.start("", "tests")
    schema = writer.register_schema("robot", "jsonschema", b'{"type":"object"}')
    channels = [writer.register_channel(topic, "json", schema, {"kind": "track"}) for topic in ("robot", "imu")]
    for i, time in enumerate(TIMES):
        payload = json.dumps({"q": [i, 0.5], "_ts": time}).encode()
        writer.add_message(channels[i == 2], int(time * 1e9), payload, int(time * 1e9))
    writer.finish()
    return output.getvalue()


def read(path: Path, on_damage: str = "skip") -> tuple[Rows, list[Loss]]:
    """The rows of every topic, and what is lost."""
    with Recording(path, on_damage=on_damage) as rec:
        found = {topic: list(rec[topic].rows()) for topic in rec.topics}
        return found, rec.losses


def chunks_of(path: Path) -> list[Chunk]:
    with Recording(path) as rec:
        return [chunk for file in rec._opened() for chunk in file.index.chunks]


def times_of(rows: Rows) -> list[float]:
    return sorted(row["_ts"] for found in rows.values() for row in found)


# -- one byte ----------------------------------------------------------------------------------------------------------


@dataclass
class Specimen:
    """A file, what is in it, and which of its chunks holds which rows."""

    path: Path
    data: bytes
    rows: Rows
    chunks: list[Chunk]
    first: int
    """Where the first record behind the header starts."""

    def lost_with(self, at: int) -> list[float]:
        """The time stamps of the rows in the chunk that a byte lies in."""
        of = [chunk for chunk in self.chunks if chunk.offset <= at < chunk.end]
        return [time for time in TIMES for chunk in of if chunk.start_ns <= time * 1e9 <= chunk.end_ns]


@pytest.fixture(scope="module", params=list(CompressionType), ids=lambda one: one.name)
def specimen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Specimen:
    path = tmp_path_factory.mktemp("damage") / "file.mcap"
    data = small(request.param)
    path.write_bytes(data)
    rows, losses = read(path, "raise")
    assert (times_of(rows), losses) == (TIMES, [])
    return Specimen(path, data, rows, chunks_of(path), len(raw.header()))


@pytest.fixture
def on_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reads as a machine with one core does: for files as small as these, threads would take most of the time."""
    monkeypatch.setattr(read_ahead, "_WORKERS", 1)


def check_subset(found: Rows, original: Rows) -> None:
    """No row is wrong, none comes twice or out of order."""
    for topic, rows in found.items():
        assert rows == [row for row in original[topic] if row in rows]


@pytest.mark.usefixtures("on_one_core")
def test_whatever_byte_is_changed_only_the_rows_of_its_chunk_are_lost(specimen):
    for at in range(len(specimen.data)):
        data = bytearray(specimen.data)
        data[at] ^= (0x01, 0x80, 0xFF, 0x20)[at % 4]
        specimen.path.write_bytes(data)
        try:
            found, losses = read(specimen.path)
        except DamagedFileError:
            if at < specimen.first:
                continue
            raise
        check_subset(found, specimen.rows)
        missing = sorted(set(TIMES) - set(times_of(found)))
        assert missing in ([], specimen.lost_with(at)), at
        assert losses or not missing
        assert sum(loss.messages for loss in losses if loss.messages is not None) in (0, len(missing))


@pytest.mark.usefixtures("on_one_core")
def test_whatever_byte_is_changed_reading_gives_the_rows_or_our_error(specimen):
    for at in range(0, len(specimen.data), 3):
        data = bytearray(specimen.data)
        data[at] ^= (0xFF, 0x01, 0x80)[at // 3 % 3]
        specimen.path.write_bytes(data)
        with suppress(DamagedFileError):
            assert read(specimen.path, "raise")[0] == specimen.rows


@pytest.mark.usefixtures("on_one_core")
def test_a_file_cut_anywhere_gives_the_rows_before_the_cut(specimen):
    for cut in range(specimen.first, len(specimen.data), 2):
        specimen.path.write_bytes(specimen.data[:cut])
        found, losses = read(specimen.path)
        whole = [time for chunk in specimen.chunks if chunk.end <= cut for time in specimen.lost_with(chunk.offset)]
        check_subset(found, specimen.rows)
        assert times_of(found) == whole, cut
        assert losses, cut


def test_a_file_cut_in_its_header_is_an_error(specimen):
    for cut in range(specimen.first):
        specimen.path.write_bytes(specimen.data[:cut])
        with pytest.raises(DamagedFileError):
            read(specimen.path)


MUTATIONS = st.lists(
    st.one_of(
        st.tuples(st.just("set"), st.integers(0, 10**6), st.integers(0, 255)),
        st.tuples(st.just("number"), st.integers(0, 10**6), st.sampled_from((0, 1, 31, 2**31, 2**63, 2**64 - 1))),
        st.tuples(st.just("cut"), st.integers(0, 10**6), st.integers(1, 200)),
        st.tuples(st.just("repeat"), st.integers(0, 10**6), st.integers(1, 200)),
        st.tuples(st.just("end"), st.integers(0, 10**6), st.just(0)),
    ),
    min_size=1,
    max_size=4,
)


def mutated(data: bytes, mutations: list[tuple[str, int, int]]) -> bytes:
    for how, place, value in mutations:
        at = place % max(len(data), 1)
        if how == "set":
            data = data[:at] + bytes([value]) + data[at + 1 :]
        elif how == "number":
            data = data[:at] + struct.pack("<Q", value) + data[at + 8 :]
        elif how == "cut":
            data = data[:at] + data[at + value :]
        elif how == "repeat":
            data = data[:at] + data[at : at + value] + data[at:]
        else:
            data = data[:at]
    return data


@given(mutations=MUTATIONS)
@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_is_done_to_a_file_nothing_but_our_error_comes_of_it(specimen, mutations):
    specimen.path.write_bytes(mutated(specimen.data, mutations))
    for on_damage in ("raise", "skip"):
        with suppress(DamagedFileError), Recording(specimen.path, on_damage=on_damage) as rec:
            everything(rec)


# -- what is counted ---------------------------------------------------------------------------------------------------

CHUNKS = [
    {"robot": [{"q": [i, 0.5], "_ts": i / 30} for i in range(5)], "imu": [{"a": 1, "_ts": 0.1}]},
    {"robot": [{"q": [i, 0.5], "_ts": i / 30} for i in range(5, 9)]},
    {"imu": [{"a": 2, "_ts": 0.5}], "robot": [{"q": [9, 0.5], "_ts": 9 / 30}]},
]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return save(tmp_path / "run.mcap", CHUNKS)


def garble(path: Path, at: int, by: bytes = b"\xff" * 4) -> None:
    data = bytearray(path.read_bytes())
    data[at : at + len(by)] = by
    path.write_bytes(data)


def readers(rec: Recording) -> Iterator[Callable[[], Any]]:
    """Each way to read a topic, after which what is lost is known."""
    robot = rec["robot"]
    yield lambda: list(robot.rows())
    yield lambda: robot.to_arrow().to_pylist()
    yield lambda: list(robot.batches(rows=2))
    yield lambda: robot.to_numpy()
    for name in ("json", "jsonl", "parquet", "mcap"):
        yield lambda name=name: robot.read(format=name)  # type: ignore[misc]
    yield lambda: list(robot.rows(0.1, 0.29))
    yield lambda: robot.info


@pytest.mark.breaks_files
def test_a_damaged_chunk_is_lost_with_its_messages_and_no_other(path):
    chunk = chunks_of(path)[0]
    garble(path, chunk.offset + 80)
    with Recording(path, on_damage="skip") as rec:
        assert rec.losses == []  # nobody has read it yet
        assert [row["q"][0] for row in rec["robot"].rows()] == [5, 6, 7, 8, 9]
        [loss] = rec.losses
    assert (loss.path, loss.offset, loss.messages) == (path, chunk.offset, 6)
    assert "checksum" in loss.what


@pytest.mark.breaks_files
def test_a_loss_is_counted_once_however_it_is_met(path):
    garble(path, chunks_of(path)[0].offset + 80)
    with Recording(path, on_damage="skip") as rec:
        for read_it in (*readers(rec), *readers(rec)):
            read_it()
        assert list(rec["imu"].rows()) == [{"a": 2, "_ts": 0.5}]
        rec.refresh()
        assert [loss.messages for loss in rec.losses] == [6]


@pytest.mark.breaks_files
def test_every_way_to_read_leaves_out_the_same(path):
    garble(path, chunks_of(path)[1].offset + 80)
    with Recording(path, on_damage="skip") as rec:
        expected = [0, 1, 2, 3, 4, 9]
        assert [row["q"][0] for row in rec["robot"].rows()] == expected
        assert [row["q"][0] for row in rec["robot"].to_arrow().to_pylist()] == expected
        assert rec["robot"].to_numpy()["q"][:, 0].tolist() == expected
        assert [entry["q"][0] for entry in rec["robot"].read()["entries"]] == expected
        assert len(rec["robot"].read(format="jsonl").splitlines()) == len(expected)
        assert rec["robot"].last()["q"][0] == 9
        assert rec["robot"].at(0.2)["q"][0] == 4
    with pytest.raises(DamagedFileError) as caught:
        read(path, "raise")
    assert caught.value.path == path


@pytest.mark.breaks_files
@pytest.mark.parametrize("which", [0, 2])
def test_a_topic_whose_first_or_last_chunk_is_lost_still_has_its_times(path, which):
    garble(path, chunks_of(path)[which].offset + 80)
    with Recording(path, on_damage="skip") as rec:
        info = rec["robot"].info
        assert (info.start, info.end, info.count) == (0.0, 0.3, 10)  # as the file announces them


@pytest.mark.breaks_files
def test_a_damaged_message_index_loses_nothing(path):
    chunk = chunks_of(path)[0]
    garble(path, next(iter(chunk.message_index_offsets.values())))
    with Recording(path, on_damage="skip") as rec:
        assert len(list(rec["robot"].rows())) == 10
        assert all(loss.corrected and loss.messages == 0 for loss in rec.losses)
        assert {loss.offset for loss in rec.losses} == {chunk.offset, chunk.end}
        assert rec["robot"].info.count == 10
    found, losses = read(path, "raise")
    assert len(found["robot"]) == 10
    assert all(loss.corrected for loss in losses)


@pytest.mark.breaks_files
def test_an_index_that_puts_messages_into_other_times_loses_nothing(path):
    chunk = chunks_of(path)[1]
    at = next(iter(chunk.message_index_offsets.values())) + 9 + 6
    garble(path, at, struct.pack("<Q", 2**62))
    for on_damage in ("raise", "skip"):
        found, losses = read(path, on_damage)
        assert len(found["robot"]) == 10
        assert losses
        assert all(loss.corrected and loss.messages == 0 for loss in losses)


def loose(*payloads: bytes, encoding: str = "json", schema: bytes = b"{}") -> bytes:
    """A file whose messages have these payloads, at 1, 2, 3, ... ns."""
    described = Schema(id=1, data=schema, encoding="jsonschema" if encoding == "json" else encoding, name="t")
    channel = Channel(1, "robot", encoding, {}, 1)
    messages = [Message(1, i, payload, i, 0) for i, payload in enumerate(payloads, 1)]
    return finished(Draft([described, channel, *bundle(messages)]))


def test_a_message_that_cannot_be_decoded_is_lost_and_no_other(tmp_path):
    path = tmp_path / "file.mcap"
    path.write_bytes(loose(b'{"q":1}', b"{", b'{"q":3}', b"\xff", b'{"q":5}'))
    with Recording(path, on_damage="skip") as rec:
        for _ in range(2):
            assert [row["q"] for row in rec["robot"].rows()] == [1, 3, 5]
            assert rec["robot"].to_arrow().column("q").to_pylist() == [1, 3, 5]
            assert list(rec["robot"].rows(2e-9, 2e-9)) == []
        [loss] = rec.losses
    assert loss.messages == 2
    assert "at 2 ns in the chunk here is not json" in loss.what
    with pytest.raises(DamagedFileError, match="at 2 ns"):
        read(path, "raise")


def test_messages_of_one_time_of_which_some_cannot_be_decoded_stay_with_their_times(tmp_path):
    described = Schema(id=1, data=b"{}", encoding="jsonschema", name="t")
    channels = [Channel(number, "robot", "json", {"kind": "track"}, 1) for number in (1, 2)]
    messages = [
        Message(number, time, payload, time, 0)
        for time in (1, 2)
        for number, payload in ((1, b'{"a":%d}' % time), (2, b"{"), (2, b'{"b":%d}' % time), (1, b"["))
    ]
    path = tmp_path / "file.mcap"
    path.write_bytes(finished(Draft([described, *channels, *bundle(messages)])))
    found, losses = read(path)
    assert found["robot"] == [{"a": 1, "b": 1, "_ts": 1e-9}, {"a": 2, "b": 2, "_ts": 2e-9}]
    assert sorted(loss.messages or 0 for loss in losses) == [2, 2]


def test_messages_of_a_schema_that_cannot_be_used_are_bytes_and_no_loss(tmp_path):
    path = tmp_path / "file.mcap"
    path.write_bytes(loose(b"1", b"2", encoding="protobuf", schema=b"no descriptors"))
    for on_damage in ("raise", "skip"):
        with Recording(path, on_damage=on_damage) as rec:
            with pytest.warns(UndecodedWarning, match="no protobuf that can"):
                assert [row["data"] for row in rec["robot"].rows()] == [b"1", b"2"]
            assert rec.losses == []
        with Recording(path, on_damage=on_damage, on_unknown="raise") as rec, pytest.raises(EncodingError):
            list(rec["robot"].rows())


@pytest.mark.breaks_files
def test_a_damaged_metadata_record_is_lost_and_no_other(tmp_path):
    path = save(tmp_path / "run.mcap", CHUNKS, metadata=[("a", {"x": "1"}), ("b", {"x": "2"})])
    with Recording(path) as rec:
        [first, _] = rec._opened()[0].index.metadata
    garble(path, first.offset)
    with Recording(path, on_damage="skip") as rec:
        assert rec.metadata == [("b", {"x": "2"})]
        assert rec.metadata == [("b", {"x": "2"})]
        assert [(loss.offset, loss.messages) for loss in rec.losses] == [(first.offset, 0)]


# -- without a summary that helps --------------------------------------------------------------------------------------


@pytest.mark.breaks_files
def test_a_finished_file_is_walked_around_the_damage_by_what_is_left_of_its_summary(path):
    second = chunks_of(path)[1]
    garble(path, second.offset, struct.pack("<BQ", 6, 2**40))  # nobody can walk over it
    garble(path, len(path.read_bytes()) - 8 - 4)  # the summary's checksum
    found, losses = read(path)
    assert [row["q"][0] for row in found["robot"]] == [0, 1, 2, 3, 4, 9]
    assert [(loss.offset, loss.messages) for loss in losses] == [(second.offset, 4)]
    with pytest.raises(DamagedFileError):
        read(path, "raise")


@pytest.mark.breaks_files
def test_a_finished_file_without_any_summary_is_read_up_to_the_damage(path):
    second = chunks_of(path)[1]
    data = path.read_bytes()
    path.write_bytes(data[: second.offset] + bytes(100) + data[second.offset :][:-37] + raw.footer(0))
    found, losses = read(path)
    assert [row["q"][0] for row in found["robot"]] == [0, 1, 2, 3, 4]
    assert [(loss.offset, loss.messages) for loss in losses] == [(second.offset, None)]


@pytest.mark.breaks_files
def test_bytes_missing_from_the_middle_lose_what_lies_behind_them_at_most(path):
    second = chunks_of(path)[1]
    data = path.read_bytes()
    path.write_bytes(data[: second.offset + 30] + data[second.offset + 60 :])
    found, losses = read(path)
    assert [row["q"][0] for row in found["robot"]][:5] == [0, 1, 2, 3, 4]
    assert losses


@pytest.mark.breaks_files
def test_a_message_index_that_no_walk_recognises_loses_nothing(tmp_path):
    path = tmp_path / "file.mcap"
    path.write_bytes(small(CompressionType.NONE, use_statistics=False))
    rows, _ = read(path, "raise")
    for chunk in chunks_of(path):
        garble(path, min(chunk.message_index_offsets.values()), b"\x90")  # an application's own kind of record
    assert read(path, "raise")[0] == rows


def test_a_file_without_its_end_says_so_and_is_read(tmp_path):
    path = tmp_path / "file.mcap"
    path.write_bytes(raw.header() + raw.schema() + raw.channel() + raw.chunk(raw.message(1, 1, b'{"a":1}')))
    for on_damage in ("raise", "skip"):
        found, [loss] = read(path, on_damage)
        assert found == {"t": [{"a": 1, "_ts": 1e-9}]}
        assert (loss.offset, loss.messages) == (path.stat().st_size, None)


def test_a_recording_in_progress_has_lost_nothing(tmp_path):
    with Recorder(tmp_path / "run", RecorderOptions(backlog_bytes=4 * 1024 * 1024)) as recorder:
        for i in range(100):
            recorder.topic("robot").append(q=i, _ts=i / 30)
            if i % 10 == 0:
                recorder.flush()
                with Recording(tmp_path / "run") as rec:
                    assert rec.losses == []
                    assert len(rec["robot"]) == i + 1


@pytest.mark.skipif(not hasattr(os, "pread"), reason="files are read in another way")
@pytest.mark.parametrize("on_damage", ["raise", "skip"])
def test_what_a_disk_cannot_read_is_lost_with_its_chunk(path, on_damage, monkeypatch):
    first, second, _ = chunks_of(path)
    read_really = os.pread

    def read_from_a_bad_disk(descriptor: int, length: int, offset: int) -> bytes:
        if offset <= second.offset + 20 < offset + length:
            raise OSError(errno.EIO, "Input/output error")
        return read_really(descriptor, length, offset)

    with Recording(path, on_damage=on_damage) as rec:
        monkeypatch.setattr(os, "pread", read_from_a_bad_disk)
        if on_damage == "skip":
            assert [row["q"][0] for row in rec["robot"].rows()] == [0, 1, 2, 3, 4, 9]
            assert [(loss.offset, loss.messages) for loss in rec.losses] == [(second.offset, 4)]
        else:
            with pytest.raises(DamagedFileError, match="the disk cannot read this"):
                list(rec["robot"].rows(5 / 30, 8 / 30))
        assert len(list(rec["imu"].rows(0.0, 0.1))) == 1
    assert first.end < second.offset


# -- several files -----------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run's folder of two sound files, one that is empty and one that is something else."""
    folder = tmp_path / "run"
    save(folder / "1.mcap", CHUNKS[:1])
    (folder / "2.mcap").write_bytes(b"")
    (folder / "3.mcap").write_bytes(b"no MCAP file at all")
    save(folder / "4.mcap", CHUNKS[1:])
    return folder


@pytest.mark.breaks_files
def test_a_file_in_a_folder_that_is_no_mcap_file_is_lost_and_the_others_read(folder):
    found, losses = read(folder)
    assert [row["q"][0] for row in found["robot"]] == list(range(10))
    assert [(loss.path.name, loss.offset, loss.messages) for loss in losses] == [
        ("2.mcap", 0, None),
        ("3.mcap", 0, None),
    ]
    with pytest.raises(DamagedFileError, match=r"2\.mcap"):
        read(folder, "raise")


@pytest.mark.breaks_files
def test_one_of_several_files_that_is_no_mcap_file_is_lost_and_the_others_read(folder):
    with Recording([folder / "3.mcap", folder / "1.mcap"], on_damage="skip") as rec:
        assert len(list(rec["robot"].rows())) == 5
        assert [loss.path.name for loss in rec.losses] == ["3.mcap"]


@pytest.mark.breaks_files
def test_the_only_file_that_was_asked_for_is_an_error_if_it_is_no_mcap_file(folder):
    with pytest.raises(DamagedFileError, match="empty"):
        Recording(folder / "2.mcap", on_damage="skip")


@pytest.mark.breaks_files
def test_a_file_that_has_become_whole_is_lost_no_more(folder):
    with Recording(folder, on_damage="skip") as rec:
        (folder / "3.mcap").unlink()
        save(folder / "2.mcap", [{"robot": [{"q": [10, 0.5], "_ts": 1.0}]}])
        assert rec.refresh()
        assert rec.losses == []
        assert rec["robot"].last()["q"] == [10, 0.5]


# -- the ways in -------------------------------------------------------------------------------------------------------


def test_what_to_do_on_damage_is_one_of_two_words(path):
    with pytest.raises(OptionError, match="neither"):
        Recording(path, on_damage="ignore")


def test_limits_decide_what_is_refused(path):
    tight = Limits(chunk_bytes=200)
    with Recording(path, limits=tight) as rec, pytest.raises(DamagedFileError, match=r"limit is 200 \(Limits\.chunk"):
        list(rec["robot"].rows())
    with Recording(path, limits=tight, on_damage="skip") as rec:
        expected, lost = fitting(path, 200)
        assert [row["q"][0] for row in rec["robot"].rows()] == expected
        assert [loss.messages for loss in rec.losses] == lost


def fitting(path: Path, room: int) -> tuple[list[int], list[int]]:
    """The rows of `robot` whose records fit into so many bytes of their chunk, and how many messages of each do not."""
    rows, lost, robots = [], [], set()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        robots = {one.id for one in summary.channels.values() if one.topic == "robot"}
        file.seek(0)
        chunks = [one for one in StreamReader(file, emit_chunks=True).records if isinstance(one, mcap_records.Chunk)]
    for chunk in chunks:
        messages = [one for one in breakup_chunk(chunk) if isinstance(one, Message)]
        is_over, used, left_out = chunk.uncompressed_size > room, 0, 0
        for one in messages:
            size = 31 + len(one.data)
            if is_over and used + size > room:
                left_out += 1
                continue
            used += size
            if one.channel_id in robots:
                rows.append(json.loads(one.data)["q"][0])
        lost += [left_out] if left_out else []
    return rows, lost


def test_a_large_row_that_compresses_like_a_bomb_is_written_so_that_it_is_read(tmp_path):
    with Recorder(tmp_path / "run", RecorderOptions(backlog_bytes=96 * 1024 * 1024)) as recorder:
        recorder.topic("camera").append(image="0" * (40 * 1024 * 1024), _ts=1.0)
    with Recording(tmp_path / "run") as rec:
        assert len(rec["camera"].last()["image"]) == 40 * 1024 * 1024


def test_the_error_says_where_and_what_in_another_process_too(path):
    error = DamagedFileError(path, 7, "something is wrong")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.path, again.offset, again.what) == (str(error), path, 7, "something is wrong")


def test_a_draft_is_read_as_it_was_made(path):
    assert path.read_bytes() == finished(draft(CHUNKS))
    assert read(path)[1] == []
