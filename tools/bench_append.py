"""Measures what logging a row costs, beside the recorders that a user would otherwise take.

    pip install ".[bench]"
    python tools/bench_append.py --quick                       # does it all work? under half a minute
    python tools/bench_append.py --out docs/benchmarks.md      # the figures: leave the machine alone meanwhile
    python tools/bench_append.py --only latency --only ours    # one measure, one contender

Each figure comes from a process of its own that runs one measure of one contender. The contenders take turns within
a round, and a ratio is one of medians over the rounds, so that the machine's moods hit all alike. The statement that
logs a row is compiled into the timed loop, as `timeit` does it: no wrapper's cost is added to anybody's.
"""

from __future__ import annotations

import gc
import tempfile
import time
from array import array
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import islice
from math import ceil
from pathlib import Path
from typing import Any

import kernel
import report
import rounds
from recorders import CONTENDERS, KEYWORDS, Contender, Names
from report import Figures, Results
from robot_rows import BLOCK_ROWS, PERIOD_S, TOPICS, Row, fresh_blocks, fresh_rows

MEMORY_SAMPLES = 10

THIRDS = ("q=q, qd=qd", "tau=tau, ee_pos=ee_pos", "ee_quat=ee_quat, gripper=gripper")


@dataclass(frozen=True, slots=True)
class Sizes:
    """How much a run measures."""

    rows: int = 200_000  # a latency, sustained or merge run
    column_rows: int = 1_000_000
    tick_s: float = 10.0
    memory_rows: int = 3_600_000  # an hour at 1 kHz


QUICK = Sizes(rows=5_000, column_rows=20_000, tick_s=0.3, memory_rows=20_000)


PACKAGES = ("ml-dash-mcap", "foxglove-sdk", "mcap", "ml-dash", "dreamlake", "orjson", "numpy", "zstandard")


# The loops: {call} is replaced by the contender's statement.

ROW = "(q, qd, tau, ee_pos, ee_quat, gripper, t, t_ns, ready)"
EACH_CALL = f"""
def run(rows, topic, took_ns):
    for i, {ROW} in enumerate(rows):
        start_ns = clock()
        CALL
        took_ns[i] = clock() - start_ns
"""
ALL_CALLS = f"""
def run(rows, topic):
    for {ROW} in rows:
        CALL
"""
ONE_TICK = f"""
def run(rows, topics):
    start_ns = clock()
    for topic, {ROW} in zip(topics, rows):
        CALL
    return clock() - start_ns
"""


def compiled(loop: str, call: str, names: Names) -> Callable[..., Any]:
    scope = {"clock": time.perf_counter_ns, **names}
    exec(compile(loop.replace("CALL", call), "<timed loop>", "exec"), scope)
    return scope["run"]  # type: ignore[no-any-return]


# The measures: each runs one contender once, in a process of its own.


def latency(contender: Contender, folder: Path, sizes: Sizes) -> Figures:
    """Time each call at full speed; the next row is made between two calls."""
    took_ns = array("q", bytes(8 * sizes.rows))
    with contender.open(folder, ["robot"]) as names:
        run = compiled(EACH_CALL, contender.call, names)
        run(fresh_rows(sizes.rows, ready=contender.ready), names["topics"][0], took_ns)
    return percentiles_us(took_ns)


def sustained(contender: Contender, folder: Path, sizes: Sizes) -> Figures:
    """Log rows that lie ready until the finished file is closed."""
    rows = list(fresh_rows(sizes.rows, ready=contender.ready))
    return to_disk(contender, folder, rows, contender.call, sizes.rows)


def columns(contender: Contender, folder: Path, sizes: Sizes) -> Figures:
    """Log whole arrays until the finished file is closed."""
    return to_disk(contender, folder, list(fresh_blocks(sizes.column_rows)), contender.call, sizes.column_rows)


