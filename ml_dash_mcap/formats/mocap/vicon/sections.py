"""Finds the sections of Vicon's CSV files: where each begins and ends, and what its columns are."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from ....errors import ForeignFileError
from ...text.dialect import BLANKS, Dialect, number, of_line
from ...text.headers import HeaderLines, refuse_numbers, without_empty_end
from ...text.plain_text import is_filler
from .. import placement
from ..placement import NOTE_KEY, Note
from . import layout
from .layout import SECTIONS

# The note numbers the columns of all sections, whose sum is not known here. `_part` picks those of each section.
_MOST_COLUMNS = 1 << 20
_FIRST_COLUMNS = [column.lower().replace(" ", "") for column in layout.COLUMNS]
_COMMAS = Dialect(",")


@dataclass(frozen=True, slots=True)
class Section:
    """A table of numbers."""

    title: str
    rate: float
    names: list[str]
    """The name of each column behind those of frame and sub frame. A name stands for all columns up to the next
    name."""
    axes: list[str]
    units: list[str]
    dialect: Dialect
    line: int
    """Where its numbers begin."""
    start: int
    """Where its numbers begin, in bytes from the start of the file."""
    stop: int
    """Where they end, in bytes."""


@dataclass(slots=True)
class Contents:
    """The contents of a file."""

    sections: list[Section] = field(default_factory=list)
    events: list[tuple[int, dict[str, str]]] = field(default_factory=list)
    """Each with its line, by the words of the header's row."""
    note: Note | None = None


def title_of(line: str) -> str:
    """Return what a line says if it has one cell."""
    return line.strip(f'{BLANKS},;"')


def read(path: Path, file: BinaryIO) -> Contents:
    """Read the heads of all sections.

    Raises:
        ForeignFileError: The file is not as Vicon writes it; says the line and the column.
    """
    header, contents = HeaderLines(path, file), Contents()
    while (line := header.next_or_none()) is not None:
        title = title_of(line)
        if not title or is_filler(line):
            continue
        if title == NOTE_KEY:
            text = (header.next_or_none() or "").strip(BLANKS)
            text = text if text.startswith("{") else _COMMAS.split(text)[0]
            contents.note = placement.from_text(text, _MOST_COLUMNS)
        elif title == layout.EVENTS:
            contents.events += _events(header)
        else:
            contents.sections.append(_section(path, header, file, title))
    return contents


def _section(path: Path, header: HeaderLines, file: BinaryIO, title: str) -> Section:
    title_line = header.line
    text = _line(header, "the section's rate")
    rate = number(title_of(text))
    if rate is None and title not in SECTIONS:
        sections = ", ".join(SECTIONS)
        raise ForeignFileError(path, f"{title[:40]!r} is not the name of a section; {sections} are known", title_line)
    bad_rate = ForeignFileError(path, f"{title_of(text)[:40]!r} is not a rate in Hz", header.line, 1)
    if rate is None or not 0 <= rate < 1e9:
        raise bad_rate
    names_text, names_line, axes_text = _names_and_axes(header)
    dialect = of_line(axes_text, default=",")
    axes, names = _axes(path, header, dialect, axes_text), without_empty_end(dialect.split(names_text))
    count = len(axes)
    if len(names) > count:
        raise ForeignFileError(path, f"there are names for {len(names)} columns, but axes for {count}", names_line)
    units = _units(path, header, dialect)
    if len(units) > count:
        raise ForeignFileError(path, f"there are units for {len(units)} columns, but axes for {count}", header.line)
    filled, last = [], ""
    for name in (names + [""] * count)[layout.LEADING : count]:
        last = name or last
        filled.append(last)
    line, start = header.line + 1, header.at()
    _pass_rows(header, dialect)
    if rate == 0 and header.line > line:
        raise bad_rate
    return Section(
        title,
        rate or 1.0,  # 0 is what earlier releases wrote of a single frame
        filled,
        axes[layout.LEADING :],
        (units + [""] * count)[layout.LEADING : count],
        dialect,
        line,
        start,
        header.at(),
    )


def _names_and_axes(header: HeaderLines) -> tuple[str, int, str]:
    """Read the rows of names and axes; returns the names, which may be missing, with their line, and the axes."""
    names, axes = "", _line(header, "the row of names")
    line = header.line
    if not title_of(axes).lower().startswith(layout.COLUMNS[0].lower()):
        names, axes = axes, _line(header, "the row of axes")
    return names, line, axes


def _axes(path: Path, header: HeaderLines, dialect: Dialect, text: str) -> list[str]:
    """Return the axes of all columns."""
    axes = without_empty_end(dialect.split(text))
    if [axis.lower().replace(" ", "") for axis in axes[: layout.LEADING]] != _FIRST_COLUMNS:
        problem = f"the row of axes does not begin with {' and '.join(layout.COLUMNS)}"
        raise ForeignFileError(path, problem, header.line, 1)
    return axes


def _line(header: HeaderLines, expected: str) -> str:
    """Return the next line that is not blank."""
    text = header.next(expected)
    while not title_of(text):
        text = header.next(expected)
    return text


def _units(path: Path, header: HeaderLines, dialect: Dialect) -> list[str]:
    """Read the row of units, which may be blank where the columns have none."""
    cells = dialect.split(header.next("the row of units"))
    at, line = header.at(), header.line
    while not any(cells):
        text = header.next_or_none()
        if text is None or number(dialect.split(text)[0]) is not None or title_of(text) in (*SECTIONS, NOTE_KEY):
            header.to(at, line)
            return []
        cells = dialect.split(text)
    refuse_numbers(path, cells, "row of units", header.line)
    return without_empty_end(cells)


def _pass_rows(header: HeaderLines, dialect: Dialect) -> None:
    """Read on to the end of the section's rows: blank ones are among them if numbers follow."""
    end, lines = header.at(), header.line
    while True:
        line = header.next_or_none()
        if line is None:
            return
        if dialect.is_blank(line):
            continue
        first = line.partition(dialect.separator)[0]  # splitting whole lines would take as long as parsing them
        # A row of numbers may lack its frame; a title has fewer cells than frame and sub frame.
        if number(first.strip('"')) is None and len(without_empty_end(dialect.split(line))) < layout.LEADING:
            header.to(end, lines)
            return
        end, lines = header.at(), header.line


def _events(header: HeaderLines) -> list[tuple[int, dict[str, str]]]:
    """Read the rows of events, each by the words of the row above them."""
    words: list[str] = []
    dialect = _COMMAS
    events: list[tuple[int, dict[str, str]]] = []
    while True:
        end, before = header.at(), header.line
        line = header.next_or_none()
        if line is None:
            return events
        if not title_of(line):
            continue
        if title_of(line) in (*SECTIONS, NOTE_KEY):
            header.to(end, before)
            return events
        if not words:
            if number(title_of(line)) is None:  # the first line is a rate
                dialect = of_line(line, default=",")
                words = dialect.split(line)
            continue
        events.append((header.line, dict(zip(words, dialect.split(line), strict=False))))
