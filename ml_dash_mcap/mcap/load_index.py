"""Loads the index of a file: from its summary if it is finished, otherwise by a scan of its records."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from ..errors import DamagedFileError
from ..store.byte_source import ByteSource
from . import file_index, records, scan, summary
from .file_index import FileIndex, Glance
from .limits import Limits
from .losses import Loss
from .record_layout import PREFIX_BYTES, Fields, read_prefix
from .records import Header, Opcode

# One read that holds the magic and the header of nearly every file.
_HEAD_BYTES = 4096
_MOST_HEADER_BYTES = 1024 * 1024

_LOOKED_AT_BYTES = 1024 * 1024
"""So many bytes behind the end of a file are looked at. They belong to nothing, or to another file."""


def glance(source: ByteSource, limits: Limits, *, is_new: bool) -> Glance | None:
    """Look at a long file without reading where its chunks are; None for any other file.

    The arguments and errors are those of `load`.
    """
    size = source.size()
    header_fields = _start(source, size, is_new)
    footer = None if header_fields is None else summary.read_footer(source, size)
    if header_fields is None or footer is None:
        return None
    try:
        header = records.HEADER.read(header_fields)
    except DamagedFileError:
        return None
    return summary.glance(source, size, header, footer, limits)


def load(
    source: ByteSource,
    limits: Limits,
    *,
    is_new: bool = False,
    salvages: bool = False,
    previous: FileIndex | None = None,
) -> FileIndex:
    """Index a file.

    Args:
        source: The file.
        limits: Limits for reading.
        is_new: Whether it is in progress: it may still be without its magic and header, and ends anywhere.
        salvages: Whether to step over damage and count it as lost, rather than to refuse the file.
        previous: The result of an earlier call, to go on from if the file is still not finished.

    Raises:
        DamagedFileError: It is no MCAP file, or a finished one that is broken.
    """
    size = source.size()
    header_fields = _start(source, size, is_new)
    if header_fields is None:
        return file_index.empty(source.name)
    header, losses = _header(header_fields, source.name, salvages)
    scan_of = partial(scan.FileScan, source, header=header, limits=limits, is_new=is_new, salvages=salvages)
    index = _indexed(scan_of(size), header_fields.end, previous)
    if isinstance(index, int):  # the file ends there, before its last byte
        losses = (*losses, _trailing_bytes(source, index, size))
        index = _indexed(scan_of(index), header_fields.end, None)
        assert not isinstance(index, int)
    return replace(index, losses=(*losses, *index.losses))


def by_scanning(source: ByteSource, limits: Limits, index: FileIndex) -> FileIndex:
    """Index a finished file by its records alone, whatever its summary says. Damage is stepped over.

    Args:
        source: The file.
        limits: Limits for reading.
        index: The index by its summary.
    """
    header_fields = _start(source, index.size, is_new=False)
    footer = summary.read_footer(source, index.size)
    if header_fields is None or footer is None:
        return index
    file_scan = scan.FileScan(source, index.size, index.header, limits, salvages=True)
    return file_scan.finished(header_fields.end, summary.clues(source, index.size, footer, limits))


def _header(content: Fields, path: str, salvages: bool) -> tuple[Header, tuple[Loss, ...]]:
    """Return a file's header, and the loss if it is damaged. Then the header is empty, for no reader needs it."""
    try:
        return records.HEADER.read(content), ()
    except DamagedFileError as error:
        if not salvages:
            raise
        return Header("", ""), (Loss(Path(path), error.offset, f"the file's header: {error.what}", 0),)


def _indexed(file_scan: scan.FileScan, first: int, previous: FileIndex | None) -> FileIndex | int:
    """Return the index of a file, or where it ends, if bytes lie behind its end."""
    source, size, limits = file_scan.source, file_scan.size, file_scan.limits
    footer = summary.read_footer(source, size)
    if footer is None:
        is_next = previous is not None and first <= previous.end <= size
        scanned = file_scan.unfinished(first, previous if is_next else None)
    else:
        try:
            by_summary = summary.read(source, size, file_scan.header, footer, limits)
        except DamagedFileError:
            by_summary = None
        if by_summary is not None:
            return by_summary
        clues = summary.clues(source, size, footer, limits)
        scanned = file_scan.finished(first, clues if file_scan.salvages else None)
        if not clues.agree_with(scanned) and not scanned.losses:
            scanned = replace(scanned, doubtful=True)
    return scanned if file_scan.end is None or file_scan.end == size else file_scan.end


def _start(source: ByteSource, size: int, is_new: bool) -> Fields | None:
    """Return the content of a file's header; None while it has none."""
    head = source.read(0, min(size, _HEAD_BYTES))
    magic = head[: len(records.MAGIC)]
    if is_new and records.MAGIC.startswith(magic) and len(head) < len(records.MAGIC) + PREFIX_BYTES:
        return None
    if not head:
        raise DamagedFileError(source.name, 0, "the file is empty")
    if magic != records.MAGIC:
        raise DamagedFileError(source.name, 0, f"this is no MCAP file: it starts with {magic!r}")
    at = len(records.MAGIC)
    opcode, length = read_prefix(head, at) if len(head) >= at + PREFIX_BYTES else (0, 0)
    end = at + PREFIX_BYTES + length
    if opcode == Opcode.HEADER and len(head) < end <= min(size, _MOST_HEADER_BYTES):
        head = source.read(0, end)
    if opcode != Opcode.HEADER or end > len(head):
        if is_new and end > size:
            return None
        raise DamagedFileError(source.name, at, "an MCAP file without a header")
    return Fields(head, source.name, 0, at + PREFIX_BYTES, end)


def _trailing_bytes(source: ByteSource, end: int, size: int) -> Loss:
    """Say which bytes lie behind the end of a file.

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
