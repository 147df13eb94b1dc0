"""Recordings to make bags of, and what rosbags finds in a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader

from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording

Row = dict[str, Any]

ROBOT = {
    "q": [0.5, -1.5, 0.25, 0.0, 1.0, 2.5, -0.125],
    "qd": [0.0] * 7,
    "tau": [1.0] * 7,
    "gripper": 0.04,
    "ee_pos": [0.5, 0.0, 0.25],
    "ee_quat": [0.0, 0.0, 0.6, 0.8],
    "phase": "reach",
    "step": 7,
    "grasped": False,
}


class Found(NamedTuple):
    """A message as rosbags reads it."""

    topic: str
    type: str
    time_ns: int
    data: bytes
    message: Any


def record(folder: Path, topics: dict[str, list[Row]], metadata: dict[str, dict[str, Any]] | None = None) -> Path:
    """Record rows; those without `_ts` are 10 ms apart."""
    with Recorder(folder) as recorder:
        for name, rows in topics.items():
            topic = recorder.topic(name, metadata=(metadata or {}).get(name))
            topic.append_batch([{"_ts": 0.01 * number, **row} for number, row in enumerate(rows)])
    return folder


def export(folder: Path, dest: Path, format: str = "rosbag2", **options: Any) -> Path:
    """Export a recording as a bag."""
    with Recording(folder) as recording:
        return recording.export(dest, format=format, **options)


def with_rosbags(path: Path) -> list[Found]:
    """Return all messages of a bag, in the order in which rosbags reads them."""
    with AnyReader([path]) as reader:
        return [
            Found(connection.topic, connection.msgtype, time, bytes(data), reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]


def robot_rows(count: int) -> list[Row]:
    """Rows of a robot whose joints move."""
    return [{**ROBOT, "q": [0.1 * number + joint for joint in range(7)], "step": number} for number in range(count)]


def smooth_columns(count: int) -> dict[str, Any]:
    """Columns of 29 numbers that a robot may have: smooth, with all their digits."""
    time = np.arange(count)[:, None] / 1000
    phase = np.arange(7)[None, :]
    q = np.sin(time + phase)
    half = 0.25 * time[:, 0]
    quat = np.stack([np.zeros(count), np.zeros(count), np.sin(half), np.cos(half)], 1)
    return {
        "q": q,
        "qd": np.cos(time + phase),
        "tau": 2 * q,
        "ee_pos": q[:, :3].copy(),
        "ee_quat": quat,
        "gripper": q[:, 6].copy(),
    }
