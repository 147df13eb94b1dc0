"""Other people's files as recordings: one module each, and a table of them."""

from __future__ import annotations

import errno
import inspect
import tempfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import FormatError, MissingRecordingError, UsageError
from ..recorder import Recorder
from ..suggestions import did_you_mean

Progress = Callable[[int, int], object]
"""Called now and then with the rows done and the rows in all."""

FORMATS: Mapping[str, str] = {
    "rosbag1": "rosbag",
    "rosbag2": "rosbag",
    "mocap": "motive",
    "sto": "sto",
    "trc": "trc",
    "qtm": "qtm",
    "vicon": "vicon",
    "wide": "wide",
    "c3d": "c3d",
    "parquet": "parquet",
    "jsonl": "jsonl",
    "csv": "csv_table",
}
"""Formats, to the module here that reads them.

A module has `detect(path) -> str | None`, which names the format of what is at a path that exists, or None, and
`record(src, recorder, *, progress=None, **options) -> None`, which appends its rows to a recorder.
"""


def detect(path: str | Path) -> str | None:
    """Return the format of what is at a path; None if it is none of them, or nothing is there."""
    place = Path(path)
    if not place.exists():
        return None
    for module in dict.fromkeys(FORMATS.values()):
        found: str | None = _load(module).detect(place)
        if found is not None:
            return found
    return None


def record(
    src: str | Path, recorder: Recorder, *, format: str | None = None, progress: Progress | None = None, **options: Any
) -> None:
    """Append what is in a foreign file or folder to a recorder.

    Args:
        src: The file or folder.
        recorder: Where to.
        format: One of `FORMATS`; None to find out.
        progress: Called now and then with the rows done and the rows in all.
        options: Of the format.

    Raises:
        MissingRecordingError: Nothing is at `src`; also a FileNotFoundError.
        FormatError: Its format is not known; also a ValueError.
        UsageError: The format has no such option; also a TypeError.
    """
    place = Path(src)
    if not place.exists():
        raise MissingRecordingError(errno.ENOENT, "there is nothing", str(place))
    name = format if format is not None else detect(place)
    if name is None or name not in FORMATS:
        known = ", ".join(sorted(FORMATS))
        said = "its format is not known" if name is None else f"there is no format {name!r}"
        raise FormatError(f"{place}: {said}; those that can be read are {known}")
    read = _load(FORMATS[name]).record
    taken = [one for one, how in inspect.signature(read).parameters.items() if how.kind is how.KEYWORD_ONLY]
    for option in options:
        if option not in taken:
            offered = [one for one in taken if one != "progress"]
            what = f"it has {', '.join(offered) or 'none'}. {did_you_mean(option, offered, spelling='{}=')}".rstrip(
                " ."
            )
            raise UsageError(f"{place}: reading {name!r} has no option {option!r}; {what}")
    read(place, recorder, progress=progress, **options)


def is_foreign(path: str | Path) -> bool:
    """Whether what is at a path must become a recording before it can be read as one.

    A rosbag2 folder of MCAP files need not, unless we exported it: then its rows come back as they were.
    """
    name = detect(path)
    if name is None:
        return False
    reads_as_it_is = getattr(_load(FORMATS[name]), "is_read_as_it_is", None)
    return reads_as_it_is is None or not reads_as_it_is(Path(path))


def as_folder(path: str | Path) -> tempfile.TemporaryDirectory[str]:
    """Return a temporary folder with a recording of what is in a foreign file or folder.

    Raises:
        As `record`; then there is no folder.
    """
    folder = tempfile.TemporaryDirectory(prefix="ml_dash_mcap-")
    try:
        with Recorder(folder.name, prefix=Path(path).name) as recorder:
            record(path, recorder)
    except BaseException:
        folder.cleanup()
        raise
    return folder


def _load(module: str) -> ModuleType:
    return import_module(f".{module}", __name__)
