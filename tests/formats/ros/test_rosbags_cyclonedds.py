"""The bytes of our messages are those that a DDS vendor's serialiser makes of the same values."""

# No `from __future__ import annotations`: cyclonedds reads them.

from dataclasses import dataclass
from pathlib import Path

import pytest

idl = pytest.importorskip("cyclonedds.idl", reason="there is no cyclonedds for this system or Python")
types = pytest.importorskip("cyclonedds.idl.types")

from tests.support.bags import export, record, robot_rows, with_rosbags  # noqa: E402 - cyclonedds may be missing


@dataclass
class Time(idl.IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):  # type: ignore[misc, name-defined]
    sec: types.int32  # type: ignore[name-defined]
    nanosec: types.uint32  # type: ignore[name-defined]


@dataclass
class Header(idl.IdlStruct, typename="std_msgs.msg.dds_.Header_"):  # type: ignore[misc, name-defined]
    stamp: Time
    frame_id: str


@dataclass
class JointState(idl.IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):  # type: ignore[misc, name-defined]
    header: Header
    name: types.sequence[str]  # type: ignore[name-defined]
    position: types.sequence[types.float64]  # type: ignore[name-defined]
    velocity: types.sequence[types.float64]  # type: ignore[name-defined]
    effort: types.sequence[types.float64]  # type: ignore[name-defined]


@dataclass
class Nested(idl.IdlStruct, typename="ml_dash_msgs.msg.dds_.RobotNested_"):  # type: ignore[misc, name-defined]
    flag: bool
    text: str


@dataclass
class Robot(idl.IdlStruct, typename="ml_dash_msgs.msg.dds_.Robot_"):  # type: ignore[misc, name-defined]
    header: Header
    ts: types.float64  # type: ignore[name-defined]
    word: str
    q: types.array[types.float64, 3]  # type: ignore[name-defined]
    ragged: types.sequence[types.float64]  # type: ignore[name-defined]
    nested: Nested
    count: types.int64  # type: ignore[name-defined]
    blob: types.sequence[types.uint8]  # type: ignore[name-defined]


def test_joint_states(tmp_path: Path) -> None:
    rows = robot_rows(5)
    record(tmp_path / "run", {"robot": rows}, {"robot": {"frame_id": "base link"}})
    found = [
        one for one in with_rosbags(export(tmp_path / "run", tmp_path / "bag")) if one.topic == "/robot/joint_states"
    ]
    names = [f"joint{number}" for number in range(1, 8)]
    for number, (one, row) in enumerate(zip(found, rows, strict=True)):
        header = Header(Time(0, 10_000_000 * number), "base link")
        assert JointState(header, names, row["q"], row["qd"], row["tau"]).serialize() == one.data


def test_a_message_of_our_own_of_many_types(tmp_path: Path) -> None:
    rows = [
        {
            "word": "\u00e4" * number,
            "q": [0.5, 1.5, float(number)],
            "ragged": [0.25] * number,
            "nested": {"flag": number % 2 == 0, "text": "x" * (7 - number)},
            "count": -number,
            "blob": bytes(range(number)),
        }
        for number in range(6)
    ]
    record(tmp_path / "run", {"robot": rows})
    found = [one for one in with_rosbags(export(tmp_path / "run", tmp_path / "bag")) if one.topic == "/robot"]
    for number, (one, row) in enumerate(zip(found, rows, strict=True)):
        nested = Nested(row["nested"]["flag"], row["nested"]["text"])
        header = Header(Time(0, 10_000_000 * number), "")
        said = Robot(
            header, 0.01 * number, row["word"], row["q"], row["ragged"], nested, row["count"], list(row["blob"])
        )
        assert said.serialize() == one.data
