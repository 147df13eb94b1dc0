"""Reads files and folders of other formats as recordings."""

from __future__ import annotations

import errno
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..codecs import codec_table
from ..errors import FormatError, MissingRecordingError
from ..options import RecorderOptions
from ..recorder import Recorder
from . import registry
from .registry import Format, Progress


def record(
    src: str | Path, recorder: Recorder, *, format: str | None = None, progress: Progress | None = None, **options: Any
) -> None:
    """Append what is in a foreign file or folder to a recorder.

    Args:
        src: The file or folder.
        recorder: Where its rows go.
        format: The name of its format; None to find out.
        progress: Called now and then with the rows done and the rows in all.
        options: Of the format.

    Raises:
        MissingRecordingError: Nothing is at `src`; also a FileNotFoundError.
        FormatError: Its format is not known; also a ValueError.
        UsageError: The format has no such option; also a TypeError.
    """
    path = Path(src)
    if not path.exists():
        raise MissingRecordingError(errno.ENOENT, "there is nothing", str(path))
    name = format if format is not None else registry.detect(path)
    entry = registry.find(name, "read")
    if entry is None or entry.read is None:
        problem = "its format is not known" if name is None else f"there is no format {name!r}"
        raise FormatError(f"{path}: {problem}; those that can be read are {', '.join(registry.names('read'))}")
    registry.load(entry.read)(path, recorder, _made(entry, path, options), progress)


def into(src: str | Path, folder: Path, prefix: str, /, *, progress: Progress | None = None, **options: Any) -> None:
    """Make a recording of what is in a foreign file or folder.

    Args:
        src: The file or folder.
        folder: Of the recording; it is there.
        prefix: Of the recording.
        progress: Called now and then with the rows done and the rows in all.
        options: Of the format; and `encoding`, that of the rows, where it is one that rows can be recorded in.

    Raises:
        As `record`; also an OptionError: rows cannot be recorded in `encoding`.
    """
    entry = registry.find(registry.detect(src), "read")
    if entry is None or entry.carry is None:
        recording, options = _divided(options, [] if entry is None else registry.option_names(entry.read_options))
        with Recorder(folder, recording, prefix=prefix) as recorder:
            record(src, recorder, progress=progress, **options)
    else:
        registry.load(entry.carry)(Path(src), folder, prefix, _made(entry, src, options), progress)


def _divided(options: dict[str, Any], of_format: list[str]) -> tuple[RecorderOptions, dict[str, Any]]:
    """Return the options of the recorder and those of the format, both of which may have an `encoding`."""
    recording = RecorderOptions.from_environment()
    encoding = options.get("encoding")
    if encoding is None or ("encoding" in of_format and encoding not in codec_table.CODECS):
        return recording, options
    codec_table.to_record(encoding)
    return replace(recording, encoding=encoding), {name: options[name] for name in options if name != "encoding"}


def options_of(src: str | Path) -> list[str]:
    """Return the options that reading what is at a path has; none if it is none of the formats."""
    entry = registry.find(registry.detect(src), "read")
    return [] if entry is None else registry.option_names(entry.read_options)


def takes(src: str | Path, options: object) -> bool:
    """Whether something is an instance of the class of options that reading what is at a path has."""
    entry = registry.find(registry.detect(src), "read")
    return entry is not None and isinstance(options, registry.load(entry.read_options))


def read_as_it_is(path: Path) -> list[Path] | None:
    """Return the MCAP files of what is at a path, in the order of writing, if they can be read where they lie.

    None for what must become a recording before it can be read as one.
    """
    entry = registry.find(registry.detect(path), "read")
    if entry is None:
        return [path]
    files: list[Path] | None = None if entry.as_it_lies is None else registry.load(entry.as_it_lies)(path)
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
    # `Recording` passes options of all formats; a format gets only those that it has.
    names = [*options_of(path), "options"]
    folder = tempfile.TemporaryDirectory(prefix="ml_dash_mcap-")
    try:
        into(path, Path(folder.name), Path(path).name, **{name: wanted[name] for name in wanted if name in names})
    except BaseException:
        folder.cleanup()
        raise
    return folder


def _made(entry: Format, src: str | Path, options: dict[str, Any]) -> Any:
    return registry.make_options(entry.read_options, options, f"{src}: reading {entry.name!r}")
