"""JSON lines in files are those of `read`; dreamlake's layout is read by dreamlake."""

from __future__ import annotations

import importlib.metadata
import math
from pathlib import Path

import orjson
import pytest

from ml_dash_mcap import Recorder, Recording
from ml_dash_mcap.formats.dreamlake import path_of
from ml_dash_mcap.rows.json_text import restore
from tests.formats.tables.test_parquet_files import recording, steps

ROWS = [
    {"q": [0.5, 1.5], "pose": {"xyz": [1.0, 2.0]}, "_ts": 0.1 + 0.2},
    {"bad": math.nan, "raw": b"\x00", "text": "größe", "none": None, "_ts": 1.5},
]


def test_json_lines_are_those_of_read_each_with_its_newline(tmp_path: Path) -> None:
    with recording(tmp_path, ROWS) as rec:
        path = rec.export(tmp_path / "out", format="jsonl") / "robot.jsonl"
        assert path.read_bytes() == rec.read("robot", format="jsonl") + b"\n"


def test_a_topic_without_rows_in_the_range_is_an_empty_file(tmp_path: Path) -> None:
    with recording(tmp_path, ROWS) as rec:
        assert rec.export(tmp_path / "x.jsonl", format="jsonl", start=9.0).read_bytes() == b""


def test_dreamlakes_lines_number_the_rows_as_they_were_given(tmp_path: Path) -> None:
    with recording(tmp_path, ROWS) as rec:
        folder = rec.export(tmp_path / "lake", format="dreamlake")
    lines = (folder / "tracks/robot/data.jsonl").read_bytes().splitlines()
    assert lines[0] == b'{"index":0,"data":{"q":[0.5,1.5],"pose":{"xyz":[1.0,2.0]},"_ts":0.30000000000000004}}'
    assert repr(restore(orjson.loads(lines[1])["data"])) == repr(ROWS[1])
    assert orjson.loads((folder / "tracks/robot/metadata.json").read_bytes())["totalDataPoints"] == 2


def test_dreamlake_itself_reads_the_session(tmp_path: Path) -> None:
    dreamlake = pytest.importorskip("dreamlake")
    if importlib.metadata.version("dreamlake") >= "0.4":
        pytest.skip("this dreamlake keeps its tracks as msgpack")
    with Recorder(tmp_path / "run") as recorder:
        recorder.set_parameters({"lr": 0.1, "model.layers": 3})
        recorder.topic("robot/pose", description="an arm", tags=["a"]).append_batch(steps(30, 1.0, position=[1.0, 2.0]))
        recorder.topic("camera").append(frame_id=3, _ts=1.0)
    with Recording(tmp_path / "run") as rec:
        rec.export(tmp_path / ".dreamlake/robotics/demo", format="dreamlake")
        rows = list(rec["robot/pose"].rows())
    with dreamlake.Session(name="demo", workspace="robotics", local_path=str(tmp_path / ".dreamlake")) as session:
        found = session.track("robot/pose").read(start_index=10, limit=5)
        assert found["data"] == [{"index": index, "data": rows[index]} for index in range(10, 15)]
        assert (found["total"], found["hasMore"]) == (5, True)
        stats = session.track("robot/pose").stats()
        assert (stats["description"], stats["tags"], stats["totalDataPoints"]) == ("an arm", ["a"], "30")
        assert session.track("camera").read()["data"][0]["data"] == {"frame_id": 3, "_ts": 1.0}
        assert session.parameters().get() == {"lr": 0.1, "model.layers": 3}
        result = session.track("robot/pose").append_batch([{"position": [0.0, 0.0]}])
        assert result["startIndex"] == "30", "what follows is numbered on"


@pytest.mark.parametrize(
    ("topic", "path"),
    [
        ("robot", "robot"),
        ("robot/pose", "robot/pose"),
        ("/robot", "%2F/robot"),
        ("a//b", "a/%2F/b"),
        ("../../evil", "%2E./%2E./evil"),
        (".hidden", "%2Ehidden"),
        ("a/data.jsonl", "a/%64ata.jsonl"),
        ("a/metadata.json", "a/%6Detadata.json"),
        ("camera:left [0]", "camera:left [0]"),
        ("50%", "50%25"),
        ("a\x00b", "a%00b"),
        ("größe", "größe"),
    ],
)
def test_a_topic_becomes_a_folder_inside(topic: str, path: str) -> None:
    assert path_of(topic).as_posix() == path


def test_long_topics_stay_apart() -> None:
    assert path_of("x" * 300 + "a") != path_of("x" * 300 + "b")
    assert max(len(part) for part in path_of("x" * 300).parts) <= 200
