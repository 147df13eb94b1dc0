"""What the corpus was recorded by: small programs whose files do not depend on the machine or the time.

`python -m tests.corpus.programs FOLDER` runs them all (on a host that is called `robot`). The files in `files/` were made by an earlier release; today's
code must read them as that release did, and must write the same bytes for the same input.
"""

from __future__ import annotations

import json
import math
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ml_dash_mcap import Recorder, RecorderOptions, Recording

QUIET: dict[str, Any] = {"flush_interval_s": 3600.0, "chunk_bytes": 65536, "backlog_bytes": 1 << 20}
"""No block is written but at `flush` and at the end, so that the files do not depend on how fast a machine is."""


def values(folder: Path, compression: str) -> None:
    """Record every kind of value, rows that merge, rows that come late, fields that appear and widen."""
    with Recorder(folder, RecorderOptions(compression=compression, **QUIET)) as recorder:  # type: ignore[arg-type]
        robot = recorder.topic("robot", units={"q": "rad"}, joint_names=["a", "b", "c"], frame_id="base")
        for step in range(200):
            time = step * 0.005
            robot.append(q=np.array([0.1, 0.2, 0.3]) * step, _ts=time)
            robot.append(tau=[step, -step, 0.5], ok=step % 2 == 0, _ts=time)
        odd = recorder.topic("odd")
        for number, value in enumerate(ODD):
            odd.append(value=value, number=number, _ts=10.0 + number)
        recorder.flush()
        robot.append(late="a field that comes late", q=[1.0, 2.0, 3.0], _ts=0.25)
        robot.append(q=None, tau=[1.5], _ts=2.0)
        pose = recorder.topic("pose/left")
        for step in range(20):
            pose.append(pos=[1.0, 2.0, step * 0.1], quat=[0.0, 0.0, 0.0, 1.0], inner={"a": {"b": step}}, _ts=step * 0.5)


ODD: list[Any] = [
    None,
    True,
    -1,
    2**63 - 1,
    2**64 - 1,
    0.1,
    -0.0,
    math.nan,
    math.inf,
    -math.inf,
    5e-324,
    "text with ümlaut and \N{SNOWMAN}",
    b"\x00\xff bytes",
    [],
    [1, 2.5, None],
    [[1.0, 2.0], [3.0]],
    {"nested": {"deep": [1, {"x": math.nan}]}},
    [{"a": 1}, {"b": "two"}],
    np.arange(6, dtype=np.float32).reshape(2, 3),
    np.arange(5000, dtype=np.int16),
    (1, "tuple"),
]


def columns(folder: Path) -> None:
    """Record columns of a simulator, some with gaps."""
    with Recorder(folder, RecorderOptions(compression="zstd", **QUIET)) as recorder:
        times = np.arange(500) / 1000
        recorder.topic("sim").append_columns(
            _ts=times,
            q=np.linspace(0, 1, 1500).reshape(500, 3),
            step=np.arange(500),
            name=[f"n{number % 7}" for number in range(500)],
            pair={"a": np.arange(500) * 0.5, "b": [None if number % 3 else number for number in range(500)]},
        )
        masked = np.ma.masked_array(np.arange(500) * 1.5, mask=np.arange(500) % 5 == 0)
        recorder.topic("gappy").append_columns(_ts=times, x=masked, y=np.arange(500) % 2 == 0)


DYING: dict[str, Any] = {"flush_interval_s": 3600.0, "chunk_bytes": 65536, "backlog_bytes": 2 * 65536}

PROGRAMS: dict[str, Callable[[Path], None]] = {
    "values-zstd": lambda folder: values(folder, "zstd"),
    "values-lz4": lambda folder: values(folder, "lz4"),
    "values-none": lambda folder: values(folder, "none"),
    "columns": columns,
}
"""Name of a recording to the program that makes it."""

EXPORTS: dict[str, tuple[str, dict[str, Any]]] = {
    "bag-mcap": ("rosbag2", {"storage": "mcap"}),
    "bag-sqlite": ("rosbag2", {"storage": "sqlite3"}),
    "bag1.bag": ("rosbag1", {}),
    "robot.parquet": ("parquet", {"topics": ["robot"]}),
    "robot.csv": ("csv", {"topics": ["robot"]}),
    "lines.jsonl": ("jsonl", {"topics": ["robot"]}),
    "take.csv": ("mocap", {"topics": ["pose/left"]}),
    "robot.sto": ("sto", {"topics": ["robot"], "end": 0.9}),
    "pose.trc": ("trc", {"topics": ["pose/left"]}),
    "pose.tsv": ("qtm", {"topics": ["pose/left"]}),
    "vicon.csv": ("vicon", {"topics": ["pose/left"]}),
    "pose.c3d": ("c3d", {"topics": ["pose/left"]}),
}
"""Name of a file that the recording `values-zstd` is exported to, its format and its options."""

OLDER = ("robot.jsonl",)
"""Files whose format has changed since: lines of JSON called the time stamp `timestamp` before."""


def main(folder: Path) -> None:
    """Make all recordings and exports in a folder, and what is read of each."""
    for name, program in PROGRAMS.items():
        program(folder / name)
    die(folder / "dead")
    for name, (target, options) in EXPORTS.items():
        with Recording(folder / "values-zstd") as recording:
            recording.export(folder / name, format=target, **options)
    for name in [*PROGRAMS, *EXPORTS]:
        (folder / f"{name}.rows.json").write_text(json.dumps(rows_of(folder / name), indent=0) + "\n")


def die(folder: Path) -> None:
    """Record in a process that ends without closing: a segment without an end, and rows in the journal."""
    process = os.fork()
    if process == 0:
        try:
            folder.mkdir()
            recorder = Recorder(folder, RecorderOptions(journal_dir=folder, compression="zstd", **DYING))
            for step in range(300):
                recorder.topic("robot").append(q=[0.1 * step, 1.0], _ts=step * 0.01)
                if step == 150:
                    recorder.flush()
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.waitpid(process, 0)


def rows_of(path: Path) -> dict[str, list[str]]:
    """Return the rows of each topic, each as a text that tells all values and types apart."""
    with Recording(path) as recording:
        return {name: [repr(row) for row in recording[name].rows()] for name in recording.topics}


if __name__ == "__main__":
    main(Path(sys.argv[1]))
