"""Recognises columns that are elements of vectors and matrices by their names: `q.0`, `q.1` and `m.0.0`, `m.0.1`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

import numpy as np

Index = tuple[int, ...]

_INDEXED = re.compile(r"(.+?)((?:\.\d+)+)")


def split(name: str) -> tuple[str, Index]:
    """Return the name of a vector or matrix and the index of one of its elements; () if the name has no index."""
    indexed = _INDEXED.fullmatch(name)
    return (indexed[1], tuple(map(int, indexed[2][1:].split(".")))) if indexed else (name, ())


def whole_shape(indices: Sequence[Index]) -> tuple[int, ...] | None:
    """Return the shape whose elements have these indices, row by row; None if some are missing or out of order."""
    shape = tuple(max(axis) + 1 for axis in zip(*indices, strict=False))
    is_regular = len(set(map(len, indices))) == 1 and len(indices) == math.prod(shape)
    return shape if is_regular and list(indices) == list(np.ndindex(*shape)) else None


def vectors(names: Iterable[str]) -> dict[str, tuple[list[str], tuple[int, ...]]]:
    """Return the columns of each whole vector or matrix and its shape, by its name."""
    columns: dict[str, list[tuple[Index, str]]] = {}
    for name in names:
        base, index = split(name)
        if index:
            columns.setdefault(base, []).append((index, name))
    shapes = {base: whole_shape([index for index, _ in entries]) for base, entries in columns.items()}
    return {base: ([name for _, name in columns[base]], shape) for base, shape in shapes.items() if shape}
