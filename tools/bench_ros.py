"""Measures making a rosbag2 folder of a recording and the way back, beside the straightforward loops with rosbags.

    pip install ".[bench]"
    python tools/bench_ros.py --quick                       # does it all work? under a minute
    python tools/bench_ros.py --out docs/benchmarks.md      # the figures: leave the machine alone meanwhile

Each figure comes from a process of its own. The contenders take turns within a round, and a ratio is one of medians
over the rounds.
"""

from __future__ import annotations

import resource
import shutil
import time
from pathlib import Path

import ros_loops
import rounds
from comparison import Comparison
from report import Aim, Figures

ROWS, QUICK_ROWS = 1_000_000, 20_000
BLOCK_ROWS = 10_000
LONGER = 4
CONTENDERS = ("ours", "rosbags")
TITLES = {"ours": "this library", "rosbags": "the loop with rosbags", "longer": f"this library, {LONGER} times as long"}
MEASURES = {
    "export": "A recording to a rosbag2 folder (MCAP, zstd, our message and three standard ones a row)",
    "import": "The folder of the same library back to a recording",
}
TURNS = {"export": (*CONTENDERS, "longer"), "import": (*CONTENDERS, "longer")}
SHOWN = {"seconds": "seconds", "per_s": "rows a second", "peak_mb": "peak memory, MB", "mb": "MB on disk"}
PACKAGES = ("ml-dash-mcap", "rosbags", "mcap", "numpy", "orjson", "pyarrow", "zstandard")
AIMS = (
    Aim("export, rows a second", ("export", "ours", "per_s"), ("export", "rosbags", "per_s"), at_least=8),
    Aim("import, rows a second", ("import", "ours", "per_s"), ("import", "rosbags", "per_s"), at_least=3),
    Aim("peak memory of an export, MB", ("export", "longer", "peak_mb"), None, at_most=500),
    Aim("peak memory of an import, MB", ("import", "longer", "peak_mb"), None, at_most=500),
)


def record(folder: Path, count: int) -> None:
    """Record rows of 29 floats in 6 fields, smooth as a robot's, with all their digits."""
    import numpy as np

    from ml_dash_mcap import Recorder

    rng = np.random.default_rng(7)
    phase = np.arange(7)
    with Recorder(folder) as recorder:
        topic = recorder.topic("robot", quat_order="xyzw")
        for first in range(0, count, BLOCK_ROWS):
            times = np.arange(first, min(first + BLOCK_ROWS, count)) / 1000
            angle = times[:, None] + phase + rng.normal(scale=1e-4, size=(len(times), 7))
            q = np.sin(angle)
            zero = np.zeros(len(times))
            half = 0.5 * q[:, 0]
            topic.append_columns(
                _ts=1.7e9 + times,
                q=q,
                qd=np.cos(angle),
                tau=2 * q + 0.1,
                ee_pos=q[:, :3].copy(),
                ee_quat=np.stack([zero, zero, np.sin(half), np.cos(half)], 1),
                gripper=0.04 + 0.01 * q[:, 6],
            )


def measure(order: rounds.Order) -> Figures:
    """Carry out one measure of one contender."""
    if "record" in order:
        record(Path(order["record"]), order["count"])
        return {}
    src, dest = Path(order["src"]), Path(order["dest"])
    begin = time.perf_counter()
    if order["name"] == "rosbags":
        done = (ros_loops.to_bag if order["measure"] == "export" else ros_loops.from_bag)(src, dest)
    else:
        done = ours(order["measure"], src, dest)
    seconds = time.perf_counter() - begin
    assert done == order["count"], f"{done} rows instead of {order['count']}"
    size = sum(path.stat().st_size for path in ([dest] if dest.is_file() else dest.rglob("*")) if path.is_file())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return {"seconds": seconds, "per_s": done / seconds, "peak_mb": peak, "mb": size / 1e6}


def ours(what: str, src: Path, dest: Path) -> int:
    """Convert with this library."""
    from ml_dash_mcap.conversion import convert

    seen = [0]

    def progress(done: int, _: int) -> None:
        seen[0] = done

    if what == "export":
        convert(src, dest, format="rosbag2", progress=progress)
        return seen[0]
    convert(src, dest, progress=progress)
    return seen[0] // 4  # three standard messages a row are left out


def run(what: str, name: str, data: Path, count: int) -> Figures:
    """Take one measure of one contender in a process of its own."""
    is_longer = name == "longer"
    rows = count * LONGER if is_longer else count
    recording = data / f"recording-{rows}"
    bag = data / f"bag-{name}"
    if not recording.exists():
        rounds.in_a_process(__file__, {"record": str(recording), "count": rows})
    src, dest = (recording, bag) if what == "export" else (bag, data / f"back-{name}")
    if what == "import" and not bag.exists():
        run("export", name, data, count)
    remove(dest)
    try:
        order = {"measure": what, "name": name, "src": str(src), "dest": str(dest), "count": rows}
        return rounds.in_a_process(__file__, order)
    finally:
        if what == "import":
            remove(dest)
            if is_longer:
                remove(bag)
                remove(recording)


def remove(path: Path) -> None:
    """Delete a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


COMPARISON = Comparison(
    about=__doc__,
    section="ros",
    heading="ROS bags",
    measures=MEASURES,
    turns=TURNS,
    titles=TITLES,
    shown=SHOWN,
    aims=AIMS,
    packages=PACKAGES,
    sizes=(ROWS, QUICK_ROWS),
    space="10 GB",
    notes="""\
Written by `tools/bench_ros.py`. A recording of {size} rows of 29 floats in 6 fields becomes a rosbag2 folder, and a
recording again. The loop with rosbags is in `tools/ros_loops.py`: read with mcap and json, fill the same four messages
a row, serialise, write; and read, deserialise, encode with json, write with mcap. Both compress with zstd. Each figure
is the median of {rounds} (lowest to highest), the contenders in turn, each time in a process of its own.""",
)


if __name__ == "__main__":
    COMPARISON.main(measure, run)
