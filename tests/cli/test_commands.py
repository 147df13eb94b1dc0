"""Each command prints what its public function says, and its exit code says how it went."""

from __future__ import annotations

import csv
import glob
import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer

from ml_dash_mcap import Experiment, Recorder, Recording
from ml_dash_mcap.cli import main
from ml_dash_mcap.formats import registry
from tests.support import disk
from tests.support.files import draft, finished, save

ROOT = Path(__file__).resolve().parents[2]
WALL_CLOCK = 1_700_000_000.0
"""2023-11-14T22:13:20Z."""

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a completed run: `robot` at 100 Hz for a second, and one row of `cam/left`."""
    with Experiment("alice/arm", root=tmp_path / "runs").run as exp:
        exp.params.set(lr=0.1)
        for step in range(101):
            exp.tracks("robot").append(q=[0.1, 0.2], step=step, _ts=step / 100)
        exp.tracks("cam/left").append(frame="a.png", _ts=0.5)
    return exp.path


def facts(capsys: Capture, *arguments: str | Path) -> Any:
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def failure(capsys: Capture, *arguments: str | Path, code: int = 1) -> str:
    """Run a command that fails, in one line; returns what it says."""
    assert main([*map(str, arguments)]) == code
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("ml-dash-mcap: error: ")
    assert said.err.count("\n") == 1
    return said.err


# info


def test_info_tells_what_a_recording_holds(run: Path, capsys: Capture) -> None:
    assert main(["info", str(run)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == str(run)
    assert said[1].startswith("1 file, ")
    assert said[2:5] == ["0.000 s to 1.000 s, 1.000 s", "status: completed", "lr = 0.1"]
    assert said[6:] == [
        "topic     rows    rate  fields",
        "cam/left     1    0 Hz  frame string",
        "robot      101  100 Hz  q number[2], step integer",
    ]


def test_info_says_the_same_as_json(run: Path, capsys: Capture) -> None:
    said = facts(capsys, "info", run, "--bytes")
    with Recording(run) as rec:
        robot = rec.topics["robot"]
        assert [topic["name"] for topic in said["topics"]] == list(rec.topics)
        assert said["topics"][1]["bytes"] == robot.bytes
        assert said["files"] == [{"path": str(path), "bytes": path.stat().st_size} for path in rec.segments]
    assert (said["start"], said["end"], said["duration"]) == (0.0, 1.0, 1.0)
    assert (said["params"], said["run"]["status"]) == ({"lr": 0.1}, "completed")
    assert said["topics"][1]["fields"] == {"q": "number[2]", "step": "integer"}
    assert (said["topics"][1]["count"], said["topics"][1]["rate"]) == (101, 100.0)


def test_info_shows_wall_clock_times_in_utc(tmp_path: Path, capsys: Capture) -> None:
    path = save(tmp_path / "a.mcap", [{"arm": [{"_ts": WALL_CLOCK}, {"_ts": WALL_CLOCK + 100.25}]}])
    assert main(["info", str(path)]) == 0
    assert "2023-11-14T22:13:20.000Z to 2023-11-14T22:15:00.250Z, 1 min 40.2 s" in capsys.readouterr().out


# ls


def test_ls_lists_the_recordings_below_a_folder(run: Path, tmp_path: Path, capsys: Capture) -> None:
    save(tmp_path / "runs/other/a.mcap", [{"arm": [{"_ts": WALL_CLOCK}]}])
    save(tmp_path / "runs/.hidden/a.mcap", [{"arm": [{"_ts": 0.0}]}])
    assert main(["ls", str(tmp_path / "runs")]) == 0
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert said[0] == ["recording", "status", "start", "duration", "topics", "size"]
    assert said[1][:7] == ["alice/arm", "completed", "0.000", "s", "1.000", "s", "2"]
    assert said[2][:5] == ["other", "finished", "2023-11-14T22:13:20.000Z", "0.000", "s"]
    assert len(said) == 3


def test_ls_says_the_same_as_json(run: Path, tmp_path: Path, capsys: Capture) -> None:
    (found,) = facts(capsys, "ls", tmp_path / "runs")
    size = sum(path.stat().st_size for path in run.glob("*.mcap"))
    assert found == {
        "path": str(run),
        "status": "completed",
        "start": 0.0,
        "end": 1.0,
        "duration": 1.0,
        "topics": 2,
        "files": 1,
        "bytes": size,
        "problem": None,
    }


def test_ls_lists_the_topics_of_a_recording(run: Path, capsys: Capture) -> None:
    assert main(["ls", str(run)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "topic     rows    rate  duration",
        "cam/left     1    0 Hz   0.000 s",
        "robot      101  100 Hz   1.000 s",
    ]
    assert [topic["name"] for topic in facts(capsys, "ls", run)] == ["cam/left", "robot"]


def test_ls_shows_what_is_damaged_and_exits_with_3(run: Path, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "runs/broken").mkdir()
    (tmp_path / "runs/broken/a.mcap").write_bytes(b"not MCAP")
    assert main(["ls", str(tmp_path / "runs")]) == 3
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 3
    assert "broken" in said[2]
    assert "damaged: " in said[2]


def test_ls_says_when_there_is_nothing(tmp_path: Path, capsys: Capture) -> None:
    assert main(["ls", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"no recordings in {tmp_path}, nor below it\n"
    assert facts(capsys, "ls", tmp_path) == []


# cat


def test_cat_prints_the_lines_of_read(run: Path, capsys: Capture) -> None:
    assert main(["cat", str(run), "robot"]) == 0
    with Recording(run) as rec:
        assert capsys.readouterr().out.encode() == rec["robot"].read(format="jsonl") + b"\n"


def test_cat_prints_a_part_as_csv(run: Path, capsys: Capture) -> None:
    window = ["--start", "0.5", "--end", "0.9", "--limit", "2"]
    assert main(["cat", str(run), "robot", "--format", "csv", "--columns", "step", "q", *window]) == 0
    rows = list(csv.reader(io.StringIO(capsys.readouterr().out)))
    assert rows[0] == ["_ts", "q.0", "q.1", "step"]
    assert sorted(rows[0]) == sorted(["_ts", "step", "q.0", "q.1"])
    assert [row[0] for row in rows[1:]] == ["0.5", "0.51"]


def test_cat_takes_wall_clock_times(tmp_path: Path, capsys: Capture) -> None:
    path = save(tmp_path / "a.mcap", [{"arm": [{"n": n, "_ts": WALL_CLOCK + n} for n in range(5)]}])
    window = ["--start", "2023-11-14T22:13:21Z", "--end", "2023-11-14 23:13:22+01:00"]
    assert main(["cat", str(path), "arm", *window]) == 0
    assert [json.loads(line)["n"] for line in capsys.readouterr().out.splitlines()] == [1, 2]


def test_cat_names_topics_and_columns_that_are_similar(run: Path, capsys: Capture) -> None:
    assert "did you mean 'robot'?" in failure(capsys, "cat", run, "rob")
    assert "did you mean 'step'?" in failure(capsys, "cat", run, "robot", "--columns", "stp")


# export


@pytest.mark.parametrize("format", ["csv", "dreamlake", "jsonl", "parquet"])
def test_export_writes_what_the_method_writes(run: Path, tmp_path: Path, capsys: Capture, format: str) -> None:
    assert main(["export", str(run), str(tmp_path / "a"), "--format", format, "--start", "0.5"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'a'}\n"
    with Recording(run) as rec:
        rec.export(tmp_path / "b/a", format=format, start=0.5)
    ours, theirs = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path / "a", tmp_path / "b/a")
    )
    ours.pop(Path("session.json"), None)  # which has the name of the folder above
    theirs.pop(Path("session.json"), None)
    assert ours == theirs


def test_export_takes_topics_and_the_formats_options(run: Path, tmp_path: Path, capsys: Capture) -> None:
    dest = tmp_path / "robot.parquet"
    said = facts(capsys, "export", run, dest, "--format=parquet", "--topics", "robot", "--option", "flatten=true")
    assert said == {"dest": str(dest), "format": "parquet"}
    assert pq.read_table(dest).column_names == ["_ts", "timestamp_ns", "q.0", "q.1", "step"]


def test_export_refuses_what_is_there_already(run: Path, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "out").touch()
    assert "is there already" in failure(capsys, "export", run, tmp_path / "out", "--format", "csv")


# recover


def crash(folder: Path) -> None:
    """Record 1,000 rows, and die: of those only the first 500 are in a file for sure."""
    child = f"""
