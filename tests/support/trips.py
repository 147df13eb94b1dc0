"""The trips of docs/architecture.md, taken in a process of their own: prints the files of the package that ran.

`python -m tests.support.trips TRIP WAY FOLDER`
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import ml_dash_mcap
from ml_dash_mcap import Experiment, Recording, convert

PACKAGE = Path(ml_dash_mcap.__file__).parent
CORPUS = Path(__file__).resolve().parents[1] / "corpus" / "files"


def append(folder: Path) -> None:
    with Experiment(prefix="a/b/c", root=folder).run as experiment:
        experiment.tracks("robot").append(q=[0.1, float("nan")], _ts=0.5)


def read(folder: Path) -> None:
    with Recording(CORPUS / "values-zstd") as recording:
        assert recording["robot"].select(start=0.1, end=0.2, columns=["q"]).arrow().num_rows == 21


def take_bag_in(folder: Path) -> None:
    convert(CORPUS / "bag-sqlite", folder / "run")


def write_bag(folder: Path) -> None:
    convert(folder / "run", folder / "bag", format="rosbag2")


def take_capture_in(folder: Path) -> None:
    convert(CORPUS / "take.csv", folder / "run")


ACTIONS: dict[str, list[Callable[[Path], None]]] = {
    "One append": [append],
    "One windowed read": [read],
    "A bag in and out": [take_bag_in, write_bag],
    "A motion capture import": [take_capture_in],
}


def files_run_by(action: Callable[[], None]) -> set[str]:
    """The files of the package of which something runs while an action does, on any thread that it begins."""
    codes: set[Any] = set()

    def note(frame: FrameType, event: str, argument: object) -> None:
        codes.add(frame.f_code)

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    paths = {Path(code.co_filename) for code in codes}
    return {path.relative_to(PACKAGE).as_posix() for path in paths if path.is_relative_to(PACKAGE)}


if __name__ == "__main__":
    action = ACTIONS[sys.argv[1]][int(sys.argv[2])]
    print("\n".join(sorted(files_run_by(lambda: action(Path(sys.argv[3]))))))
