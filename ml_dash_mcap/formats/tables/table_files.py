"""Reads files with a table each: one file, or a folder of nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from urllib.parse import unquote

from ...errors import UsageError
from ...recorder import Recorder
from ..registry import Progress
from . import table_intake
from .table_intake import TableFile, TableProgress
from .table_options import TableReadOptions


def of(path: Path) -> list[Path]:
    """Return the files at a path, by name."""
    return sorted(file for file in path.iterdir() if not file.name.startswith(".")) if path.is_dir() else [path]


def topic_name(path: Path, *, is_ours: bool) -> str:
    """Return the topic that a file is named after; `formats.destination.name_of` made the names of our files."""
    return unquote(path.stem) if is_ours else path.stem


def record(
    src: Path,
    recorder: Recorder,
    opened: Callable[[Path], TableFile],
    options: TableReadOptions,
    progress: Progress | None,
    rows: Callable[[Path], int],
) -> None:
    """Append the table of each file to a topic of its own.

    Args:
        src: A file, or a folder of such.
        recorder: Where to.
        opened: Opens a file.
        options: How to read the tables.
        progress: Called now and then with the rows done and the rows in all.
        rows: Returns about how many rows a file has, without reading them.

    Raises:
        UsageError: There are several files for one topic.
    """
    files = of(src)
    if options.topic is not None and len(files) > 1:
        raise UsageError(f"{src}: topic={options.topic!r} names one topic, but there are {len(files)} files")
    counter = TableProgress(progress, sum(map(rows, files)) if progress is not None else 0)
    names = _distinct(files)
    for path, name in zip(files, names, strict=True):
        file = opened(path)
        try:
            topic = topic_name(Path(name), is_ours=file.about is not None)
            table_intake.record(file, topic, recorder, options, counter)
        finally:
            file.close()
    counter.finish()


def _distinct(files: Sequence[Path]) -> list[str]:
    """Return the files' names, with their suffix twice where two differ in it only."""
    stems = [path.stem for path in files]
    return [path.name if stems.count(path.stem) == 1 else f"{path.name}{path.suffix}" for path in files]
