"""A recording's rows are encoded anew as the rows, times and descriptions that they were, and so are foreign rows."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory

from ml_dash_mcap import (
    ConversionWarning,
    DestinationExistsError,
    Experiment,
    OptionError,
    Recorder,
    RecorderOptions,
    Recording,
    UsageError,
    convert,
)
from tests.support.bags import ROBOT, export
from tests.support.protobuf_messages import NAME, descriptor_set, message_class

ENCODINGS = ("json", "cbor", "protobuf")

CLOUD = np.arange(3000, dtype="f4").reshape(1000, 3)

ROWS: list[dict[str, Any]] = [
    {"q": [0.1, -0.0, 1e300], "n": 1, "name": "a"},
    {"n": 2**63, "f": math.nan, "mixed": [1, "a", None], "goal": None, "d": {"x": {"y": 1}, "e": {}}},
    {"q": [1, 2.5, 3], "b": b"\x00\xff", "matrix": [[1.0, 2.0], [3.0, 4.0]], "ragged": [[1], [2, 3]], "empty": []},
    {"cloud": CLOUD, "dicts": [{"a": 1}, {"b": 0.5}], "flag": True, "inf": -math.inf, "text": "\N{SNOWMAN}\0"},
]


def record(folder: Path, encoding: str = "json", count: int = 40) -> Path:
    """Record rows of every kind, some of which share a time stamp, beside what a run has else."""
    options = RecorderOptions(encoding=encoding, chunk_bytes=64 * 1024)
    with Recorder(folder, options, prefix="alice/demo", metadata={"site": "lab"}) as recorder:
        recorder.set_parameters({"gain": 0.5})
        arm = recorder.topic("robot/arm", units={"q": "rad"}, joint_names=["a", "b", "c"], description="an arm")
        for number in range(count):
            arm.append(**ROWS[number % len(ROWS)], _ts=0.1 * (number // 3))
        recorder.topic("tool").append(force=[1.0, 2.0], _ts=1.1)
        recorder.topic("nothing yet")
    return folder


def contents(path: Path) -> dict[str, Any]:
    """Everything of a recording that does not depend on the encoding."""
    with Recording(path) as recording:
        return {
            "rows": {name: list(topic.rows()) for name, topic in recording.items()},
            "topics": {
                name: (info.kind, info.count, info.start, info.end, info.description, info.tags, info.metadata)
                for name, info in recording.topics.items()
            },
            "metadata": recording.metadata,
            "params": recording.params,
            "logs": recording.logs,
            "metrics": dict(recording.metrics),
            "episodes": recording.episodes,
            "files": recording.files,
            "attachments": {name: each.read() for name, each in recording.attachments.items()},
            "runs": [(run.id, run.status, run.start, run.end) for run in recording.runs],
            "segments": [segment.name for segment in recording.segments],
        }


def messages(path: Path) -> list[tuple[str, int, int, int]]:
    """Topic, log time, publish time and sequence number of all messages, as the `mcap` package finds them."""
    found = []
    for file in sorted(path.glob("*.mcap")):
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                found.append((channel.topic, message.log_time, message.publish_time, message.sequence))
    return found


def encodings(path: Path) -> dict[str, str]:
    with Recording(path) as recording:
        return {name: info.encoding for name, info in recording.topics.items()}


def check_same(first: Path, second: Path) -> None:
    np.testing.assert_equal(contents(second), contents(first))
    assert exact_types(contents(second)["rows"]) == exact_types(contents(first)["rows"])
    assert messages(second) == messages(first)


def exact_types(value: Any) -> Any:
    """The types of a value and of all that is in it: assertions take 1 for 1.0 and True."""
    if isinstance(value, dict):
        return {key: exact_types(inner) for key, inner in value.items()}
    return [exact_types(inner) for inner in value] if isinstance(value, list) else type(value)


@pytest.mark.parametrize("source", ENCODINGS)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_rows_are_the_same_in_every_encoding_and_back(tmp_path: Path, source: str, encoding: str) -> None:
    run = record(tmp_path / "run", source)
    convert(run, tmp_path / "new", encoding=encoding)
    assert set(encodings(tmp_path / "new").values()) == {encoding}
    check_same(run, tmp_path / "new")
    convert(tmp_path / "new", tmp_path / "back", encoding=source)
    assert set(encodings(tmp_path / "back").values()) == {source}
    check_same(run, tmp_path / "back")


def test_the_protobuf_package_reads_what_was_json(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("arm").append_batch([{"q": [0.5 * at, 1.0], "step": at, "_ts": float(at)} for at in range(500)])
    convert(tmp_path / "run", tmp_path / "typed", encoding="protobuf")
    [file] = (tmp_path / "typed").glob("*.mcap")
    with file.open("rb") as stream:
        decoded = [
            each.decoded_message
            for each in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        ]
    assert [(list(each.q), each.step) for each in decoded] == [([0.5 * at, 1.0], at) for at in range(500)]


def test_a_schema_that_outgrows_its_room_is_whole_and_there_once(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run", RecorderOptions(segment_bytes=2**30)) as recorder:
        topic = recorder.topic("growing")
        topic.append(first=1, _ts=0.0)
        topic.append_batch([{f"a_rather_long_name_{at}": float(at), "_ts": 1.0 + at} for at in range(150)])
    source = merged(tmp_path / "run", tmp_path / "one.mcap")
    progress: list[tuple[int, int]] = []
    for number, encoding in enumerate(("protobuf", "json")):
        dest = tmp_path / f"{number}.mcap"
        convert(source, dest, format="mcap", encoding=encoding, progress=lambda *done: progress.append(done))
        with dest.open("rb") as stream:
            in_data = [
                record for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Schema)
            ]
        schemas = {schema.data for schema in in_data}
        assert len(in_data) == 2 and len(schemas) == 1, "one in the data section, the same in the summary"
        assert b"a_rather_long_name_149" in schemas.pop()
        with Recording(source) as before, Recording(dest) as after:
            assert list(after["growing"].rows()) == list(before["growing"].rows())
        assert progress == sorted(progress) and progress[-1] == (151, 151)
        progress.clear()
        source = dest


def merged(folder: Path, dest: Path) -> Path:
    """Write a recording's rows of one topic as one file whose schema says nothing, as other tools do."""
    with Recording(folder) as recording, dest.open("wb") as stream:
        writer = Writer(stream, chunk_size=1000)
        writer.start()
        [topic] = recording
        schema_id = writer.register_schema(topic, "jsonschema", b'{"type":"object"}')
        channel_id = writer.register_channel(topic, "json", schema_id)
        for row in recording[topic].rows():
            time_ns = round(row["_ts"] * 1e9)
            writer.add_message(channel_id, time_ns, json.dumps(row).encode(), time_ns)
        writer.finish()
    return dest


