"""What a type checker knows of what a user calls: exact types, without a cast."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytest.importorskip("mypy")

ROOT = Path(__file__).resolve().parent.parent

PROGRAM = """
from collections.abc import Iterator, KeysView
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
from typing_extensions import assert_type

from ml_dash_mcap import (
    CatalogEntry, Entries, Episode, Experiment, Gap, Loss, Page, Recorder, Recording, Recovered, Report, RunInfo, Selection,
    Session, SessionTrack, Stats, Take, TimePage, Topic, TopicInfo, TopicReader, Track, convert, recordings, recover,
)
from ml_dash_mcap.run.logs import Logs
from ml_dash_mcap.run.metrics import Metric


def any_format() -> str:
    return "json"


with Recording("run") as rec:
    assert_type(rec, Recording)
    assert_type(list(rec), list[str])
    assert_type(rec.keys(), KeysView[str])
    assert_type(dict(rec), dict[str, TopicReader])
    assert_type(rec.get("robot"), TopicReader | None)
    robot = rec["robot"]
    assert_type(robot.read(), Entries)
    assert_type(robot.read(0.0, 5.0, ["q"])["entries"], list[dict[str, Any]])
    assert_type(robot.read(format="json")["count"], int)
    assert_type(robot.read(format="jsonl"), bytes)
    assert_type(robot.read(format="parquet", end=1.0), bytes)
    assert_type(robot.read(format="mcap"), bytes)
    assert_type(robot.read(format="mocap"), Take)
    assert_type(robot.read(format="mocap")["metadata"]["fps"], float)
    assert_type(robot.read(format=any_format()), Any)
    assert_type(rec.read("robot"), Entries)
    assert_type(rec.read("robot", format="parquet"), bytes)
    assert_type(rec.read("robot", format="mocap"), Take)
    assert_type(robot.to_arrow(), pa.Table)
    assert_type(next(robot.batches()), pa.Table)
    assert_type(robot.to_pandas(), pd.DataFrame)
    assert_type(robot.to_pandas(flatten=True, time="datetime"), pd.DataFrame)
    part = robot.select(0.0, 5.0, ["q"], limit=10)
    assert_type(part, Selection)
    assert_type(robot.select(start=0.0, end=5.0), Selection)
    assert_type(next(part.rows()), dict[str, Any])
    assert_type(part.arrow(), pa.Table)
    assert_type(part.pandas(flatten=True), pd.DataFrame)
    assert_type(next(part.batches()), pa.Table)
    assert_type(part.read(), Entries)
    assert_type(part.read("parquet"), bytes)
    assert_type(part.read(format="mocap"), Take)
    assert_type(part.read(any_format()), Any)
    assert_type(len(part), int)
    assert_type(next(robot.rows(0.0, 1.0, limit=3)), dict[str, Any])
    assert_type(rec.topics["robot"], TopicInfo)
    assert_type(rec.gaps("robot"), list[Gap])
    assert_type(rec.losses, list[Loss])
    assert_type(rec.check(), Report)
    assert_type(rec.runs, list[RunInfo])
    assert_type(rec.episodes, list[Episode])
    assert_type(rec.align(["robot"], hz=100), pa.Table)
    assert_type(rec.export("robot.csv"), Path)

with Experiment("alice/franka/demo").run as exp:
    assert_type(exp, Experiment)
    track = exp.tracks("robot")
    assert_type(track, Track)
    assert_type(track.append(q=[0.1], _ts=0.0), Track)
    assert_type(track.read(), Entries)
    assert_type(track.read(0.0, 1.0, ["q"]), Entries)
    assert_type(track.read(format="jsonl"), bytes)
    assert_type(track.read(format="mocap"), Take)
    assert_type(track.list_entries(), list[dict[str, Any]])
    assert_type(exp.metrics("train").log({"loss": 0.5}), Metric)
    assert_type(exp.metrics("train").read(), Page)
    assert_type(exp.metrics("train").read()["data"][0]["createdAt"], str)
    assert_type(exp.log(camera=1), Logs)
    exp.log("started", level="info")