import os, signal
from ml_dash_mcap import Recorder
recorder = Recorder({str(folder)!r})
for step in range(1000):
    recorder.topic("robot").append(step=step, text="x" * 50, _ts=step / 100)
    if step == 499:
        recorder.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", child], env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=60)
    assert done.returncode == -signal.SIGKILL


def forget_journal(folder: Path) -> None:
    """What a power cut does to shared memory."""
    (session,) = folder.glob(".ml_dash-*.json")
    for journal in glob.glob(json.loads(session.read_bytes())["journals"]):
        os.unlink(journal)


def test_recover_makes_a_crashed_run_whole(tmp_path: Path, capsys: Capture) -> None:
    crash(tmp_path / "run")
    said = facts(capsys, "recover", tmp_path / "run")
    assert (said["rows"], said["lost_bytes"], said["left"]) == (500, 0, [])
    assert [Path(path).suffix for path in said["finished"]] == [".mcap", ".mcap"]
    assert main(["recover", str(tmp_path / "run")]) == 0
    assert capsys.readouterr().out == "nothing to recover\n"
    with Recording(tmp_path / "run") as rec:
        assert rec.topics["robot"].count == 1000


def test_recover_makes_all_runs_below_a_folder_whole_and_leaves_a_living_one_alone(
    tmp_path: Path, capsys: Capture
) -> None:
    dead = [tmp_path / ".dash/alice/franka/first", tmp_path / ".dash/alice/franka/second", tmp_path / ".dash/alice"]
    for folder in dead:
        crash(folder)
    with Recorder(tmp_path / ".dash/alice/franka") as living:
        living.topic("robot").append(step=0, _ts=0.0)
        living.flush()
        assert all(list(folder.glob("*.active")) for folder in dead), "opening a recording recovers that one only"
        said = facts(capsys, "recover", tmp_path)
        assert sorted({str(Path(path).parent) for path in said["finished"]}) == sorted(map(str, dead))
        assert (said["rows"], said["lost_bytes"], said["left"]) == (1500, 0, [])
        living.topic("robot").append(step=1, _ts=1.0)
    for folder in dead:
        assert [row["step"] for row in disk.rows(folder)["robot"]] == list(range(1000))
    assert [row["step"] for row in disk.rows(tmp_path / ".dash/alice/franka")["robot"]] == [0, 1]


