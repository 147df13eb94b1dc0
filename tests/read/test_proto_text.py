"""A topic's messages as .proto text: a compiler accepts it, and the classes that it makes decode each message."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap import EncodingError, Recorder, RecorderOptions, Recording
from ml_dash_mcap.codecs.proto import proto_text, topic_files
from ml_dash_mcap.codecs.proto.descriptor import entries_of
from ml_dash_mcap.codecs.proto.row_comments import RowsAbout
from ml_dash_mcap.codecs.protobuf import CODEC
from ml_dash_mcap.mcap.records import Schema
from tests.support import disk, foreign, protoc
from tests.support.examples import examples

PROTOBUF = RecorderOptions(encoding="protobuf")

ROWS: list[dict[str, Any]] = [
    {"q": [0.1, 0.2], "step": 0, "ok": True, "mode": "run", "raw": b"\x00\xff", "joint temp": 3.5, "_ts": 0.0},
    {"q": [0.3, 0.4], "step": -(2**62), "ok": False, "ee": {"pos": [1.0, 2.0, 3.0], "n": 1}, "_ts": 0.5},
    {"m": [[1.0, 2.0], [3.0, 4.0]], "big": 2**63, "contacts": [{"body": "a", "f": 1.5}, {"body": "b"}], "_ts": 1.0},
    {"mode": 7, "names": ["a", "b"], "flags": [True, False], "ids": [1, 2], "goal": None, "_ts": 1.5},
]

DECODED: list[dict[str, Any]] = [
    {
        "q": [0.1, 0.2],
        "step": 0,
        "ok": True,
        "mode": "run",
        "raw": {"base64": "AP8="},
        "joint_temp": 3.5,
        "_ts": 0.0,
    },
    {"q": [0.3, 0.4], "step": -(2**62), "ok": False, "ee": {"pos": [1.0, 2.0, 3.0], "n": 1}, "_ts": 0.5},
    {"m": [1.0, 2.0, 3.0, 4.0], "big": 2**63, "contacts": [{"body": "a", "f": 1.5}, {"body": "b"}], "_ts": 1.0},
    {
        "mode_int": 7,
        "names": ["a", "b"],
        "flags": [True, False],
        "ids": [1, 2],
        "_exact": '{"/goal":null}',
        "_ts": 1.5,
    },
]

TEXT = """\
// Written by ml_dash_mcap from a recording's schema.
syntax = "proto3";

package ml_dash.robot;

