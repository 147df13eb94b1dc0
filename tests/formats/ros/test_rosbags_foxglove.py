"""The code that Foxglove and Lichtblick read bags with reads ours, with the definitions that they carry."""

from __future__ import annotations

import json
import subprocess
import warnings
from pathlib import Path
from typing import Any

import pytest

from tests.support import node_program
from tests.support.bags import export, record, robot_rows

NODE = Path(__file__).parents[2] / "support" / "node_ros"
SECOND = {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": ""}


@pytest.fixture(scope="session")
def reader_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program with its packages, installed once."""
    return node_program.install(NODE / "read_bags.mjs", tmp_path_factory.mktemp("node_ros"))


def read(program: Path, *bags: Path) -> list[dict[str, Any]]:
    done = subprocess.run(["node", str(program), *map(str, bags)], capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stderr) == (0, "")
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_the_viewers_readers_decode_every_message_of_both_generations(tmp_path: Path, reader_program: Path) -> None:
    odd = {
        "class": "a",
        "nested": {"eeQuat": None, "list": [1, 2.5]},
        "ragged": [],
        "any": [1, "a"],
        "blob": b"\0\xff",
    }
    rows = [
        {**row, **odd, "ragged": [0.5] * (number % 3), "_ts": 1.0 + number} for number, row in enumerate(robot_rows(30))
    ]
    record(tmp_path / "run", {"robot": rows})
    bags = [export(tmp_path / "run", tmp_path / "mc", compression=one) / "mc_0.mcap" for one in ("zstd",)]
    bags += [
        export(tmp_path / "run", tmp_path / f"{one}.bag", "rosbag1", compression=one) for one in ("none", "bz2", "lz4")
    ]
    found = read(reader_program, *bags)
    assert found[0]["profile"] == "ros2"
    for said in found:
        topics = said["topics"]
        assert {topic: one["count"] for topic, one in topics.items()} == dict.fromkeys(
            ("/robot", "/robot/joint_states", "/robot/gripper", "/robot/ee_pose"), 30
        )
        own = topics["/robot"]["first"]
        assert (own["ts"], own["q"], own["step"], own["phase"]) == (1.0, rows[0]["q"], "0", "reach")
        assert (own["f_class"], own["nested"]["list"], own["any"]) == ("a", [1, 2.5], '[1,"a"]')
        assert (own["ragged"], own["blob"]) == ([], [0, 255])
        assert topics["/robot/joint_states"]["first"]["position"] == rows[0]["q"]
    assert found[0]["topics"]["/robot"]["first"]["header"] == SECOND


def test_all_standard_messages_are_decoded(tmp_path: Path, reader_program: Path) -> None:
    turned = [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
    row = {
        "q": [0.5] * 7,
        "pose": turned,
        "twist": [1.0] * 6,
        "wrench": [1.0] * 6,
        "accel": [1.0] * 3,
        "gyro": [1.0] * 3,
        "mag": [1.0] * 3,
        "temp": 20.0,
        "K": [[1.0] * 3] * 3,
        "rgb": [[[1, 2, 3]]],
        "png": b"\x89PNG",
        "_ts": 1.0,
    }
    record(tmp_path / "run", {"all": [row]})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bags = [
            export(tmp_path / "run", tmp_path / "mc", tf=True, frame_id="base") / "mc_0.mcap",
            export(tmp_path / "run", tmp_path / "out.bag", "rosbag1", tf=True, frame_id="base"),
        ]
    names = {"/all", "/tf"} | {
        f"/all/{name}"
        for name in (
            "joint_states",
            "pose",
            "twist",
            "wrench",
            "imu",
            "mag",
            "temp",
            "camera_info",
            "image",
            "image/compressed",
        )
    }
    for said in read(reader_program, *bags):
        assert set(said["topics"]) == names
        assert said["topics"]["/all/image"]["first"]["data"] == [1, 2, 3]
