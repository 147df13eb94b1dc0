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
    "rosbag1": "ros.read",
    "rosbag2": "ros.read",
    "mocap": "mocap.motive.read",
    "sto": "mocap.sto.read",
    "trc": "mocap.trc.read",
    "qtm": "mocap.qtm.read",
    "vicon": "mocap.vicon.read",
    "wide": "mocap.wide.read",
    "c3d": "mocap.c3d.read",
    "parquet": "tables.parquet.read",
    "jsonl": "tables.jsonl.read",
    "csv": "tables.csv.read",
}
"""Formats, to the module here that reads them.

A module has `detect(path) -> str | None`, which names the format of what is at a path that exists, or None, and one of

- `record(src, recorder, *, progress=None, **options) -> None`, which appends its rows to a recorder;
- `carry(src, folder, prefix, *, progress=None, **options) -> None`, which makes a recording in a folder.
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
    _check_options(place, name, read, options)
    read(place, recorder, progress=progress, **options)


def into(
    src: str | Path,
    folder: Path,
    prefix: str,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> None:
    """Make a recording of what is in a foreign file or folder.

    Args:
        src: The file or folder.
        folder: Of the recording; it is there.
        prefix: Of the recording.
        progress: Called now and then with the rows done and the rows in all.
        options: Of the format.

    Raises:
        As `record`.
    """
    name = detect(src)
    carry = None if name is None else getattr(_load(FORMATS[name]), "carry", None)
    if name is None or carry is None:
        with Recorder(folder, prefix=prefix) as recorder:
            record(src, recorder, progress=progress, **options)
    else:
        _check_options(src, name, carry, options)
        carry(Path(src), folder, prefix, progress=progress, **options)


def _check_options(src: str | Path, name: str, read: Callable[..., None], options: Mapping[str, Any]) -> None:
    """Raise UsageError if a format has not all of the options that a caller gave."""
    taken = _options_of(read)
    for option in options:
        if option not in taken:
            offered = [one for one in taken if one != "progress"]
            what = f"it has {', '.join(offered) or 'none'}. {did_you_mean(option, offered, spelling='{}=')}".rstrip(
                " ."
            )
            raise UsageError(f"{src}: reading {name!r} has no option {option!r}; {what}")


def options_of(src: str | Path) -> list[str]:
    """Return the options that reading what is at a path has; none if it is none of the formats."""
    name = detect(src)
    return [] if name is None else [one for one in _options_of(_reader(name)) if one != "progress"]


def _reader(name: str) -> Callable[..., None]:
    """Return what reads a format."""
    module = _load(FORMATS[name])
    reader: Callable[..., None] = getattr(module, "carry", None) or module.record
    return reader


def _options_of(read: Callable[..., None]) -> list[str]:
    return [one for one, how in inspect.signature(read).parameters.items() if how.kind is how.KEYWORD_ONLY]


def read_as_it_is(path: Path) -> list[Path] | None:
    """Return the MCAP files of what is at a path, in the order of writing, if they can be read where they lie.

    None for what must become a recording before it can be read as one.
    """
    name = detect(path)
    if name is None:
        return [path]
    read = getattr(_load(FORMATS[name]), "read_as_it_is", None)
    files: list[Path] | None = None if read is None else read(path)
    return files


def as_folder(path: str | Path, *, salvages: bool = False, **options: Any) -> tempfile.TemporaryDirectory[str]:
    """Return a temporary folder with a recording of what is in a foreign file or folder.

    Args:
        path: The file or folder.
        salvages: Whether to leave out what is damaged, with a warning, where the format can.
        options: Those that the format has are passed on.

    Raises:
        As `record`; then there is no folder.
    """
    wanted = {**options, **({"on_damage": "skip"} if salvages else {})}
    known = options_of(path)
    options = {name: value for name, value in wanted.items() if name in known}
    folder = tempfile.TemporaryDirectory(prefix="ml_dash_mcap-")
    try:
        into(path, Path(folder.name), Path(path).name, **options)
    except BaseException:
        folder.cleanup()
        raise
    return folder


def _load(module: str) -> ModuleType:
    return import_module(f".{module}", __package__)
