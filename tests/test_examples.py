"""The programs in examples/ and the Python in README.md and docs/ do what they say."""

from __future__ import annotations

import doctest
import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from ml_dash_mcap.recording import Recording

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
WITH_PYTHON = [page for page in PAGES if "```python" in page.read_text(encoding="utf-8")]

_SECONDS = 60


def run(*arguments: str | Path, cwd: Path) -> str:
    """Run Python in a folder, in the environment of a user who has the library and no settings; returns its output."""
    environment = {name: text for name, text in os.environ.items() if not name.startswith("ML_DASH_")}
    environment["PYTHONPATH"] = str(ROOT)
    command = [sys.executable, "-W", "error", *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=_SECONDS)
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert not done.stderr, done.stderr
    return done.stdout


# The programs


def quickstart_experiment(folder: Path, said: str) -> None:
    assert "101 rows from 0.5 s to 0.6 s, the first one: {'timestamp': 0.5, 'gripper': 0.04}" in said
    with Recording(folder / ".dash/examples/franka/quickstart") as recording:
        assert [row["q"][6] for row in recording["robot"].rows()] == [0.001 * step for step in range(1000)]
        assert recording.params == {"robot": "franka_panda", "control_freq": 1000}
        assert [row["message"] for row in recording.logs] == ["recording starts"]
        assert recording.run["status"] == "completed"


def quickstart_session(folder: Path, said: str) -> None:
    assert "pose and camera have the same times: True" in said
    with Recording(folder / ".dreamlake/examples/quickstart") as recording:
        pose, camera = (list(recording[topic].rows()) for topic in ("robot/pose", "camera/left"))
        assert [row["step"] for row in pose] == [row["frame_id"] for row in camera] == list(range(100))
        assert [row["_ts"] for row in pose] == [row["_ts"] for row in camera]


def recorder_columns(folder: Path, said: str) -> None:
    assert "20000 rows written, 0 dropped" in said
    assert "as recorded, bit for bit: True" in said
    with Recording(folder / ".dash/examples/recorder-columns") as recording:
        info = recording.topics["sim"]
        assert (info.count, info.end, info.description) == (20_000, 19.999, "a simulated arm")
        assert len(next(recording["sim"].rows())["q"]) == 7


def real_time_loop(folder: Path, said: str) -> None:
    accepted, written, waiting, dropped = map(int, re.findall(r"\d+", said.splitlines()[-1]))
    assert accepted == written + waiting + dropped == 2000
    with Recording(folder / ".dash/examples/real-time-loop") as recording:
        assert recording.topics["arm"].count + recording.topics["imu"].count == written


def survive_a_crash(folder: Path, said: str) -> None:
    rows = int(re.search(r"said (\d+) rows", said)[1])  # type: ignore[index]
    assert rows >= 5000
    assert "every row that the child had said is there: True" in said
    (run_folder,) = (folder / ".dash/examples/survive-a-crash").iterdir()
    assert {path.suffix for path in run_folder.iterdir()} == {".mcap"}, "the leftovers are gone"
    with Recording(run_folder) as recording:
        assert recording.topics["robot"].count >= rows


def read_a_window(folder: Path, said: str) -> None:
    assert "{'timestamp': 10.01, 'pose.yaw': 0.1}" in said
    table = pq.read_table(folder / ".dash/examples/drone/window/second-10.parquet")
    assert table.column_names == ["_ts", "timestamp_ns", "pose"]
    assert table["_ts"].to_pylist() == [step / 100 for step in range(1000, 1101)]


def same_time_rows(folder: Path, said: str) -> None:
    with Recording(folder / ".dash/examples/camera/same-time-rows") as recording:
        assert list(recording["camera/rgb"].rows()) == [
            {"frame_id": 0, "exposure_s": 0.02, "path": "frame_0.png", "_ts": 0.0},
            {"frame_id": 1, "exposure_s": 0.01, "_ts": 1 / 30},
            {"frame_id": 3, "_ts": 0.3},
            {"frame_id": 2, "_ts": 0.1 + 0.2},
        ]
    assert said.splitlines()[-1].endswith("time: 1")


def images_and_files(folder: Path, said: str) -> None:
    from PIL import Image

    run_folder = folder / ".dash/examples/camera/images-and-files"
    with Image.open(run_folder / "files/frames/frame_00004.png") as image:
        assert image.size == (64, 48)
    with Recording(run_folder) as recording:
        assert len(recording.files) == 6
        assert [row["frame"] for row in recording["camera"].rows()] == [f"frames/frame_0000{i}.png" for i in range(5)]
    assert "copied out: ['frame_00000.png', 'frame_00001.png', 'frame_00002.png']" in said


def metrics_and_logs(folder: Path, said: str) -> None:
    with Recording(folder / ".dash/examples/policy/metrics-and-logs") as recording:
        assert recording.params == {"model.layers": 4, "model.lr": 0.001, "optimizer": "adamw"}
        assert [row["loss"] for row in recording.metrics["train"]] == [1.0, 1 / 2, 1 / 3]
        assert [(row["level"], row["metadata"]) for row in recording.logs] == [(2, {"epochs": 3}), (3, {"loss": 1 / 3})]
    assert "the run is completed; its metrics: ['train']" in said


def ros_bag(folder: Path, said: str) -> None:
    assert 'type: "sensor_msgs/msg/JointState"' in said
    assert "the message that says all: Robot.msg" in said
    assert "arm gives back every row as it was: True" in said
    assert "arm.bag gives back every row as it was: True" in said
    assert (folder / ".dash/examples/arm/bags/arm/metadata.yaml").exists()


