"""Measures reading a topic back, beside the readers that a user would otherwise take.

    pip install ".[bench]"
    python tools/bench_read.py --quick                       # does it all work? under a minute
    python tools/bench_read.py --out docs/benchmarks.md      # the figures: leave the machine alone meanwhile
    python tools/bench_read.py --only window --only ours     # one measure, one contender

The same rows are recorded in each contender's own form first. Each figure comes from a process of its own that runs
one measure of one contender. The contenders take turns within a round, and a ratio is one of medians over the rounds,
so that the machine's moods hit all alike.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import read_measures
import report
import rounds
from read_measures import CURVE_POINTS
from readers import CONTENDERS
from recordings import FORMS, bytes_on_disk
from report import Aim, Figures, Results
from robot_rows import TOPICS

MINUTE_CHUNKS = 366  # of 1 MiB: ten topics at 1 kHz fill them in a minute
GIGABYTES_TIMEOUT_S = 3_600


@dataclass(frozen=True, slots=True)
class Sizes:
    """How much is read."""

    rows: int = 1_000_000  # of all topics
    small_rows: int = 2_000
    times_longer: int = 100
    segments: int = 1_000
    topics: int = 1_000
    batches_bytes: int = 5_000_000_000  # on disk


QUICK = Sizes(rows=20_000, times_longer=4, segments=20, topics=50, batches_bytes=20_000_000)


@dataclass(frozen=True, slots=True)
class Measure:
    """One table of the report."""

    title: str
    run: Callable[[str, Path], Figures]
    contenders: tuple[str, ...]
    shown: dict[str, str]  # figure -> head of its column
    once: bool = False  # whether one round of it is enough


OURS = ("ours", "typed")
PEERS = ("mcap", "mcap-orjson", "mcap-ours", "rosbags", "ml-dash", "dreamlake", "rerun")
BULK = {
    "seconds": "seconds",
    "opening_s": "of them opening",
    "cpu_s": "CPU, s",
    "per_s": "rows a second",
    "peak_mb": "peak memory, MB",
}
WINDOW = {"ms": "ms", "read_kb": "read, kB", "read_percent": "of what is on disk, %"}
OPENING = {
    "mb": "MB",
    "open_ms": "open, ms",
    "open_kb": "read for it, kB",
    "info_ms": "and its topics' counts and times, ms",
    "last_ms": "or a topic's last row, ms",
}
BATCHES = {"rows": "rows", "gb": "GB on disk", "seconds": "seconds", "per_s": "rows a second", "peak_mb": "peak, MB"}
MEASURES = {
    "arrow": Measure("One topic of ten, as an Arrow table", read_measures.arrow, (*OURS, *PEERS), BULK),
    "column": Measure("One column of it (`q`, of 7), as an Arrow table", read_measures.column, (*OURS, *PEERS), BULK),
    "rows": Measure("Its rows, as dicts", read_measures.rows, (*OURS, *PEERS), BULK),
    "window": Measure(
        "One second in the middle, as dicts", read_measures.window, (*OURS, "ours-arrow", *PEERS), WINDOW
    ),
    "opening": Measure(
        "Opening, with this library", read_measures.opening, ("minute", "longer", "segments", "topics"), OPENING
    ),
    "batches": Measure("`batches()`, with this library", read_measures.batches, ("gigabytes",), BATCHES, once=True),
}
OTHERS = {
    "minute": "one file of as many chunks as a minute has",
    "longer": "one file of {times_longer} times as many",
    "segments": "a folder of {segments:,} segments",
    "topics": "one file of {topics:,} topics",
    "gigabytes": "one topic",
}  # what our own measures read; the rest have contenders
PACKAGES = (
    *("ml-dash-mcap", "mcap", "rosbags", "ml-dash", "dreamlake", "rerun-sdk"),
    *("orjson", "pyarrow", "numpy", "zstandard"),
)


def beside(says: str, measure: str, peer: str, at_least: float | None = None) -> Aim:
    says = f"{says}, beside {CONTENDERS[peer].title}"
    return Aim(says, (measure, "ours", "per_s"), (measure, peer, "per_s"), at_least=at_least)


def typed(says: str, measure: str, peer: str, at_least: float) -> Aim:
    says = f"protobuf: {says}, beside {CONTENDERS[peer].title}"
    return Aim(says, (measure, "typed", "per_s"), (measure, peer, "per_s"), at_least=at_least)


AIMS = (
    beside("a topic to Arrow, how often a second", "arrow", "mcap", 10),
    beside("one column to Arrow, how often a second", "column", "mcap", 15),
    beside("rows a second", "rows", "mcap", 5),
    beside("a window, how often a second", "window", "mcap", 5),
    beside("a window, how often a second", "window", "ml-dash", 50),
    beside("a window, how often a second", "window", "dreamlake", 50),
    beside("a topic to Arrow, how often a second", "arrow", "mcap-ours"),
    beside("rows a second", "rows", "mcap-ours"),
    beside("a window, how often a second", "window", "mcap-ours"),
    Aim("bytes read for it, beside what overlaps it", ("window", "ours", "read_of_needed"), None, at_most=1.05),
    Aim("opening a folder of segments, ms", ("opening", "segments", "open_ms"), None, at_most=1_000),
    Aim("counts and times of a thousand topics, ms", ("opening", "topics", "info_ms"), None, at_most=300),
    Aim(
        "opening a long file, beside one of a minute",
        ("opening", "longer", "open_ms"),
        ("opening", "minute", "open_ms"),
        at_most=1.5,
    ),
    Aim("peak memory of batches(), MB", ("batches", "gigabytes", "peak_mb"), None, at_most=200),
    typed("a topic to Arrow, how often a second", "arrow", "rerun", 1),
    typed("one column to Arrow, how often a second", "column", "rerun", 1),
    typed("rows a second", "rows", "ours", 1.5),
    typed("a window, how often a second", "window", "ours", 1),
)


# What is read, and one process of the benchmark.


def prepare(turns: Mapping[str, Sequence[str]], sizes: Sizes, data: Path) -> dict[str, Figures]:
    """Record what the chosen measures will read, but the gigabytes; returns what was recorded, by form."""
    names = {name for measure, found in turns.items() for name in found if measure != "batches"}
    forms = {CONTENDERS[name].form for name in names if name in CONTENDERS}
    counts = {
        "minute": MINUTE_CHUNKS,
        "longer": MINUTE_CHUNKS * sizes.times_longer,
        "segments": sizes.segments,
        "topics": sizes.topics,
    }
    made = {form: record(form, counts[form], data / form) for form in counts if form in names}
    for form in ["truth", *(form for form in FORMS if form in forms)] if forms else []:
        record(form, sizes.small_rows, data / "small" / form)
        made[form] = record(form, sizes.rows, data / "large" / form)
    return made


def record(form: str, count: int, folder: Path, timeout_s: float = rounds.TIMEOUT_S) -> Figures:
    folder.mkdir(parents=True)
    figures = rounds.in_a_process(__file__, {"form": form, "count": count, "folder": str(folder)}, timeout_s)
    print(f"recorded {count:,} of {form}: {bytes_on_disk(folder):,} bytes", file=sys.stderr)
    return figures if "absent" in figures else {"mb": bytes_on_disk(folder) / 1e6}


def read(measure: str, name: str, made: Mapping[str, Figures], sizes: Sizes, data: Path) -> Figures:
    """Take one measure of one contender, in a process of its own; the gigabytes are there only meanwhile."""
    order = {"measure": measure, "name": name, "data": str(data)}
    if measure != "batches":
        recorded = made[CONTENDERS[name].form if name in CONTENDERS else name]
        return recorded if "absent" in recorded else rounds.in_a_process(__file__, order)
    try:
        record(name, sizes.batches_bytes, data / name, GIGABYTES_TIMEOUT_S)
        return rounds.in_a_process(__file__, order, GIGABYTES_TIMEOUT_S)
    finally:
        shutil.rmtree(data / name)


def carry_out(order: rounds.Order) -> Figures:
    if "form" in order:
        FORMS[order["form"]](Path(order["folder"]), order["count"])
        return {}
    return MEASURES[order["measure"]].run(order["name"], Path(order["data"]))


# The report.


def title(name: str, sizes: Sizes) -> str:
    return CONTENDERS[name].title if name in CONTENDERS else OTHERS[name].format(**asdict(sizes))


def measure_table(name: str, results: Results, sizes: Sizes) -> str:
    measure = MEASURES[name]
    taken = {one: results[name, one] for one in measure.contenders if (name, one) in results}
    head = ["", *measure.shown.values()]
    body = [
        [title(one, sizes), *(report.cell(found, figure) for figure in measure.shown)] for one, found in taken.items()
    ]
    if "ours" in measure.contenders:
        head.append("this library's speed")
        for one, cells in zip(taken, body, strict=True):
            cells.append(report.judge(beside("", name, one), results)[1])
    text = f"### {measure.title}\n\n{report.table(head, body)}"
    return "\n\n".join([text, *(curve(found[0]) for found in taken.values() if "resident_mb" in found[0])])


def curve(figures: Figures) -> str:
    resident = figures["resident_mb"]
    head = ["rows done", *(f"{point * 100 // CURVE_POINTS} %" for point in range(1, CURVE_POINTS + 1))]
    return report.table(head, [["resident memory, MB", *(report.number(one) for one in resident)]])


def section(results: Results, made: Mapping[str, Figures], count: int, sizes: Sizes, folder: Path) -> str:
    """The whole report as Markdown."""
    ours = made.get("ours", {}).get("mb", 0.0)
    seen = {name for _, name in results}
    notes = f"""\
