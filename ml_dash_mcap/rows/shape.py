"""The type of some values: the one answer that schemas, Arrow columns, ROS messages and CSV files are made from.

A `Shape` covers values. `first | second` is the least shape that covers what the two cover: it is associative,
commutative and idempotent, and the shape of some values is the join of the shapes of each. So it makes no difference
in which blocks values come, nor in which order. What a shape does not compare, the order of `fields` and the
`first_text`, is taken from the left side of a join.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

NULL, BOOLEAN, INTEGER, FLOAT64, TEXT, BYTES, LIST, DICT, ARRAY = (1 << bit for bit in range(9))
"""Kinds of values, as bits of `Shape.kinds`: None, bool, int, float, str, bytes, list, dict, and numpy's arrays."""

NEGATIVE, INEXACT, UNSIGNED, HUGE = (1 << bit for bit in range(9, 13))
"""Of the integers, whether some are negative, beyond 2**53 (so that a double may round them), from 2**63 on, or beyond
what 64 bits hold. NaN and the infinities are FLOAT64 like all fractions."""

HAS_NUL, HAS_SURROGATE, EMPTY_DICT = (1 << bit for bit in range(13, 16))
"""Whether some texts have a NUL, which ROS has no place for, or a lone surrogate, which UTF-8 has none for; and
whether some dicts have no keys."""

OPAQUE = 1 << 16
"""Some values may be of any type: those that were not looked into, and those that are spelled as JSON text."""

INT8, INT16, INT32, UINT8, UINT16, UINT32, UINT64, FLOAT16, FLOAT32 = (1 << bit for bit in range(17, 26))
"""Numbers that come from numpy's arrays keep their type as long as no others are beside them."""

INTEGERS = INTEGER | INT8 | INT16 | INT32 | UINT8 | UINT16 | UINT32 | UINT64
FLOATS = FLOAT64 | FLOAT32 | FLOAT16
NUMBERS = INTEGERS | FLOATS

_PROPERTIES = NEGATIVE | INEXACT | UNSIGNED | HUGE | HAS_NUL | HAS_SURROGATE | EMPTY_DICT
"""Bits that are no kinds but tell more about one."""

ANY_INTEGER = INTEGER | NEGATIVE | INEXACT | UNSIGNED | HUGE
ANY_TEXT = TEXT | HAS_NUL | HAS_SURROGATE
"""All properties that integers and texts may have, for values that were not looked into."""

EXACT_INTEGER = 2**53
"""Doubles hold all integers up to here exactly, and all from its negative on."""

UNBOUNDED = 2**63
"""The greatest length of lists of which no greatest length is told."""

_TEXT_END = 16
"""So many of its last characters are kept of the first text."""


@dataclass(frozen=True, slots=True)
class ArrayType:
    """Type and dimensions of numpy's arrays."""

    dtype: str | None
    """Its name, such as "float32"; None where it differs."""
    lengths: tuple[int | None, ...] | None
    """Of the dimensions, None for those that differ; None in all where their number differs."""
    is_plain: bool = True
    """Whether all are of this machine's byte order, and none has masked elements."""

    def __or__(self, other: ArrayType) -> ArrayType:
        if self == other:
            return self
        lengths = None
        if self.lengths is not None and other.lengths is not None and len(self.lengths) == len(other.lengths):
            pairs = zip(self.lengths, other.lengths, strict=True)
            lengths = tuple(first if first == second else None for first, second in pairs)
        dtype = self.dtype if self.dtype == other.dtype else None
        return ArrayType(dtype, lengths, self.is_plain and other.is_plain)


@dataclass(frozen=True, slots=True)
class Shape:
    """The types of some values, and of their contents."""

    kinds: int = 0
    """The bits of all of their kinds."""
    items: Shape | None = None
    """Of the lists: all elements of all of them; None where there are no lists."""
    shortest: int = 0
    longest: int = 0
    """Of the lists: their lengths."""
    fields: Mapping[str, Shape] = field(default_factory=dict)
    """Of the dicts: the values of each key."""
    optional: frozenset[str] = frozenset()
    """Of the dicts: the keys that some of them lack."""
    array: ArrayType | None = None
    """Of numpy's arrays; None where there are none."""
    first_text: str | None = field(default=None, compare=False)
    """The end of the first text; an example, and no part of the type."""

    def __or__(self, other: Shape) -> Shape:
        """Return the least shape that covers both; this one itself if it does."""
        return join(self, other)

    @property
    def has_nulls(self) -> bool:
        """Whether some values are None."""
        return bool(self.kinds & NULL)

    @property
    def value_kinds(self) -> int:
        """The kinds of those that are not None, without the bits that tell more of one."""
        return self.kinds & ~(NULL | _PROPERTIES)

    @property
    def is_exact_as_doubles(self) -> bool:
        """Whether a double holds every integer."""
        return not self.kinds & INEXACT


NOTHING = Shape()
"""Covers no value."""