@pytest.mark.breaks_files
def test_recover_exits_with_3_when_rows_are_lost(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "run"
    crash(folder)
    forget_journal(folder)
    (active,) = folder.glob("*.active")
    os.truncate(active, active.stat().st_size - 100)
    with active.open("rb") as file:
        data = file.read()
    chunk = data.index(b"\x06", data.index(b"robot"))
    os.truncate(active, chunk + 60)
    assert main(["recover", str(folder)]) == 3
    said = capsys.readouterr()
    assert "finished " in said.out
    assert "lost: 60 bytes at the end of a file" in said.err


def test_recover_says_when_there_is_no_folder(tmp_path: Path, capsys: Capture) -> None:
    assert "no recording here" in failure(capsys, "recover", tmp_path / "nowhere")


# what all have in common


def test_a_missing_recording_is_one_line_and_exit_code_1(tmp_path: Path, capsys: Capture) -> None:
    for command in (["info"], ["ls"], ["cat", "x"], ["export", "x", "--format", "csv"]):
        said = failure(capsys, command[0], tmp_path / "nowhere", *command[1:])
        assert str(tmp_path / "nowhere") in said


def test_debug_shows_where_an_error_came_from(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        main(["info", str(tmp_path / "nowhere"), "--debug"])


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["info"],
        ["cat", "x"],
        ["cat", "x", "y", "--start", "yesterday"],
        ["cat", "x", "y", "--format", "xml"],
        ["cat", "x", "y", "--limit", "many"],
        ["export", "x"],
        ["export", "x", "y", "--format", "xml"],
        ["export", "x", "y", "--format", "csv", "--option", "flat"],
    ],
    ids=" ".join,
)
def test_what_cannot_be_parsed_is_exit_code_2(arguments: list[str], capsys: Capture) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "usage: ml-dash-mcap" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "{run}", "{out}", "--format", "parquet", "--option", "flt=1"], "no option 'flt'; it has flatten"),
        (["export", "{run}", "{out}.csv", "--format", "csv"], "there are 2 topics"),
        (["cat", "{run}", "robot", "--start", "2", "--end", "1"], "lies after"),
        (["cat", "{run}", "robot", "--limit", "-1"], "must be an integer, 0 or more"),
    ],
)
def test_what_makes_no_sense_is_exit_code_2(
    run: Path, tmp_path: Path, capsys: Capture, arguments: list[str], message: str
) -> None:
    filled = [one.format(run=run, out=tmp_path / "out") for one in arguments]
    assert message in failure(capsys, *filled, code=2)


@pytest.mark.breaks_files
def test_damage_is_an_error_or_is_skipped_and_told(tmp_path: Path, capsys: Capture) -> None:
    data = bytearray(finished(draft([{"arm": [{"n": at, "_ts": float(at)}]} for at in range(3)])))
    at = data.rindex(b'{"n":1')
    data[at + 5 : at + 6] = b"7"
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    assert f"{path}, byte " in failure(capsys, "cat", path, "arm")
    assert main(["cat", str(path), "arm", "--skip-damage"]) == 3
    said = capsys.readouterr()
    assert [json.loads(line)["n"] for line in said.out.splitlines()] == [0, 2]
    assert said.err.startswith(f"lost: {path}, byte ")
    dest = tmp_path / "arm.csv"
    assert main(["export", str(path), str(dest), "--format", "csv", "--skip-damage"]) == 3
    assert dest.read_text() == "_ts,n\n0.0,0\n2.0,2\n"


def test_a_warning_is_one_line(tmp_path: Path, capsys: Capture) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("arm", "avro", 0)
        writer.add_message(channel, 0, b"\xa0", 0)
        writer.finish()
    assert main(["cat", str(tmp_path / "a.mcap"), "arm"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["data"] == "oA=="
    assert said.err.startswith("ml-dash-mcap: warning: ")
    assert said.err.count("\n") == 1


def test_every_export_format_can_be_asked_for(capsys: Capture) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["export", "--help"])
    assert stopped.value.code == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"one of {', '.join(registry.names('write'))}" in said


def test_an_empty_recording_is_printed_too(tmp_path: Path, capsys: Capture) -> None:
    Recorder(tmp_path / "run").close()
    path = save(tmp_path / "a.mcap", [])
    assert main(["info", str(path)]) == 0
    assert main(["ls", str(path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "topic  rows  rate  duration"
