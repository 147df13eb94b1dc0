"""The judge of the files that we finish: what in them a viewer or tool would trip over."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tests.support import chunks, closing, contents, summary
from tests.support.records import MAGIC
from tests.support.sections import Sections, cut

PROFILES = ("", "ros2")
"""What the Header may say: nothing for our own files, ros2 for bags."""


def problems(path: Path) -> list[str]:
    """Every violation in a finished MCAP file of the rules that its readers need.

    The rules are the MCAP specification (https://mcap.dev/spec), the checks of `mcap doctor`, and what Lichtblick, Foxglove, PlotJuggler
    and Rerun need beyond them: one channel a topic, a schema within the viewers' subset for every channel, payloads that are JSON and
    match it, everything indexed, counted and repeated in the summary.

    Returns:
        One sentence with the byte offset for each violation; empty for a good file. Offsets are from the start of the file, except those
        "in the chunk at byte N", which are from the start of the chunk's uncompressed records.
    """
    return list(_problems(cut(path.read_bytes())))


def _problems(sections: Sections) -> Iterator[str]:
    yield from sections.faults
    yield from _header_problems(sections)
    for opened in sections.chunks:
        yield from chunks.problems(opened)
    yield from contents.problems(sections.contents())
    yield from summary.problems(sections)
    yield from closing.problems(sections)


def _header_problems(sections: Sections) -> Iterator[str]:
    header = sections.header
    if header is None:
        yield f"The file has no Header at byte {len(MAGIC)}."
        return
    if not header.library:
        yield f"{header.where} names no library."
    if header.profile not in PROFILES:
        yield f"{header.where} has the profile {header.profile!r}, which is neither empty nor ros2."