ONLY_NULL = Shape(NULL)

Admit = Callable[[str], bool]
"""Whether there is room for one more field of a name."""


def join(first: Shape, second: Shape, admit: Admit | None = None) -> Shape:
    """Return the least shape that covers two; the first one itself if it covers the second.

    Args:
        first: A shape.
        second: Another one.
        admit: Asked for each field that only the second one has, outer ones before those inside; a field that it
            refuses is left out. That bounds what a topic whose rows have ever new keys takes, at the price of the laws.
            Nothing is optional then: to compare thousands of keys with those of each row takes too long.
    """
    if first is second:
        return first
    if not first.kinds and (admit is None or not _has_dicts(second)):
        return second
    kinds = first.kinds | second.kinds
    if first.items is None or second.items is None:
        items = _admitted(second.items, admit) if first.items is None else first.items
        holder = first if second.items is None else second
        shortest, longest = holder.shortest, holder.longest
    else:
        items = join(first.items, second.items, admit)
        shortest, longest = min(first.shortest, second.shortest), max(first.longest, second.longest)
    fields, optional = _joined_fields(first, second, admit)
    array = first.array or second.array
    if first.array is not None and second.array is not None:
        array = first.array | second.array
    if (
        kinds == first.kinds
        and items is first.items
        and (shortest, longest) == (first.shortest, first.longest)
        and fields is first.fields
        and optional == first.optional
        and array == first.array
    ):
        return first
    text = first.first_text if first.first_text is not None else second.first_text
    return Shape(kinds, items, shortest, longest, fields, optional, array, text)


def _has_dicts(values: Shape) -> bool:
    return bool(values.kinds & DICT) or (values.items is not None and _has_dicts(values.items))


def _admitted(items: Shape | None, admit: Admit | None) -> Shape | None:
    return items if items is None or admit is None else join(NOTHING, items, admit)


def _joined_fields(first: Shape, second: Shape, admit: Admit | None) -> tuple[Mapping[str, Shape], frozenset[str]]:
    """Return the fields of two shapes' dicts, and the optional ones among them."""
    if not second.kinds & DICT:
        return first.fields, first.optional
    if not first.kinds & DICT and admit is None:
        return second.fields, second.optional
    fields: dict[str, Shape] | None = None  # a copy is made when the first field differs
    for name, theirs in second.fields.items():
        own = first.fields.get(name)
        if own is theirs:  # nearly always: shapes of single values are the same objects
            continue
        if own is None and admit is not None and not admit(name):
            continue
        both = join(NOTHING if own is None else own, theirs, admit)
        if both is not own:
            fields = dict(first.fields) if fields is None else fields
            fields[name] = both
    joined = first.fields if fields is None else fields
    if admit is not None:
        return joined, frozenset()
    optional = first.optional | second.optional
    if first.fields.keys() != second.fields.keys():
        optional |= first.fields.keys() ^ second.fields.keys()
    return joined, optional


def of_integers(lowest: int, highest: int) -> Shape:
    """Return the shape of integers from their bounds."""
    kinds = INTEGER
    if lowest < 0:
        kinds |= NEGATIVE
    if lowest < -EXACT_INTEGER or highest > EXACT_INTEGER:
        kinds |= INEXACT
    if highest >= 2**63:
        kinds |= UNSIGNED
    if lowest < -(2**63) or highest >= 2**64:
        kinds |= HUGE
    return scalar(kinds)


def of_texts(first: str, *, has_nul: bool = False, has_surrogate: bool = False) -> Shape:
    """Return the shape of texts from the first one, and whether any is special."""
    kinds = TEXT | (HAS_NUL if has_nul else 0) | (HAS_SURROGATE if has_surrogate else 0)
    return Shape(kinds, first_text=first[-_TEXT_END:])


def of_lists(items: Shape, shortest: int, longest: int) -> Shape:
    """Return the shape of lists from that of all of their elements, and from their lengths."""
    if items is _SCALARS.get(items.kinds):
        return _of_plain_lists(items.kinds, shortest, longest)
    return Shape(LIST, items, shortest, longest)


def of_dicts(fields: Mapping[str, Shape], optional: Iterable[str] = ()) -> Shape:
    """Return the shape of dicts from the shapes of their fields."""
    return Shape(DICT if fields else DICT | EMPTY_DICT, fields=fields, optional=frozenset(optional))


_SCALARS: dict[int, Shape] = {0: NOTHING, NULL: ONLY_NULL}


def scalar(kinds: int) -> Shape:
    """Return the shape that is nothing but some kinds; always the same object, so that joins are short."""
    shape = _SCALARS.get(kinds)
    if shape is None:
        shape = _SCALARS[kinds] = Shape(kinds)
    return shape


@functools.lru_cache(4096)
def _of_plain_lists(kinds: int, shortest: int, longest: int) -> Shape:
    return Shape(LIST, scalar(kinds), shortest, longest)
