"""Restores tables that this library wrote to the fields, units and axes of the recording."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Set
from typing import Any

from ...meaning.space import turned, turned_rotations, unit_of
from ...meaning.units import DECIMALS
from .placement import Note, Placement


def shifts(note: Note | None, decimals: int, columns: int, lengths: Set[int]) -> list[int]:
    """Return by how many places the decimal point of each column moves to the right.

    Args:
        note: The note of the file; None for a file of another tool, whose lengths become metres.
        decimals: Of the file's unit of length: by how many places the point moves from metres.
        columns: How many there are.
        lengths: Those of them that are lengths.
    """
    shifts_by_column = [-decimals if at in lengths else 0 for at in range(columns)]
    for placement in note.placements if note else ():
        for at in lengths & set(placement.columns):
            shifts_by_column[at] += _decimals(note, placement)
    return shifts_by_column


def _decimals(note: Note | None, placement: Placement) -> int:
    """Return by how many places the point moves from metres to the unit that a field had."""
    metadata = note.metadata.get(placement.topic, {}) if note else {}
    return DECIMALS[unit_of(metadata, ".".join(placement.path))]


def metadata(note: Note, more: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the metadata that topics had when they were recorded, with more for each."""
    return {topic: {**about, **more} for topic, about in note.metadata.items()}


def turn_back(
    numbers: Any, note: Note, points: Collection[tuple[int, ...]], rotations: Collection[tuple[int, ...]]
) -> None:
    """Turn positions and rotations to the axes that they had, in place.

    Args:
        numbers: [N, C].
        note: The note of the file.
        points: The columns of each position, x y z.
        rotations: The columns of each quaternion, x y z w.
    """
    if note.up is None:
        return
    topics = {at: placement.topic for placement in note.placements for at in placement.columns}
    for group in points:
        up = _up(note, topics.get(group[0]))
        numbers[:, group] = turned(numbers[:, group], note.up, up)
    for group in rotations:
        up = _up(note, topics.get(group[0]))
        numbers[:, group] = turned_rotations(numbers[:, group], note.up, up)


def _up(note: Note, topic: str | None) -> str:
    return str(note.metadata.get(topic or "", {}).get("up", "z")).lower()
