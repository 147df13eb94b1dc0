"""`Recording` opens bags like any recording."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from ml_dash_mcap.errors import DamagedFileError
from ml_dash_mcap.recording import Recording
from tests.formats.ros.test_rosbag import write_rosbag2
from tests.support.bags import export, record, robot_rows


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that temporary recordings are made in."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


@pytest.mark.parametrize("kind", ["rosbag1", "mcap", "sqlite3"])
def test_a_bag_of_ours_has_the_rows_that_it_was_made_of(tmp_path: Path, temporary: Path, kind: str) -> None:
    rows = [{**row, "_ts": 1.0 + number} for number, row in enumerate(robot_rows(20))]
    record(tmp_path / "run", {"robot": rows})
    options = {} if kind == "rosbag1" else {"storage": kind}
    bag = export(tmp_path / "run", tmp_path / "x.bag", "rosbag1" if kind == "rosbag1" else "rosbag2", **options)
    with Recording(bag) as recording:
        assert list(recording.topics) == ["robot"]
        assert list(recording["robot"].rows()) == rows
        assert recording.path == bag
        assert list(temporary.iterdir())
    assert not list(temporary.iterdir())


def test_a_folder_of_mcap_files_is_read_where_it_is(tmp_path: Path, temporary: Path) -> None:
    bag = write_rosbag2(tmp_path / "bag")
    with Recording(bag) as recording:
        assert {topic: info.count for topic, info in recording.topics.items()} == {"/odd": 3, "/point": 3}
        assert recording.segments == [bag / "bag.mcap"]
        assert not list(temporary.iterdir())


def test_nothing_stays_of_a_bag_that_cannot_be_read(tmp_path: Path, temporary: Path) -> None:
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(50))
    with pytest.raises(DamagedFileError):
        Recording(tmp_path / "x.bag")
    assert not list(temporary.iterdir())
