"""Every Python example of the pages that the two APIs come from, run as it stands there.

Only the imports are replaced, and only what belongs to the robot has a stand-in. What an example logged is then
counted on the disk by mcap's own reader.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.experiment import Experiment
from ml_dash_mcap.run.tracks import Track
from tests.support import disk

SEEDS = Path(__file__).resolve().parents[2] / "shared" / "seeds"
if not SEEDS.is_dir():
    pytest.skip("the pages are not beside this repository", allow_module_level=True)

PAGES = {"api": "ml-dash-track-api.md", "skill": "ml-dash-tracks-skill.md", "session": "dreamlake-session-tracks.md"}

_BLOCK = re.compile(r"^```(?:python|\{code-block\} python)\n(.*?)^```", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Example:
    """A Python block of a page."""

    page: str
    number: int
    line: int
    """Line of the page at which its code starts."""
    code: str

    @property
    def name(self) -> str:
        return f"{self.page}-{self.number}"


def examples() -> dict[str, Example]:
    found: dict[str, Example] = {}
    for page, file in PAGES.items():
        text = (SEEDS / file).read_text(encoding="utf-8")
        for number, block in enumerate(_BLOCK.finditer(text)):
            example = Example(page, number, text[: block.start()].count("\n") + 2, block[1])
            found[example.name] = example
    return found


EXAMPLES = examples()

SIGNATURE = "api-2"
"""The one block that is no program but the signature of `read`."""

INVALID = "skill-8"
"""The one that the page itself calls invalid: its last line misses a time stamp."""

COUNTS: dict[str, dict[str, int]] = {
    "api-0": {"robot/pose": 1000},
    "api-1": {"camera/rgb": 1},
    "api-3": {"robot/pose": 3},
    "api-4": {"robot/pose": 3},
    "api-5": {"robot/pose": 1000},
    "skill-0": {"robot": 1000},
    "skill-1": {"imu": 5},
    "skill-2": {"cam/wrist": 5, "cam/overhead": 5},
    "skill-3": {"ft_sensor": 5},
    "skill-4": {},
    "skill-5": {"robot": 1},
    "skill-6": {"robot": 3},
    "skill-7": {"robot": 3},
    "skill-8": {"imu": 1},
    "skill-9": {"robot": 1},
    "skill-10": {"robot": 2},
    "skill-11": {"robot": 10000, "action": 10000, "obs": 1000},
    "skill-12": {"robot": 1},
    "session-0": {"train_loss": 1, "accuracy": 1},
    "session-1": {"loss": 1, "metrics": 1, "system": 1},
    "session-2": {"train_loss": 4},
    "session-3": {"loss": 100},
    "session-4": {"train_loss": 10, "val_loss": 10, "val_accuracy": 10},
    "session-5": {"train_loss": 1000},
    "session-6": {"all_metrics": 10},
    "session-7": {"loss": 1},
    "session-8": {"robot/position": 1},
    "session-9": {"robot/pose": 100, "camera/left/image": 100, "robot/velocity": 100},
    "session-10": {"robot/state": 1},
    "session-11": {"loss": 2},
    "session-12": {"robot/position/left-camera": 1, "robot/position/right-camera": 1, "robot/velocity": 1},
}
"""How many rows each example leaves behind, by topic; those that only read or flush find three rows there."""

FIND_ROWS = {"api-3": "robot/pose", "api-4": "robot/pose", "skill-6": "robot", "skill-7": "robot"}


class Countdown:
    """True a few times, then false: a `while running:` that ends."""

    def __init__(self, times: int) -> None:
        self._left = times

    def __bool__(self) -> bool:
        self._left -= 1
        return self._left >= 0


def robot_things() -> dict[str, Any]:
    """Stand-ins for what the examples presume of a robot and its training."""
    vector = np.array
    robot = SimpleNamespace(
        joint_positions=np.zeros(7),
        joint_velocities=np.zeros(7),
        joint_torques=np.zeros(7),
        ee_position=np.zeros(3),
        ee_quaternion=vector([0.0, 0.0, 0.0, 1.0]),
        gripper_width=0.04,
        q=np.zeros(7),
        qd=np.zeros(7),
        tau=np.zeros(7),
        ee_pos=np.zeros(3),
        ee_quat=np.zeros(4),
        gripper_pos=0.04,
    )
    losses = itertools.count(1)
    return {
        "time": time,
        "robot": robot,
        "env": SimpleNamespace(robot=robot),
        "action": np.arange(8.0),
        "running": Countdown(5),
        "inserting": Countdown(5),
        "imu": SimpleNamespace(temperature=21.5),
        **dict.fromkeys(
            ["ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz", "fx", "fy", "fz", "tx", "ty", "tz"], 0.5
        ),
        "is_contact": True,
        "num_frames": 5,
        "fps": 30.0,
        **dict.fromkeys(["K_wrist", "K_overhead"], np.eye(3)),
        **dict.fromkeys(["T_wrist", "T_overhead"], np.eye(4)),
        "frame": np.zeros((4, 4, 3), np.uint8),
        "q_step": [0.1, 0.2],
        "model": object(),
        "train_loader": object(),
        "val_loader": object(),
        "train_one_epoch": lambda model, loader: 1 / next(losses),
        "validate": lambda model, loader: (0.5, 0.9),
        "train_step": lambda: 1 / next(losses),
    }


def run(example: Example, given: dict[str, Any]) -> dict[str, Any]:
    code = example.code.replace(":linenos:\n", "\n")
    code = code.replace("from ml_dash import Experiment", "from ml_dash_mcap.experiment import Experiment")
    code = code.replace("from dreamlake import Session", "from ml_dash_mcap.session import Session")
    presumed: dict[str, Any] = {}
    exec("from ml_dash_mcap.experiment import Experiment\nfrom ml_dash_mcap.session import Session", presumed)
    names = {**presumed, **robot_things(), **given}
    padding = "\n" * (example.line - 1)  # so that a traceback names the line of the page
    exec(compile(padding + code, PAGES[example.page], "exec"), names)
    return names


def on_disk(cwd: Path) -> dict[str, int]:
    """Rows by topic of the one recording below a folder."""
    (folder,) = {path.parent for path in cwd.rglob("*.mcap")}
    return disk.counts(folder)


@pytest.mark.parametrize("name", COUNTS)
def test_what_an_example_logs_is_on_the_disk(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    example, check = EXAMPLES[name], CHECKS.get(name, check_nothing)
    if re.search(r"^with (Experiment|Session)", example.code, re.MULTILINE):
        check(run(example, {}), None)
    else:
        with Experiment("seed/page").run as exp:
            for step in range(3 if name in FIND_ROWS else 0):
                exp.tracks(FIND_ROWS[name]).append(q=[float(step)], ee_pos=[0.0], gripper=0.04, _ts=5.0 * step)
            given = {"exp": exp, "experiment": exp}
            with pytest.raises(ValueError, match="'_ts' is required") if name == INVALID else nullcontext():
                given = run(example, given)
            check(given, exp)
    assert on_disk(tmp_path) == COUNTS[name]


def test_every_block_of_the_pages_is_run() -> None:
    assert set(EXAMPLES) == {*COUNTS, SIGNATURE}


def test_read_has_the_signature_of_the_page() -> None:
    text = EXAMPLES[SIGNATURE].code.replace("TrackBuilder.read(", "def read(").rstrip() + ": ..."
    (function,) = ast.parse(text).body
    assert isinstance(function, ast.FunctionDef)
    parameters = list(inspect.signature(Track.read).parameters.values())[1:]
    assert [argument.arg for argument in function.args.args] == [parameter.name for parameter in parameters]
    assert [ast.literal_eval(default) for default in function.args.defaults] == [
        parameter.default for parameter in parameters
    ]


# What single examples say about what they get


def check_nothing(names: dict[str, Any], exp: Any) -> None:
    """For examples of which the counts say it all."""


def check_merged(names: dict[str, Any], exp: Any) -> None:
    assert exp.tracks("camera/rgb").read() == {
        "entries": [{"timestamp": 0.0, "frame_id": 0, "path": "frame_0.png"}],
        "count": 1,
    }


def check_window(names: dict[str, Any], exp: Any) -> None:
    assert (names["data"]["count"], names["window"]["count"]) == (3, 3)
    assert names["parquet"][:4] == b"PAR1"


def check_images(names: dict[str, Any], exp: Any) -> None:
    frames = exp.files("frames").list("*.jpg")
    paths = [entry["frame"] for entry in exp.tracks("robot/pose").read()["entries"]]
    assert [file["filename"] for file in frames] == paths
    assert len(paths) == 1000


def check_builders(names: dict[str, Any], exp: Any) -> None:
    assert names["builder"] is exp.tracks("cam/wrist")


def check_columns(names: dict[str, Any], exp: Any) -> None:
    assert set(names["data"]["entries"][0]) == {"timestamp", "q", "ee_pos"}
    assert names["parquet"][:4] == b"PAR1"


def check_valid_row(names: dict[str, Any], exp: Any) -> None:
    assert exp.tracks("imu").list_entries() == [{"timestamp": 0.0, "accel": [0, 0, 9.8]}]


def check_merged_robot(names: dict[str, Any], exp: Any) -> None:
    assert exp.tracks("robot").list_entries() == [{"timestamp": 1.0, "q": [0.1, 0.2], "gripper": 0.04}]


def check_robot_data(names: dict[str, Any], exp: Any) -> None:
    entries = names["robot_data"]["entries"]
    assert names["robot_data"]["count"] == len(entries) == 501
    assert entries[-1] == {"timestamp": 5.0, "q": [0.0] * 7, "ee_pos": [0.0] * 3}


def check_metric(names: dict[str, Any], exp: Any) -> None:
    (point,) = exp.metrics("train").read()["data"]
    assert {key: point["data"][key] for key in ("loss", "accuracy", "epoch")} == {
        "loss": 0.5,
        "accuracy": 0.92,
        "epoch": 10,
    }


def check_batch(names: dict[str, Any], exp: Any) -> None:
    assert names["result"]["count"] == 4


def check_points(names: dict[str, Any], exp: Any) -> None:
    assert [point["data"]["step"] for point in names["result"]["data"]] == list(range(10))


def check_automatic_time(names: dict[str, Any], exp: Any) -> None:
    assert abs(names["data"]["data"][0]["data"]["_ts"] - time.time()) < 60


def check_merged_point(names: dict[str, Any], exp: Any) -> None:
    assert names["merged"] == {"q": [0.1, 0.2], "v": [0.01, 0.02], "e": [0.5, 0.6, 0.7], "_ts": names["ts"]}


def check_flushed(names: dict[str, Any], exp: Any) -> None:
    assert names["data"]["total"] == 2


def check_list(names: dict[str, Any], exp: Any) -> None:
    assert names["tracks"] == ["robot/position/left-camera", "robot/position/right-camera", "robot/velocity"]


CHECKS: dict[str, Callable[[dict[str, Any], Any], None]] = {
    "api-1": check_merged,
    "api-3": check_window,
    "api-5": check_images,
    "skill-4": check_builders,
    "skill-7": check_columns,
    "skill-8": check_valid_row,
    "skill-9": check_merged_robot,
    "skill-11": check_robot_data,
    "skill-12": check_metric,
    "session-2": check_batch,
    "session-3": check_points,
    "session-7": check_automatic_time,
    "session-10": check_merged_point,
    "session-11": check_flushed,
    "session-12": check_list,
}
