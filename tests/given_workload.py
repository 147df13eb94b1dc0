"""A recorder of topics with given schemas that is killed while its rows are in the journal."""

from __future__ import annotations

import os
import signal
from typing import Any

from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder

ROWS = 500
SCHEMA: dict[str, Any] = {
    "type": "object",
    "title": "Step",
    "properties": {"n": {"type": "integer"}},
    "additionalProperties": False,
}


def pose(number: int) -> PoseInFrame:
    """A message of its own."""
    return PoseInFrame(frame_id=f"frame {number}", pose={"position": {"x": number / 3}})


def record_until_killed(folder: str, flushed: int) -> None:
    """Record, and die of SIGKILL.

    Args:
        folder: The run's.
        flushed: So many rows of each topic are in the file by then.
    """
    recorder = Recorder(folder, RecorderOptions(flush_interval_s=3600))
    late = recorder.topic("late")
    for number in range(ROWS):
        time = number // 2 / 10  # two of one time stamp
        recorder.topic("pose", schema=PoseInFrame).append(
            frame_id=f"frame {number}", pose={"position": {"x": number / 3}}, _ts=time
        )
        late.append_message(pose(number), _ts=time)
        recorder.topic("step", schema=SCHEMA).append(n=number, _ts=time)
        recorder.topic("track").append(n=number, _ts=time)
        if number + 1 == flushed:
            recorder.flush()
    os.kill(os.getpid(), signal.SIGKILL)