with Session("demo", "robotics") as session:
    assert_type(session, Session)
    point = session.track("robot")
    assert_type(point, SessionTrack)
    assert_type(point.append(q=[0.1]), SessionTrack)
    assert_type(point.append_message(object()), SessionTrack)
    assert_type(session.track("tool", schema="foxglove.Log", encoding="protobuf"), SessionTrack)
    assert_type(point.read(), Page)
    assert_type(point.read(0, 10)["total"], int)
    assert_type(point.read(0, 10, format="parquet"), bytes)
    assert_type(point.read(format="mocap"), Take)
    assert_type(point.read_by_time(0.0, 1.0), TimePage)

with Recorder("run") as recorder:
    assert_type(recorder.topic("imu").append(accel=[0.0], _ts=0.0), Topic)
    assert_type(recorder.topic("tool", schema="foxglove.PoseInFrame").append(frame_id="a", _ts=0.0), Topic)
    assert_type(recorder.topic("step", schema={"type": "object"}, encoding="json").append_message(object(), _ts=0), Topic)
    assert_type(recorder.stats(), Stats)
    assert_type(recorder.stats().accepted, int)
assert_type(recover("run"), Recovered)
assert_type(convert("a.bag", "b"), Path)
assert_type(recordings(".dash"), Iterator[CatalogEntry])
"""

STUBS = {
    "pyarrow/__init__.pyi": "class Table:\n    def to_pandas(self) -> object: ...\n",
    "pandas/__init__.pyi": "class DataFrame: ...\n",
}
"""Stand for pandas-stubs and pyarrow-stubs: these packages come without types."""

MISTAKES = {
    'Recorder("run", compression="lz4")': "compression",
    'Experiment("a", dashroot="b")': "dashroot",
    'RecorderOptions(compresion="lz4")': "compresion",
    'RecorderOptions(compression="gzip")': "compression",
    'Experiment("a").run.read()': "read",
    'Recording("a")["b"].read(start_timestamp=1.0)': "start_timestamp",
    'Recording("a")["b"].rows(limit="all")': "limit",
    'Recording("a", recover="no")': "recover",
}
"""Calls that a type checker should find, and a word of what it says."""


def check(folder: Path, program: str) -> str:
    """Return what mypy says of a user's program."""
    for name, text in STUBS.items():
        (folder / "stubs" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "stubs" / name).write_text(text)
    (folder / "program.py").write_text(program)
    paths = os.pathsep.join([str(folder / "stubs"), str(ROOT)])
    options = ["--strict", "--follow-imports=silent", "--config-file=", "--cache-dir", str(ROOT / ".mypy_cache/users")]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *options, "program.py"],
        cwd=folder,
        env={**os.environ, "MYPYPATH": paths},
        capture_output=True,
        text=True,
        timeout=110,
    )
    return done.stdout + done.stderr


def test_reads_have_exact_types(tmp_path: Path) -> None:
    said = check(tmp_path, PROGRAM)
    assert said.startswith("Success"), said


@pytest.mark.skipif(find_spec("pyright") is None, reason="pyright is not installed")
def test_pyright_agrees(tmp_path: Path) -> None:
    for name, text in STUBS.items():
        (tmp_path / "typings" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "typings" / name).write_text(text)
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "pyrightconfig.json").write_text(json.dumps({"extraPaths": [str(ROOT)], "stubPath": "typings"}))
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "program.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_type_checker_finds_misspelt_options(tmp_path: Path) -> None:
    lines = ["from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording", "", *MISTAKES]
    found = check(tmp_path, "\n".join(lines)).splitlines()
    by_line = {int(line.split(":")[1]): line for line in found if ": error: " in line}
    for number, (call, word) in enumerate(MISTAKES.items(), start=3):
        assert word in by_line.get(number, "nothing"), f"{call}: {found}"