// A row of the topic "robot/arm". Lists of lists are written one after the other.
// The arm at 1 kHz.
// Joints: j1, j2.
// Frame: base.
message Arm {
  // Time stamp, s.
  optional double _ts = 1;
  // What the other fields do not express, as JSON: values by JSON Pointer (RFC 6901). An integer here says
  // that the double in its field was an integer.
  // Some rows have here what no field expresses (None, mixed or empty lists, and the like):
  // "goal".
  optional string _exact = 2;
  // Shape [2], unit rad.
  repeated double q = 3;
  optional sfixed64 step = 4;
  // Key "joint temp", unit degC.
  optional double joint_temp = 5;
  // Shape [N, 2].
  repeated double m = 6;
  Ee ee = 7;

  message Ee {
    // Shape [N], unit m.
    repeated double pos = 1;
  }
}
"""


def record(root: Path, rows: list[dict[str, Any]], topic: str = "robot/arm", **about: Any) -> Path:
    """Record rows of one topic; returns the folder."""
    with Recorder(root, options=PROTOBUF) as recorder:
        recorded = recorder.topic(topic, **about)
        for row in rows:
            recorded.append(**row)
    return root


def without_absent(message: dict[str, Any]) -> dict[str, Any]:
    """A message without its empty lists, which cannot be told from absent ones."""
    return {
        name: [without_absent(each) if isinstance(each, dict) else each for each in value]
        if isinstance(value, list)
        else value
        for name, value in message.items()
        if value != []
    }


def test_the_text_names_shapes_units_keys_and_what_the_exact_text_holds(tmp_path: Path) -> None:
    rows = [
        {"q": [0.1, 0.2], "step": 0, "joint temp": 3.5, "_ts": 0.0},
        {"m": [[1.0, 2.0]], "goal": None, "ee": {"pos": [1.0]}, "_ts": 1.0},
    ]
    units = {"q": "rad", "joint temp": "degC", "ee.pos": "m"}
    about = {"description": "The arm at 1 kHz.", "units": units, "joint_names": ["j1", "j2"], "frame_id": "base"}
    with Recording(record(tmp_path, rows, **about)) as recording:
        assert recording["robot/arm"].proto() == TEXT
        assert recording["robot/arm"].proto_files() == {"ml_dash/robot/Arm.proto": TEXT}


def test_classes_that_protoc_generates_from_the_text_decode_every_message_of_the_file(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", ROWS)
    with Recording(folder) as recording:
        files = recording["robot/arm"].proto_files()
    protoc.compile_files(files, tmp_path / "classes")
    payloads = [payload for _, payload in disk.payloads(folder)]
    messages = protoc.decode(tmp_path / "classes", "ml_dash/robot/Arm.proto", "Arm", payloads)
    assert [without_absent(message) for message in messages] == DECODED


def test_the_text_compiles_to_the_descriptor_in_the_file(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", ROWS)
    with Recording(folder) as recording:
        compiled = protoc.compile_files(recording["robot/arm"].proto_files(), tmp_path / "classes")
    _, schema = disk.channel(folder, "robot/arm")
    recorded = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
    assert protoc.without_sources(compiled) == protoc.without_sources(recorded)


KEYS = st.one_of(
    st.text(max_size=4),
    st.sampled_from(
        [
            "_x",
            "x",
            "X_x",
            "a b",
            "a_b",
            "Array",
            "constructor",
            "message",
            "optional",
            "class",
            "double",
            "1",
            "größe",
            "_",
        ]
    ),
)
VALUES = st.sampled_from([1.5, 1, True, "a", b"a", [1.5], [[1, 2]], ["a"], None, np.zeros(5000)])


@settings(max_examples=examples(10), deadline=None)
@given(
    st.lists(
        st.dictionaries(KEYS, VALUES | st.dictionaries(KEYS, VALUES) | st.lists(st.dictionaries(KEYS, VALUES))),
        min_size=1,
        max_size=3,
    ),
    st.sampled_from(["robot", "a/b", "Array", "1/2", "constructor/x", "größe"]),
    st.text(max_size=20),
)
def test_the_text_of_rows_with_any_keys_compiles_to_their_descriptor(
    tmp_path_factory: pytest.TempPathFactory, rows: list[dict[str, Any]], topic: str, description: str
) -> None:
    codec = CODEC.for_channel(topic)
    for row in rows:
        codec.encode_read({**{key: value for key, value in row.items() if key != "_ts"}, "_ts": 0.0})
    data = codec.schema(None, topic)
    about = RowsAbout(topic, description, units={key: description for row in rows for key in row})
    texts = topic_files.texts([Schema(1, codec.schema_name(topic), "protobuf", data)], about)
    compiled = protoc.compile_files(texts, tmp_path_factory.mktemp("classes"))
    recorded = descriptor_pb2.FileDescriptorSet.FromString(data)
    assert protoc.without_sources(compiled) == protoc.without_sources(recorded)


@pytest.mark.parametrize("is_told_later", [False, True])
def test_the_descriptor_in_the_file_says_the_units(tmp_path: Path, is_told_later: bool) -> None:
    with Recorder(tmp_path, options=PROTOBUF) as recorder:
        robot = recorder.topic("robot", units=None if is_told_later else {"q": "rad"})
        robot.append(q=[1.0], _ts=0.0)
        if is_told_later:
            recorder.topic("robot", units={"q": "rad"})
        robot.append(q=[1.0], late=True, _ts=1.0)
    _, schema = disk.channel(tmp_path, "robot")
    [file] = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
    assert entries_of(file.message_type[0].options) == {"ml_dash": 1, "units": {"q": "rad"}}
    assert [row for _, row in sorted(read_rows(tmp_path).items())] == [{"q": [1.0]}, {"q": [1.0], "late": True}]


def read_rows(folder: Path) -> dict[float, dict[str, Any]]:
    with Recording(folder) as recording:
        return {row.pop("_ts"): row for row in recording["robot"].rows()}


# Messages of others


def test_the_text_of_a_message_of_others_comes_with_the_files_that_it_imports(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    foreign.write(path)
    with Recording(path) as recording:
        topic = next(name for name, info in recording.topics.items() if info.schema_name == "foxglove.LaserScan")
        files = recording[topic].proto_files()
        text = recording[topic].proto()
    assert next(iter(files)) == "foxglove/LaserScan.proto"
    assert set(files) == {f"foxglove/{name}.proto" for name in ("LaserScan", "Pose", "Quaternion", "Vector3")}
    assert text == files["foxglove/LaserScan.proto"]
    compiled = protoc.compile_files(files, tmp_path / "classes")
    assert {file.name for file in compiled.file} == {*files, "google/protobuf/timestamp.proto"}


PROTO2 = """\
syntax = "proto2";