# -- files of others ---------------------------------------------------------------------------------------------------


def foreign(path: Path, add: Callable[[Writer], None], compression: CompressionType = CompressionType.ZSTD) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start("", "somebody 1.0")
        add(writer)
        writer.finish()
    return path


def odd_json(writer: Writer) -> None:
    channel = writer.register_channel("/odd", "json", 0, {"origin": "elsewhere"})
    for sequence, payload in enumerate((b'{"a":1}', b'{"a":2.0,"_ts":7}', b"[1,2]", b'{"a":NaN}', b"", b'{"a":1}')):
        writer.add_message(channel, 5_000_000_007, payload, 4_000_000_000, sequence)
    writer.add_attachment(3, 4, "notes.txt", "text/plain", b"hello")
    writer.add_metadata("somewhere", {"x": "y"})


@pytest.mark.breaks_files  # publish times of others differ from log times, which our recorder never writes
def test_rows_of_others_stay_apart_and_keep_their_times(tmp_path: Path) -> None:
    file = foreign(tmp_path / "odd.mcap", odd_json)
    convert(file, tmp_path / "typed", encoding="protobuf")
    convert(tmp_path / "typed", tmp_path / "back", encoding="json")
    with Recording(file) as before:
        rows = list(before["/odd"].rows())
    for folder in (tmp_path / "typed", tmp_path / "back"):
        with Recording(folder) as after:
            np.testing.assert_equal(list(after["/odd"].rows()), rows)
            assert after.attachments["notes.txt"].read() == b"hello"
            assert ("somewhere", {"x": "y"}) in after.metadata
            assert after.topics["/odd"].kind is None
        assert messages(folder) == [("/odd", 5_000_000_007, 4_000_000_000, at) for at in range(6)]
    assert len(rows) == 6


def test_one_file_can_become_one_file(tmp_path: Path) -> None:
    file = foreign(tmp_path / "x.mcap", rows_in_chunks)
    assert convert(file, tmp_path / "typed.mcap", format="mcap", encoding="protobuf").is_file()
    record(tmp_path / "run")
    record(tmp_path / "run")
    with pytest.raises(UsageError, match="name a folder"):
        convert(tmp_path / "run", tmp_path / "run.mcap", format="mcap", encoding="protobuf")
    assert not (tmp_path / "run.mcap").exists()


