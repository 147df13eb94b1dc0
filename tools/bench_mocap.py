"""Measures writing and reading Motive CSV, beside the loops over rows that a user would otherwise write.

    pip install ".[bench]"
    python tools/bench_mocap.py --quick                        # does it all work? under a minute
    python tools/bench_mocap.py --out docs/benchmarks.md       # the figures: leave the machine alone meanwhile
    python tools/bench_mocap.py --only export --only ours      # one measure, one contender

A take is recorded first: a rigid body and 20 markers, some of them hidden at times. Each figure comes from a process of
its own. The contenders take turns within a round, and a ratio is one of medians over the rounds.
"""

from __future__ import annotations

import csv
import json
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import kernel
import numpy as np
import rounds
from comparison import Comparison
from mcap.reader import make_reader
from mcap.writer import Writer
from report import Aim, Figures

from ml_dash_mcap import Recorder, Recording
from ml_dash_mcap.formats import readers

FRAMES, QUICK_FRAMES = 1_000_000, 60_000
TENTH = 10  # the memory of a take is compared with that of one of so many times fewer frames
RATE_HZ = 240
MARKERS = [f"M{number:02d}" for number in range(20)]
BLOCK = 10_000
PACKAGES = ("ml-dash-mcap", "mcap", "orjson", "pyarrow", "numpy", "zstandard")

Row = Mapping[str, Any]

TITLES = {
    "ours": "this library",
    "rows": "its `rows()` and the csv module",
    "mcap": "mcap's reader, `json.loads` and the csv module",
    "append": "the csv module, `float` and this library's `append`",
    "mcap-writer": "the csv module, `json.dumps` and mcap's writer",
    "tenth": "this library, a tenth of the frames",
}
MEASURES = {"export": ("ours", "rows", "mcap", "tenth"), "import": ("ours", "append", "mcap-writer", "tenth")}
SHOWN = {
    "seconds": "seconds",
    "cpu_s": "CPU, s",
    "per_s": "frames a second",
    "peak_mb": "peak memory, MB",
    "mb": "CSV, MB",
}


def faster(measure: str, peer: str, at_least: float | None) -> Aim:
    says = f"{measure}, frames a second, beside {TITLES[peer]}"
    return Aim(says, (measure, "ours", "per_s"), (measure, peer, "per_s"), at_least=at_least)


def bounded(measure: str) -> Aim:
    says = f"{measure}, peak memory, beside a tenth of the frames"
    return Aim(says, (measure, "ours", "peak_mb"), (measure, "tenth", "peak_mb"), at_most=1.5)


AIMS = (
    faster("export", "mcap", 5),
    faster("export", "rows", None),
    bounded("export"),
    faster("import", "mcap-writer", 5),
    faster("import", "append", None),
    bounded("import"),
)


# What is written and read.


def record(folder: Path, frames: int) -> None:
    random = np.random.default_rng(0)
    with Recorder(folder) as recorder:
        body = recorder.topic("body", metadata={"quat_order": "xyzw"})
        for first in range(0, frames, BLOCK):
            count = min(BLOCK, frames - first)
            quat = random.normal(size=(count, 4))
            quat /= np.linalg.norm(quat, axis=1)[:, None]
            markers = {name: hidden(random, random.normal(size=(count, 3))) for name in MARKERS}
            times = (first + np.arange(count)) / RATE_HZ
            body.append_columns(_ts=times, pos=random.normal(size=(count, 3)), quat=quat, markers=markers)


def hidden(random: np.random.Generator, points: Any) -> Any:
    """Hide a marker for a while, twice a block on average."""
    mask = np.zeros(points.shape, bool)
    for start in random.integers(0, len(points), random.poisson(2)):
        mask[start : start + 50] = True
    return np.ma.MaskedArray(points, mask)


def export_ours(run: Path, file: Path) -> None:
    with Recording(run) as recording:
        recording.export(file, format="mocap")


def export_rows(run: Path, file: Path) -> None:
    with Recording(run) as recording:
        write(recording["body"].rows(), file)


def export_mcap(run: Path, file: Path) -> None:
    write(rows_of_mcap(run), file)


def rows_of_mcap(run: Path) -> Iterator[Row]:
    for segment in sorted(run.glob("*.mcap")):
        with segment.open("rb") as stream:
            for _, _, message in make_reader(stream).iter_messages(topics=["body"]):
                yield json.loads(message.data)