def mocap_takes(folder: Path, said: str) -> None:
    assert "take.csv: 7 columns of a rigid body" in said
    assert "take.trc: ['robot', 'hand:tip']" in said
    assert "back again: hand, robot; the same rows: True" in said
    assert (folder / "take.png").stat().st_size > 1000
    assert (folder / "take.joints.sto").exists()


CHECKS: dict[str, Callable[[Path, str], None]] = {
    check.__name__: check
    for check in (
        quickstart_experiment,
        quickstart_session,
        recorder_columns,
        real_time_loop,
        survive_a_crash,
        read_a_window,
        same_time_rows,
        images_and_files,
        metrics_and_logs,
        ros_bag,
        mocap_takes,
    )
}


def test_every_example_is_run_by_a_test() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {*CHECKS, "franka_control"}


@pytest.mark.parametrize("name", CHECKS)
def test_an_example_runs_and_leaves_what_it_says(name: str, tmp_path: Path) -> None:
    said = run(EXAMPLES / f"{name}.py", cwd=tmp_path)
    CHECKS[name](tmp_path, said)


@pytest.mark.parametrize("name", CHECKS)
def test_an_example_is_short_enough_to_be_read(name: str) -> None:
    assert len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= 50


def test_the_demo_records_the_arm_and_plots_what_it_read_back(tmp_path: Path) -> None:
    if importlib.util.find_spec("mujoco") is None:
        pytest.skip("mujoco is not installed")
    said = run(EXAMPLES / "franka_control.py", "--seconds", "1", "--root", tmp_path / "recordings", cwd=tmp_path)
    median, rare, most = map(float, re.findall(r"([\d.]+) us", said.split("inside append, a tick:")[1])[:3])
    assert median <= rare <= most < 10_000, "the loop's own time: what others take from it is told apart"
    assert "a second of warming up is not in it" in said
    folder = tmp_path / "recordings/demo/franka/reach-and-grasp"
    with Recording(folder) as recording:
        assert {name: info.count for name, info in recording.topics.items()} == {
            "action": 1000,
            "obs": 10,
            "robot": 1000,
        }
        assert [row["_ts"] for row in recording["robot"].rows()] == [step / 1000 for step in range(1000)]
        assert recording.params["control_freq"] == 1000
        assert len(recording.files) == 20
    assert (folder / "plot.png").read_bytes().startswith(b"\x89PNG")


# The pages


@dataclass(frozen=True)
class Block:
    """A code block of a page."""

    language: str
    text: str
    line: int
    """Where its text begins, from 1."""
    not_run: str
    """Why it is not run; empty if it is."""


_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NOT_RUN = re.compile(r"<!-- not run: (.+?) -->\s*$")


def blocks(page: str) -> Iterator[tuple[Block, str]]:
    """Yield a page's code blocks, each with the text between it and the one before."""
    end = 0
    for found in _FENCE.finditer(page):
        before = page[end : found.start()]
        end = found.end()
        reason = _NOT_RUN.search(before)
        line = page.count("\n", 0, found.start()) + 2
        yield Block(found[1], found[2], line, reason[1] if reason else ""), before


def program(name: str, page: str) -> tuple[str, list[tuple[int, str]]]:
    """Return what runs a page's Python blocks one after the other, in one namespace, and what they shall print.

    Args:
        name: Of the page, for tracebacks.
        page: Its text.

    Returns:
        The program, which prints `_MARK` and a line number before each block; the line and the text of each output
        that the page shows, a text block right behind a Python block.
    """
    lines = ["namespace = {'__name__': '__main__'}"]
    expected: list[tuple[int, str]] = []
    last: Block | None = None
    for block, before in blocks(page):
        if block.language == "python" and not block.not_run:
            source = "\n" * (block.line - 1) + block.text
            lines.append(f"print({_MARK!r}, {block.line}, flush=True)")
            lines.append(f"exec(compile({source!r}, {name!r}, 'exec'), namespace)")
            last = block
            continue
        if block.language == "text" and last is not None and not before.strip():
            expected.append((last.line, block.text))
        last = None
    return "\n".join(lines), expected


_MARK = "== block at line"


def outputs(said: str) -> dict[int, str]:
    """Return what each block printed, by its line."""
    parts = re.split(rf"^{_MARK} (\d+)\n", said, flags=re.MULTILINE)
    return {int(line): text for line, text in zip(parts[1::2], parts[2::2], strict=True)}


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_python_of_a_page_runs_and_prints_what_the_page_shows(page: Path, tmp_path: Path) -> None:
    """A page is one program; a text block right behind Python is what that prints, `...` standing for any text."""
    text = page.read_text(encoding="utf-8")
    code, expected = program(page.relative_to(ROOT).as_posix(), text)
    script = tmp_path / "page.py"
    script.write_text(code, encoding="utf-8")
    printed = outputs(run(script, cwd=tmp_path))
    for line, shown in expected:
        same = doctest.OutputChecker().check_output(shown, printed[line], doctest.ELLIPSIS)
        assert same, f"the block at line {line} printed\n{printed[line]}and not\n{shown}"


def test_python_that_is_not_run_says_why() -> None:
    page = "<!-- not run: needs a robot -->\n\n```python\nmove()\n```\n```python\nprint(1)\n```\n```text\n1\n```\n"
    found = [(block.language, block.not_run) for block, _ in blocks(page)]
    assert found == [("python", "needs a robot"), ("python", ""), ("text", "")]
    code, expected = program("page", page)
    assert "move" not in code
    assert expected == [(7, "1\n")]