Written by `tools/bench_read.py`. What is read: {sizes.rows:,} rows over {len(TOPICS)} topics at 1 kHz, rows as in the
section on appending, logged tick by tick with this library: one MCAP file of {ours:,.0f} MB, JSON, zstd, as it comes;
and one in protobuf.
The others have the same rows in their own form. Each figure is the median of {count} (lowest to highest), the
contenders in turn, each time in a process of its own that has read a small recording before. Times begin before opening
and end when the rows are there; the speed of this library is a ratio of medians, above 1 where it is the faster one.
What was read is compared with what was recorded.

What limits the comparison: the files are in the page cache. mcap reads the same payloads in a file of its own writer's,
and in one line our file. Where a package knows rows only, `pyarrow.Table.from_pylist` makes a table of them. rosbags
reads CDR with arrays of fixed size instead of JSON, and times in nanoseconds. ml-dash and dreamlake have a file for
each topic and were given no other topic than the one that is read, which spares them nine tenths of the data. rerun was
given whole columns to store, topic by topic; its format is columnar, and memory that it maps is not counted as read."""
    aims = report.table(["", "measured", "aim", ""], [report.judge(aim, results) for aim in AIMS])
    tables = [
        measure_table(name, results, sizes) for name in MEASURES if any(name == measure for measure, _ in results)
    ]
    forms = [
        [form, report.number(figures["mb"])] for form, figures in made.items() if form != "truth" and "mb" in figures
    ]
    calls = [f"- {one.title}: {(one.open.__doc__ or '').strip()}" for name, one in CONTENDERS.items() if name in seen]
    parts = ["## Reading", notes, report.environment(PACKAGES, folder), "### Aims\n\n" + aims, *tables]
    if sizes == QUICK:
        parts.insert(1, "**A quick run: it shows that the benchmark works, and no more.**")
    parts += ["### What is read\n\n" + report.table(["", "MB"], forms)] if forms else []
    return "\n\n".join([*parts, "### What is timed", "\n".join(calls)])


def main() -> None:
    everything = {name: measure.contenders for name, measure in MEASURES.items()}
    given = rounds.options(__doc__, [*MEASURES, *CONTENDERS, *OTHERS], "8 GB", carry_out)
    if given is None:
        return

    sizes = QUICK if given.quick else Sizes()
    turns = rounds.chosen(everything, given.only)
    once = [name for name, measure in MEASURES.items() if measure.once]
    with tempfile.TemporaryDirectory(dir=given.folder) as scratch:
        data = Path(scratch)
        made = prepare(turns, sizes, data)
        results = rounds.play(turns, given.rounds, lambda measure, name: read(measure, name, made, sizes, data), once)
    text = section(results, made, given.rounds, sizes, given.folder)
    report.deliver(given.out, "read", text)


if __name__ == "__main__":
    main()
