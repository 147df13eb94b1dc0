"""A recording in protobuf is read by readers that are not ours: the viewers' for JavaScript, Rerun, mcap's for Python."""

from __future__ import annotations

import base64
import importlib.util
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import Message
from mcap_protobuf.reader import read_protobuf_messages

from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording
from tests.support import disk, node_program, rerun_reader

NODE_SOURCES = Path(__file__).parent / "support" / "node"
EXAMPLES = Path(__file__).parent.parent / "examples"
PROTOBUF = RecorderOptions(encoding="protobuf")

Fields = dict[str, Any]
DecodeInNode = Callable[[Path], list[tuple[str, Fields]]]

ROWS: list[Fields] = [
    {"q": [0.25, -1e300], "step": 0, "ok": False, "mode": "", "raw": b"", "_ts": 0.0},
    {"q": [0.5], "step": -(2**63), "ok": True, "mode": "größe \U0001f916", "raw": b"\x00\xff", "_ts": 0.5},
    {"big": 2**64 - 1, "m": [[1.0, 2.0], [3.0, 4.0]], "ee": {"pos": [1.0, 2.0, 3.0], "n": 0}, "_ts": 1.0},
    {"contacts": [{"body": "a", "f": 0.0}, {"body": "b"}], "names": ["a", ""], "flags": [True, False], "_ts": 1.5},
    {"ids": [1, -(2**53) - 1], "joint temp": 3.5, "constructor": 1.0, "bigs": [2**63, 0], "_ts": 2.0},
    {"step": 1.5, "goal": None, "mixed": [1, "a"], "frames": [b"a", b"b"], "empty": [], "nothing": {}, "_ts": 2.5},
    {"step": 2, "image": np.arange(5000, dtype=np.uint16).reshape(50, 100), "_ts": 3.0},
]

