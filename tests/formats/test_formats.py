"""Each format holds the same rows, in the shape that ml-dash gives it."""

import io
import json
import math

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from ml_dash_mcap.formats import registry
from ml_dash_mcap.formats.tables.parquet import file_bytes
from ml_dash_mcap.query.topic_part import TopicPart
from ml_dash_mcap.recorded_topics import stored_topic
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.json_text import restore
from tests.support.files import payload, save
from tests.support.rules import problems

EXACT = {"NaN": {"/q": [1]}, "bytes": {"": ["img"]}}
ROWS = [
    {"q": [0.5, 1.5], "time": 7, "timestamp": "x", "_ts": 0.0},
    {"q": [1.5, None], "img": "AAE=", "none": None, "_exact": EXACT, "_ts": 0.5},
    {"cam": {"pos": [1, 2]}, "_ts": 1.0},
    {"q": [2.5, 3.5], "_ts": 1.5},
]
SCHEMA = {
    "type": "object",
    "properties": {"q": {"type": "array", "items": {"type": "number"}}, "_ts": {"type": "number"}},
}


@pytest.fixture
def recording(tmp_path):
    save(
        tmp_path / "run" / "a.mcap",
        [{"robot": ROWS[:2]}, {"robot": ROWS[2:], "foreign": [{"a": 1, "_ts": 1.0}, {"a": 2, "_ts": 1.0}]}],
        kinds={"foreign": None},
        schemas={"robot": SCHEMA},
        described={"robot": {"description": "an arm", "tags": '["a", "b"]'}},
    )
    save(tmp_path / "run" / "b.mcap.active", [{"robot": [{"late": 1, "_ts": 0.0}]}])
    return Recording(tmp_path / "run")


def test_the_formats_are_those_of_ml_dash():
    assert registry.names("render") == ["json", "jsonl", "mcap", "mocap", "parquet"]


def test_json_is_a_dict_of_flat_entries(recording):
    assert repr(recording["robot"].read()) == repr(
        {
            "entries": [
                {"timestamp": 0.0, "q": [0.5, 1.5], "time": 7, "fields.timestamp": "x", "late": 1},
                {"timestamp": 0.5, "q": [1.5, math.nan], "img": b"\x00\x01", "none": None},
                {"timestamp": 1.0, "cam.pos": [1, 2]},
                {"timestamp": 1.5, "q": [2.5, 3.5]},
            ],
            "count": 4,
        }
    )


def test_jsonl_is_strict_json_a_row_a_line_and_loses_nothing(recording):
    def refuse(spelling):
        raise AssertionError(spelling)

    lines = recording["robot"].read(format="jsonl").split(b"\n")
    parsed = [json.loads(line, parse_constant=refuse) for line in lines]
    assert parsed[1]["q"] == [1.5, None]
    assert list(parsed[0]) == ["_ts", "q", "time", "timestamp", "late"]
    assert repr([restore(row) for row in parsed]) == repr([flatten(row, "_ts") for row in recording["robot"].rows()])


def test_parquet_is_the_file_that_is_exported(recording, tmp_path):
    data = recording["robot"].read(format="parquet")
    recording.export(tmp_path / "robot.parquet", topics=["robot"])
    assert data == (tmp_path / "robot.parquet").read_bytes()


def test_parquet_has_the_columns_that_are_asked_for(recording):
    table = pq.read_table(io.BytesIO(recording["robot"].read(0.5, columns=["cam", "q"], format="parquet")))
    assert table.column_names == ["_ts", "timestamp_ns", "cam", "q"]
    assert table.column("cam").to_pylist() == [None, {"pos": [1, 2]}, None]


def test_parquet_of_a_track_is_compressed_and_has_the_time_first(recording):
    data = file_bytes.render(TopicPart(stored_topic(recording, "robot")))
    table = pq.read_table(io.BytesIO(data))
    assert table.column_names[0] == "timestamp"
    assert set(table.column_names[1:]) == {"q", "time", "fields.timestamp", "late", "img", "none", "cam.pos"}
    assert table.schema.field("timestamp").type == pa.float64()
    assert pq.ParquetFile(io.BytesIO(data)).metadata.row_group(0).column(0).compression == "ZSTD"
    assert table.column("timestamp").to_pylist() == [0.0, 0.5, 1.0, 1.5]
    assert table.column("cam.pos").to_pylist() == [None, None, [1, 2], None]
    assert table.column("img").to_pylist() == [None, b"\x00\x01", None, None]


