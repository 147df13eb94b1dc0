"""Columns that are the elements of vectors and matrices by their names: `q.0`, `q.1` and `m.0.0`, `m.0.1`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

_INDEXED = re.compile(r"(.+?)((?:\.\d+)+)")


class Elements(NamedTuple):
    """Columns that may be the elements of one vector or matrix."""

    names: list[str]
    """Of the columns, in their order."""
    shape: tuple[int, ...]
    is_whole: bool
    """Whether there is a column for each element, row by row."""


def grouped(names: Iterable[str]) -> dict[str, Elements]:
    """Return the columns whose names end in numbers, by what stands before these, in the order of the columns."""
    columns: dict[str, list[tuple[tuple[int, ...], str]]] = {}
    for name in names:
        indexed = _INDEXED.fullmatch(name)
        if indexed:
            index = tuple(map(int, indexed[2][1:].split(".")))
            columns.setdefault(indexed[1], []).append((index, name))
    return {base: _elements(entries) for base, entries in columns.items()}


def _elements(entries: list[tuple[tuple[int, ...], str]]) -> Elements:
    indices = [index for index, _ in entries]
    shape = tuple(max(axis) + 1 for axis in zip(*indices, strict=False))
    is_whole = (
        len(set(map(len, indices))) == 1 and len(indices) == math.prod(shape) and indices == [*np.ndindex(*shape)]
    )
    return Elements([name for _, name in entries], shape, is_whole)