def write(rows: Iterable[Row], file: Path) -> None:
    """The straightforward loop: one row a frame."""
    start = None
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        for frame, row in enumerate(rows):
            start = row["_ts"] if start is None else start
            cells = [frame, row["_ts"] - start, *row["quat"], *row["pos"]]
            for name in MARKERS:
                cells += row["markers"].get(name, ("", "", ""))
            writer.writerow(cells)


def import_ours(file: Path, run: Path) -> None:
    with Recorder(run) as recorder:
        readers.record(file, recorder)


def rows_of_csv(file: Path) -> Iterator[Row]:
    """The straightforward loop: one row a line."""
    with file.open(newline="") as stream:
        lines = csv.reader(stream)
        for line in lines:
            if line and line[0] == "Frame":
                break
        for line in lines:
            cells = [float(cell) if cell else None for cell in line[1:]]
            points = {name: cells[8 + 3 * at : 11 + 3 * at] for at, name in enumerate(MARKERS)}
            seen = {name: point for name, point in points.items() if point[0] is not None}
            yield {"quat": cells[1:5], "pos": cells[5:8], "markers": seen, "_ts": cells[0]}


def import_append(file: Path, run: Path) -> None:
    with Recorder(run) as recorder:
        body = recorder.topic("body")
        for row in rows_of_csv(file):
            body.append(**row)


def import_mcap(file: Path, run: Path) -> None:
    run.mkdir()
    with (run / "take.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("body", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("body", "json", schema)
        for row in rows_of_csv(file):
            time_ns = round(row["_ts"] * 1e9)
            writer.add_message(channel, time_ns, json.dumps(row).encode(), time_ns)
        writer.finish()


RUN: Mapping[tuple[str, str], Callable[[Path, Path], None]] = {
    ("export", "ours"): export_ours,
    ("export", "rows"): export_rows,
    ("export", "mcap"): export_mcap,
    ("export", "tenth"): export_ours,
    ("import", "ours"): import_ours,
    ("import", "append"): import_append,
    ("import", "mcap-writer"): import_mcap,
    ("import", "tenth"): import_ours,
}


# One process of the benchmark, and the report.


def carry_out(order: rounds.Order) -> Figures:
    data, measure, name = Path(order["data"]), order["measure"], order["name"]
    if measure == "record":
        record(data / name, order["frames"])
        export_ours(data / name, data / f"{name}.csv")
        return {}
    take = "tenth" if name == "tenth" else "whole"
    with tempfile.TemporaryDirectory(dir=data) as scratch:
        result = Path(scratch, "result.csv" if measure == "export" else "result")
        source = data / take if measure == "export" else data / f"{take}.csv"
        begin, busy = time.perf_counter(), time.process_time()
        RUN[measure, name](source, result)
        seconds, cpu_s = time.perf_counter() - begin, time.process_time() - busy
        size = (result if measure == "export" else source).stat().st_size
    return {
        "seconds": seconds,
        "cpu_s": cpu_s,
        "per_s": order["frames"] / seconds,
        "peak_mb": kernel.memory_mb("VmHWM"),
        "mb": size / 1e6,
    }


def run(measure: str, name: str, data: Path, frames: int) -> Figures:
    """Take one measure of one contender in a process of its own."""
    sizes = {"whole": frames, "tenth": frames // TENTH}
    for take, size in sizes.items():
        if not (data / take).exists():
            rounds.in_a_process(__file__, {"measure": "record", "name": take, "frames": size, "data": str(data)})
    size = sizes["tenth" if name == "tenth" else "whole"]
    return rounds.in_a_process(__file__, {"measure": measure, "name": name, "frames": size, "data": str(data)})


COMPARISON = Comparison(
    about=__doc__,
    section="mocap",
    heading="Motion capture",
    measures={measure: measure.title() for measure in MEASURES},
    turns=MEASURES,
    titles=TITLES,
    shown=SHOWN,
    aims=AIMS,
    packages=PACKAGES,
    sizes=(FRAMES, QUICK_FRAMES),
    space="6 GB",
    notes=f"""\
Written by `tools/bench_mocap.py`. A take of {{size}} frames: a rigid body and {len(MARKERS)} markers, of which some
are hidden now and then, as one topic of a recording and as Motive CSV. Each figure is the median of {{rounds}} (lowest
to highest), the contenders in turn, each in a process of its own; the files are in the page cache. The loops do less
than this library: they neither check that frames are evenly spaced and rotations are rotations, nor write a header.""",
)


if __name__ == "__main__":
    COMPARISON.main(carry_out, run)
