"""How much a file from outside may ask for."""

from __future__ import annotations

from dataclasses import dataclass

MIB = 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Bounds that are checked before memory is taken; a file beyond them is refused as damaged."""

    chunk_bytes: int = 1024 * MIB
    """An uncompressed chunk's records, in bytes."""

    ratio: int = 2000
    """Uncompressed to compressed size, for chunks above `any_ratio_bytes`."""

    any_ratio_bytes: int = 64 * MIB
    """Chunks up to this uncompressed size may be compressed by any ratio (rows of zeros compress very well)."""

    record_bytes: int = 256 * MIB
    """A schema, channel, message index or metadata record, in bytes."""

    summary_bytes: int = 1024 * MIB
    """A summary section, in bytes; a file with a larger one is walked."""


DEFAULT = Limits()
