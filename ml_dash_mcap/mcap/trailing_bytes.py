"""Bytes that lie behind the end of a file: they belong to nothing, or to another file that was appended."""

from __future__ import annotations

from pathlib import Path

from ..store.file_source import Source
from . import records
from .losses import Loss

_LOOKED_AT_BYTES = 1024 * 1024
"""So much is looked at; whatever is there, it is not read as part of the file."""


def look(source: Source, end: int, size: int) -> Loss:
    """Say what lies behind the end of a file.

    Args:
        source: The file.
        end: Where its closing magic ends, in bytes.
        size: How long it is; more than that.
    """
    data = source.read(end, min(size - end, _LOOKED_AT_BYTES))
    path, left = Path(source.name), f"{size - end} bytes lie behind the file's end, byte {end}"
    second = data.find(records.MAGIC)
    if second >= 0:
        what = f"{left}: a second MCAP file starts at byte {end + second}, which is not read (cut it out to read it)"
        return Loss(path, end + second, what, None)
    if not any(data):
        return Loss(path, end, f"{left}: zeros", 0)
    return Loss(path, end, f"{left}: what they are is not known, and they are not read", None)