package old.style;

import "google/protobuf/timestamp.proto";
import public "google/protobuf/duration.proto";

option java_package = "org.old";
option optimize_for = SPEED;

message Thing {
  required int32 id = 1;
  optional string name = 2 [default = "a \\"b\\"\\n", json_name = "called"];
  optional bytes raw = 3 [default = "\\001\\377"];
  optional double limit = 4 [default = inf];
  repeated sint64 packed = 5 [packed = true];
  optional Mode mode = 6 [default = RUN, deprecated = true];
  map<string, Inner> by_name = 7;
  oneof choice {
    bool yes = 8;
    .google.protobuf.Timestamp when = 9;
  }
  optional group Result = 10 {
    optional string url = 1;
  }
  optional google search = 11;

  message Inner {
    optional Thing parent = 1;
    optional style looks = 2;

    message style {
    }
  }

  message google {
  }

  enum Mode {
    option allow_alias = true;
    IDLE = 0;
    RUN = 7;
    GO = 7 [deprecated = true];
    reserved 3, 10 to 12;
    reserved "OLD";
  }
  extensions 100 to 199, 1000 to max;
  reserved 50 to 60, 70;
  reserved "gone";
}

extend Thing {
  optional int32 more = 100;
}

service Things {
  rpc Get(Thing) returns (stream Thing);
}
"""

EDITION = """\
edition = "2023";

package new.style;

option features.field_presence = IMPLICIT;

message Thing {
  int32 count = 1 [features.field_presence = EXPLICIT];
  Inner inner = 2 [features.message_encoding = DELIMITED];
  repeated double values = 3 [features.repeated_field_encoding = EXPANDED];

  message Inner {
    string name = 1;
  }
}
"""


@pytest.mark.parametrize("text", [PROTO2, EDITION], ids=["proto2", "editions"])
def test_a_file_that_was_compiled_and_written_again_compiles_to_the_same(text: str, tmp_path: Path) -> None:
    compiled = protoc.compile_files({"thing.proto": text}, tmp_path / "first")
    [file] = [file for file in compiled.file if file.name == "thing.proto"]
    again = protoc.compile_files({"thing.proto": proto_text.write(file, compiled.file, {})}, tmp_path / "second")
    assert protoc.without_sources(again) == protoc.without_sources(compiled)


def test_comments_that_the_compiler_kept_are_written(tmp_path: Path) -> None:
    text = textwrap.dedent("""\
        // What a file is about.
        syntax = "proto3";

        // A thing.
        // It has parts.
        message Thing {
          // How many.
          int32 count = 1;
        }
        """)
    [file] = protoc.compile_files({"thing.proto": text}, tmp_path).file
    assert proto_text.write(file, [file], proto_text.comments_of(file)) == text


# What has no text


@pytest.mark.about_json
def test_a_topic_that_is_not_protobuf_says_how_to_get_one_that_is(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("robot").append(q=[1.0], _ts=0.0)
    with Recording(tmp_path) as recording, pytest.raises(EncodingError) as caught:
        recording["robot"].proto()
    assert str(caught.value) == (
        "topic 'robot' has no .proto file: its messages are encoded as 'json'; record it with encoding=\"protobuf\", "
        "or see its JSON Schema in recording.topics['robot'].schema"
    )


def test_runs_whose_fields_have_other_numbers_have_no_common_text_but_one_each(tmp_path: Path) -> None:
    record(tmp_path, [{"q": 1.0, "v": 2.0, "_ts": 0.0}])
    record(tmp_path, [{"v": 2.0, "q": 1.0, "_ts": 1.0}])
    with Recording(tmp_path) as recording:
        with pytest.raises(EncodingError, match="2 message types that contradict each other"):
            recording["robot/arm"].proto()
        segments = recording.segments
    fields = []
    for segment in segments:
        with Recording(segment) as recording:
            text = recording["robot/arm"].proto()
            fields.append([line.strip() for line in text.splitlines() if line.endswith((" = 3;", " = 4;"))])
    assert fields == [
        ["optional double q = 3;", "optional double v = 4;"],
        ["optional double v = 3;", "optional double q = 4;"],
    ]


def test_runs_of_which_one_goes_on_where_the_other_ended_have_one_text(tmp_path: Path) -> None:
    record(tmp_path, [{"q": 1.0, "v": 2.0, "_ts": 0.0}])
    record(tmp_path, [{"q": 1.0, "goal": None, "_ts": 1.0}])
    with Recording(tmp_path) as recording:
        text = recording["robot/arm"].proto()
    assert "optional double v = 4;" in text
    assert '// "goal".' in text