def typed_messages(writer: Writer) -> None:
    numbers = {
        "protobuf": writer.register_schema(NAME, "protobuf", descriptor_set()),
        "cdr": writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data"),
        "json": writer.register_schema("foxglove.Log", "jsonschema", b'{"type":"object"}'),
    }
    payloads = {
        "protobuf": message_class()(a_int32=3).SerializeToString(),
        "cdr": b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00",
        "json": b'{"message":"hi"}',
    }
    for encoding, schema in numbers.items():
        channel = writer.register_channel(f"of {encoding}", encoding, schema)
        writer.add_message(channel, 1, payloads[encoding], 1)
    channel = writer.register_channel("unknown", "flatbuffer", 0)
    writer.add_message(channel, 1, b"\1\2", 1)


@pytest.mark.breaks_files  # a channel of others may lack a schema, which none of our recorder's does
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_messages_of_types_of_their_own_stay_as_they_are(tmp_path: Path, encoding: str) -> None:
    file = foreign(tmp_path / "typed.mcap", typed_messages)
    convert(file, tmp_path / "new", encoding=encoding)

    def all_of(path: Path) -> list[tuple[Any, ...]]:
        with path.open("rb") as stream:
            found = make_reader(stream).iter_messages()
            return [
                (
                    schema and (schema.name, schema.encoding, schema.data),
                    channel.topic,
                    channel.message_encoding,
                    message.data,
                )
                for schema, channel, message in found
            ]

    [copy] = (tmp_path / "new").glob("*.mcap")
    assert all_of(copy) == all_of(file) and len(all_of(file)) == 4


