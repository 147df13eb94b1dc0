"""Writes the source of code that encodes rows like one that was seen."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import orjson

from ...rows import packed_arrays
from ...rows.plain_row import TIME_KEY, PlainRow
from ...rows.shape import EXACT_INTEGER
from . import exact_values, wire
from .growth import member_for
from .layout import Kind, Layout, Member
from .row_encoder import EXACT_TAG, MOST_SINGLE_INTEGERS, TIME_TAG, element_pointer, encode_array, encode_list
from .value_slots import Fit, fit

_MOST_UNROLLED = 64
"""Lists with more elements are packed as they come, whatever their length."""

_ARRAY_CODES = {f"{kind}{width}" for kind in "fiu" for width in (1, 2, 4, 8)} - {"f1", "u8"} | {"b1"}
"""The types of small arrays of numpy that are encoded from their bytes."""


class NotCompilableError(Exception):
    """There is no compiled way for rows like this one."""


class Piece(NamedTuple):
    """A part of the bytes of a row."""

    expression: str
    """Of the bytes; of the arguments of `struct.pack` where there is a format."""
    format: str = ""
    """The codes of `struct`, where the part has always one length."""


class RowSource:
    """The source of one function, as it is written."""

    def __init__(self, give_up: str, *, is_flexible: bool = False) -> None:
        """Begin.

        Args:
            give_up: The statement for rows of another kind.
            is_flexible: Whether lists and arrays may be of any length, which takes longer.
        """
        self._give_up = give_up
        self._is_flexible = is_flexible
        self._lines: list[str] = []
        """Take the containers apart, and give up where one is of another type."""
        self._leaves: dict[type, list[str]] = {}
        """The variables that must be exactly of a type."""
        self._tests: list[str] = []
        self._late_lines: list[str] = []
        """Run after all types were looked at."""
        self._exact: list[tuple[str, str]] = []
        """Pointers into the row, each with the value as JSON, or with a variable that holds an integer."""
        self.names: dict[str, Any] = {
            "_varint": wire.varint,
            "_BYTES": [bytes((length,)) for length in range(128)],
            "_fit": fit,
            "_encode_list": encode_list,
        }
        """The constants that the source uses."""
        self._count = 0

    def variable(self) -> str:
        """Return a new name."""
        self._count += 1
        return f"_v{self._count}"

    def name(self, value: Any) -> str:
        """Return a name for a constant."""
        self._count += 1
        name = f"_c{self._count}"
        self.names[name] = value
        return name

    def constant(self, data: bytes) -> Piece:
        """Return a piece that is always the same."""
        return Piece(self.name(data), f"{len(data)}s")

    def row(self, layout: Layout, fields: Mapping[str, Any], variables: Sequence[str]) -> list[Piece]:
        """Return the pieces of a whole row.

        Args:
            layout: Of the row.
            fields: As they were seen, the time stamp last.
            variables: The names of the variables that hold the others.
        """
        pieces: list[Piece] = []
        for variable, (key, value) in zip(variables, fields.items(), strict=False):
            pieces += self.field(layout, key, value, variable, "")
        return [*pieces, *self.exact_text(), self.constant(TIME_TAG), Piece("_time_s", "d")]

    # -- values --------------------------------------------------------------------------------------------------------

    def field(self, layout: Layout, key: str, value: Any, variable: str, parent: str) -> list[Piece]:
        """Return the pieces of a field whose value is in a variable.

        Args:
            layout: Of the dict that holds it.
            key: Of the value.
            value: As it was seen.
            variable: The name of the variable.
            parent: The pointer of the dict.
        """
        place = exact_values.pointer(parent, key)
        if value is None:
            self._tests.append(f"{variable} is None")
            self._exact.append((place, "null"))
            return []
        plain = PlainRow("").row({key: value, TIME_KEY: 0.0})[key]
        fitted_value = fit(plain)
        member = (
            None if fitted_value is None else member_for(layout, key, fitted_value.slot, fitted_value.leaves or plain)
        )
        if fitted_value is None or member is None:
            raise NotCompilableError
        if fitted_value.slot.is_list or fitted_value.slot.kind is Kind.ARRAY:
            return self._list(member, fitted_value, value, variable, place)
        if fitted_value.slot.kind is Kind.DICT:
            return self._dict(member, value, variable, place)
        return self._single(member, plain, value, variable, place)

    def _single(self, member: Member, plain: Any, value: Any, variable: str, place: str) -> list[Piece]:
        kind = member.slot.kind
        self._leaf(variable, value)
        if kind is Kind.TEXT and type(value) is str:
            encoded = self._late(f"{variable}.encode()")
            return [self.constant(member.tag), *self._delimited(encoded)]
        if kind is Kind.BYTES and type(value) is bytes:
            return [self.constant(member.tag), *self._delimited(variable)]
        if kind.struct_code is None or kind is Kind.UINT or not _is_number(value):
            raise NotCompilableError
        if kind is Kind.DOUBLE and type(plain) is int:
            self._integer_as_double(variable, place)
        return [self.constant(member.tag), Piece(variable, kind.struct_code)]

    def _integer_as_double(self, variable: str, place: str) -> None:
        self._tests.append(f"{-EXACT_INTEGER} <= {variable} <= {EXACT_INTEGER}")
        self._exact.append((place, variable))

    def _dict(self, member: Member, value: Any, variable: str, place: str) -> list[Piece]:
        if type(value) is not dict or {*map(type, value)} - {str}:
            raise NotCompilableError
        keys = self.name(tuple(value))
        self._lines.append(f"if type({variable}) is not dict or tuple({variable}) != {keys}: {self._give_up}")
        inner = [self.variable() for _ in value]
        if inner:
            self._lines.append(f"({', '.join(inner)},) = {variable}.values()")
        pieces: list[Piece] = []
        for name, (key, inner_value) in zip(inner, value.items(), strict=True):
            pieces += self.field(member.inner or Layout(), key, inner_value, name, place)
        if all(piece.format for piece in pieces):
            size = struct.calcsize("<" + "".join(piece.format for piece in pieces))
            return [self.constant(member.tag + wire.varint(size)), *pieces]
        return [self.constant(member.tag), *self._delimited(self._late(self._joined(pieces)))]

    # -- lists and arrays ----------------------------------------------------------------------------------------------

    def _list(self, member: Member, fitted_value: Fit, value: Any, variable: str, place: str) -> list[Piece]:
        kind = member.slot.kind
        if type(value) in (list, tuple):
            is_short = kind.is_packed and kind is not Kind.UINT and len(fitted_value.leaves) <= _MOST_UNROLLED
            if is_short and not self._is_flexible:
                return self._unrolled(member, fitted_value.leaves, value, variable, place)
            if kind is Kind.DICT or fitted_value.slot != member.slot or fitted_value.integers:
                raise NotCompilableError
            return self._as_it_comes(member, fitted_value, value, variable)
        if type(value).__module__ != "numpy" or type(value).__name__ != "ndarray" or member.slot != fitted_value.slot:
            raise NotCompilableError
        return self._array(member, value, variable)

    def _unrolled(
        self, member: Member, leaves: Sequence[Any], value: Sequence[Any], variable: str, place: str
    ) -> list[Piece]:
        names: list[str] = []
        self._take_apart(value, [variable], names)
        integers = 0
        for at, (name, leaf) in enumerate(zip(names, leaves, strict=True)):
            self._leaf(name, leaf)
            if type(leaf) is int and member.slot.kind is Kind.DOUBLE:
                integers += 1
                self._integer_as_double(name, element_pointer(place, at, member.slot.lengths or ()))
        if integers > MOST_SINGLE_INTEGERS or {*map(type, leaves)} - {float, int, bool}:
            raise NotCompilableError
        code = member.slot.kind.struct_code or ""
        size = struct.calcsize(f"<{len(names)}{code}")
        return [self.constant(member.tag + wire.varint(size)), Piece(", ".join(names), f"{len(names)}{code}")]

    def _take_apart(self, value: Any, variables: list[str], leaves: list[str]) -> None:
        """Write the lines that put the elements of lists into variables, level by level.

        Args:
            value: One of the lists.
            variables: The names of all lists of its level, which are of its type and its length.
            leaves: Gets the names of the elements that are no lists.
        """
        kind = type(value).__name__
        self._lines.append(
            f"if not ({' is '.join(f'type({variable})' for variable in variables)} is {kind}): {self._give_up}"
        )
        elements: list[str] = []
        for variable in variables:
            names = [self.variable() for _ in value]
            self._lines.append(f"({', '.join(names)},) = {variable}")
            elements += names
        if type(value[0]) in (list, tuple):
            self._take_apart(value[0], elements, leaves)
            return
        leaves += elements

    def _as_it_comes(self, member: Member, fitted_value: Fit, value: Any, variable: str) -> list[Piece]:
        """Return the pieces of a list of any length."""
        self._lines.append(f"if type({variable}) is not {type(value).__name__}: {self._give_up}")
        fitted = self.variable()
        self._lines.append(f"{fitted} = _fit({variable})")
        slot = self.name(fitted_value.slot)
        self._lines.append(f"if {fitted} is None or {fitted}.slot != {slot} or {fitted}.integers: {self._give_up}")
        return [Piece(f"_encode_list({self.name(member)}, {fitted}.leaves)")]

    def _array(self, member: Member, value: Any, variable: str) -> list[Piece]:
        dtype = value.dtype
        ndarray = self.name(type(value))
        check = f"type({variable}) is {ndarray} and {variable}.dtype is {self.name(dtype)}"
        if member.slot.kind is Kind.ARRAY:
            self.names |= {"_is_large": packed_arrays.is_large, "_encode_array": encode_array}
            self._tests.append(f"{check} and _is_large({variable})")
            parsed = packed_arrays.parse(member.array)
            if parsed is not None:  # its schema must hold for the next arrays too
                self.names["_has_lengths"] = _has_lengths
                self._tests.append(f"_has_lengths({variable}.shape, {self.name(parsed[1])})")
            return [self.constant(member.tag), *self._delimited(self._late(f"_encode_array({variable})"))]
        if dtype.str[1:] not in _ARRAY_CODES or not dtype.isnative or not value.size:
            raise NotCompilableError
        wanted = {"f": "<f8", "i": "<i8", "u": "<i8", "b": "|b1"}[dtype.kind]
        data = f"{variable}.tobytes()" if dtype.str == wanted else f"{variable}.astype({wanted!r}).tobytes()"
        if self._is_flexible:
            inner = self.name(value.shape[1:])
            self._tests.append(f"{check} and {variable}.size and {variable}.ndim and {variable}.shape[1:] == {inner}")
            return [self.constant(member.tag), *self._delimited(self._late(data))]
        self._tests.append(f"{check} and {variable}.shape == {self.name(value.shape)}")
        size = value.size * np.dtype(wanted).itemsize
        return [self.constant(member.tag + wire.varint(size)), Piece(data, f"{size}s")]

    # -- the function --------------------------------------------------------------------------------------------------

    def _leaf(self, variable: str, value: Any) -> None:
        self._leaves.setdefault(type(value), []).append(variable)

    def _late(self, expression: str) -> str:
        """Return a variable for an expression that is reached only if all types are right."""
        variable = self.variable()
        self._late_lines.append(f"{variable} = {expression}")
        return variable

    def _delimited(self, variable: str) -> list[Piece]:
        """Return the pieces of the length of a variable's bytes, and of these."""
        length = f"(_BYTES[len({variable})] if len({variable}) < 128 else _varint(len({variable})))"
        return [Piece(length), Piece(variable)]

    def exact_text(self) -> list[Piece]:
        """Return the pieces of the row's exact text; none if it has none."""
        if not self._exact:
            return []
        values = [value if value == "null" else "%d" for _, value in self._exact]
        pointers = [orjson.dumps(place).decode().replace("%", "%%") for place, _ in self._exact]
        template = "{" + ",".join(map(":".join, zip(pointers, values, strict=True))) + "}"
        variables = [value for _, value in self._exact if value != "null"]
        arguments = f"({', '.join(variables)},)" if variables else "()"
        text = self._late(f"{self.name(template.encode())} % {arguments}")
        return [self.constant(EXACT_TAG), *self._delimited(text)]

    def _joined(self, pieces: Sequence[Piece]) -> str:
        return " + ".join(self.terms(pieces)) or "b''"

    def terms(self, pieces: Sequence[Piece]) -> list[str]:
        """Return the expressions of pieces: those of fixed length side by side are packed together."""
        terms: list[str] = []
        fixed: list[Piece] = []
        for piece in [*pieces, Piece("")]:
            if piece.format:
                fixed.append(piece)
                continue
            if fixed:
                pack = self.name(struct.Struct("<" + "".join(part.format for part in fixed)).pack)
                terms.append(f"{pack}({', '.join(part.expression for part in fixed)})")
                fixed = []
            if piece.expression:
                terms.append(piece.expression)
        return terms

    def statements(self) -> list[str]:
        """Return the statements that look at a row's types, and prepare the values for the expressions."""
        types: list[str] = []
        for at, (kind, variables) in enumerate(self._leaves.items()):
            self.names[f"_t{at}"] = kind
            types.append(f"{' is '.join(f'type({name})' for name in variables)} is _t{at}")
        tests = [*types, *self._tests]  # what an array does with a comparison, nobody asks
        test = [f"if not ({' and '.join(tests)}): {self._give_up}"] if tests else []
        return [*self._lines, *test, *self._late_lines]


def _has_lengths(lengths: Sequence[int], expected: Sequence[int | None]) -> bool:
    """Whether an array has some dimensions; None stands for any length."""
    return len(lengths) == len(expected) and all(map(_is_length, lengths, expected))


def _is_length(length: int, expected: int | None) -> bool:
    return expected is None or length == expected


def _is_number(value: Any) -> bool:
    """Whether a value is a number of a type that `struct` takes."""
    if type(value) in (float, int, bool):
        return True
    return type(value).__module__ == "numpy" and type(value).__name__ in _NUMPY_SCALARS


_NUMPY_SCALARS = {"float64", "float32", "float16", "bool", "bool_", *(f"int{bits}" for bits in (8, 16, 32, 64))} | {
    f"uint{bits}" for bits in (8, 16, 32)
}
