"""Random rows of all that a row may hold, for tests of formats that must lose nothing."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

Row = dict[str, Any]

KEYS = st.sampled_from(
    ["q", "eeQuat", "ee_quat", "class", "a.b", "header", "ts", "\u89d2", "", "x y", "_value", "field_state"]
)
INTEGERS = st.integers(-(2**63), 2**64 - 1) | st.integers(-3, 3)
NUMBERS = st.floats(allow_nan=True) | st.sampled_from([0.0, -0.0, 1.0, math.inf, 5e-324, 1e16])
TEXTS = st.text(max_size=8)
SIMPLE = st.none() | st.booleans() | INTEGERS | NUMBERS | TEXTS | st.binary(max_size=5)
VALUES = st.recursive(
    SIMPLE,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)


def like(value: Any) -> st.SearchStrategy[Any]:
    """Values of the same type and shape as another, mostly, so that typed fields come about."""
    if isinstance(value, bool):
        return st.booleans()
    if isinstance(value, int):
        return INTEGERS if abs(value) > 3 else st.integers(-3, 3)
    if isinstance(value, float):
        return NUMBERS
    if isinstance(value, str):
        return st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), max_size=8)
    if isinstance(value, bytes):
        return st.binary(max_size=5)
    if isinstance(value, list):
        if not value:
            return st.just([])
        fixed = st.tuples(*(like(inner) for inner in value)).map(list)
        return fixed | st.lists(like(value[0]), max_size=4) if len(value) < 3 else fixed
    if isinstance(value, dict):
        return st.fixed_dictionaries({key: like(inner) for key, inner in value.items()})
    return st.none()


@st.composite
def tables(draw: st.DrawFn, max_size: int = 6) -> list[Row]:
    """Rows of mostly one form: some fields missing, None, or of another type here and there."""
    first: Row = draw(st.dictionaries(KEYS, VALUES, max_size=4))
    odd = draw(st.sampled_from([0, 0, 1, 3]))
    rows = []
    for _ in range(draw(st.integers(1, max_size))):
        row: Row = {}
        for key, value in first.items():
            kind = draw(st.integers(0, 9)) if odd else 9
            if kind >= odd:
                row[key] = draw(like(value))
            elif kind == 1:
                row[key] = None
            elif kind == 2:
                row[key] = draw(VALUES)
        rows.append(row)
    return rows


def typed(value: Any) -> Any:
    """Return what tells values apart that Python takes for equal: True, 1 and 1.0, 0.0 and -0.0, NaN and NaN."""
    if isinstance(value, dict):
        return {key: typed(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [typed(inner) for inner in value]
    return (type(value).__name__, repr(value))
