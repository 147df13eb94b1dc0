"""The pattern of JSON rows that differ in their values only: the text between the values, and the columns they make.

A row of the pattern `{"q":[`, `,`, `],"_ts":`, `}` is these texts with a value between each two of them. Whoever finds
them all in a row, one behind the other, and a value of JSON between each two, knows what a parser makes of the row.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import orjson

from ..rows.plain_row import EXACT_KEY

MOST_BYTES = 64 * 1024
"""Longer rows have no pattern: to find it takes 1 us for each of their values."""

_MOST_LEVELS = 8
"""Rows with lists in more lists, or dicts in more dicts, have no pattern."""

_WORD_BYTES = 8

COMMA, QUOTE, POINT = b',".'

_BLANKS = re.compile(rb"[ \t\r\n]*")
_TEXT = re.compile(rb'"([^"\\\x00-\x1f]*)"')
_WORD = re.compile(rb"[-+.0-9A-Za-z]+")


@dataclass(frozen=True, slots=True)
class PatternColumn:
    """One column of the rows: a value, or a list of values, in each row."""

    name: str
    """Dotted, where it lies in dicts."""
    first: int
    """The number of its first value in the row."""
    lengths: tuple[int, ...]
    """Of the list, and of the lists in it; nothing for a single value."""
    is_text: bool
    """Whether the values are texts; otherwise they are numbers, booleans and nulls."""

    @property
    def size(self) -> int:
        """How many values a row has in the column."""
        return int(np.prod(self.lengths, dtype=np.int64))


@dataclass(frozen=True)
class RowPattern:
    """What rows have in common that differ in their values only."""

    gaps: list[bytes]
    """The texts before, between and behind the values of a row, [K + 1]. The quotes of texts belong to them."""
    columns: list[PatternColumn]
    """In the order of their values."""

    @cached_property
    def gap_bytes(self) -> npt.NDArray[np.int32]:
        """How long each gap is, [K + 1]."""
        return np.array(list(map(len, self.gaps)), np.int32)

    @cached_property
    def is_text(self) -> npt.NDArray[np.bool_]:
        """Which values are texts, [K]."""
        return np.repeat([column.is_text for column in self.columns], [column.size for column in self.columns])

    @cached_property
    def has_texts(self) -> bool:
        """Whether any value is a text."""
        return any(column.is_text for column in self.columns)

    def count(self, letters: bytes) -> int:
        """Return how many of some bytes the gaps have."""
        return sum(gap.count(letter) for gap in self.gaps for letter in letters)

    @cached_property
    def anchors(self) -> Anchors:
        """The commas by which the gaps are looked for."""
        counts = [gap.count(b",") for gap in self.gaps]
        inner = self.gaps[1:-1]
        which: slice | npt.NDArray[np.intp] = np.cumsum(counts)[: len(inner)]
        if counts == [0, *(1 for _ in inner), 0]:
            which = slice(None)  # which numpy takes without a copy
        return Anchors(sum(counts), which, np.array([gap.index(b",") for gap in inner], np.int32))

    @cached_property
    def may_follow_comma(self) -> npt.NDArray[np.bool_]:
        """Which bytes follow a comma of the gaps, [256]."""
        text = b"0".join(self.gaps)
        following = {text[at + 1] for at, letter in enumerate(text[:-1]) if letter == COMMA}
        if ord("0") in following:  # a value that is no text
            following |= set(b"-0123456789ntf")
        return np.isin(np.arange(256), list(following))

    @cached_property
    def quotes_of_texts(self) -> npt.NDArray[np.intp]:
        """The numbers of the quotes, among all of a row, with which the values that are texts begin, [T]."""
        before = np.cumsum([gap.count(b'"') for gap in self.gaps[:-1]])
        return before[self.is_text] - 1

    @cached_property
    def words(self) -> Words:
        """The gaps, eight bytes at a time; those that are no more than an anchor are left out."""
        gaps, places, texts, masks = [], [], [], []
        for number, gap in enumerate(self.gaps):
            if len(gap) == 1 and 0 < number < len(self.gaps) - 1:
                continue
            for place in range(0, len(gap), _WORD_BYTES):
                text = gap[place : place + _WORD_BYTES]
                gaps.append(number)
                places.append(place)
                texts.append(int.from_bytes(text, "little"))
                masks.append(2 ** (8 * len(text)) - 1)
        return Words(np.array(gaps), np.array(places, np.int32), np.array(texts, "<u8"), np.array(masks, "<u8"))


@dataclass(frozen=True, slots=True)
class Anchors:
    """The commas of a row by which its gaps are looked for."""

    count: int
    """How many commas a row has in all its gaps."""
    numbers: slice | npt.NDArray[np.intp]
    """For each gap between two values the number of its first comma, [K - 1]."""
    places: npt.NDArray[np.int32]
    """Where in its gap this comma is, [K - 1]."""


@dataclass(frozen=True, slots=True)
class Words:
    """The texts of gaps in words of eight bytes, [W], the last word of a gap with zeros behind its text."""

    gaps: npt.NDArray[np.intp]
    """Which gap each word belongs to."""
    places: npt.NDArray[np.int32]
    """Where it lies in its gap."""
    texts: npt.NDArray[np.uint64]
    masks: npt.NDArray[np.uint64]
    """Bits that belong to the text."""


def learn(payload: bytes) -> RowPattern | None:
    """Return the pattern of one row; None if it has none.

    It has none if it holds escapes, the side key, a key with a dot or one that stands twice, an empty list or dict,
    lists of dicts, or lists of different lengths inside a list.
    """
    if len(payload) > MOST_BYTES or b"\\" in payload or not _is_row(payload):
        return None
    walk = _RowWalk(payload)
    try:
        walk.row()
    except _NoPatternError:
        return None
    return RowPattern([*walk.gaps, payload[walk.gap_start :]], walk.columns) if walk.columns else None


def _is_row(payload: bytes) -> bool:
    try:
        return isinstance(orjson.loads(payload), dict)
    except orjson.JSONDecodeError:
        return False


class _NoPatternError(Exception):
    """The row has something that patterns do not have."""


class _RowWalk:
    """Goes through one row, which is valid JSON without escapes."""

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._at = 0
        self.gap_start = 0
        """Where the latest value ends."""
        self.gaps: list[bytes] = []
        self.columns: list[PatternColumn] = []

    def row(self) -> None:
        """Go through the whole row."""
        self._dict("")

    def _dict(self, prefix: str) -> None:
        keys: set[str] = set()
        while self._next(b"{" if not keys else b",}") != b"}":
            key = self._key()
            if key in keys or "." in key or not key or key == EXACT_KEY:
                raise _NoPatternError
            keys.add(key)
            self._next(b":")
            self._field(prefix + key)

    def _field(self, name: str) -> None:
        if self._peek() == b"{" and name.count(".") < _MOST_LEVELS:
            self._dict(name + ".")
            return
        first = len(self.gaps)
        lengths, is_text = self._value(_MOST_LEVELS)
        self.columns.append(PatternColumn(name, first, lengths, is_text))

    def _value(self, levels: int) -> tuple[tuple[int, ...], bool]:
        """Go through a value; returns the lengths of its lists, and whether it is a text or holds texts."""
        if self._peek() == b"[" and levels:
            return self._list(levels - 1)
        text = _TEXT.match(self._payload, self._at)
        word = text or _WORD.match(self._payload, self._at)
        if word is None:  # a dict, or an empty list
            raise _NoPatternError
        start, end = word.span(0 if text is None else 1)
        self.gaps.append(self._payload[self.gap_start : start])
        self.gap_start, self._at = end, word.end()
        return (), text is not None

    def _list(self, levels: int) -> tuple[tuple[int, ...], bool]:
        kinds: set[tuple[tuple[int, ...], bool]] = set()
        count = 0
        while self._next(b",]" if count else b"[") != b"]":
            kinds.add(self._value(levels))
            count += 1
            self._peek()
        if len(kinds) > 1:
            raise _NoPatternError
        ((lengths, is_text),) = kinds
        return (count, *lengths), is_text

    def _key(self) -> str:
        self._peek()
        key = _TEXT.match(self._payload, self._at)
        if key is None:  # an empty dict
            raise _NoPatternError
        self._at = key.end()
        return key[1].decode()

    def _peek(self) -> bytes:
        """Return the next byte that is no blank."""
        blanks = _BLANKS.match(self._payload, self._at)
        self._at = self._at if blanks is None else blanks.end()
        return self._payload[self._at : self._at + 1]

    def _next(self, expected: bytes) -> bytes:
        """Return the next byte that is no blank, one of those expected, and go on behind it."""
        byte = self._peek()
        if byte not in expected:
            raise _NoPatternError
        self._at += 1
        return byte
