"""docs/architecture.md and docs/rooms.md say what the code is: its floors, its files, and the trips through it."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from ml_dash_mcap import file_names
from tests.support.trips import ACTIONS

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "ml_dash_mcap"
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")

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


def test_the_four_trips_are_all_there_are() -> None:
    assert {trip: len(ways) for trip, ways in trips().items()} == {trip: len(ways) for trip, ways in ACTIONS.items()}


@pytest.mark.about_json
@pytest.mark.parametrize("trip", ACTIONS)
def test_a_trip_is_what_the_code_does(trip: str, tmp_path: Path) -> None:
    for number, way in enumerate(trips()[trip]):
        command = [sys.executable, "-m", "tests.support.trips", trip, str(number), str(tmp_path)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert [file for file in way if file not in done.stdout.splitlines()] == []


def test_the_page_names_every_metadata_record_and_own_topic() -> None:
    for name, text in vars(file_names).items():
        is_own = name.endswith(("_TOPIC", "_TOPICS")) and name != "OWN_TOPICS"
        if is_own or name.endswith("_RECORD") or name == "ACTIVE_SUFFIX":
            assert text in PAGE, name