MESSAGES: list[Fields] = [
    {"q": [0.25, -1e300], "step_int": 0, "ok": False, "mode": "", "raw": b"", "_ts": 0.0},
    {"q": [0.5], "step_int": -(2**63), "ok": True, "mode": "größe \U0001f916", "raw": b"\x00\xff", "_ts": 0.5},
    {"big": 2**64 - 1, "m": [1.0, 2.0, 3.0, 4.0], "ee": {"pos": [1.0, 2.0, 3.0], "n": 0}, "_ts": 1.0},
    {"contacts": [{"body": "a", "f": 0.0}, {"body": "b"}], "names": ["a", ""], "flags": [True, False], "_ts": 1.5},
    {"ids": [1, -(2**53) - 1], "joint_temp": 3.5, "constructor_": 1.0, "bigs": [2**63, 0], "_ts": 2.0},
    {
        "step": 1.5,
        "nothing": {},
        "_exact": '{"/goal":null,"/mixed":[1,"a"],"/frames":["YQ==","Yg=="],"/empty":[],"_exact":{"bytes":{"/~1frames":[0,1]}}}',
        "_ts": 2.5,
    },
    {
        "step": 2.0,
        "image": {"type": "uint16[50,100]", "data": np.arange(5000, dtype="<u2").tobytes()},
        "_exact": '{"/step":2}',
        "_ts": 3.0,
    },
]
"""The rows as other readers see them. Absent fields and empty lists, which are the same in protobuf, are left out."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a recording with every kind of value."""
    folder = tmp_path_factory.mktemp("typed") / "run"
    with Recorder(folder, options=PROTOBUF) as recorder:
        for row in ROWS:
            recorder.topic("robot/arm").append(**row)
        for step, value in enumerate((math.nan, math.inf, -math.inf)):
            recorder.topic("odd").append(x=value, q=[value, 1.0], _ts=step)
    return folder


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the demo, recorded in protobuf."""
    if importlib.util.find_spec("mujoco") is None:
        pytest.skip("mujoco is not installed")
    root = tmp_path_factory.mktemp("demo")
    command = [sys.executable, str(EXAMPLES / "franka_control.py"), "--seconds", "1", "--root", str(root)]
    environment = {**os.environ, "PYTHONPATH": str(EXAMPLES.parent), "ML_DASH_ENCODING": "protobuf"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stderr
    return root / "demo/franka/reach-and-grasp"


def present(fields: Fields) -> Fields:
    """Fields without those that are absent, and without empty lists."""
    return {name: _present(value) for name, value in fields.items() if value is not None and value != []}


def _present(value: Any) -> Any:
    if isinstance(value, list):
        return [_present(each) for each in value]
    return present(value) if isinstance(value, dict) else value


def rows_of(folder: Path, topic: str) -> list[Fields]:
    with Recording(folder) as opened:
        return list(opened[topic].rows())


# Foxglove and Lichtblick


@pytest.fixture(scope="session")
def decode_in_node(tmp_path_factory: pytest.TempPathFactory) -> DecodeInNode:
    """What decodes files with @mcap/core and protobufjs, installed for this session."""
    program = node_program.install(NODE_SOURCES / "decode_protobuf.mjs", tmp_path_factory.mktemp("node"))

    def decode(path: Path) -> list[tuple[str, Fields]]:
        done = subprocess.run(["node", str(program), str(path)], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, "")
        messages = [json.loads(line) for line in done.stdout.splitlines()]
        return [(message["topic"], message["fields"]) for message in messages]

    return decode


def as_in_javascript(value: Any) -> Any:
    """A value as the program for Node.js prints it: 64-bit integers and bytes as text."""
    if isinstance(value, dict):
        return {name: as_in_javascript(each) for name, each in value.items()}
    if isinstance(value, list):
        return [as_in_javascript(each) for each in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    return str(value) if type(value) is int else value


@pytest.mark.timeout(300)
def test_the_viewers_decoder_shows_every_value_and_no_zero_for_what_is_absent(
    recording: Path, decode_in_node: DecodeInNode
) -> None:
    [segment] = disk.segments(recording)
    decoded = [fields for topic, fields in decode_in_node(segment) if topic == "robot/arm"]
    assert [present(fields) for fields in decoded] == as_in_javascript(MESSAGES)


@pytest.mark.timeout(300)
def test_the_viewers_decoder_reads_every_channel_of_the_demo(demo: Path, decode_in_node: DecodeInNode) -> None:
    [segment] = disk.segments(demo)
    decoded = decode_in_node(segment)
    assert {topic for topic, _ in decoded} == {"action", "obs", "robot"}
    robot = [present(fields) for topic, fields in decoded if topic == "robot"]
    assert robot == rows_of(demo, "robot")


@pytest.mark.timeout(300)
def test_the_viewers_decoder_reads_topics_and_keys_of_any_name(tmp_path: Path, decode_in_node: DecodeInNode) -> None:
    keys = ["constructor", "toString", "__proto__", "Array", "message", "größe", "1", "a b", "a_b", "_x", "x", "$type"]
    topics = ["constructor/toString", "__proto__", "größe/1", "a b", "Robot", "robot"]
    with Recorder(tmp_path, options=PROTOBUF) as recorder:
        for topic in topics:
            for step, key in enumerate(keys):
                recorder.topic(topic).append(**{key: 1.5, "in": {key: {key: [{key: 2}]}}}, _ts=step)
            recorder.topic(topic).append(**dict.fromkeys(keys, 2.5), image=np.zeros((100, 100)), _ts=100)
    decoded = decode_in_node(disk.segments(tmp_path)[0])
    last = dict(decoded)
    assert set(last) == set(topics)
    assert {topic: sum(value == 2.5 for value in fields.values()) for topic, fields in last.items()} == dict.fromkeys(
        topics, len(keys)
    )


# Rerun


@pytest.mark.timeout(300)
def test_rerun_has_nothing_to_say_about_the_demo(demo: Path, tmp_path: Path) -> None:
    [segment] = disk.segments(demo)
    verdicts = rerun_reader.check(segment, tmp_path)
    assert {"/action", "/obs", "/robot", "/ml_dash/log"} <= set(verdicts)
    assert set(verdicts.values()) == {"ok"}


@pytest.mark.timeout(300)
def test_reruns_table_has_the_rows_of_the_demo(demo: Path, tmp_path: Path) -> None:
    [segment] = disk.segments(demo)
    messages = rerun_reader.messages(segment, "robot", tmp_path)
    assert [present(message) for _, message in messages] == rows_of(demo, "robot")
    assert [time_ns for time_ns, _ in messages] == [step * 1_000_000 for step in range(1000)]


@pytest.mark.timeout(300)
def test_reruns_table_has_every_value_and_nothing_for_what_is_absent(recording: Path, tmp_path: Path) -> None:
    [segment] = disk.segments(recording)
    messages = rerun_reader.messages(segment, "robot/arm", tmp_path)
    assert [present(message) for _, message in messages] == MESSAGES


# mcap's decoder for Python


def plain(message: Message) -> Fields:
    """The fields of a message that are there."""
    return {described.name: _plain(value) for described, value in message.ListFields()}


def _plain(value: Any) -> Any:
    if isinstance(value, Message):
        return plain(value)
    return value if isinstance(value, (str, bytes, int, float)) else [_plain(each) for each in value]


def decoded_in_python(folder: Path, topic: str) -> Iterator[Fields]:
    for segment in disk.segments(folder):
        yield from (plain(read.proto_msg) for read in read_protobuf_messages(str(segment), topics=[topic]))


def test_mcaps_decoder_shows_every_value_and_nothing_for_what_is_absent(recording: Path) -> None:
    assert list(decoded_in_python(recording, "robot/arm")) == MESSAGES


def test_mcaps_decoder_shows_numbers_that_are_not_finite(recording: Path) -> None:
    odd = [(fields["x"], *fields["q"]) for fields in decoded_in_python(recording, "odd")]
    assert list(map(repr, odd)) == ["(nan, nan, 1.0)", "(inf, inf, 1.0)", "(-inf, -inf, 1.0)"]


def test_mcaps_decoder_reads_every_row_of_the_demo(demo: Path) -> None:
    assert list(decoded_in_python(demo, "robot")) == rows_of(demo, "robot")


def test_logs_metrics_and_files_stay_json_beside_tracks_in_protobuf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ML_DASH_ENCODING", "protobuf")
    with Experiment("alice/arm", root=tmp_path).run as exp:
        exp.tracks("robot").append(q=[1.0], _ts=0.0)
        exp.logs.info("hello")
        exp.metrics("train").log(loss=0.5)
    topics = ["robot", "ml_dash/log", "ml_dash/metrics/train"]
    schemas = [disk.channel(exp.path, topic)[1] for topic in topics]
    assert [(schema.encoding, schema.name) for schema in schemas] == [
        ("protobuf", "ml_dash.Robot"),
        ("jsonschema", "foxglove.Log"),
        ("jsonschema", "ml_dash/metrics/train"),
    ]
