"""A benchmark's section of docs/benchmarks.md: its aims, its tables, its machine.

A figure is taken once a round; what is shown and judged is the median over the rounds.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib import import_module, metadata
from pathlib import Path
from statistics import median
from typing import Any

TITLE = "# Benchmarks\n\nWritten by the programs in `tools/`; a figure changed by hand is lost with the next run.\n"

Figures = dict[str, Any]  # what one run measured; {"absent": "missing" or "failed"} if it did not
Results = dict[tuple[str, str], list[Figures]]  # (measure, contender) -> one for each round
Place = tuple[str, str, str]  # measure, contender, figure


@dataclass(frozen=True, slots=True)
class Aim:
    """What a figure, or its ratio to another, has to reach; for information if it has no limit."""

    says: str
    figure: Place
    beside: Place | None  # None: the figure itself is judged
    at_most: float | None = None
    at_least: float | None = None


def deliver(path: Path | None, name: str, body: str) -> None:
    """Put a section into a file, see `write_section`, or print it where there is none."""
    if path is None:
        print(body)
    else:
        write_section(path, name, body)


def write_section(path: Path, name: str, body: str) -> None:
    """Put `body` between the markers of `name`; what lies outside them stays as it is.

    A file without the markers gets them at its end, and a missing file is made.

    Raises:
        ValueError: The file has one marker of the pair, or has them in the wrong order.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    text = path.read_text(encoding="utf-8") if path.exists() else TITLE
    section = f"{begin}\n{body.strip()}\n{end}"
    if begin not in text and end not in text:
        text = f"{text.rstrip()}\n\n{section}\n"
    else:
        before, found_begin, rest = text.partition(begin)
        _, found_end, after = rest.partition(end)
        if not (found_begin and found_end):
            raise ValueError(f"{path.name}: expected {begin} and then {end}, each once; mend the pair or remove both")
        text = before + section + after
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table, its first column to the left and the others to the right."""
    rule = ["---", *("---:" for _ in head[1:])]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *rows))


def judge(aim: Aim, results: Results) -> list[str]:
    """A row for the table of aims: what was aimed at, what was measured, the limit, the verdict."""
    value, unit = _middle(results, aim.figure), ""
    if aim.beside is not None:
        other, unit = _middle(results, aim.beside), "x"
        value = None if value is None or not other else value / other
    limit = "none"
    if aim.at_most is not None:
        limit = f"at most {aim.at_most:,}{unit}"
    elif aim.at_least is not None:
        limit = f"at least {aim.at_least:,}{unit}"
    if value is None:
        return [aim.says, "-", limit, "not measured"]
    return [aim.says, number(value) + unit, limit, _verdict(aim, value)]


def cell(rounds: Sequence[Figures], figure: str) -> str:
    """The median of a figure over the rounds, with the lowest and the highest of them."""
    found = sorted(figures[figure] for figures in rounds if figure in figures)
    if not found:
        return str(rounds[0].get("absent", "-"))
    if len(found) == 1:
        return number(found[0])
    return f"{number(median(found))} ({number(found[0])} to {number(found[-1])})"


def number(value: float) -> str:
    """Three figures that count, and no more than two decimals."""
    decimals = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:,.{decimals}f}"


def environment(packages: Iterable[str], folder: Path) -> str:
    """The machine, its cores, the interpreter and the packages that a run's figures belong to.

    Args:
        packages: Names of distributions; one that is not installed is said to be missing.
        folder: Where the benchmark wrote; the kind of its file system is named, its path is not.
    """
    versions = ", ".join(f"{package} {_version(package)}" for package in packages)
    return (
        f"Measured on {datetime.now(timezone.utc):%Y-%m-%d}: {_processor()}, {_cores()} cores, {_memory_gb()}, "
        f"{platform.system()} {platform.release()}, files on {_file_system(folder)}; "
        f"{platform.python_implementation()} {platform.python_version()}{_priority()}; {versions}."
    )


def _priority() -> str:
    """Whether the run had more than an ordinary claim to the processors, so that others hardly disturbed it."""
    if not hasattr(os, "sched_getscheduler"):
        return ""
    is_real_time = os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)
    return "; all contenders at real-time priority, on a machine that others use" if is_real_time else ""


def _middle(results: Results, place: Place) -> float | None:
    """The median over the rounds, or None if no round has the figure."""
    measure, contender, figure = place
    found = [figures[figure] for figures in results.get((measure, contender), []) if figure in figures]
    return median(found) if found else None


def _verdict(aim: Aim, value: float) -> str:
    if aim.at_most is None and aim.at_least is None:
        return "for information"
    reached = (aim.at_most is None or value <= aim.at_most) and (aim.at_least is None or value >= aim.at_least)
    return "reached" if reached else "**not reached**"


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return _version_of_sources(package)


def _version_of_sources(package: str) -> str:
    try:
        return f"{import_module(package.replace('-', '_')).__version__} (from its sources)"
    except (ImportError, AttributeError):
        return "(missing)"


def _processor() -> str:
    for line in _lines(Path("/proc/cpuinfo")):
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))  # what this process may use, not what the machine has
    return os.cpu_count() or 1


def _memory_gb() -> str:
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemTotal"):
            return f"{int(line.split()[1]) / 2**20:.0f} GB of memory"
    return "memory unknown"


def _file_system(folder: Path) -> str:
    """The type of the file system that holds `folder`: the longest mount point above it says."""
    where = folder.resolve()
    mounts = [line.split()[1:3] for line in _lines(Path("/proc/mounts"))]
    above = [(len(point), kind) for point, kind in mounts if where.is_relative_to(point)]
    return max(above)[1] if above else "an unknown file system"


def _lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []
