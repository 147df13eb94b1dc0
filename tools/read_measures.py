"""What the reading benchmark measures: each takes one contender once, in a process of its own.

Opening is part of each time, closing is not; a small recording is read before, so that no import is timed. What was
read is compared with what was recorded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Generic, Protocol, TypeVar

import kernel
from readers import CONTENDERS, NS_PER_S, Reader
from recordings import TOPIC, bytes_on_disk
from report import Figures
from robot_rows import PERIOD_S, START_S

WINDOW_S = 1.0
CURVE_POINTS = 10
REPEAT_S = 0.5  # what takes less is repeated for so long
MOST_REPEATS = 15


class Closable(Protocol):
    """What can be opened."""

    def close(self) -> None:
        """Let go of everything."""


Opened = TypeVar("Opened", bound=Closable)
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Taken(Generic[Result]):
    """What came of opening something and reading from it."""

    result: Result
    seconds: float
    opening_s: float
    """The part of it that was opening."""
    cpu_s: float
    bytes_read: int


def take(opening: Callable[[], Opened], reading: Callable[[Opened], Result]) -> Taken[Result]:
    read_before, cpu_start_s, start_s = kernel.bytes_read(), time.process_time(), time.perf_counter()
    opened = opening()
    opened_s = time.perf_counter()
    result = reading(opened)
    seconds, cpu_s = time.perf_counter() - start_s, time.process_time() - cpu_start_s
    bytes_read = kernel.bytes_read() - read_before
    opened.close()
    return Taken(result, seconds, opened_s - start_s, cpu_s, bytes_read)


def repeated(once: Callable[[], Taken[Result]]) -> list[Taken[Result]]:
    """Take what is short several times."""
    takes: list[Taken[Result]] = []
    while not takes or (sum(one.seconds for one in takes) < REPEAT_S and len(takes) < MOST_REPEATS):
        takes.append(once())
    return takes


# The whole topic.


def arrow(name: str, data: Path) -> Figures:
    """One topic as an Arrow table."""
    return _to_table(name, data, None)


def column(name: str, data: Path) -> Figures:
    """One column of it."""
    return _to_table(name, data, ["q"])


def _to_table(name: str, data: Path, columns: list[str] | None) -> Figures:
    take(_opening(name, data / "small"), lambda reader: reader.table(columns))
    taken = take(_opening(name, data / "large"), lambda reader: reader.table(columns))
    q = taken.result["q"].combine_chunks()
    _check(name, q.flatten().to_numpy().reshape(len(q), -1), _recorded(data)[1])
    return _figures(taken, len(q))


def rows(name: str, data: Path) -> Figures:
    """All rows as dicts, one by one, as a loop would use them."""
    take(_opening(name, data / "small"), lambda reader: _last(reader.rows()))
    taken = take(_opening(name, data / "large"), lambda reader: _last(reader.rows()))
    count, row = taken.result
    times, q = _recorded(data)
    if count != len(times):
        raise ValueError(f"{name} read {count:,} rows; {len(times):,} were recorded")
    _check(name, [row["q"]], q[-1:])
    return _figures(taken, count)


def _opening(name: str, folder: Path) -> Callable[[], Reader]:
    contender = CONTENDERS[name]
    return lambda: contender.open(folder / contender.form)


def _last(found: Iterable[dict[str, Any]]) -> tuple[int, dict[str, Any]]:
    """Return how many rows there are, and the last one."""
    count, row = 0, dict[str, Any]()
    for count, row in enumerate(found, 1):  # noqa: B007  # the loop is what is timed
        pass
    return count, row


def _figures(taken: Taken[Any], count: int) -> Figures:
    return {
        "seconds": taken.seconds,
        "opening_s": taken.opening_s,
        "cpu_s": taken.cpu_s,
        "per_s": count / taken.seconds,
        "peak_mb": kernel.memory_mb("VmHWM"),
    }


def _recorded(data: Path) -> tuple[Any, Any]:
    """Return the times [N] and q [N, 7] that were recorded on the topic."""
    import numpy

    found = numpy.load(data / "large" / "truth" / "truth.npz")
    return found["t"], found["q"]


def _check(name: str, found: Any, recorded: Any) -> None:
    """Compare what was read of q, [N][7], with what was recorded.

    Raises:
        ValueError: They differ.
    """
    import numpy

    if not numpy.array_equal(numpy.asarray(found), recorded):
        raise ValueError(f"{name} read {len(found):,} values of q that are not the {len(recorded):,} recorded ones")


# A window of it.


def window(name: str, data: Path) -> Figures:
    """One second in the middle, as a list of dicts."""
    form = data / "large" / CONTENDERS[name].form
    times, q = _recorded(data)
    size = int(WINDOW_S / PERIOD_S)
    first = (len(times) - size) // 2
    start_s, end_s = (START_S + (number - 0.5) * PERIOD_S for number in (first, first + size))
    take(_opening(name, data / "small"), lambda reader: reader.window(START_S, START_S + PERIOD_S))
    takes = repeated(lambda: take(_opening(name, data / "large"), lambda reader: reader.window(start_s, end_s)))
    _check(name, [row["q"] for row in takes[-1].result], q[first : first + size])
    seconds, bytes_read = median(one.seconds for one in takes), takes[-1].bytes_read
    figures: Figures = {"ms": seconds * 1000, "per_s": 1 / seconds, "read_kb": bytes_read / 1000}
    figures["read_percent"] = 100 * bytes_read / bytes_on_disk(form)
    if form.name == "ours":
        figures["read_of_needed"] = bytes_read / _needed_bytes(form, start_s, end_s)
    return figures


def _needed_bytes(folder: Path, start_s: float, end_s: float) -> int:
    """Return the size of a file's summary and of its chunks, message indexes included, that overlap a time range.

    `mcap` says which they are.
    """
    from mcap.reader import make_reader

    (path,) = folder.glob("*.mcap")
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None:
        raise ValueError(f"{path.name} has no summary")
    size: int = path.stat().st_size - max(
        one.chunk_start_offset + one.chunk_length + one.message_index_length for one in summary.chunk_indexes
    )
    for one in summary.chunk_indexes:
        if one.message_start_time <= end_s * NS_PER_S and one.message_end_time >= start_s * NS_PER_S:
            size += one.chunk_length + one.message_index_length
    return size


# Long recordings.


def opening(name: str, data: Path) -> Figures:
    """Open a recording; ask for its topics' counts and times; ask for a topic's last row."""
    from ml_dash_mcap import Recording

    readings: dict[str, Callable[[Recording], Any]] = {
        "open_ms": lambda recording: None,
        "info_ms": lambda recording: [(info.count, info.start, info.end) for info in recording.topics.values()],
        "last_ms": lambda recording: recording[TOPIC].last(),
    }
    figures: Figures = {"mb": bytes_on_disk(data / name) / 1e6}
    take(lambda: Recording(data / name), lambda recording: recording[TOPIC].last())
    for figure, reading in readings.items():
        takes = repeated(lambda: take(lambda: Recording(data / name), reading))  # noqa: B023  # it is called at once
        figures[figure] = median(one.seconds for one in takes) * 1000
        figures.setdefault("open_kb", takes[0].bytes_read / 1000)
    return figures


def batches(name: str, data: Path) -> Figures:
    """Go through a topic of several gigabytes; sample the process's resident memory on the way."""
    from ml_dash_mcap import Recording

    with Recording(data / name) as recording:
        reader = recording[TOPIC]
        total = reader.info.count
        done, resident_mb, start_s = 0, list[float](), time.perf_counter()
        for table in reader.batches():
            done += len(table)
            while done * CURVE_POINTS >= total * (len(resident_mb) + 1):
                resident_mb.append(kernel.memory_mb("VmRSS"))
        seconds = time.perf_counter() - start_s
    if done != total:
        raise ValueError(f"batches() gave {done:,} rows of {total:,}")
    return {
        "resident_mb": resident_mb,
        "peak_mb": kernel.memory_mb("VmHWM"),
        "seconds": seconds,
        "per_s": total / seconds,
        "rows": total,
        "gb": bytes_on_disk(data / name) / 1e9,
    }
