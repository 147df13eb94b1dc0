"""Reads the messages in a SQLite file of a bag as rows: some MiB at a time, and around broken pages."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from ....errors import DamagedFileError
from . import layout

Row = tuple[Any, Any, Any]
"""Id of the topic, time in ns, content: what a sound file has there are two integers and bytes."""

ERRORS = (sqlite3.Error, UnicodeError)
"""The errors that SQLite raises for a damaged file. `UnicodeError` comes from names in a damaged schema."""

_MOST_ROWS = 512
_MOST_BYTES = 4 << 20
# `_MOST_ROWS` rows of this size are 4 MiB together, so smaller ones need not be counted.
_SMALL_BYTES = _MOST_BYTES // _MOST_ROWS
_MOST_GAPS = 256
_NAMED_GAPS = 8
_LEAST_ID, _MOST_ID = -(1 << 63), (1 << 63) - 1


def rows(base: sqlite3.Connection, path: Path, losses: list[str] | None) -> Iterator[list[Row]]:
    """Yield all rows in the order of their ids, some at a time: at most 4 MiB of content and the row that goes beyond.

    Args:
        base: The file.
        path: Its name in errors.
        losses: Takes in which ids cannot be read; None to raise.

    Raises:
        DamagedFileError: The file is damaged further on.
    """
    done = 0
    try:
        for some in _some(base.execute(f"{layout.SELECT_MESSAGES} FROM messages ORDER BY id")):
            yield some
            done += len(some)
    except ERRORS as error:
        if losses is None:
            raise DamagedFileError(path, 0, f"this SQLite bag cannot be read on: {error}") from error
        what = f"{path}: this SQLite bag is damaged ({error})"
        for some in _around_gaps(base, layout.SELECT_MESSAGES, _id_behind(base, done), what, losses):
            yield [row[:3] for row in some]


def count(base: sqlite3.Connection) -> int:
    """Return how many rows can be read of a file that cannot be counted."""
    return sum(map(len, _around_gaps(base, "SELECT 0, 0, x''", _LEAST_ID, "", [])))


def _some(cursor: sqlite3.Cursor) -> Iterator[list[Any]]:
    """Yield the rows of a cursor in lists. Those that came before an error are yielded before it is raised."""
    while True:
        some: list[Any] = []
        append, size = some.append, 0
        try:
            for row in islice(cursor, _MOST_ROWS):
                append(row)
                if len(row[2]) > _SMALL_BYTES:  # all others together are not too many
                    size += len(row[2])
                    if size > _MOST_BYTES:
                        break
        except TypeError:  # a content that is no bytes ends a list
            pass
        except ERRORS:
            if some:
                yield some
            raise
        if not some:
            return
        yield some


def _id_behind(base: sqlite3.Connection, done: int) -> int:
    """Return the id from which to read on behind a number of rows that could be read."""
    if not done:
        return _LEAST_ID
    (last,) = base.execute("SELECT id FROM messages ORDER BY id LIMIT 1 OFFSET ?", (done - 1,)).fetchone()
    return last + 1 if isinstance(last, int) else _MOST_ID + 1


def _around_gaps(
    base: sqlite3.Connection, columns: str, start: int, what: str, losses: list[str]
) -> Iterator[list[Any]]:
    """Yield the rows from an id on that can be read, with their ids, and note the ids of those that cannot."""
    question = f"{columns}, id FROM messages WHERE id >= ? AND typeof(id) = 'integer' ORDER BY id"
    gaps: list[str] = []
    while start <= _MOST_ID:
        try:
            for some in _some(base.execute(question, (start,))):
                yield some
                start = some[-1][3] + 1
            break
        except ERRORS:
            pass
        row = _first(base, question, start)  # Python's sqlite3 drops the row before the failing row
        if row is not None:
            yield [row]
            start = row[3] + 1
            continue
        # Each gap costs up to 128 queries; in a file of nothing but gaps that has to end.
        end = _after(base, question, start) if len(gaps) < _MOST_GAPS else None
        gaps.append(f"from {max(start, 0)} on" if end is None else f"{max(start, 0)} to {end - 1}")
        if end is None:
            break
        start = end
    if gaps:
        more = f" and {len(gaps) - _NAMED_GAPS} more spans" if len(gaps) > _NAMED_GAPS else ""
        losses.append(f"{what}: no messages with the ids {', '.join(gaps[:_NAMED_GAPS])}{more} can be read")


def _first(base: sqlite3.Connection, question: str, start: int) -> Any:
    """Return the first row from an id on; None if it cannot be read, or is not there."""
    try:
        return base.execute(f"{question} LIMIT 1", (start,)).fetchone()
    except ERRORS:
        return None


def _after(base: sqlite3.Connection, question: str, start: int) -> int | None:
    """Return the first id behind a broken page that SQLite finds a way to; None if there is none.

    The step is doubled until a row can be read, then halved to find the end of the broken part: at most 128 tries.
    """

    def is_readable(at: int) -> bool:
        try:
            base.execute(f"{question} LIMIT 1", (at,)).fetchone()
        except ERRORS:
            return False
        return True

    start = max(start, 0)  # bags count from 1
    broken, step = start, 1
    while not is_readable(start + step):
        broken = start + step
        step *= 2
        if start + step > _MOST_ID:
            return None
    whole = start + step
    while whole - broken > 1:
        middle = (broken + whole) // 2
        if is_readable(middle):
            whole = middle
        else:
            broken = middle
    return whole