def test_a_bag_becomes_typed_rows_only_if_that_is_asked_for(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append_batch([{**ROBOT, "_ts": 0.01 * at} for at in range(30)])
    bag = export(tmp_path / "run", tmp_path / "bag", profile="std")
    convert(bag, tmp_path / "carried")
    rows = {}
    for encoding in ENCODINGS:
        convert(bag, tmp_path / encoding, encoding=encoding)
        with Recording(tmp_path / encoding) as recording:
            rows[encoding] = {name: list(topic.rows()) for name, topic in recording.items()}
        assert set(encodings(tmp_path / encoding).values()) == {encoding}
    assert set(encodings(tmp_path / "carried").values()) == {"cdr"}
    with Recording(tmp_path / "carried") as recording:
        assert {name: list(topic.rows()) for name, topic in recording.items()} == rows["json"]
    assert rows["json"] == rows["cbor"] == rows["protobuf"] and rows["json"]


def test_a_table_and_a_take_are_recorded_in_the_encoding(tmp_path: Path) -> None:
    (tmp_path / "arm.csv").write_bytes("_ts,x,place\n0.0,1,Köln\n1.0,2.5,Bonn\n".encode())
    convert(tmp_path / "arm.csv", tmp_path / "typed", encoding="protobuf")
    assert encodings(tmp_path / "typed") == {"arm": "protobuf"}
    with Recording(tmp_path / "typed") as recording:
        assert next(recording["arm"].rows()) == {"x": 1.0, "place": "Köln", "_ts": 0.0}


def test_the_encoding_of_a_text_is_still_one_of_texts(tmp_path: Path) -> None:
    (tmp_path / "arm.csv").write_bytes("_ts,place\n0.0,Köln\n".encode("latin-1"))
    convert(tmp_path / "arm.csv", tmp_path / "run", encoding="latin-1")
    with Recording(tmp_path / "run") as recording:
        assert list(recording["arm"].rows()) == [{"place": "Köln", "_ts": 0.0}]


# -- parts, places, mistakes -------------------------------------------------------------------------------------------


def test_logs_metrics_episodes_and_saved_files_come_along(tmp_path: Path) -> None:
    with Experiment("p", root=tmp_path / "root").run as experiment:
        experiment.tracks("arm").append(q=[1.0, 2.0], _ts=1.0)
        experiment.log("hello")
        experiment.metrics("train").log(loss=0.5)
        experiment.files.save_text("some text", to="notes.txt")
    [folder] = {path.parent for path in (tmp_path / "root").rglob("*.mcap")}
    convert(folder, tmp_path / "typed", encoding="protobuf")
    check_same(folder, tmp_path / "typed")
    saved = [path.relative_to(folder) for path in (folder / "files").rglob("*") if path.is_file()]
    assert saved and all((tmp_path / "typed" / path).read_bytes() == (folder / path).read_bytes() for path in saved)
    with Recording(tmp_path / "typed") as recording:
        assert recording.topics["arm"].encoding == "protobuf"
        assert recording.logs and recording.metrics["train"] and recording.files
        [file] = recording.segments
    with file.open("rb") as stream:
        channels = {channel.topic: channel for _, channel, _ in make_reader(stream).iter_messages()}
    assert channels["ml_dash/log"].message_encoding == "json", "viewers show logs in JSON"


@pytest.mark.parametrize("encoding", [None, "protobuf"])
def test_a_window_of_some_topics_is_a_recording(tmp_path: Path, encoding: str | None) -> None:
    run = record(tmp_path / "run")
    with Recording(run) as recording:
        recording.export(tmp_path / "cut", format="mcap", topics=["robot/arm"], start=0.2, end=0.6, encoding=encoding)
        rows = list(recording["robot/arm"].select(start=0.2, end=0.6).rows())
    with Recording(tmp_path / "cut") as cut:
        assert list(cut) == ["robot/arm"]
        np.testing.assert_equal(list(cut["robot/arm"].rows()), rows)
        assert cut.params == {"gain": 0.5} and cut.topics["robot/arm"].metadata["units"] == {"q": "rad"}
    assert len(rows) > 3


def test_a_run_that_was_continued_in_another_encoding_becomes_one(tmp_path: Path) -> None:
    run = record(tmp_path / "run", "json")
    record(run, "protobuf")
    record(run, "cbor")
    for encoding in ENCODINGS:
        convert(run, tmp_path / encoding, encoding=encoding)
        check_same(run, tmp_path / encoding)
        assert set(encodings(tmp_path / encoding).values()) == {encoding}


def test_only_an_earlier_recording_is_replaced(tmp_path: Path) -> None:
    run = record(tmp_path / "run")
    convert(run, tmp_path / "typed", encoding="protobuf")
    with pytest.raises(DestinationExistsError):
        convert(run, tmp_path / "typed", encoding="cbor")
    convert(run, tmp_path / "typed", encoding="cbor", overwrite=True)
    assert set(encodings(tmp_path / "typed").values()) == {"cbor"}
    with pytest.raises(DestinationExistsError, match="is what is read here"):
        convert(run, run, encoding="cbor", overwrite=True)
    (tmp_path / "typed/mine.txt").write_text("mine")
    with pytest.raises(DestinationExistsError, match=r"mine\.txt"):
        convert(run, tmp_path / "typed", encoding="json", overwrite=True)


@pytest.mark.parametrize("encoding", ["protobuff", "cdr", 7])
def test_an_encoding_that_rows_have_not_is_refused(tmp_path: Path, encoding: Any) -> None:
    run = record(tmp_path / "run")
    (tmp_path / "arm.jsonl").write_text('{"_ts": 0.0}\n')
    for source in (run, tmp_path / "arm.jsonl"):
        with pytest.raises(OptionError, match="encoding"):
            convert(source, tmp_path / "new", encoding=encoding)
        assert not (tmp_path / "new").exists()


def test_rows_in_another_format_have_no_encoding(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="encoding"):
        convert(record(tmp_path / "run"), tmp_path / "arm.parquet", encoding="protobuf")


@pytest.mark.breaks_files
def test_a_damaged_chunk_is_refused_or_left_out_with_a_warning(tmp_path: Path) -> None:
    file = foreign(tmp_path / "a.mcap", rows_in_chunks, CompressionType.NONE)
    data = bytearray(file.read_bytes())
    data[data.index(b'"n":1500') + 5] ^= 1
    file.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(Exception, match="checksum"):
            convert(file, tmp_path / "new", encoding="protobuf")
    assert not (tmp_path / "new").exists()
    with pytest.warns(ConversionWarning, match="left out"):
        convert(file, tmp_path / "new", encoding="protobuf", on_damage="skip")
    with Recording(file, on_damage="skip") as before, Recording(tmp_path / "new") as after:
        assert list(after["x"].rows()) == list(before["x"].rows()) and 0 < after.topics["x"].count < 3000


def rows_in_chunks(writer: Writer) -> None:
    channel = writer.register_channel("x", "json", 0)
    for number in range(3000):
        writer.add_message(channel, number, b'{"n":%d,"fill":"%s"}' % (number, b"x" * 900), number)
