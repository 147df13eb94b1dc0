"""Learns the types of a CSV file's columns from all of their cells, and converts the cells."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from ....rows import arrow_types
from ....rows.shape import (
    BOOLEAN,
    FLOAT64,
    FLOATS,
    INEXACT,
    LIST,
    NOTHING,
    NULL,
    NUMBERS,
    TEXT,
    Shape,
    of_integers,
    scalar,
)
from ....rows.typed_columns import ENCODING_KEY, to_text

_DIGITS = r"(0|[1-9][0-9]*)"
_INTEGER = rf"^[+\-]?{_DIGITS}$"
_NUMBER = rf"^[+\-]?(({_DIGITS}(\.[0-9]*)?|\.[0-9]+)([eE][+\-]?[0-9]+)?|(?i:inf|infinity|nan))$"
_BOOLEAN = r"^(?i:true|false)$"
_NOTHING = r"^(NA|N/A|n/a|#N/A|<NA>|NULL|null|Null|None|none)$"
"""Words for a missing value, in columns that are no text otherwise."""
_PATTERNS = {FLOAT64: _NUMBER, BOOLEAN: _BOOLEAN, NULL: _NOTHING}
_COMMA_NUMBER = r"^[+\-]?[0-9]+,[0-9]+([eE][+\-]?[0-9]+)?$"
_POINT_NUMBER = r"^[+\-]?[0-9]+\.[0-9]+([eE][+\-]?[0-9]+)?$"
_LONG = 16
"""Integers of fewer letters are exact as doubles; longer ones count as if they were not."""
_FORMULA = r"^'('*[=+\-@\t\r])"
_CONTAINER = r"(?s)^(\[.*\]|\{.*\})$"

_IS_INTEGER, _IS_NUMBER = re.compile(_INTEGER), re.compile(_NUMBER)


@dataclass
class CellTypes:
    """The shapes of a column's cells so far.

    A word for a missing value counts as None, and text like JSON also as a list.
    """

    bare: Shape = NOTHING
    """The shape of the cells without quotes."""
    quoted: Shape = NOTHING
    has_empty_texts: bool = False
    """Whether some were quoted with nothing between."""

    def add(self, cells: pa.Array, quoted: npt.NDArray[np.bool_] | None, decimal: str) -> None:
        """Look at some cells."""
        texts = _trimmed(cells, decimal)
        if quoted is None:
            self.bare |= _shape_of(texts)
            return
        flags = pa.array(quoted)
        inside = texts.filter(flags)
        self.bare |= _shape_of(texts.filter(pc.invert(flags)))
        self.quoted |= _shape_of(inside)
        self.has_empty_texts |= _any(pc.equal(inside, ""))

    def type(self, *, heeds_quotes: bool, is_ours: bool) -> pa.DataType | None:
        """Return the type that holds all cells; None where each has one of its own.

        Args:
            heeds_quotes: Whether what is quoted is text, because not everything in the file is.
            is_ours: Whether this library wrote the file, which spells each value by its own type.
        """
        kinds = self.bare.kinds | self.quoted.kinds
        has_texts = bool(kinds & TEXT)
        others = (self.bare.kinds if heeds_quotes else kinds) & (NUMBERS | BOOLEAN | NULL)
        if heeds_quotes:
            has_texts = has_texts or bool(self.quoted.kinds) or self.has_empty_texts
        if is_ours and (kinds & LIST or (has_texts and others) or (kinds & NUMBERS and kinds & BOOLEAN)):
            return None
        if has_texts or not kinds & (NUMBERS | BOOLEAN):
            return pa.string() if has_texts or kinds & NULL else pa.null()
        if kinds & BOOLEAN:
            return pa.string() if kinds & NUMBERS else pa.bool_()
        type_ = arrow_types.type_of(self.bare | self.quoted)
        is_too_large = type_ is None and not kinds & FLOATS  # for 64 bits
        return pa.string() if is_too_large else type_


def _shape_of(texts: pa.Array) -> Shape:
    """Return the shape of the values that cells without blanks around them stand for; an empty one stands for none."""
    if not len(texts):
        return NOTHING
    if _are_numbers(texts):
        are_integers = pc.match_substring_regex(texts, r"^[+\-]?[0-9]+$")
        return _shape_of_numbers(texts, are_integers, len(texts))
    are_integers, *masks = (pc.match_substring_regex(texts, pattern) for pattern in (_INTEGER, *_PATTERNS.values()))
    counts = dict(zip(_PATTERNS, map(_count, masks), strict=True))
    shape = _shape_of_numbers(texts, are_integers, counts[FLOAT64])
    for kind in (BOOLEAN, NULL):
        shape |= scalar(kind if counts[kind] else 0)
    if _count(pc.not_equal(texts, "")) > sum(counts.values()):
        shape |= scalar(TEXT | LIST if _any(pc.match_substring_regex(texts, _CONTAINER)) else TEXT)
    return shape


def _are_numbers(texts: pa.Array) -> bool:
    """Whether cells are all numbers. This is a faster test than that for all other types."""
    try:
        texts.cast(pa.float64())
    except pa.ArrowInvalid:
        return False
    # Numbers with zeros in front stay text: 007 can become 7 later, but not the other way round (docs/decisions,
    # 0017).
    return not _any(pc.match_substring_regex(texts, r"^[+\-]?0[0-9]"))


def _shape_of_numbers(texts: pa.Array, are_integers: pa.Array, count: int) -> Shape:
    """Return the shape of the numbers among cells.

    Args:
        texts: The cells.
        are_integers: Which of them are integers, [N].
        count: How many are numbers, integers included.
    """
    integers = texts.filter(are_integers)
    fractions = scalar(FLOAT64) if count > len(integers) else NOTHING
    if not len(integers):
        return fractions
    # Short integers need not be looked at one by one: only their sign matters for the type.
    if (pc.max(pc.utf8_length(integers)).as_py() or 0) >= _LONG:
        values = list(map(int, integers.to_pylist()))
        return fractions | of_integers(min(values), max(values)) | scalar(INEXACT)
    return fractions | of_integers(-1 if _any(pc.starts_with(integers, "-")) else 0, 0)


def converted(
    cells: pa.Array,
    quoted: npt.NDArray[np.bool_] | None,
    type_: pa.DataType | None,
    decimal: str,
    *,
    is_ours: bool,
) -> pa.Array:
    """Return cells as values: JSON text where each has a type of its own."""
    if type_ is None:
        flags = [False] * len(cells) if quoted is None else quoted.tolist()
        texts = [_json(cell, flag, decimal, is_ours) for cell, flag in zip(cells.to_pylist(), flags, strict=True)]
        return pa.array(texts, pa.string())
    if pa.types.is_null(type_):
        return pa.nulls(len(cells))
    if pa.types.is_string(type_):
        is_empty = pc.equal(cells, "")
        if quoted is not None:
            is_empty = pc.and_(is_empty, pa.array(~quoted))
        texts = pc.replace_substring_regex(cells, _FORMULA, r"\1") if is_ours else cells
        return pc.if_else(is_empty, pa.scalar(None, pa.string()), texts)
    texts = _trimmed(cells, decimal)
    is_missing = pc.or_(pc.equal(texts, ""), pc.match_substring_regex(texts, _NOTHING))
    kept = pc.if_else(is_missing, pa.scalar(None, pa.string()), texts)
    if pa.types.is_boolean(type_):
        return pc.equal(pc.utf8_lower(kept), "true")
    return pc.replace_substring_regex(kept, r"^\+", "").cast(type_)


def field(name: str, type_: pa.DataType | None) -> pa.Field:
    """Return the field of a column."""
    if type_ is None:
        return pa.field(name, pa.string(), metadata={ENCODING_KEY: b"json"})
    return pa.field(name, type_)


def decimal_of(rows: list[list[str]], separator: str) -> str:
    """Return what stands before the fraction in some rows: "," only where that is plain."""
    cells = [cell.strip() for row in rows for cell in row]
    if separator == "," or any(re.match(_POINT_NUMBER, cell) for cell in cells):
        return "."
    return "," if any(re.match(_COMMA_NUMBER, cell) for cell in cells) else "."


def _trimmed(cells: pa.Array, decimal: str) -> pa.Array:
    texts = pc.utf8_trim_whitespace(cells)
    if decimal == ".":
        return texts
    return pc.if_else(pc.match_substring_regex(texts, _COMMA_NUMBER), pc.replace_substring(texts, ",", "."), texts)


def _count(mask: pa.Array) -> int:
    return int(pc.sum(mask).as_py() or 0)


def _any(mask: pa.Array) -> bool:
    return bool(pc.any(mask).as_py())


def _json(text: str, is_quoted: bool, decimal: str, is_ours: bool) -> str | None:
    """Return one cell's value as JSON; None for an empty one."""
    container = _container(text) if is_ours else None
    if container or is_quoted:
        return container or to_text(_unguarded(text) if is_ours else text)
    plain = text.strip()
    if not plain:
        return None
    if decimal == "," and re.match(_COMMA_NUMBER, plain):
        plain = plain.replace(",", ".")
    if _IS_INTEGER.match(plain) and -(2**63) <= int(plain) < 2**64:
        return to_text(int(plain))
    if _IS_NUMBER.match(plain):
        return to_text(float(plain))
    if plain.lower() in ("true", "false"):
        return plain.lower()
    return to_text(_unguarded(text) if is_ours else text)


def _container(text: str) -> str | None:
    """Return text that is a list or a dict in JSON; None if it is not."""
    if not re.match(_CONTAINER, text):
        return None
    try:
        orjson.loads(text)
    except orjson.JSONDecodeError:
        return None
    return text


def _unguarded(text: str) -> str:
    return re.sub(_FORMULA, r"\1", text)


def numbers(cells: pa.Array, decimal: str) -> pa.Array:
    """Return the numbers among cells as doubles."""
    texts = _trimmed(cells, decimal)
    kept = texts.filter(pc.match_substring_regex(texts, _NUMBER))
    return pc.replace_substring_regex(kept, r"^\+", "").cast(pa.float64())
