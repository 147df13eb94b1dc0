"""What the columns of a CSV file hold, learnt from all of their cells, and the cells as such values."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from ....rows.typed_columns import ENCODING_KEY, to_text

_DIGITS = r"(0|[1-9][0-9]*)"
_INTEGER = rf"^[+\-]?{_DIGITS}$"
_NUMBER = rf"^[+\-]?(({_DIGITS}(\.[0-9]*)?|\.[0-9]+)([eE][+\-]?[0-9]+)?|(?i:inf|infinity|nan))$"
_BOOLEAN = r"^(?i:true|false)$"
_NOTHING = r"^(NA|N/A|n/a|#N/A|<NA>|NULL|null|Null|None|none)$"
"""Words for a missing value, in columns that are no text otherwise."""
_COMMA_NUMBER = r"^[+\-]?[0-9]+,[0-9]+([eE][+\-]?[0-9]+)?$"
_POINT_NUMBER = r"^[+\-]?[0-9]+\.[0-9]+([eE][+\-]?[0-9]+)?$"
_LONG = 16
"""Integers of fewer digits are exact as doubles."""
_FORMULA = r"^'('*[=+\-@\t\r])"
_CONTAINER = r"(?s)^(\[.*\]|\{.*\})$"

_IS_INTEGER, _IS_NUMBER = re.compile(_INTEGER), re.compile(_NUMBER)


@dataclass
class Column:
    """What a column's cells have been so far."""

    integers: int = 0
    numbers: int = 0
    """Integers included."""
    booleans: int = 0
    words: int = 0
    """Words for what is missing."""
    texts: int = 0
    """All else, and what was quoted though it looks like a number."""
    is_long: bool = False
    """Whether an integer had so many digits that a double may round it."""
    low: int = 0
    high: int = 0
    """Of the integers."""
    quoted: int = 0
    """How many of the numbers, booleans and words were quoted."""
    empty_texts: int = 0
    """How many were quoted with nothing between."""
    containers: int = 0
    """How many looked like a list or a dict in JSON."""

    def add(self, cells: pa.Array, quoted: npt.NDArray[np.bool_] | None, decimal: str) -> None:
        """Look at some cells."""
        texts = _trimmed(cells, decimal)
        is_there = pc.not_equal(texts, "")
        if quoted is not None:
            self.empty_texts += _count(pc.and_(pa.array(quoted), pc.invert(is_there)))
        if quoted is None and self._are_numbers(texts):
            return
        kinds = [pc.match_substring_regex(texts, pattern) for pattern in (_INTEGER, _NUMBER, _BOOLEAN, _NOTHING)]
        counts = [_count(kind) for kind in kinds]
        self.integers += counts[0]
        self.numbers += counts[1]
        self.booleans += counts[2]
        self.words += counts[3]
        texts_here = _count(is_there) - sum(counts[1:])
        if texts_here:
            self.texts += texts_here
            self.containers += _count(pc.match_substring_regex(texts, _CONTAINER))
        if quoted is not None:
            self.quoted += sum(_count(pc.and_(kind, pa.array(quoted))) for kind in kinds[1:])
        if counts[0]:
            self._measure(texts.filter(kinds[0]))

    def _are_numbers(self, texts: pa.Array) -> bool:
        """Take cells that are all numbers, which is told faster than what else they may be."""
        try:
            texts.cast(pa.float64())
        except pa.ArrowInvalid:
            return False
        if _count(pc.match_substring_regex(texts, r"^[+\-]?0[0-9]")):
            return False
        are_integers = pc.match_substring_regex(texts, r"^[+\-]?[0-9]+$")
        found = _count(are_integers)
        self.integers += found
        self.numbers += len(texts)
        if found:
            self._measure(texts.filter(are_integers))
        return True

    def _measure(self, integers: pa.Array) -> None:
        if (pc.max(pc.utf8_length(integers)).as_py() or 0) < _LONG:
            return
        values = list(map(int, integers.to_pylist()))
        self.low, self.high = min(self.low, *values), max(self.high, *values)
        self.is_long = True

    def type(self, *, heeds_quotes: bool, is_ours: bool) -> pa.DataType | None:
        """Return the type that holds all cells; None where each has one of its own.

        Args:
            heeds_quotes: Whether what is quoted is text, because not everything in the file is.
            is_ours: Whether this library wrote the file, which spells each value by its own type.
        """
        quoted = self.quoted if heeds_quotes else 0
        texts = self.texts + quoted + (self.empty_texts if heeds_quotes else 0)
        others = self.numbers + self.booleans + self.words - quoted
        if is_ours and (self.containers or (texts and others) or (self.numbers and self.booleans)):
            return None
        if texts or not (self.numbers or self.booleans):
            return pa.string() if texts or self.words else pa.null()
        if self.booleans:
            return pa.string() if self.numbers else pa.bool_()
        if self.integers < self.numbers:
            return None if self.is_long else pa.float64()
        if self.low >= -(2**63) and self.high < 2**63:
            return pa.int64()
        return pa.uint64() if self.low >= 0 and self.high < 2**64 else pa.string()


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
        texts = [_json(one, flag, decimal, is_ours) for one, flag in zip(cells.to_pylist(), flags, strict=True)]
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
