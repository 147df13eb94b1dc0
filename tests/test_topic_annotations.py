"""Units, joint names, frames and quaternion orders are kept with a topic, through every API."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap import Experiment, Recorder, Recording, Session
from ml_dash_mcap.errors import FieldError

SAID: dict[str, Any] = {
    "units": {"q": "rad"},
    "joint_names": ["a", "b"],
    "frame_id": "base",
    "quat_order": "wxyz",
}


def metadata(folder: Path) -> dict[str, Any]:
    with Recording(folder) as recording:
        return dict(recording.topics["robot"].metadata)


def test_a_recorder_keeps_them(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("robot", **SAID).append(q=[0.0, 0.0], _ts=0.0)
    assert metadata(tmp_path) == SAID


def test_an_experiment_keeps_them(tmp_path: Path) -> None:
    with Experiment(prefix="a/b/c", root=tmp_path).run as exp:
        track = exp.tracks("robot", **SAID)
        assert exp.tracks("robot") is track
        track.append(q=[0.0, 0.0], _ts=0.0)
    assert metadata(tmp_path / "a/b/c") == SAID


def test_a_session_keeps_them(tmp_path: Path) -> None:
    with Session("name", "workspace", local_path=tmp_path) as session:
        session.track("robot", **SAID).append(q=[0.0, 0.0])
    (folder,) = {path.parent for path in tmp_path.rglob("*.mcap")}
    assert metadata(folder) == SAID


def test_they_are_added_to_what_was_said_before(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("robot", metadata={"serial": 7, "frame_id": "world"}, units={"q": "deg"})
        recorder.topic("robot").append(q=[0.0], _ts=0.0)
        recorder.topic("robot", frame_id="base")
        recorder.topic("robot", quat_order="xyzw")
    assert metadata(tmp_path) == {"serial": 7, "frame_id": "base", "units": {"q": "deg"}, "quat_order": "xyzw"}


@pytest.mark.parametrize(
    "said",
    [
        {"units": ["rad"]},
        {"units": {"q": 1}},
        {"joint_names": "ab"},
        {"joint_names": [1]},
        {"frame_id": 1},
        {"quat_order": "zyxw"},
    ],
)
def test_what_is_no_such_thing_is_named(tmp_path: Path, said: dict[str, Any]) -> None:
    with Recorder(tmp_path) as recorder, pytest.raises(FieldError, match=next(iter(said))):
        recorder.topic("robot", **said)
