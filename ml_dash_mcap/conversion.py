"""One format to another: foreign files to a recording, a recording to the formats of others."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

from . import ingest
from .errors import FormatError, MissingRecordingError
from .export import EXPORTERS
from .export.destination import fresh_folder
from .ingest import Progress
from .recorder import Recorder
from .recording import Recording

_SUFFIXES = {
    ".bag": "rosbag1",
    ".parquet": "parquet",
    ".csv": "csv",
    ".jsonl": "jsonl",
    ".trc": "trc",
    ".sto": "sto",
    ".tsv": "qtm",
    ".c3d": "c3d",
}
"""What a destination's suffix says about its format."""


def convert(
    src: str | Path, dest: str | Path, *, format: str | None = None, progress: Progress | None = None, **options: Any
) -> Path:
    """Turn a foreign file or folder into a recording, or a recording into another format.

    The result appears when it is whole; until then nothing is at `dest`.

    Args:
        src: A ROS bag, another foreign file, or a recording.
        dest: Where to; nothing may be there yet. A recording becomes a folder.
        format: What to write a recording as, such as "rosbag2"; None to tell by the suffix of `dest`.
        progress: Called now and then with the rows done and the rows in all.
        options: Of the format that is read, or else of the one that is written.

    Returns:
        `dest`.

    Raises:
        MissingRecordingError: Nothing is at `src`; also a FileNotFoundError.
        DestinationExistsError: Something is at `dest`; also a FileExistsError.
        FormatError: There is no such format, or the one to write is not known; also a ValueError.
        UsageError: The format has no such option; also a TypeError.

    Example:
        >>> convert("field-test.bag", "runs/field-test")
        >>> convert("runs/field-test", "field-test-ros2", format="rosbag2")
    """
    place = Path(dest)
    if format is None and ingest.detect(src) is not None and place.suffix not in _SUFFIXES:
        with fresh_folder(place) as folder, Recorder(folder, prefix=place.name) as recorder:
            ingest.record(src, recorder, progress=progress, **options)
        return place
    chosen = format if format is not None else _SUFFIXES.get(place.suffix)
    if chosen is None:
        if not Path(src).exists():
            raise MissingRecordingError(errno.ENOENT, "there is nothing", str(src))
        raise FormatError(
            f"convert({str(src)!r}, {str(dest)!r}): pass format= to say what to write a recording as;"
            f" the formats are {', '.join(sorted(EXPORTERS))}"
        )
    with Recording(src) as recording:
        return recording.export(place, format=chosen, progress=progress, **options)


__all__ = ["convert"]
