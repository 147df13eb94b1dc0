"""Limits on the memory that a file from outside may ask for."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..errors import UsageError
from ..file_names import LARGE_BYTES, LARGE_RATIO
from ..suggestions import checks_names

MIB = 1024 * 1024


@checks_names(UsageError)
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Bounds that are checked before memory is taken. Records and chunks beyond them are refused as damaged.

    They keep a small file from taking much memory: under 300 MB for whatever unpacks to much more than it is long. A
    file that really holds a chunk of 500 MB takes 500 MB to read; lower `chunk_bytes` where that is too much.

    Example:
        >>> Recording("upload.mcap", limits=Limits(chunk_bytes=64 * 1024 * 1024))
    """

    chunk_bytes: int = 1024 * MIB
    """A chunk's records, uncompressed, in bytes. Most tools write 1 to 4 MB, some above 100 MB."""

    ratio: int = LARGE_RATIO
    """Uncompressed to compressed size, for chunks above `any_ratio_bytes`; rows and images do not reach it."""

    any_ratio_bytes: int | None = None
    """Chunks up to this uncompressed size, in bytes, may be compressed by any ratio: a map of 41 MB compresses to some
    kB. Some of them are in memory at once. None is 48 MiB, or as much as the file takes on the disk: who has room for
    that has room for a chunk of the same size."""

    record_bytes: int = 64 * MIB
    """A schema, channel, message index or metadata record, in bytes."""

    summary_bytes: int = 128 * MIB
    """A summary section, in bytes; a file with a larger one is scanned record by record."""


DEFAULT = Limits()


def of_file(limits: Limits, stored_bytes: int) -> Limits:
    """Return limits whose `any_ratio_bytes` is filled in for a file.

    Args:
        limits: For files.
        stored_bytes: The bytes that the file takes on the disk: fewer than its length if it has holes.
    """
    if limits.any_ratio_bytes is not None:
        return limits
    return replace(limits, any_ratio_bytes=max(LARGE_BYTES, stored_bytes))


def too_long(what: str, length: int, limits: Limits) -> str:
    """Say that a record is longer than `record_bytes`, and how to read it all the same."""
    limit = f"the limit is {limits.record_bytes} (Limits.record_bytes)"
    return f"{what} of {length} bytes; {limit}; limits=Limits(record_bytes={length}) reads it"
