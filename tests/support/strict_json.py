"""JSON as every client reads it: RFC 8259, without the spellings that Python's own parser forgives."""

from __future__ import annotations

import json
import math
from typing import NoReturn


def parse(data: bytes) -> object:
    """The value that `data` spells.

    Raises:
        ValueError: it is not UTF-8, not JSON, holds NaN or Infinity in any spelling, or a name twice in one object.
    """
    try:
        return json.loads(data.decode("utf-8"), parse_constant=_refuse, parse_float=_finite, object_pairs_hook=_unique)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _refuse(literal: str) -> NoReturn:
    raise ValueError(f"it holds the literal {literal}, which is not JSON")


def _finite(literal: str) -> float:
    value = float(literal)
    if math.isinf(value):
        raise ValueError(f"it holds the number {literal}, which reads as Infinity")
    return value


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    row = dict(pairs)
    if len(row) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it has the name {twice!r} twice in one object")
    return row
