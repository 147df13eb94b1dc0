"""Writes and compiles, for one definition, the Python functions that read its messages.

Generated code is used for speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from struct import Struct
from typing import Any

import numpy as np

from ...errors import EncodingError
from .message_types import (
    CODES,
    PLACEHOLDER,
    STRING,
    Array,
    Basic,
    Definitions,
    Named,
    Optional,
    Type,
    Undecoded,
)
from .pieces import MOST_NOTHINGS, pieces
from .value_sizes import ValueSizes
from .wire import CDR_HEAD_BYTES, Wire

Read = Callable[[bytes, int], tuple[Any, int]]
"""Reads at a place in a payload; returns a value and the place behind it."""

_WIDEST = 8
_FIELDS = 10_000
"""How many fields of fields a message may have: a schema of a few lines can ask for more than memory holds. Compiling
so many takes 1 s and 200 MB."""

_DEPTH = 40
"""How deep messages may lie in messages, other than in lists."""


def reader(definitions: Definitions, wire: Wire, *, default: str = "final", replaces: bool = False) -> Read:
    """Return a function that reads a message.

    Values at fixed places are read with one call of `struct`; numbers in lists are read with numpy.

    Args:
        definitions: The message and those in it.
        wire: What the bytes are in; CDR counts places from behind its head.
        default: What messages are in XCDR2 whose definition does not say it: "final" or "appendable".
        replaces: Whether a text that is no UTF-8 gets U+FFFD for what is wrong, instead of a `UnicodeDecodeError`.

    Raises:
        EncodingError: It has a message in itself, far too many fields, or what cannot be decoded.
    """
    return _Compiler(definitions, wire, default, replaces).function(Named(definitions.root), _WIDEST)


class _Compiler:
    """Makes the functions for one definition, one for each type that stands in lists."""

    def __init__(self, definitions: Definitions, wire: Wire, default: str, replaces: bool) -> None:
        self.definitions = definitions
        self.wire = wire
        self.fields_left = _FIELDS
        self.has_placeholders = wire.is_cdr and definitions.has_placeholders
        self.value_sizes = ValueSizes(definitions, wire, default)
        # No builtins: the code is made from a definition that may come from outside. Its names enter the code only as
        # `repr`.
        self._names: dict[str, Any] = {"__builtins__": {}, **pieces(wire, replaces=replaces)}
        """The names that the compiled functions may refer to."""
        self._elements: dict[Type, str] = {}

    def function(self, type_: Type, alignment: int) -> Read:
        """Compile the function that reads a type.

        Args:
            type_: The type.
            alignment: The start is known to be at a multiple of so many bytes.
        """
        body = _Body(self, alignment)
        value = body.value(type_, ())
        body.read_run()
        source = "\n ".join(["def read(data, at):", *body.lines, f"return {value}, at"])
        # Functions put together as closures take 1.2 to 1.9 times as long (docs/decisions, 0033).
        exec(compile(source, f"<{self.definitions.root}>", "exec"), self._names)
        read: Read = self._names.pop("read")
        return read

    def element(self, type_: Type) -> str:
        """Return the name of the function that reads a value for which there is a function of its own."""
        name = self._elements.get(type_)
        if name is None:
            name = self._elements[type_] = f"element{len(self._elements)}"
            # Items of a list may begin anywhere, so nothing is assumed about their alignment.
            self._names[name] = self.function(type_, 1)
        return name

    def refer(self, prefix: str, value: Any) -> str:
        """Give something a name that the functions can use."""
        name = f"{prefix}{len(self._names)}"
        self._names[name] = value
        return name

    def weight(self, type_: Type) -> int:
        """Return how many values there are in one of a type that takes no bytes; 0 if it takes some.

        Raises:
            EncodingError: They are so many that a message of a few bytes would fill the memory.
        """
        if self.value_sizes.least(type_):
            return 0
        if isinstance(type_, Array):
            count = 1 + (type_.length or 0) * self.weight(type_.of)
        else:
            fields = self.definitions.messages[type_.name] if isinstance(type_, Named) else {}
            count = 1 + sum(self.weight(field) for field in fields.values())
        if count > MOST_NOTHINGS:
            what = type_.name if isinstance(type_, Named) else type_
            raise EncodingError(f"it has {what}, which are {count} values that take no bytes")
        return count


class _Body:
    """The body of one function: lines, and numbers in a run that is still to be read."""

    def __init__(self, compiler: _Compiler, alignment: int) -> None:
        self.lines: list[str] = []
        self._compiler = compiler
        self._modulus, self._rest = alignment, 0
        """The place is known to be `_rest` modulo `_modulus`."""
        self._runs = self._count = self._size = 0
        self._format: list[str] = []
        """The format of the run for `struct`. The run holds `_count` values in `_size` bytes."""

    # -- values --------------------------------------------------------------------------------------------------------

    def value(self, type_: Type, inside: tuple[str, ...]) -> str:
        """Read a value; returns the expression for it, good at the end of the function.

        Args:
            type_: Its type.
            inside: The messages that it lies in.
        """
        self._compiler.fields_left -= 1
        if self._compiler.fields_left < 0 or len(inside) > _DEPTH:
            raise EncodingError(f"it has more than {_FIELDS} fields, or is more than {_DEPTH} messages deep")
        if isinstance(type_, Named):
            return self._message(type_.name, inside)
        if isinstance(type_, Array):
            return self._array(type_)
        if isinstance(type_, Optional):
            return self._optional(type_.of)
        if isinstance(type_, Undecoded):  # the parsers refuse such a type already
            raise TypeError(type_.name)
        return self._text() if type_.name == STRING else self._numbers(type_.name, None)

    def _message(self, name: str, inside: tuple[str, ...]) -> str:
        if name in inside:
            raise EncodingError(f"{name} has a {name} in itself")
        fields = self._compiler.definitions.messages[name]
        end = self._sized() if self._compiler.value_sizes.has_size(name) else ""
        values = {key: self.value(field, (*inside, name)) for key, field in fields.items()}
        if self._compiler.has_placeholders and not fields:
            self._numbers("uint8", None)
        if end:
            self._finish(end)
        values.pop(PLACEHOLDER, None)
        return "{" + ", ".join(f"{key!r}: {value}" for key, value in values.items()) + "}"

    def _array(self, type_: Array) -> str:
        compiler, of, length = self._compiler, type_.of, type_.length
        if isinstance(of, Basic) and of.name != STRING and not (of.is_enum and compiler.wire.is_version_2):
            return self._list_of_numbers(of.name) if length is None else self._numbers(of.name, length)
        if compiler.wire.is_version_2 and _is_array(type_) and _is_array(of) and not _is_matrix(type_):
            return self._dimensions(type_)
        end = self._sized() if compiler.wire.is_version_2 and not _is_matrix(type_) else ""
        if length is None:
            count = self._counted()
        else:
            self.read_run()
            count = str(length)
        if isinstance(of, Basic) and of.name == STRING:
            read = "texts("
        elif weight := compiler.weight(of):
            compiler.fields_left -= compiler.weight(type_)
            read = f"nothings({compiler.element(of)}, {weight}, "
        else:
            read = f"elements({compiler.element(of)}, "
        value = self._variable()
        self._line(f"{value}, at = {read}data, at, {count})")
        self._forget(1)
        if end:
            self._finish(end)
        return value

    def _dimensions(self, type_: Array) -> str:
        """Read arrays in an array, which XCDR2 takes for one, but for numbers."""
        lengths: list[int] = []
        of: Type = type_
        while isinstance(of, Array) and of.length is not None:
            lengths.append(of.length)
            of = of.of
        flat = self._array(Array(of, math.prod(lengths)))
        value = self._variable()
        self._line(f"{value} = divided({flat}, {tuple(lengths[1:])!r})")
        return value

    def _optional(self, of: Type) -> str:
        """Read a value that may be absent, behind a byte that tells it."""
        if not self._compiler.wire.is_version_2:
            raise EncodingError("it has an @optional member, which is not decoded in this version of CDR")
        is_there = self._numbers("uint8", None)
        self.read_run()
        value = self._variable()
        self._line(f"{value}, at = {self._compiler.element(of)}(data, at) if {is_there} else (None, at)")
        self._forget(1)
        return value

    def _sized(self) -> str:
        """Read the size of what follows; returns the name of the place where it must end."""
        size, end = self._counted(), self._variable()
        self._line(f"{end} = at + {size}")
        return end

    def _finish(self, end: str) -> None:
        """Compare the place with the place where the value must end."""
        self.read_run()
        self._line(f"if at != {end}: wrong_size(at, {end})")

    def _text(self) -> str:
        count, value = self._counted(), self._variable()
        self._line(f"{value} = text(data, at, {count})")
        self._line(f"at += {count}")
        self._forget(1)
        return value

    def _list_of_numbers(self, name: str) -> str:
        count, value, size = self._counted(), self._variable(), Struct(CODES[name]).size
        # The length before the items leaves the place at a multiple of 4, so only 8-byte numbers need padding, and an
        # empty list has none.
        if size == self._compiler.wire.alignment == _WIDEST:
            self._line(f"if {count}: at = {_aligned(size)}")
        if name == "uint8":
            self._line(f"{value} = octets(data, at, {count})")
        else:
            dtype = self._compiler.refer("dtype", np.dtype(self._compiler.wire.order + CODES[name]))
            self._line(f"{value} = numbers(data, {dtype}, {count}, at).tolist()")
        self._line(f"at += {count} * {size}")
        # An empty list of 8-byte numbers is not padded, so no more than a multiple of 4 is certain behind it.
        self._forget(min(size, CDR_HEAD_BYTES))
        return value

    # -- runs of numbers at places known beforehand --------------------------------------------------------------------

    def _numbers(self, name: str, length: int | None) -> str:
        """Add a number, or an array of known length, to the run; returns the expression for it."""
        code = CODES[name]
        size = Struct(code).size
        self._align(size)
        first, times = self._count, 1 if length is None else length
        self._size += size * times
        self._rest = (self._rest + size * times) % self._modulus
        if length is not None and name == "uint8":
            self._format.append(f"{length}s")
            self._count += 1
            return f"run{self._runs}[{first}]"
        self._format.append(code if length is None else f"{length}{code}")
        self._count += times
        return f"run{self._runs}[{first}]" if length is None else f"[*run{self._runs}[{first}:{self._count}]]"

    def _align(self, size: int) -> None:
        size = min(size, self._compiler.wire.alignment)
        if size == 1:
            return
        if self._modulus < size:
            self.read_run()
            self._line(f"at = {_aligned(size)}")
            self._modulus, self._rest = size, 0
        padding = -self._rest % size
        if padding:
            # `x` makes `struct` skip a byte, so padding costs no line of its own.
            self._format.append(f"{padding}x")
            self._size += padding
            self._rest = (self._rest + padding) % self._modulus

    def read_run(self) -> None:
        """Write the line that reads the numbers so far."""
        if self._size:
            layout = Struct(self._compiler.wire.order + "".join(self._format))
            read = self._compiler.refer("layout", layout.unpack_from)
            self._line(f"run{self._runs} = {read}(data, at)")
            self._line(f"at += {layout.size}")
            self._runs += 1
            self._format, self._count, self._size = [], 0, 0

    def _counted(self) -> str:
        """Read a length; returns the expression for it."""
        number = self._numbers("uint32", None)
        self.read_run()
        return number

    # -- lines ---------------------------------------------------------------------------------------------------------

    def _line(self, line: str) -> None:
        self.lines.append(line)

    def _variable(self) -> str:
        return f"value{len(self.lines)}"

    def _forget(self, modulus: int) -> None:
        """Note that only one thing is known of the place: it is a multiple of `modulus`."""
        self._modulus, self._rest = modulus, 0


def _is_array(type_: Type) -> bool:
    return isinstance(type_, Array) and type_.length is not None


def _is_matrix(type_: Array) -> bool:
    """Whether it is numbers in lists of known lengths, which XCDR2 takes for one list."""
    of: Type = type_
    while isinstance(of, Array) and of.length is not None:
        of = of.of
    return isinstance(of, Basic) and of.name != STRING and not of.is_enum


def _aligned(size: int) -> str:
    """Return the expression for the next place that CDR aligns to `size` bytes."""
    return f"(at + {size - 1 - CDR_HEAD_BYTES % size} & -{size}) + {CDR_HEAD_BYTES % size}"