def test_mocap_has_the_true_frame_rate(recording):
    mocap = recording["robot"].read(format="mocap", columns=["q", "time"])
    assert mocap["version"] == "1.0"
    assert mocap["metadata"] == {
        "topic": "robot",
        "description": "an arm",
        "tags": ["a", "b"],
        "fps": 2.0,
        "duration": 1.5,
        "frameCount": 4,
        "startTime": 0.0,
        "endTime": 1.5,
    }
    assert mocap["channels"] == ["fields.time", "q"]
    assert mocap["frames"][0] == {"time": 0.0, "q": [0.5, 1.5], "fields.time": 7}


@pytest.mark.parametrize(("missing", "rate"), [((), 120), ((3, 4, 50), 120), (range(1, 60, 2), 60)])
def test_the_frame_rate_of_rows_of_today_is_not_blurred_by_their_time_stamps(missing, rate, tmp_path):
    """Doubles of seconds since 1970 are 240 ns apart."""
    with Recorder(tmp_path / "run") as recorder:
        for frame in sorted({*range(60)} - {*missing}):
            recorder.topic("robot").append(q=frame, _ts=1.7e9 + frame / 120)
    with Recording(tmp_path / "run") as opened:
        assert opened["robot"].read(format="mocap")["metadata"]["fps"] == pytest.approx(rate, abs=1e-3)


def read_mcap(data: bytes) -> list[tuple[str, int, bytes]]:
    """Messages as the `mcap` package reads them, its checksums checked."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [(channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()]


def test_mcap_is_a_complete_file_of_merged_rows_in_the_eyes_of_another_reader(recording):
    data = recording["robot"].read(start=0.0, end=0.5, format="mcap")
    assert read_mcap(data) == [
        ("robot", 0, payload({"q": [0.5, 1.5], "time": 7, "timestamp": "x", "late": 1, "_ts": 0.0})),
        ("robot", 500_000_000, payload({"q": [1.5, None], "img": "AAE=", "none": None, "_exact": EXACT, "_ts": 0.5})),
    ]
    summary = make_reader(io.BytesIO(data)).get_summary()
    (channel,) = summary.channels.values()
    assert channel.metadata == {"kind": "track", "description": "an arm", "tags": '["a", "b"]'}
    (schema,) = summary.schemas.values()
    assert (schema.encoding, json.loads(schema.data)["properties"]["q"]) == ("jsonschema", SCHEMA["properties"]["q"])
    assert summary.statistics.message_count == 2


@pytest.mark.parametrize("topic", ["robot", "foreign"])
def test_an_exported_mcap_obeys_the_rules_of_all_clients(recording, tmp_path, topic):
    path = tmp_path / "out.mcap"
    path.write_bytes(recording.read(topic, format="mcap"))
    assert problems(path) == []


def test_an_exported_mcap_gives_the_same_rows_again(recording, tmp_path):
    path = tmp_path / "out.mcap"
    path.write_bytes(recording["robot"].read(format="mcap"))
    again = Recording(path)
    assert repr(again["robot"].read()) == repr(recording["robot"].read())
    assert again.topics["robot"].count == 4


def test_an_mcap_of_some_columns_has_only_those(recording):
    data = recording["robot"].read(start=1.0, end=1.0, columns=["cam.pos"], format="mcap")
    assert [message for _, _, message in read_mcap(data)] == [b'{"cam":{"pos":[1,2]},"_ts":1.0}']


def test_messages_of_other_writers_are_copied_as_they_are(recording):
    data = recording["foreign"].read(format="mcap")
    assert [message for _, _, message in read_mcap(data)] == [b'{"a":1,"_ts":1.0}', b'{"a":2,"_ts":1.0}']


def test_importing_the_reader_loads_nothing_heavy():
    import subprocess
    import sys

    code = (
        "import sys, ml_dash_mcap.recording; print(sorted({'pyarrow', 'mcap', 'rosbags', 'google'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
