"""Rows have the same meaning in whichever encoding they lie: every export, every read and every summary is the same."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from ml_dash_mcap import Recorder, RecorderOptions, Recording, convert
from ml_dash_mcap.formats import registry

ENCODINGS = ("json", "cbor", "protobuf")
COUNT = 300

UNITS = {"robot": {"q": "rad", "ee_pos": "m"}, "markers": {"hand_pos": "m"}}


def robot(at: int) -> dict[str, Any]:
    """Fields of fixed types, integers among fractions, and a field that comes late."""
    row: dict[str, Any] = {"q": [0.1 * at, 0.2, -0.0], "ee_pos": [0.5, 0, 0.25] if at % 2 else [0.5, 0.0, 0.25]}
    row |= {"ee_quat": [0.0, 0.0, 0.6, 0.8], "phase": f"reach {at}", "step": at, "grasped": bool(at % 2)}
    row |= {"gripper": 0.04 if at % 3 else 1, "pose": {"frame": "base", "matrix": [[1.0, at], [0.5, 2.0]]}}
    return row if at < 200 else {**row, "late": [1, 2, 3]}


def markers(at: int) -> dict[str, Any]:
    return {"hand_pos": [0.1 * at, 0.2, 0.3], "hand_quat": [0.0, 0.0, 0.0, 1.0]}


def clouds(at: int) -> dict[str, Any]:
    """Large arrays beside lists."""
    return {"points": (np.arange(600, dtype="f4") + at).reshape(200, 3), "mask": np.arange(40) % 3 == 0, "n": at}


def gaps(at: int) -> dict[str, Any]:
    """Fields that some rows lack, and that are None in others."""
    row: dict[str, Any] = {"n": at if at % 5 else at + 0.5, "f": math.nan if at % 7 else -math.inf}
    row |= {"goal": 1.5} if at % 4 == 0 else {}
    row |= {"data": b"\x00\xff", "big": 2**63 + at} if at % 11 == 0 else {}
    row |= {"dicts": [{"a": 1}, {"a": 0.5, "b": "x"}], "d": {"x": {"y": at}, "e": {}}} if at % 13 == 0 else {}
    return row | ({"last": None if at % 2 else f"x{at}"} if at % 3 == 0 else {})


TOPICS: dict[str, Callable[[int], dict[str, Any]]] = {
    "robot": robot,
    "markers": markers,
    "clouds": clouds,
    "gaps": gaps,
}

OF_TAKES = {
    "vicon": "markers",
    "qtm": "markers",
    "trc": "markers",
    "c3d": "markers",
    "mocap": "markers",
    "sto": "robot",
}

SUFFIXES = {"rosbag1": ".bag", "trc": ".trc", "sto": ".sto", "qtm": ".tsv", "c3d": ".c3d"}


def record(folder: Path, encoding: str = "json") -> Path:
    options = RecorderOptions(encoding=encoding, chunk_bytes=64 * 1024)
    with Recorder(folder, options, prefix="run") as recorder:
        recorder.set_parameters({"gain": 0.5})
        for name, make in TOPICS.items():
            topic = recorder.topic(name, units=UNITS.get(name), description=name)
            for at in range(COUNT):
                topic.append(**make(at), _ts=0.01 * at)
            topic.append(extra=1, _ts=0.05)  # merges with a row of before
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same run in each encoding: the copies have its id and its metadata, which some formats state."""
    folder = tmp_path_factory.mktemp("runs")
    made = {"json": record(folder / "json" / "run")}
    for encoding in ENCODINGS[1:]:
        made[encoding] = convert(made["json"], folder / encoding / "run", encoding=encoding)
    return made


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same rows, recorded in each encoding."""
    folder = tmp_path_factory.mktemp("recorded")
    return {encoding: record(folder / encoding / "run", encoding) for encoding in ENCODINGS}


def files(path: Path) -> dict[str, bytes]:
    if path.is_file():
        return {"": path.read_bytes()}
    return {inside.relative_to(path).as_posix(): inside.read_bytes() for inside in path.rglob("*") if inside.is_file()}


def tables(path: Path) -> dict[str, Any]:
    """The tables of a folder of Parquet files, without what they state about their source: its run, encoding and schema."""

    return {file.name: table(file.read_bytes()) for file in path.rglob("*.parquet")}


def table(data: bytes) -> pa.Table:
    read = pq.read_table(pa.BufferReader(data))
    about = json.loads(read.schema.metadata[b"ml_dash"])
    for key in ("encoding", "schema", "schema_name", "source"):
        del about[key]
    return read.replace_schema_metadata({"ml_dash": json.dumps(about)})


CONTENTS: dict[str, Callable[[Path], Any]] = {"parquet": tables}
"""What is compared of a format whose files state more than the rows."""


def check_equal(actual: Any, expected: Any, what: str) -> None:
    if isinstance(expected, pa.Table):
        assert actual.schema.equals(expected.schema, check_metadata=True), what
        np.testing.assert_equal(actual.to_pylist(), expected.to_pylist(), err_msg=what)  # NaN is NaN here
    elif isinstance(expected, bytes):
        assert actual == expected, what
    else:
        np.testing.assert_equal(actual, expected, err_msg=what)


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.ConversionWarning", "ignore:there are messages at time 0")
@pytest.mark.parametrize("format", sorted({*registry.names("write")} - {"mcap"}))
def test_an_export_is_the_same_from_every_encoding(tmp_path: Path, runs: dict[str, Path], format: str) -> None:
    if format == "c3d":
        pytest.importorskip("ezc3d")
    results = {}
    for encoding, run in runs.items():
        # A session's folder is named in what dreamlake reads, so all lie in the same place, one after the other.
        source = tmp_path / "source" / "run"
        shutil.copytree(run, source)
        dest = tmp_path / f"out{SUFFIXES.get(format, '')}"
        with Recording(source) as recording:
            topics = [OF_TAKES[format]] if format in OF_TAKES else None
            topics = ["robot", "markers", "gaps"] if format == "dreamlake" else topics
            recording.export(dest, format=format, topics=topics)
        results[encoding] = CONTENTS.get(format, files)(dest)
        for made in tmp_path.iterdir():
            shutil.rmtree(made) if made.is_dir() else made.unlink()
    assert results["json"]
    for encoding in ENCODINGS[1:]:
        assert results[encoding].keys() == results["json"].keys()
        for name, result in results[encoding].items():
            check_equal(result, results["json"][name], f"{encoding}: {name}")


def test_a_bag_of_typed_rows_is_what_rosbags_reads_of_json(tmp_path: Path, runs: dict[str, Path]) -> None:
    read = {}
    for encoding, run in runs.items():
        with Recording(run) as recording:
            bag = recording.export(tmp_path / encoding, format="rosbag2", topics=["robot"])
        with AnyReader([bag]) as reader:
            read[encoding] = [
                (connection.topic, connection.msgtype, time, bytes(data))
                for connection, time, data in reader.messages()
            ]
    assert read["json"] == read["cbor"] == read["protobuf"]
    assert len({topic for topic, *_ in read["json"]}) > 1


@pytest.mark.parametrize("made", ["runs", "recorded"])
@pytest.mark.parametrize("topic", TOPICS)
def test_every_read_is_the_same_from_every_encoding(request: pytest.FixtureRequest, made: str, topic: str) -> None:
    with Recording(request.getfixturevalue(made)["json"]) as recording:
        expected = every_read(recording, topic)
    for encoding in ENCODINGS[1:]:
        with Recording(request.getfixturevalue(made)[encoding]) as recording:
            actual = every_read(recording, topic)
            assert recording.topics[topic].encoding == encoding
        if made == "recorded":  # in which block a late row lies depends on the size of the rows
            expected.pop("findings", None)
        # Rows that are encoded by a template of their like may come back with their keys in its order.
        in_order = not (made == "recorded" and topic == "gaps" and encoding == "protobuf")
        if not in_order:
            expected.pop("jsonl", None)
        for name, value in expected.items():
            check_equal(actual[name], value, f"{encoding}: {name}")
        assert not in_order or [list(row) for row in actual["rows"]] == [list(row) for row in expected["rows"]], (
            "the order of keys"
        )


def every_read(recording: Recording, topic: str) -> dict[str, Any]:
    """What each way of reading a topic returns, and what is told about it."""
    reader, info = recording[topic], recording.topics[topic]
    part = reader.select(start=0.1, end=1.0)
    field = next(name for name in info.fields if "." not in name)
    return {
        "rows": list(reader.rows()),
        "arrow": reader.to_arrow(),
        "column": reader.to_arrow(columns=[field]),
        "window": part.arrow(),
        "window of rows": list(part.rows()),
        "numpy": reader.to_numpy(),
        "at": [reader.at(time) for time in (0.0, 0.055, 1.0)],
        "count": len(reader),
        "json": reader.read(),
        "jsonl": reader.read(format="jsonl"),
        "parquet": table(reader.read(format="parquet")),
        "aligned": recording.align([topic, "markers"], hz=50, how="nearest"),
        "gaps": recording.gaps(topic),
        "findings": [str(finding) for finding in recording.check()],
        "fields": {name: str(field) for name, field in info.fields.items()} if topic != "robot" else None,
        "told": (info.kind, info.count, info.start, info.end, info.description, info.tags, info.metadata),
        "types": types_of(info.schema),
    }


def types_of(schema: Any) -> Any:
    """A JSON Schema without the lengths of lists and arrays, which only rows tell."""
    if not isinstance(schema, dict):
        return schema
    lengths = ("minItems", "maxItems", "description")
    return {name: types_of(value) for name, value in schema.items() if name not in lengths}


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_topic_as_mcap_is_the_same_rows_in_the_encoding_they_have(
    tmp_path: Path, runs: dict[str, Path], encoding: str
) -> None:
    with Recording(runs[encoding]) as recording:
        for topic in TOPICS:
            data = recording[topic].read(0.1, 2.5, format="mcap")
            (tmp_path / "part.mcap").write_bytes(data)
            with (tmp_path / "part.mcap").open("rb") as stream:
                found = [(schema, channel) for schema, channel, _ in make_reader(stream).iter_messages()]
            assert {(channel.topic, channel.message_encoding) for _, channel in found} == {(topic, encoding)}
            assert len({schema.data for schema, _ in found}) == 1
            with Recording(tmp_path / "part.mcap") as part:
                np.testing.assert_equal(list(part[topic].rows()), list(recording[topic].select(0.1, 2.5).rows()))


@pytest.mark.parametrize("topic", TOPICS)
def test_a_run_whose_segments_differ_in_encoding_is_read_as_one(tmp_path: Path, topic: str) -> None:
    rows = [{**TOPICS[topic](at), "_ts": 0.01 * at} for at in range(90)]
    for number, encoding in enumerate(ENCODINGS):
        with Recorder(tmp_path / "mixed", RecorderOptions(encoding=encoding)) as recorder:
            for row in rows[30 * number : 30 * number + 35]:  # some rows come twice, and merge
                recorder.topic(topic).append(**row)
    with Recorder(tmp_path / "plain") as recorder:
        for row in rows:
            recorder.topic(topic).append(**row)
    with Recording(tmp_path / "mixed") as mixed, Recording(tmp_path / "plain") as plain:
        np.testing.assert_equal(list(mixed[topic].rows()), list(plain[topic].rows()))
        assert mixed[topic].to_arrow().schema.names == plain[topic].to_arrow().schema.names
        np.testing.assert_equal(mixed[topic].to_arrow().to_pylist(), plain[topic].to_arrow().to_pylist())
        (tmp_path / "part.mcap").write_bytes(mixed[topic].read(format="mcap"))
        with Recording(tmp_path / "part.mcap") as part:
            np.testing.assert_equal(list(part[topic].rows()), list(plain[topic].rows()))


def test_segments_whose_layout_is_older_are_read_with_later_ones(tmp_path: Path) -> None:
    options = RecorderOptions(encoding="protobuf")
    for at, fields in enumerate(({"a": 1}, {"a": 1.5, "b": [1.0]}, {"b": "text", "c": {"x": [1, 2]}}, {"a": 2})):
        with Recorder(tmp_path / "run", options) as recorder:
            recorder.topic("x").append(**fields, _ts=float(at))
    convert(tmp_path / "run", tmp_path / "json", encoding="json")
    with Recording(tmp_path / "run") as typed, Recording(tmp_path / "json") as plain:
        assert len(typed.segments) == 4
        assert list(typed["x"].rows()) == list(plain["x"].rows())
        assert typed["x"].to_arrow().equals(plain["x"].to_arrow())
        (tmp_path / "part.mcap").write_bytes(typed["x"].read(format="mcap"))
        with Recording(tmp_path / "part.mcap") as part:
            assert list(part["x"].rows()) == list(plain["x"].rows())
