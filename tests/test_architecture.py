"""docs/architecture.md and docs/rooms.md say what the code is: its floors, its files, and the trips through it."""

from __future__ import annotations

import importlib.util
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

import pytest

from ml_dash_mcap import Experiment, Recording, convert, file_names

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "ml_dash_mcap"
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
CORPUS = Path(__file__).resolve().parent / "corpus" / "files"

_FILE = re.compile(r"`((?:\w+/)*\w+\.py)`")


def trips() -> dict[str, list[list[str]]]:
    """The trips of the page, by heading: the steps of each way, each as its first file."""
    part = PAGE.partition("## The trips")[2].partition("\n## ")[0]
    headings = re.split(r"^### ", part, flags=re.MULTILINE)[1:]
    return {text.partition("\n")[0]: ways(text) for text in headings}


def ways(text: str) -> list[list[str]]:
    """The numbered lists in a text, each as the files that its steps begin with; one that goes on is one list."""
    found: list[list[str]] = []
    for number, file in re.findall(r"^(\d+)\. `((?:\w+/)*\w+\.py)`", text, re.MULTILINE):
        if number == "1":
            found.append([])
        found[-1].append(file)
    return found


def room_of(file: str) -> str:
    return file.split("/")[0]


def tool(name: str) -> ModuleType:
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(ROOT / "tools"))
    return module


def test_the_floor_plan_is_that_of_the_import_check() -> None:
    plan = re.search(r"^floor\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert plan is not None
    drawn = {int(line.split()[0]): set(line.split()[1:]) for line in plan[1].splitlines()}
    assert drawn == dict(enumerate(tool("check_imports").FLOORS, start=1))


def test_each_file_that_the_page_names_is_there() -> None:
    named = set(_FILE.findall(PAGE))
    assert len(named) > 50
    assert [file for file in sorted(named) if not any((base / file).is_file() for base in (PACKAGE, ROOT))] == []


@pytest.mark.parametrize("trip", trips())
def test_a_trip_returns_to_no_room_that_it_left(trip: str) -> None:
    for way in trips()[trip]:
        rooms = [room_of(file) for file in way]
        entered = [room for at, room in enumerate(rooms) if at == 0 or rooms[at - 1] != room]
        assert len(entered) == len(set(entered)), entered


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


def test_the_four_trips_are_all_there_are() -> None:
    assert {trip: len(ways) for trip, ways in trips().items()} == {trip: len(ways) for trip, ways in ACTIONS.items()}


@pytest.mark.parametrize("trip", ACTIONS)
def test_a_trip_is_what_the_code_does(trip: str, tmp_path: Path) -> None:
    for way, action in zip(trips()[trip], ACTIONS[trip], strict=True):
        ran = files_run_by(lambda action=action: action(tmp_path))  # type: ignore[misc]
        assert [file for file in way if file not in ran] == []


def test_the_page_names_every_metadata_record_and_own_topic() -> None:
    for name, text in vars(file_names).items():
        is_own = name.endswith(("_TOPIC", "_TOPICS")) and name != "OWN_TOPICS"
        if is_own or name.endswith("_RECORD") or name == "ACTIVE_SUFFIX":
            assert text in PAGE, name
