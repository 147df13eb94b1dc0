"""Topics whose schema the user gives: what is stored fits it, is what others read, and survives as all rows do."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pyarrow import parquet

from ml_dash_mcap import Experiment, PreparedBlock, Recorder, RecorderOptions, Recording, Session, Topic, convert
from ml_dash_mcap.errors import (
    BacklogFullError,
    FieldError,
    OptionError,
    StateError,
    TimestampError,
    TopicError,
    UsageError,
)
from tests import given_workload
from tests.given_workload import SCHEMA, pose
from tests.interruptions import at_every_point
from tests.support import disk


def messages(folder: Path, topic: str) -> Iterator[tuple[str, int, Any, bytes]]:
    """Schema, log time (ns), message and payload, as mcap-protobuf-support reads them."""
    for path in disk.segments(folder):
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for schema, _, message, decoded in reader.iter_decoded_messages(topics=[topic]):
                assert schema is not None and schema.encoding == "protobuf"
                yield schema.name, message.log_time, decoded, message.data


def json_messages(folder: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Log time (ns) and row, each checked with the schema in the file."""
    for path in disk.segments(folder):
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages(topics=[topic]):
                assert schema is not None and (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                row = json.loads(message.data)
                jsonschema.validate(row, json.loads(schema.data))
                yield message.log_time, row


def rows(folder: Path, topic: str) -> list[dict[str, Any]]:
    with Recording(folder) as recording:
        return list(recording[topic].rows())


# what is stored


def test_rows_are_messages_that_protobufs_own_reader_decodes(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("tool", schema=PoseInFrame)
        topic.append(frame_id="base", timestamp=1.5, pose={"position": {"x": 0.5}}, _ts=1.5)
        topic.append_batch([{"frame_id": "b", "_ts": 2.0}, {"frame_id": "c", "timestamp": 3, "_ts": 3.0}])
        topic.append_columns(frame_id=["d", "e"], pose={"position": {"x": np.array([1.0, 2.0])}}, _ts=[4.0, 5.0])
    expected = [
        PoseInFrame(frame_id="base", timestamp={"seconds": 1, "nanos": 500_000_000}, pose={"position": {"x": 0.5}}),
        PoseInFrame(frame_id="b"),
        PoseInFrame(frame_id="c", timestamp={"seconds": 3}),
        PoseInFrame(frame_id="d", pose={"position": {"x": 1.0}}),
        PoseInFrame(frame_id="e", pose={"position": {"x": 2.0}}),
    ]
    read = list(messages(tmp_path, "tool"))
    assert [PoseInFrame.FromString(payload) for _, _, _, payload in read] == expected
    assert [str(decoded) for _, _, decoded, _ in read] == [str(message) for message in expected]
    assert [time_ns for _, time_ns, _, _ in read] == [1_500_000_000, *(n * 10**9 for n in (2, 3, 4, 5))]
    assert {name for name, _, _, _ in read} == {"foxglove.PoseInFrame"}
    assert rows(tmp_path, "tool")[0] == {
        "timestamp": {"seconds": 1, "nanos": 500_000_000},
        "frame_id": "base",
        "pose": {"position": {"x": 0.5, "y": 0.0, "z": 0.0}},
        "_ts": 1.5,
    }


def test_a_message_is_stored_byte_for_byte(tmp_path: Path) -> None:
    image = RawImage(width=2, height=1, encoding="mono8", step=2, data=b"\xff\x00")
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("image", schema="foxglove.RawImage")
        assert topic.append_message(image, _ts=0.1) is topic
        image.width = 3  # what is stored is a copy
        topic.append(width=2, height=1, encoding="mono8", step=2, data=np.array([[255, 0]], np.uint8), _ts=0.2)
    image.width = 2
    assert [(time_ns, payload) for _, time_ns, _, payload in messages(tmp_path, "image")] == [
        (100_000_000, image.SerializeToString()),
        (200_000_000, image.SerializeToString()),
    ]


def test_rows_of_one_time_stay_apart_as_messages_do(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for name in "ab":
            recorder.topic("tool", schema=PoseInFrame).append(frame_id=name, _ts=1.0)
            recorder.topic("step", schema=SCHEMA).append(n=ord(name), _ts=1.0)
        recorder.flush()
        recorder.topic("tool").append_message(PoseInFrame(frame_id="c"), _ts=1.0)
        assert recorder.stats().merged == 0
    assert [row["frame_id"] for row in rows(tmp_path, "tool")] == ["a", "b", "c"]
    assert rows(tmp_path, "step") == [{"n": 97, "_ts": 1.0}, {"n": 98, "_ts": 1.0}]
    with Recording(tmp_path) as recording:
        assert recording.topics["tool"].kind == "message"
        assert recording["tool"].to_arrow().column("frame_id").to_pylist() == ["a", "b", "c"]


def test_json_rows_fit_their_schema_wherever_they_are_read(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding="cbor")) as recorder:
        topic = recorder.topic("step", schema=SCHEMA)
        topic.append(n=1, _ts=0.5).append_batch([{"n": 2, "_ts": 1.0}])
        topic.append_columns(n=np.arange(3, 2000), _ts=np.arange(3, 2000) / 2)
        with pytest.raises(
            FieldError, match="topic 'step': the row does not fit the schema: field 'n': \"x\" is not of"
        ):
            topic.append(n="x", _ts=2.0)
        with pytest.raises(FieldError, match=r"row 1 of the batch: .*'m' was unexpected"):
            topic.append_batch([{"n": 1, "_ts": 2.0}, {"m": 2, "_ts": 3.0}])
        with pytest.raises(FieldError, match=r"field 'n': 0.5 is not of type"):
            topic.append_columns(n=[1, 2, 0.5], _ts=[1, 2, 3])
    assert list(json_messages(tmp_path, "step")) == [(n * 500_000_000, {"n": n}) for n in range(1, 2000)]
    assert rows(tmp_path, "step")[:2] == [{"n": 1, "_ts": 0.5}, {"n": 2, "_ts": 1.0}]
    with Recording(tmp_path) as recording:
        assert recording.topics["step"].schema_name == "Step"
        assert recording["step"].to_arrow().num_rows == 1999


def test_every_segment_has_the_schema(tmp_path: Path) -> None:
    options = RecorderOptions(segment_duration_s=1e-6)
    with Recorder(tmp_path, options) as recorder:
        for number in range(4):
            recorder.topic("tool", schema=PoseInFrame).append(frame_id=str(number), _ts=float(number))
            recorder.flush()
    assert len(disk.segments(tmp_path)) == 4
    assert [decoded.frame_id for _, _, decoded, _ in messages(tmp_path, "tool")] == ["0", "1", "2", "3"]


def test_another_run_in_the_folder_may_have_rows_without_a_schema(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("tool").append(frame_id="json", _ts=0.0)
    with Recorder(tmp_path) as recorder:
        recorder.topic("tool", schema=PoseInFrame).append(frame_id="typed", _ts=1.0)
    assert [row["frame_id"] for row in rows(tmp_path, "tool")] == ["json", "typed"]


# the schema of the first message


@pytest.mark.about_json
def test_a_topic_takes_the_schema_of_its_first_message(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("tool", description="of the arm", tags=["a"])
        assert topic.encoding == "json"
        topic.append_message(PoseInFrame(frame_id="a"), _ts=0.0)
        assert topic.encoding == "protobuf"
        topic.append(frame_id="b", _ts=1.0)
        assert recorder.topic("tool", schema=PoseInFrame) is recorder.topic("tool") is topic
        assert recorder.topic("tool", encoding="protobuf") is topic and recorder.topics() == ["tool"]
        with pytest.raises(TopicError, match="open in the encoding 'protobuf' already, not 'json'"):
            recorder.topic("tool", encoding="json")
    assert [decoded.frame_id for _, _, decoded, _ in messages(tmp_path, "tool")] == ["a", "b"]
    with Recording(tmp_path) as recording:
        info = recording.topics["tool"]
        assert (info.description, info.tags, info.kind) == ("of the arm", ("a",), "message")
    [segment] = disk.segments(tmp_path)
    with segment.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None and len(summary.channels) == len(summary.schemas) == 1


def test_a_topic_without_rows_may_be_given_its_schema_later(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("tool")
        assert recorder.topic("tool", schema=PoseInFrame) is topic
        topic.append_columns(frame_id=["a"], _ts=[0.0])
    assert [decoded.frame_id for _, _, decoded, _ in messages(tmp_path, "tool")] == ["a"]


@pytest.mark.parametrize("way", ["append", "append_batch", "append_columns", "refused"])
def test_a_topic_with_rows_takes_no_schema(tmp_path: Path, way: str) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("tool")
        if way == "append":
            topic.append(n=1, _ts=0.0)
        elif way == "append_batch":
            topic.append_batch([{"n": 1, "_ts": 0.0}])
        elif way == "append_columns":
            topic.append_columns(n=[1], _ts=[0.0])
        else:
            topic.append_message(PoseInFrame(), _ts=0.0)
        text = (
            "has the schema 'foxglove.PoseInFrame'" if way == "refused" else "has rows without a given schema already"
        )
        other = Log if way == "refused" else PoseInFrame
        with pytest.raises(TopicError, match=f"topic 'tool' {text}"):
            recorder.topic("tool", schema=other)
        if way != "refused":
            with pytest.raises(TopicError, match=text):
                topic.append_message(PoseInFrame(), _ts=1.0)
            topic.append(n=2, _ts=1.0)
    assert len(rows(tmp_path, "tool")) == (1 if way == "refused" else 2)


def test_threads_that_disagree_about_a_new_topic_get_one_schema(tmp_path: Path) -> None:
    taken: list[tuple[str, str]] = []
    with Recorder(tmp_path) as recorder:

        def work(name: str, start: threading.Barrier, mine: int) -> None:
            start.wait()
            for number in range(20):
                try:
                    if mine == 0:
                        recorder.topic(name).append(frame_id="r", _ts=number / 10)
                    elif mine == 1:
                        recorder.topic(name).append_message(PoseInFrame(frame_id="m"), _ts=number / 10 + 0.01)
                    else:
                        recorder.topic(name).append_message(Log(message="l"), _ts=number / 10 + 0.02)
                except (TopicError, UsageError, FieldError):
                    continue
                taken.append((name, "rml"[mine]))

        for round_ in range(30):
            start = threading.Barrier(3)
            threads = [threading.Thread(target=work, args=(f"t{round_}", start, mine)) for mine in range(3)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    with Recording(tmp_path) as recording:
        for name in recording.topics:
            stored = [row.get("frame_id") or row.get("message") for row in recording[name].rows()]
            assert sorted(stored) == sorted(letter for topic, letter in taken if topic == name)


def test_threads_that_agree_about_a_new_topic_are_all_taken(tmp_path: Path) -> None:
    errors: list[BaseException] = []
    with Recorder(tmp_path) as recorder:

        def work(name: str, start: threading.Barrier, is_message: bool) -> None:
            start.wait()
            try:
                for _ in range(5):
                    if is_message:
                        recorder.topic(name).append_message(PoseInFrame(frame_id="a"), _ts=1.0)
                    else:
                        recorder.topic(name, schema=PoseInFrame).append(frame_id="a", _ts=1.0)
            except Exception as error:
                errors.append(error)

        for number in range(50):
            start = threading.Barrier(4)
            threads = [threading.Thread(target=work, args=(f"t{number}", start, way % 2 == 0)) for way in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    assert errors == []
    with Recording(tmp_path) as recording:
        assert {info.count for info in recording.topics.values()} == {20}
        assert {info.encoding for info in recording.topics.values()} == {"protobuf"}


@pytest.mark.parametrize("is_message", [True, False])
def test_a_handler_may_append_to_the_topic_that_is_given_its_schema(tmp_path: Path, is_message: bool) -> None:
    taken: dict[str, list[str]] = {}

    def append(topic: Topic, letter: str, is_message: bool) -> None:
        if is_message:
            topic.append_message(PoseInFrame(frame_id=letter), _ts=1.0)
        else:
            topic.append(frame_id=letter, _ts=2.0)
        taken.setdefault(topic.name, []).append(letter)

    options = RecorderOptions(chunk_bytes=2**21, backlog_bytes=2**23, flush_interval_s=3600)
    with Recorder(tmp_path, options) as recorder:
        recorder.topic("first", schema=PoseInFrame).append(frame_id="x", _ts=0.0)  # imports what the others need
        topics = [recorder.topic(f"t{number}") for number in range(600)]

        def action() -> None:
            try:
                append(topics[-1], "m", True)
            except TopicError:  # the handler's row came first, so the topic has no schema
                assert not is_message

        for interruption in at_every_point(action, lambda: append(topics[-1], "h", is_message)):
            assert interruption.where
            topics.pop()
    with Recording(tmp_path) as recording:
        assert len(taken) > 20
        for name, letters in taken.items():
            assert sorted(row["frame_id"] for row in recording[name].rows()) == sorted(letters)
            assert "h" in letters or letters == ["m"]


# wrong uses


def test_what_does_not_fit_is_refused_at_the_call_and_costs_nothing_else(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("tool", schema=PoseInFrame)
        with pytest.raises(FieldError, match=r"topic 'tool': field 'pose.position.x' takes a double; '1' does not fit"):
            topic.append(pose={"position": {"x": "1"}}, _ts=1.0)
        with pytest.raises(FieldError, match=r"row 1 of the batch: .*'framed' is not a field of foxglove.PoseInFrame"):
            topic.append_batch([{"frame_id": "a", "_ts": 1.0}, {"framed": "b", "_ts": 2.0}])
        with pytest.raises(FieldError, match="field 'frame_id' takes a string; 2 does not fit"):
            topic.append_columns(frame_id=["a", 2], _ts=[1.0, 2.0])
        with pytest.raises(
            UsageError, match=r"the message is a foxglove.Log, but the topic's schema is foxglove.PoseInFr"
        ):
            topic.append_message(Log(), _ts=1.0)
        with pytest.raises(UsageError, match="takes its fields by name"):
            topic.append({"frame_id": "a"}, _ts=1.0)
        for value in (PoseInFrame, None, b"", {"frame_id": "a"}):
            with pytest.raises(UsageError, match=r"append_message\(\) on topic 'new' takes a "):
                recorder.topic("new").append_message(value, _ts=1.0)
        for given in ({}, {"_ts": None}, {"_ts": "x"}, {"_ts": -1}, {"_ts": float("nan")}):
            with pytest.raises(TimestampError):
                topic.append_message(PoseInFrame(), **given)
        with pytest.raises(UsageError, match="topic 'step': the topic's schema is a jsonschema; append its rows with"):
            recorder.topic("step", schema=SCHEMA).append_message(PoseInFrame(), _ts=1.0)
        with pytest.raises(OptionError, match="contradict each other"):
            recorder.topic("other", schema=SCHEMA, encoding="cbor")
        topic.append(frame_id="good", _ts=1.0)
        recorder.topic("new").append(n=1, _ts=1.0)  # a refused message gave it no schema
        assert recorder.stats().accepted == 2
    assert [row["frame_id"] for row in rows(tmp_path, "tool")] == ["good"]


def test_a_closed_recorder_takes_no_message(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path)
    typed, new = recorder.topic("tool", schema=PoseInFrame), recorder.topic("new")
    recorder.close()
    for topic in (typed, new):
        with pytest.raises(StateError, match="closed"):
            topic.append_message(PoseInFrame(), _ts=1.0)
        with pytest.raises(StateError, match="closed"):
            topic.append(frame_id="a", _ts=1.0)
    assert recorder.topic("tool", schema=PoseInFrame) is typed
    with pytest.raises(StateError):
        recorder.topic("other", schema=PoseInFrame)
    with pytest.raises(StateError):
        recorder.topic("new", schema=PoseInFrame)


def test_a_message_larger_than_a_buffer_is_stored_and_one_larger_than_the_backlog_refused(tmp_path: Path) -> None:
    options = RecorderOptions(chunk_bytes=65536, backlog_bytes=4 * 65536, on_full="raise")
    with Recorder(tmp_path, options) as recorder:
        topic = recorder.topic("image", schema=RawImage)
        topic.append_message(RawImage(data=bytes(100_000)), _ts=0.0)
        recorder.flush()
        with pytest.raises(FieldError, match="more than the whole backlog"):
            topic.append_message(RawImage(data=bytes(300_000)), _ts=1.0)
        with pytest.raises((FieldError, BacklogFullError), match="more than the whole backlog"):
            topic.append(data=np.zeros(300_000, np.uint8), _ts=1.0)
    assert [len(decoded.data) for _, _, decoded, _ in messages(tmp_path, "image")] == [100_000]


def test_without_the_packages_the_error_names_the_extra(tmp_path: Path) -> None:
    program = """if True:
        import sys
        sys.modules["foxglove_schemas_protobuf"] = sys.modules["jsonschema_rs"] = None
        from ml_dash_mcap import OptionError, Recorder
        with Recorder(sys.argv[1]) as recorder:
            for schema in ("foxglove.Log", {"type": "object"}):
                try:
                    recorder.topic("t", schema=schema)
                except OptionError as error:
                    print(error)
    """
    told = subprocess.run([sys.executable, "-c", program, tmp_path], capture_output=True, text=True, check=True).stdout
    assert "pip install 'ml-dash-mcap[foxglove]'" in told and "pip install 'ml-dash-mcap[jsonschema]'" in told


# crashes, sinks, clocks


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
@pytest.mark.parametrize("flushed", [0, 200, given_workload.ROWS])
def test_a_kill_loses_no_message(tmp_path: Path, flushed: int) -> None:
    folder = tmp_path / "run"
    program = "import sys; from tests.given_workload import *; record_until_killed(sys.argv[1], int(sys.argv[2]))"
    died = subprocess.run([sys.executable, "-c", program, folder, str(flushed)], cwd=Path(__file__).parent.parent)
    assert died.returncode == -signal.SIGKILL
    expected = [pose(number).SerializeToString() for number in range(given_workload.ROWS)]
    with Recording(folder) as recording:  # which recovers it
        assert {name: info.kind for name, info in recording.topics.items()} == {
            "pose": "message",
            "late": "message",
            "step": "message",
            "track": "track",
        }
        assert [row["n"] for row in recording["step"].rows()] == list(range(given_workload.ROWS))
        assert [row["frame_id"] for row in recording["late"].rows()] == [
            f"frame {n}" for n in range(given_workload.ROWS)
        ]
        assert recording["track"].info.count == given_workload.ROWS // 2
    for topic in ("pose", "late"):
        read = list(messages(folder, topic))
        assert [payload for _, _, _, payload in read] == expected
        assert {name for name, _, _, _ in read} == {"foxglove.PoseInFrame"}
        assert [decoded.frame_id for _, _, decoded, _ in read] == [f"frame {n}" for n in range(given_workload.ROWS)]
    assert [row["n"] for _, row in json_messages(folder, "step")] == list(range(given_workload.ROWS))
    assert sorted(folder.glob(".ml_dash-*")) + sorted(folder.glob("*.active")) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing is forked here")
def test_a_forked_child_takes_no_message(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        new, typed = recorder.topic("new"), recorder.topic("tool", schema=PoseInFrame)
        pid = os.fork()
        if pid == 0:
            refusals = 0
            for topic in (new, typed):
                for call in (
                    topic.append_message,
                    lambda message, _ts, topic=topic: topic.append(frame_id="a", _ts=_ts),
                ):
                    try:
                        call(PoseInFrame(), _ts=1.0)
                    except StateError:
                        refusals += 1
            os._exit(refusals)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 4
        new.append_message(PoseInFrame(frame_id="parent"), _ts=1.0)
    assert [row["frame_id"] for row in rows(tmp_path, "new")] == ["parent"]


class Taking:
    """A sink that keeps the rows that it is handed."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, dict[str, Any]]] = []

    def open(self, session: object) -> None:
        """Keep nothing."""

    def write(self, block: PreparedBlock) -> None:
        self.rows += [(message.channel.topic, message.row()) for message in block.messages()]

    def close(self) -> None:
        """Keep everything."""


def test_sinks_get_the_rows_with_their_time(tmp_path: Path) -> None:
    sink = Taking()
    with Recorder(tmp_path, sinks=[sink]) as recorder:
        recorder.topic("tool", schema=PoseInFrame).append(frame_id="a", _ts=0.1)
        recorder.topic("step", schema=SCHEMA).append(n=1, _ts=0.2)
    assert sink.rows == [("tool", {"frame_id": "a", "_ts": 0.1}), ("step", {"n": 1, "_ts": 0.2})]


def test_logs_are_on_the_clock_of_messages(tmp_path: Path) -> None:
    with Experiment("a/b", root=tmp_path).run as exp:
        exp.logs.info("before")
        exp.tracks("tool", schema=PoseInFrame).append(frame_id="a", _ts=5.0)
        exp.logs.info("after")
    with Recording(exp.path) as recording:
        assert [entry["_ts"] for entry in recording.logs] == [5.0, 5.0]


def test_steps_back_of_messages_are_counted(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("tool", schema=PoseInFrame)
        for time_s in (0.0, 1.0, 0.5):
            topic.append(frame_id="a", _ts=time_s)
        recorder.flush()
        assert recorder.stats().steps_back_by_topic == {"tool": 1}


# Experiment, Session, exports


def test_an_experiment_has_tracks_with_a_schema_and_an_encoding(tmp_path: Path) -> None:
    with Experiment("a/b", root=tmp_path, encoding="cbor").run as exp:
        tool = exp.tracks("tool", schema="foxglove.PoseInFrame")
        tool.append(frame_id="a", timestamp=1.5, _ts=1.5)  # its schema says what a timestamp is
        tool.append_message(PoseInFrame(frame_id="b"), _ts=2.0)
        assert exp.tracks("tool") is tool is exp.tracks("tool", schema=PoseInFrame)
        assert tool.read() == {
            "entries": [
                {"timestamp": 1.5, "timestamp.seconds": 1, "timestamp.nanos": 500_000_000, "frame_id": "a"},
                {"timestamp": 2.0, "frame_id": "b"},
            ],
            "count": 2,
        }
        assert exp.tracks("robot").append(q=1.0, _ts=0.0).encoding == "cbor"
        assert exp.tracks("json", encoding="json").append(q=1.0, _ts=0.0).encoding == "json"
        with pytest.raises(FieldError, match="the field name 'timestamp' is taken"):
            exp.tracks("robot").append(timestamp=1.5, _ts=1.5)
        with pytest.raises(TopicError, match="open in the encoding 'cbor' already, not 'json'"):
            exp.tracks("robot", encoding="json")
        assert exp.tracks.list() == ["json", "robot", "tool"]
    with Recording(exp.path) as recording:
        assert {name: info.encoding for name, info in recording.topics.items()} == {
            "json": "json",
            "robot": "cbor",
            "tool": "protobuf",
        }


def test_a_session_has_an_encoding_and_counts_messages(tmp_path: Path) -> None:
    with Session("s", "w", local_path=tmp_path, encoding="cbor") as session:
        tool = session.track("tool", schema=PoseInFrame)
        tool.append_message(PoseInFrame(frame_id="a")).append_message(PoseInFrame(frame_id="b"), _ts=-1)
        assert time.time() - 60 < tool.read_by_time()["data"][0]["data"]["_ts"] <= time.time()
        assert session.track("loss").append(value=1).encoding == "cbor"
        assert session.track("plain", encoding="json").append(value=1).encoding == "json"
        assert session.track("typed", encoding="protobuf").append(value=1).encoding == "protobuf"
        assert session.track("typed").read()["data"][0]["data"]["value"] == 1
        assert tool.append_batch([{"frame_id": "c"}])["startIndex"] == "2"
        assert [point["data"]["frame_id"] for point in tool.read()["data"]] == ["a", "b", "c"]


def test_the_encoding_is_said_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = RecorderOptions(encoding="cbor")
    for kind in (Experiment, Session):
        name = ("a/b",) if kind is Experiment else ("s", "w")
        with pytest.raises(UsageError, match="encoding='json' and options= with encoding='cbor' contradict each other"):
            kind(*name, encoding="json", options=options)
        with pytest.raises(OptionError, match="encoding='jsno': rows cannot be recorded in that; did you mean 'json'"):
            kind(*name, encoding="jsno")
        kind(*name, encoding="cbor", options=options)
    monkeypatch.setenv("ML_DASH_ENCODING", "cbor")
    with Session("s", "w", local_path=tmp_path) as session:
        assert session.track("a").append(n=1).encoding == "cbor"
    with Session("s", "w", local_path=tmp_path, encoding="json") as session:
        assert session.track("a").append(n=1).encoding == "json"


def test_exports_have_the_messages(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        for number in range(3):
            recorder.topic("tool", schema=PoseInFrame).append(frame_id=str(number), _ts=number / 10)
            recorder.topic("step", schema=SCHEMA).append(n=number, _ts=number / 10)
    convert(tmp_path / "run", tmp_path / "tables", format="parquet")
    [table] = [parquet.read_table(path) for path in (tmp_path / "tables").rglob("*tool*.parquet")]
    assert table.column("frame_id").to_pylist() == ["0", "1", "2"]
    with Recording(tmp_path / "run") as recording:
        (tmp_path / "copy.mcap").write_bytes(recording["tool"].read(format="mcap"))
        assert [json.loads(line)["n"] for line in recording["step"].read(format="jsonl").splitlines()] == [0, 1, 2]
    with Recording(tmp_path / "copy.mcap") as recording:
        assert [row["frame_id"] for row in recording["tool"].rows()] == ["0", "1", "2"]
    convert(tmp_path / "run", tmp_path / "bag", format="rosbag2")
    with Recording(tmp_path / "bag") as recording:
        assert {name.strip("/") for name in recording.topics} >= {"tool", "step"}
