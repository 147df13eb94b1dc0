"""Appends matrices of numbers as rows of topics: each row of a table is a sample of its own."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...capture.topic_registry import TopicAbout
from ...clock import END_S
from ...errors import ConversionWarning, ForeignFileError
from ...file_names import MESSAGE
from ...recorder import Recorder, open_topic
from ...topic import Topic
from .. import foreign_names
from ..registry import Progress
from ..text.number_cells import Cells, Floats, NumberPart
from .placement import Placement

TEXT_FIELD = "time_code"
"""The field of a table's time codes, in all of its topics."""


class Arrays:
    """Appends the rows of some topics, whose numbers stand in the columns of one table. No two rows merge."""

    def __init__(
        self,
        path: Path,
        recorder: Recorder,
        placements: Sequence[Placement],
        metadata: Mapping[str, Mapping[str, Any]],
        *,
        skip_empty: bool = False,
        present: Sequence[Sequence[int]] = (),
    ) -> None:
        """Open the topics.

        Args:
            path: The file that the numbers come from.
            recorder: Where the rows go.
            placements: Which columns each field has.
            metadata: Of the topics, as the placements name them.
            skip_empty: Whether a row without any number is no row, rather than one without fields.
            present: For each placement, columns beside it that have a number where a row has the field's topic; none
                where all rows have it.
        """
        self._topics: dict[str, list[Placement]] = {}
        self._present: dict[str, set[int]] = {}
        about: dict[str, Mapping[str, Any]] = {}
        for at, (placement, before) in enumerate(
            zip(foreign_names.accepted(path, placements), placements, strict=True)
        ):
            self._topics.setdefault(placement.topic, []).append(placement)
            if present:
                self._present.setdefault(placement.topic, set()).update(present[at])
            about.setdefault(placement.topic, metadata.get(before.topic) or {})
        self._tracks = {
            name: open_topic(recorder, name, MESSAGE, Topic, TopicAbout(metadata=about[name] or None))
            for name in self._topics
        }
        self._skip_empty = skip_empty

    def append(self, times: Floats, values: Floats, text: Sequence[str | None] = ()) -> None:
        """Append rows.

        Args:
            times: Time stamps, [N], s.
            values: [N, C]; a field without any of its numbers is absent from the row.
            text: The time code of each row, if there are any.
        """
        gaps = np.isnan(values)
        for topic, placements in self._topics.items():
            keep: Any = slice(None)
            if self._skip_empty or self._present:
                telling = [column for placement in placements for column in placement.columns]
                there = ~gaps[:, telling if self._skip_empty else sorted(self._present[topic])].all(axis=1)
                if not there.any():
                    continue
                keep = slice(None) if there.all() else there
            chosen = times[keep]
            if any(text):
                self._append_rows(
                    topic, chosen, values[keep], [text[at] for at in np.arange(len(times))[keep].tolist()]
                )
                continue
            fields: dict[str, Any] = {}
            for placement in placements:
                shape = (len(chosen), *placement.shape)
                numbers = values[keep, :][:, placement.columns].reshape(shape)
                missing = np.isnan(numbers)
                _put(fields, placement.path, np.ma.MaskedArray(numbers, missing) if missing.any() else numbers)
            self._tracks[topic].append_columns(_ts=chosen, **fields)

    def _append_rows(self, topic: str, times: Floats, values: Floats, text: Sequence[str | None]) -> None:
        """Append rows that have text beside their numbers."""
        rows: list[dict[str, Any]] = [{"_ts": time} for time in times.tolist()]
        for placement in self._topics[topic]:
            numbers = values[:, placement.columns]
            missing = np.isnan(numbers)
            # An array of objects can hold None where a number is missing.
            values_of_rows = numbers.astype(object)
            values_of_rows[missing] = None
            listed: list[Any] = values_of_rows.reshape(len(rows), *placement.shape).tolist()
            absent: list[bool] = np.atleast_1d(missing.all(axis=1)).tolist()
            for row, value, is_absent in zip(rows, listed, absent, strict=True):
                if not is_absent:
                    _put(row, placement.path, value)
        for row, code in zip(rows, text, strict=True):
            if code is not None:
                row[TEXT_FIELD] = code
        self._tracks[topic].append_batch(rows)


class TopicRows(Arrays):
    """Appends rows of a text file, some of which may have no valid time."""

    def append_from(
        self, cells: Cells, times: Floats, values: Floats, part: NumberPart, column: int | None = None
    ) -> None:
        """Append rows.

        Args:
            cells: The table that they come from; counts a time that is none.
            times: Time stamps, [N], s.
            values: [N, C]; a field without any of its numbers is absent from the row.
            part: Where they stand in the file, and their time codes, which are the only column of text.
            column: Which cell of a line says the time, for the error message, from 1.

        Raises:
            ForeignFileError: A time is missing, negative or too large.
        """
        text = next(iter(part.texts.values()), ())
        times, keep = checked(cells, times, part.lines, column)
        if keep is not None:
            values, text = values[keep], [text[at] for at in np.flatnonzero(keep).tolist()] if text else ()
        self.append(times, values, text)


def checked(
    cells: Cells, times: Floats, lines: npt.NDArray[np.int64], column: int | None
) -> tuple[Floats, npt.NDArray[np.bool_] | None]:
    """Return the time stamps that a recording can have, and which of them these are; None for all.

    Raises:
        ForeignFileError: One is missing, negative or too large, and none may be.
    """
    good = (times >= 0) & (times < END_S)
    if good.all():
        return times, None
    if cells.on_bad == "raise":
        row = int((~good).argmax())
        time = float(times[row])
        problem = f"the row has the time {time!r} s, and those of a recording go from 0 to the year 2262"
        # Only NaN is unequal to itself.
        if time != time:
            problem = "the row has no time"
        elif time < 0:
            problem += f"; pass a start= that is larger by {-time!r}"
        raise ForeignFileError(cells.path, f"{problem}; pass on_bad='missing' to leave it out", int(lines[row]), column)
    cells.bad += int((~good).sum())
    return times[good], good


def _put(fields: dict[str, Any], path: Sequence[str], array: Any) -> None:
    for key in path[:-1]:
        fields = fields.setdefault(key, {})
    fields[path[-1]] = array


class ReadingProgress:
    """Tells the progress of one file by the bytes read, and in the end what was left out."""

    def __init__(self, path: Path, progress: Progress | None) -> None:
        self._path = path
        self._size = max(path.stat().st_size, 1)
        self._progress = progress
        self._rows = 0

    def add(self, rows: int, bytes_read: int) -> None:
        """So many more rows are done, and so much of the file was read."""
        self._rows += rows
        if self._progress is not None:
            # The number of rows is unknown until the end; it is estimated from the part of the file that was read.
            total = round(self._rows * self._size / max(bytes_read, 1))
            self._progress(self._rows, max(total, self._rows))

    def finish(self, bad: int) -> None:
        """All rows are done.

        Args:
            bad: How many cells were left out.
        """
        if self._progress is not None:
            self._progress(self._rows, self._rows)
        if bad:
            warnings.warn(
                f"{self._path}: {bad} cells are no numbers and were left out", ConversionWarning, stacklevel=4
            )