def merge(contender: Contender, folder: Path, sizes: Sizes) -> Figures:
    """Log each row by three calls with two fields each and one time."""
    rows = list(fresh_rows(sizes.rows, ready=False))
    calls = "; ".join(contender.call.replace(KEYWORDS, third) for third in THIRDS)
    figures = to_disk(contender, folder, rows, calls, sizes.rows, split_rows=sizes.rows // 100)
    return {"calls_per_s": len(THIRDS) * sizes.rows / figures["seconds"], "rows_found": figures["rows_found"]}


def to_disk(
    contender: Contender, folder: Path, rows: list[Row], call: str, expected: int, *, split_rows: int = 0
) -> Figures:
    """Time `call` on all rows, and the closing of the file.

    Args:
        contender: Who logs.
        folder: Where to.
        rows: What to log, made beforehand.
        call: The statement or statements that log one of `rows`.
        expected: How many rows have to be found on disk.
        split_rows: How many of them may lie there in two parts, since a flush came between two calls.

    Raises:
        ValueError: Rows were lost, or were not merged.
    """
    gc.collect()
    gc.freeze()  # the rows that lie ready are the benchmark's, not a load that a user's collector would walk
    with ExitStack() as opened:
        names = opened.enter_context(contender.open(folder, ["robot"]))
        run = compiled(ALL_CALLS, call, names)
        start_s, cpu_start_s = time.perf_counter(), time.process_time()
        run(rows, names["topics"][0])
        opened.close()
        seconds, cpu_s = time.perf_counter() - start_s, time.process_time() - cpu_start_s
    found = contender.count(folder)
    if not expected <= found <= expected + split_rows:
        raise ValueError(f"{contender.title}: {found:,} rows on disk, expected {expected:,}")
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return {
        "seconds": seconds,
        "rows_per_s": expected / seconds,
        "cpu_us_per_row": cpu_s / expected * 1e6,
        "bytes_per_row": size / expected,
        "rows_found": found,
    }


def tick(contender: Contender, folder: Path, sizes: Sizes) -> Figures:
    """Time what a real 1 kHz loop spends on logging ten topics, tick by tick."""
    ticks = int(sizes.tick_s / PERIOD_S)
    took_ns = array("q", bytes(8 * ticks))
    rows = fresh_rows(ticks * len(TOPICS), ready=contender.ready, per_tick=len(TOPICS))
    with contender.open(folder, TOPICS) as names:
        run = compiled(ONE_TICK, contender.call, names)
        due_s = time.perf_counter()
        for i in range(ticks):
            now_rows = list(islice(rows, len(TOPICS)))
            due_s = max(due_s + PERIOD_S, time.perf_counter())
            time.sleep(max(0.0, due_s - time.perf_counter()))
            took_ns[i] = run(now_rows, names["topics"])
    over = sum(took > PERIOD_S * 1e9 for took in took_ns)
    return {**percentiles_us(took_ns), "over_period_percent": 100 * over / ticks}


def memory(contender: Contender, folder: Path, sizes: Sizes) -> Figures:
    """Sample the process's resident memory while it records an hour's rows as fast as it can."""
    step = sizes.memory_rows // MEMORY_SAMPLES
    rows = fresh_rows(step * MEMORY_SAMPLES, ready=contender.ready)
    resident_mb: list[float] = []
    with contender.open(folder, ["robot"]) as names:
        run = compiled(ALL_CALLS, contender.call, names)
        for _ in range(MEMORY_SAMPLES):
            run(islice(rows, step), names["topics"][0])
            resident_mb.append(kernel.memory_mb("VmRSS"))
    after_a_fifth = resident_mb[MEMORY_SAMPLES // 5 - 1]
    peak_mb = max(*resident_mb, kernel.memory_mb("VmHWM"))
    return {"resident_mb": resident_mb, "peak_mb": peak_mb, "growth": resident_mb[-1] / after_a_fifth}


def percentiles_us(took_ns: Sequence[int]) -> Figures:
    """Nearest-rank percentiles, in microseconds."""
    ordered = sorted(took_ns)
    ranks = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999, "max_us": 1.0}
    return {name: ordered[ceil(part * len(ordered)) - 1] / 1000 for name, part in ranks.items()}


@dataclass(frozen=True, slots=True)
class Measure:
    """One table of the report."""

    title: str
    run: Callable[[Contender, Path, Sizes], Figures]
    contenders: tuple[str, ...]
    shown: dict[str, str]  # figure -> head of its column; empty for one that has a table of its own
    once: bool = False  # whether one round of it is enough


CALL_TIMES = {"p50_us": "p50, us", "p99_us": "p99, us", "p999_us": "p99.9, us", "max_us": "max, us"}
DISK = {"rows_per_s": "rows a second", "cpu_us_per_row": "CPU, us a row", "bytes_per_row": "bytes a row"}
PEERS = ("foxglove-bytes", "foxglove-dict", "mcap", "ml-dash", "dreamlake")
OURS = ("ours", "typed", "experiment")
MEASURES = {
    "latency": Measure("One call, at full speed", latency, (*OURS, "foxglove-ready", *PEERS, "nothing"), CALL_TIMES),
    "sustained": Measure(
        "Sustained, until the finished file is closed",
        sustained,
        (*OURS, "foxglove-ready", "foxglove-ts", *PEERS),
        DISK,
    ),
    "columns": Measure(f"Arrays, {BLOCK_ROWS:,} rows a call", columns, ("columns", "typed-columns"), DISK),
    "merge": Measure(
        "Three calls a row, merged into one row on disk",
        merge,
        (*OURS, "ml-dash", "dreamlake"),
        {"calls_per_s": "calls a second", "rows_found": "rows on disk"},
    ),
    "tick": Measure(
        "Logging in a tick of a 1 kHz loop, 10 topics",
        tick,
        (*OURS, *PEERS),
        {**CALL_TIMES, "over_period_percent": "ticks over 1 ms, %"},
    ),
    "memory": Measure(
        "Resident memory while an hour is recorded", memory, ("ours", "typed", "foxglove-bytes"), {}, once=True
    ),
}


def beside(says: str, measure: str, figure: str, peer: str, **limit: float) -> report.Aim:
    return report.Aim(says, (measure, "ours", figure), (measure, peer, figure), **limit)


def typed(says: str, measure: str, figure: str, peer: str, **limit: float) -> report.Aim:
    return report.Aim(f"protobuf: {says}", (measure, "typed", figure), (measure, peer, figure), **limit)


TYPED_AIMS = (
    typed("call p50, beside foxglove-sdk with bytes", "latency", "p50_us", "foxglove-bytes", at_most=0.9),
    typed("call p50, beside our JSON", "latency", "p50_us", "ours", at_most=0.8),
    typed("call p99.9, beside foxglove-sdk with bytes", "latency", "p999_us", "foxglove-bytes", at_most=1.0),
    typed("call max, beside foxglove-sdk with bytes", "latency", "max_us", "foxglove-bytes", at_most=0.7),
    typed("rows a second, beside foxglove-sdk with bytes", "sustained", "rows_per_s", "foxglove-bytes", at_least=2.0),
    typed("CPU a row, beside our JSON", "sustained", "cpu_us_per_row", "ours", at_most=0.55),
    typed("bytes on disk, beside our JSON", "sustained", "bytes_per_row", "ours", at_most=0.9),
    report.Aim(
        "protobuf: append_columns rows a second, beside append of JSON",
        ("columns", "typed-columns", "rows_per_s"),
        ("sustained", "ours", "rows_per_s"),
        at_least=6.0,
    ),
    report.Aim(
        "protobuf: calls a second, three that merge into a row",
        ("merge", "typed", "calls_per_s"),
        None,
        at_least=100_000,
    ),
    report.Aim(
        "protobuf: memory after an hour, beside after a fifth of it", ("memory", "typed", "growth"), None, at_most=1.05
    ),
)

AIMS = (
    beside("call p50, beside foxglove-sdk with bytes", "latency", "p50_us", "foxglove-bytes", at_most=1.4),
    beside("call p50, beside foxglove-sdk with bytes made beforehand", "latency", "p50_us", "foxglove-ready"),
    beside("call p50, beside foxglove-sdk with dicts", "latency", "p50_us", "foxglove-dict", at_most=0.25),
    beside("call p99.9, beside foxglove-sdk with bytes", "latency", "p999_us", "foxglove-bytes", at_most=1.0),
    beside("call max, beside foxglove-sdk with bytes", "latency", "max_us", "foxglove-bytes", at_most=0.5),
    beside("rows a second, beside foxglove-sdk with bytes", "sustained", "rows_per_s", "foxglove-bytes", at_least=1.3),
    beside("rows a second, beside foxglove-sdk with dicts", "sustained", "rows_per_s", "foxglove-dict", at_least=4.0),
    beside("time in a tick p99.9, beside foxglove-sdk with bytes", "tick", "p999_us", "foxglove-bytes", at_most=0.15),
    beside("bytes on disk, beside foxglove-sdk", "sustained", "bytes_per_row", "foxglove-bytes", at_most=1.0),
    beside("bytes on disk, beside foxglove-sdk with `_ts`", "sustained", "bytes_per_row", "foxglove-ts"),
    report.Aim(
        "append_columns rows a second, beside append",
        ("columns", "columns", "rows_per_s"),
        ("sustained", "ours", "rows_per_s"),
        at_least=5.0,
    ),
    report.Aim("calls a second, three that merge into a row", ("merge", "ours", "calls_per_s"), None, at_least=100_000),
    report.Aim("memory after an hour, beside after a fifth of it", ("memory", "ours", "growth"), None, at_most=1.05),
    *TYPED_AIMS,
)


# One process of the benchmark.


def in_a_process(measure: str, contender: str, *, sizes: Sizes, folder: Path) -> Figures:
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        order = {"measure": measure, "contender": contender, "folder": scratch, "sizes": asdict(sizes)}
        return rounds.in_a_process(__file__, order)


def carry_out(order: rounds.Order) -> Figures:
    contender = CONTENDERS[order["contender"]]
    return MEASURES[order["measure"]].run(contender, Path(order["folder"]), Sizes(**order["sizes"]))


# The report.


def measure_table(name: str, results: Results) -> str:
    measure = MEASURES[name]
    taken = {contender: results[name, contender] for contender in measure.contenders if (name, contender) in results}
    if shown := measure.shown:
        head = ["", *shown.values()]
        rows = [[CONTENDERS[key].title, *(report.cell(took, name) for name in shown)] for key, took in taken.items()]
    else:
        head = ["", *(f"{tenth * 100 // MEMORY_SAMPLES} %" for tenth in range(1, MEMORY_SAMPLES + 1)), "peak"]
        rows = [[CONTENDERS[key].title, *memory_cells(taken[key])] for key in taken]
    return f"### {measure.title}\n\n{report.table(head, rows)}"


def memory_cells(taken: list[Figures]) -> list[str]:
    curve = taken[0].get("resident_mb")
    if curve is None:
        return [report.cell(taken, "peak_mb")] * (MEMORY_SAMPLES + 1)
    return [*(report.number(value) for value in curve), report.cell(taken, "peak_mb")]


def section(results: Results, count: int, sizes: Sizes, folder: Path) -> str:
    """The whole report as Markdown."""
    seen = {contender for _, contender in results}
    tables = [measure_table(name, results) for name in MEASURES if any(name == measure for measure, _ in results)]
    calls = [f"- {entry.title}: `{entry.call}`" for key, entry in CONTENDERS.items() if key in seen]
    notes = f"""\
Written by `tools/bench_append.py`. A row is 29 floats in 6 fields, new random doubles each time, made outside the timed
part. Each figure is the median of {count} (lowest to highest), the contenders in turn, each time in a process of its
own; the memory's curve is taken once, in MB, at tenths of {sizes.memory_rows:,} rows. A run has {sizes.rows:,} rows
({sizes.column_rows:,} for arrays, {sizes.tick_s:g} s of ticks).

What limits the comparison: call times include reading the clock, whose own cost is the last line. The MCAP writers use
zstd, with their own defaults otherwise; ml-dash and dreamlake do not compress, and dreamlake keeps all rows in memory
until it is closed. Nobody was asked for fsync. The payloads of foxglove-sdk and mcap hold no `_ts`, only the message's
time in nanoseconds, except where said."""
    aims = report.table(["", "measured", "aim", ""], [report.judge(aim, results) for aim in AIMS])
    parts = ["## Appending", notes, report.environment(PACKAGES, folder), "### Aims\n\n" + aims, *tables]
    if sizes == QUICK:
        parts.insert(1, "**A quick run: it shows that the benchmark works, and no more.**")
    return "\n\n".join([*parts, "### What is timed", "\n".join(calls)])


def main() -> None:
    given = rounds.options(__doc__, [*MEASURES, *CONTENDERS], "2 GB", carry_out)
    if given is None:
        return

    sizes = QUICK if given.quick else Sizes()
    turns = rounds.chosen({name: measure.contenders for name, measure in MEASURES.items()}, given.only)
    once = [name for name, measure in MEASURES.items() if measure.once]
    results = rounds.play(
        turns, given.rounds, lambda *names: in_a_process(*names, sizes=sizes, folder=given.folder), once
    )
    text = section(results, given.rounds, sizes, given.folder)
    report.deliver(given.out, "append", text)


if __name__ == "__main__":
    main()
