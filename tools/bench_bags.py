"""Measures bags of others becoming recordings and going out again, beside the loop that decodes and encodes.

    pip install ".[bench]"
    python tools/bench_bags.py --quick                       # does it all work? under a minute
    python tools/bench_bags.py --out docs/benchmarks.md      # the figures: leave the machine alone meanwhile

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

MESSAGES, QUICK_MESSAGES = 300_000, 10_000
BAGS = {"mcap": "mcap", "sqlite3": "sqlite3", "ros1": "ros1.bag"}
CONTENDERS = ("ours", "rosbags", "compressor")
TITLES = {
    "ours": "this library",
    "rosbags": "the loop with rosbags",
    "compressor": "the content through the compressor",
}
MEASURES = {
    "mcap": "A rosbag2 in MCAP (zstd) to a recording",
    "sqlite3": "A rosbag2 in SQLite to a recording",
    "ros1": "A bag of ROS 1 to a recording",
    "out": "A recording of the rosbag2 in MCAP to a rosbag2 in MCAP",
}
TURNS = {name: CONTENDERS if name in BAGS else ("ours", "rosbags") for name in MEASURES}
SHOWN = {"per_s": "messages a second", "cpu_us": "us of CPU a message", "peak_mb": "peak memory, MB"}
PACKAGES = ("ml-dash-mcap", "rosbags", "mcap", "numpy", "zstandard")
AIMS = (
    *(
        Aim(f"{name}: messages a second", (name, "ours", "per_s"), (name, "rosbags", "per_s"), at_least=30)
        for name in MEASURES
    ),
    *(
        Aim(
            f"{name}: beside the compressor alone", (name, "ours", "per_s"), (name, "compressor", "per_s"), at_least=0.5
        )
        for name in BAGS
    ),
    *(Aim(f"{name}: peak memory, MB", (name, "ours", "peak_mb"), None, at_most=200) for name in BAGS),
)


def measure(order: rounds.Order) -> Figures:
    """Carry out one measure of one contender."""
    if "write" in order:
        ros_loops.write_bags(Path(order["write"]), order["count"])
        return {}
    src, dest, name = Path(order["src"]), Path(order["dest"]), order["name"]
    from ml_dash_mcap import convert
    from ml_dash_mcap.formats.ros import read as rosbag  # noqa: F401
    from ml_dash_mcap.formats.ros import write_ros2  # noqa: F401  # loading them is not measured
    from ml_dash_mcap.formats.ros.bag_ros1 import read as bag_ros1  # noqa: F401

    begin, cpu = time.perf_counter(), time.process_time()
    if name == "ours":
        convert(src, dest, **({"format": "rosbag2"} if order["measure"] == "out" else {}))
    elif name == "rosbags":
        assert ros_loops.decode_and_encode(src, dest) == order["count"]
    else:
        ros_loops.copy_compressed(src, dest)
    seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return {"per_s": order["count"] / seconds, "cpu_us": 1e6 * cpu / order["count"], "peak_mb": peak}


def run(what: str, name: str, data: Path, count: int) -> Figures:
    """Take one measure of one contender in a process of its own."""
    if not (data / "mcap").exists():
        rounds.in_a_process(__file__, {"write": str(data), "count": count})
    src = data / BAGS.get(what, "mcap")
    if what == "out" and name == "ours":
        src = data / "recording"
        if not src.exists():
            from ml_dash_mcap import convert

            convert(data / "mcap", src)
    dest = data / "result"
    order = {"measure": what, "name": name, "src": str(src), "dest": str(dest), "count": count}
    try:
        return rounds.in_a_process(__file__, order)
    finally:
        if dest.is_dir():
            shutil.rmtree(dest)
        dest.unlink(missing_ok=True)


COMPARISON = Comparison(
    about=__doc__,
    section="bags",
    heading="Bags that are carried",
    measures=MEASURES,
    turns=TURNS,
    titles=TITLES,
    shown=SHOWN,
    aims=AIMS,
    packages=PACKAGES,
    sizes=(MESSAGES, QUICK_MESSAGES),
    space="1 GB",
    notes="""\
Written by `tools/bench_bags.py`. Bags of {size} `sensor_msgs/JointState`s of 7 joints, written by rosbags, become
recordings with the same messages, and bags again. The loop with rosbags (`tools/ros_loops.py`) decodes each message,
encodes it again and writes a rosbag2 in MCAP. The compressor alone gets the bag's content in pieces of a MiB. Each
figure is the median of {rounds} (lowest to highest), the contenders in turn, each time in a process of its own.""",
)


if __name__ == "__main__":
    COMPARISON.main(measure, run)
