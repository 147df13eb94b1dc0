"""Counts how often clocks began again, and how many rows were merged with rows of an earlier pass."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from ..file_names import STEPS_RECORD
from ..query.file import File
from . import writing_order

Times = npt.NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Counted:
    """A recorder's figures on one topic, kept while it wrote; no file shows them, because these rows are merged."""

    steps: int = 0
    """How often a row's time lay before that of the row appended before it."""
    by_ns: int = 0
    """The longest such step, in ns."""
    merged: int = 0
    """Rows that were merged with one of the same time from before such a step."""
    overwritten: int = 0
    """Merged rows that brought fields which the earlier row had, too."""

    def __add__(self, other: Counted) -> Counted:
        """Return the figures of both together."""
        return Counted(
            self.steps + other.steps,
            max(self.by_ns, other.by_ns),
            self.merged + other.merged,
            self.overwritten + other.overwritten,
        )


def counted(files: Sequence[File]) -> dict[tuple[str, str], Counted]:
    """Return the figures that recorders kept, by recorder and topic; two records about one block count once."""
    blocks: dict[tuple[str, str], Mapping[str, Any]] = {}
    for file in files:
        try:
            if not any(entry.name == STEPS_RECORD for entry in file.glance.metadata):
                continue
            run = writing_order.run_of(file) or file.source.name
            for record in file.metadata():
                if record.name == STEPS_RECORD:
                    blocks[run, record.values.get("block", "")] = _topics(record.values.get("topics", ""))
        except DamagedFileError:  # it is among the findings of damage already
            continue
    totals: dict[tuple[str, str], Counted] = {}
    for (run, _), topics in blocks.items():
        for topic, values in topics.items():
            totals[run, topic] = totals.get((run, topic), Counted()) + _counted(values)
    return totals


def _topics(text: str) -> Mapping[str, Any]:
    try:
        topics = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return topics if isinstance(topics, dict) else {}


def _counted(values: Any) -> Counted:
    values = values if isinstance(values, dict) else {}
    numbers = [values.get(name) for name in ("steps_back", "by_ns", "merged", "overwritten")]
    return Counted(*(number if type(number) is int and number >= 0 else 0 for number in numbers))


def shared_within(times_ns: Times) -> int:
    """Return how many rows of one recorder are at a time that a row in an earlier block has."""
    return len(times_ns) - len(np.unique(times_ns))


def shared_with(times_ns: Times, earlier: Sequence[Times]) -> int:
    """Return how many of a recorder's times are also times of the recorders before it."""
    return int(np.isin(np.unique(times_ns), np.concatenate(earlier)).sum())
