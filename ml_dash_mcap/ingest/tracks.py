"""Matrices of numbers as the rows of topics."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..clock import END_S
from ..errors import ConversionWarning, ForeignFileError
from ..mocap.placement import Placement
from ..recorder import Recorder
from . import Progress
from .cells import Cells

Floats = npt.NDArray[np.float64]


class Arrays:
    """Appends the rows of some topics, whose numbers stand in the columns of one table."""

    def __init__(
        self,
        recorder: Recorder,
        placements: Sequence[Placement],
        metadata: Mapping[str, Mapping[str, Any]],
        *,
        skip_empty: bool = False,
    ) -> None:
        """Open the topics.

        Args:
            recorder: Where the rows go.
            placements: Which columns each field has.
            metadata: Of the topics.
            skip_empty: Whether a row without any number is no row, rather than one without fields.
        """
        self._topics: dict[str, list[Placement]] = {}
        taken = {(one.topic, one.path) for one in placements}
        for one in placements:
            if any((one.topic, one.path[:length]) in taken for length in range(1, len(one.path))):
                one = replace(one, path=(".".join(one.path),))  # a field cannot be a dict too
            self._topics.setdefault(one.topic, []).append(one)
        self._tracks = {name: recorder.topic(name, metadata=metadata.get(name) or None) for name in self._topics}
        self._skip_empty = skip_empty

    def append(self, times: Floats, values: Floats) -> None:
        """Append rows.

        Args:
            times: Time stamps, [N], s.
            values: [N, C]; a field without any of its numbers is absent from the row.
        """
        gaps = np.isnan(values)
        for topic, placements in self._topics.items():
            keep: Any = slice(None)
            if self._skip_empty:
                there = ~gaps[:, [column for one in placements for column in one.columns]].all(axis=1)
                if not there.any():
                    continue
                keep = slice(None) if there.all() else there
            chosen = times[keep]
            fields: dict[str, Any] = {}
            for one in placements:
                shape = (len(chosen), *one.shape)
                numbers = values[keep, :][:, one.columns].reshape(shape)
                missing = np.isnan(numbers)
                _put(fields, one.path, np.ma.MaskedArray(numbers, missing) if missing.any() else numbers)
            self._tracks[topic].append_columns(_ts=chosen, **fields)


class Tracks(Arrays):
    """The same out of a text file, whose times may be none."""

    def append_from(self, cells: Cells, times: Floats, values: Floats, line: int) -> int:
        """Append rows.

        Args:
            cells: The table that they come from; counts a time that is none.
            times: Time stamps, [N], s.
            values: [N, C]; a field without any of its numbers is absent from the row.
            line: Where in the file they start.

        Returns:
            How many rows there were.

        Raises:
            ForeignFileError: A time is missing, negative or too large.
        """
        count = len(times)
        good = (times >= 0) & (times < END_S)
        if not good.all():
            if cells.on_bad == "raise":
                row = int((~good).argmax())
                raise ForeignFileError(
                    cells.path, f"the row has the time {float(times[row])!r} s, which is none", line + row
                )
            cells.bad += int((~good).sum())
            times, values = times[good], values[good]
        self.append(times, values)
        return count


def _put(fields: dict[str, Any], path: Sequence[str], array: Any) -> None:
    for key in path[:-1]:
        fields = fields.setdefault(key, {})
    fields[path[-1]] = array


class Report:
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
