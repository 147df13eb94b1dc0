"""The index of a file: by its summary if it is finished, else by walking over its records."""

from __future__ import annotations

from ..errors import DamagedFileError
from . import index, records, summary, walk
from .fields import Fields
from .index import FileIndex, Glance
from .limits import Limits
from .records import Header, Opcode
from .source import Source

_HEAD_BYTES = 4096
_MOST_HEADER_BYTES = 1024 * 1024


def glance(source: Source, limits: Limits, *, is_new: bool) -> Glance | None:
    """Look at a long file without reading where its chunks are; None for any other file.

    The arguments and errors are those of `load`.
    """
    size = source.size()
    started = _start(source, size, is_new)
    found = None if started is None else summary.footer(source, size)
    if started is None or found is None:
        return None
    return summary.glance(source, size, started[0], found, limits)


def load(
    source: Source,
    limits: Limits,
    *,
    is_new: bool = False,
    salvages: bool = False,
    previous: FileIndex | None = None,
) -> FileIndex:
    """Index a file.

    Args:
        source: The file.
        limits: For what is read.
        is_new: Whether it is in progress: it may still be without its magic and header, and ends anywhere.
        salvages: Whether to step over what is damaged, and count it as lost, rather than to refuse the file.
        previous: What an earlier call found, to go on from if the file is still not finished.

    Raises:
        DamagedFileError: It is no MCAP file, or a finished one that is broken.
    """
    size = source.size()
    started = _start(source, size, is_new)
    if started is None:
        return index.empty(source.name)
    header, first = started
    how = walk.Walk(source, size, header, limits, is_new=is_new, salvages=salvages)
    found = summary.footer(source, size)
    if found is None:
        resumable = previous if previous is not None and first <= previous.end <= size else None
        return how.unfinished(first, resumable)
    try:
        by_summary = summary.read(source, size, header, found, limits)
    except DamagedFileError:
        by_summary = None
    if by_summary is not None:
        return by_summary
    return how.finished(first, summary.clues(source, size, found, limits) if salvages else None)


def _start(source: Source, size: int, is_new: bool) -> tuple[Header, int] | None:
    """Return a file's header and where the record behind it starts; None while it has none."""
    head = source.read(0, min(size, _HEAD_BYTES))
    magic = head[: len(records.MAGIC)]
    if is_new and records.MAGIC.startswith(magic) and len(head) < len(records.MAGIC) + records.PREFIX_BYTES:
        return None
    if not head:
        raise DamagedFileError(source.name, 0, "the file is empty")
    if magic != records.MAGIC:
        raise DamagedFileError(source.name, 0, f"this is no MCAP file: it starts with {magic!r}")
    at = len(records.MAGIC)
    opcode, length = records.prefix(head, at) if len(head) >= at + records.PREFIX_BYTES else (0, 0)
    end = at + records.PREFIX_BYTES + length
    if opcode == Opcode.HEADER and len(head) < end <= min(size, _MOST_HEADER_BYTES):
        head = source.read(0, end)
    if opcode != Opcode.HEADER or end > len(head):
        if is_new and end > size:
            return None
        raise DamagedFileError(source.name, at, "an MCAP file without a header")
    return records.header(Fields(head, source.name, 0, at + records.PREFIX_BYTES, end)), end
