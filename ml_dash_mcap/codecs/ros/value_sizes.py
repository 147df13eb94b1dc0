"""Computes how many bytes values take, and at which offsets several of them lie behind each other."""

from __future__ import annotations

import numpy as np

from ...errors import EncodingError
from .message_columns import Indices
from .message_types import APPENDABLE, MUTABLE, Array, Basic, Definitions, Named, Type
from .wire import Wire

_DEEPEST = 40
"""How deep messages may lie in messages."""

_MOST_ITEMS = 100_000
"""The longest fixed array of messages whose size is computed in advance."""

_SIZE_BYTES = 4
"""The bytes of the size that stands before an appendable message."""

_MOST_BYTES = 1 << 30
"""A least size is cut to this: no message is larger, and products of larger numbers would overflow 64 bits."""


class ValueSizes:
    """Sizes of the values of one definition in one wire format.

    In CDR the size of a value depends on where it starts, because numbers are aligned. What counts is the residue: the
    place modulo the widest alignment.
    """

    def __init__(self, definitions: Definitions, wire: Wire, default: str = "final") -> None:
        """Prepare to work sizes out.

        Args:
            definitions: The message and those in it.
            wire: The format.
            default: What messages are in XCDR2 whose definition does not say it: "final" or "appendable".
        """
        self.definitions = definitions
        self.wire = wire
        self._default = default
        self._sizes: dict[tuple[Type, int], int | None] = {}
        self._least: dict[Type, int] = {}

    def has_size(self, name: str) -> bool:
        """Whether a message begins with its size, in bytes.

        Raises:
            EncodingError: Its members are numbered.
        """
        kind = self.definitions.extensibility.get(name, self._default)
        if kind == MUTABLE:
            raise EncodingError(f"{name} is @mutable, which is not decoded")
        return self.wire.is_version_2 and kind == APPENDABLE

    def is_fixed(self, type_: Type) -> bool:
        """Whether all values of a type take the same number of bytes, but for padding."""
        return self._size(type_, 0, 0) is not None

    def least(self, type_: Type) -> int:
        """Return how many bytes a value takes at least, without padding."""
        least = self._least.get(type_)
        if least is None:
            self._least[type_] = 1  # of a message in itself, by way of a list
            least = self._least[type_] = min(self._least_of(type_), _MOST_BYTES)
        return least

    def offsets(self, type_: Type, residue: int, count: int) -> Indices:
        """Return where each of some values lies, and the end of the last one, counted from the start of the first.

        Args:
            type_: Of a fixed size.
            residue: Of the start of the first.
            count: How many values.

        Returns:
            [count + 1]
        """
        seen: dict[int, int] = {}
        sizes: list[int] = []
        # The sizes depend on the residue only, so they repeat from the first residue that comes again, after 8 values
        # at most.
        while residue not in seen and len(sizes) < count:
            seen[residue] = len(sizes)
            size = self._size(type_, residue, 0)
            if size is None:
                raise ValueError("it is made of messages in messages that are not read by columns")
            sizes.append(size)
            residue = (residue + size) % self.wire.alignment
        offsets = np.zeros(count + 1, np.int64)
        offsets[1 : len(sizes) + 1] = sizes
        if len(sizes) < count:  # from here on the sizes repeat
            offsets[len(sizes) + 1 :] = np.resize(sizes[seen[residue] :], count - len(sizes))
        return np.cumsum(offsets)

    def _size(self, type_: Type, residue: int, depth: int) -> int | None:
        """Return how many bytes a value takes, with the padding before and in it; None if they vary."""
        key = (type_, residue)
        if key not in self._sizes:
            self._sizes[key] = None  # of a message in itself
            self._sizes[key] = self._size_of(type_, residue, depth) if depth < _DEEPEST else None
        return self._sizes[key]

    def _size_of(self, type_: Type, residue: int, depth: int) -> int | None:
        if isinstance(type_, Basic):
            if type_.is_text:
                return None
            width = type_.dtype.itemsize
            return -residue % min(width, self.wire.alignment) + width
        if isinstance(type_, Array):
            return self._size_of_array(type_, residue, depth)
        if not isinstance(type_, Named):
            return None
        fields = self.definitions.messages[type_.name]
        total = 1 if not fields and self.wire.is_cdr and self.definitions.has_placeholders else 0
        for inner in fields.values():
            size = self._size(inner, (residue + total) % self.wire.alignment, depth + 1)
            if size is None:
                return None
            total += size
        return total

    def _size_of_array(self, type_: Array, residue: int, depth: int) -> int | None:
        if type_.length is None:
            return None
        if not type_.length:
            return 0
        if isinstance(type_.of, Basic) and not type_.of.is_text:
            width = type_.of.dtype.itemsize
            return -residue % min(width, self.wire.alignment) + width * type_.length
        first = self._size(type_.of, residue, depth + 1)
        if first is None or type_.length > _MOST_ITEMS:
            return None
        return int(self.offsets(type_.of, residue, type_.length)[-1])

    def _least_of(self, type_: Type) -> int:
        if isinstance(type_, Basic):
            return 4 if type_.is_text else type_.dtype.itemsize
        if isinstance(type_, Array):
            return 4 if type_.length is None else type_.length * self.least(type_.of)
        if not isinstance(type_, Named):
            return 1
        fields = self.definitions.messages[type_.name]
        has_byte = not fields and self.wire.is_cdr and self.definitions.has_placeholders
        return (
            int(has_byte)
            + _SIZE_BYTES * self.has_size(type_.name)
            + sum(self.least(inner) for inner in fields.values())
        )
