"""Writes the code that encodes, in one go, rows like one that was seen, and compiles it.

The code makes the bytes that `row_encoder` would, and gives up on a row that differs in a type, a length or a key of a
dict. Every value's type is looked at: a list of floats with one integer in it is another kind of row. Generated code is
used for speed: a row of 29 floats takes a tenth of the time.
"""

from __future__ import annotations

import builtins
import functools
import keyword
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import CodeType
from typing import Any

from ...rows.plain_row import TIME_KEY
from .layout import Layout
from .row_source import NotCompilableError, Piece, RowSource

Encode = Callable[[Mapping[str, Any]], "bytes | None"]


FAILURES = (ValueError, TypeError, struct.error, AttributeError, IndexError)
"""What the code may raise for a row of another kind."""


@dataclass(frozen=True, slots=True)
class AppendCode:
    """The code that encodes the arguments of `append` where they are like those of a row that was seen."""

    keys: tuple[str, ...]
    """The arguments. They are the names of variables in the code; all its other names begin with `_`."""
    lines: Sequence[str]
    """Statements that raise one of `FAILURES` for other rows."""
    terms: Sequence[str]
    """The expressions of the bytes, to be joined, which use the time stamp as `_time_s`."""
    first_format: str
    """The codes of `struct` of the first term, if its bytes always have one length: then the term is a list of
    arguments for `struct.pack`."""
    names: Mapping[str, Any]
    """The constants that the code uses."""


def compile_row(layout: Layout, fields: Mapping[str, Any], *, is_flexible: bool = False) -> Encode:
    """Compile a function for rows like one; it returns None for others.

    Args:
        layout: That has a field for each value of the row.
        fields: The row, with its time stamp as the last key.
        is_flexible: Whether lists and arrays may be of any length, which takes longer.

    Raises:
        NotCompilableError: It is too odd.
    """
    _check_keys(fields)
    source = RowSource("return None", is_flexible=is_flexible)
    variables = [source.variable() for _ in range(len(fields) - 1)]
    pieces = source.row(layout, fields, variables)
    lines = [f"({', '.join([*variables, '_time_s'])},) = fields.values()", *source.statements()]
    terms = [*source.terms(pieces), "b''"]
    body = "".join(f"        {line}\n" for line in [*lines, f"return {' + '.join(terms[:-1] or terms)}"])
    text = f"def encode(fields):\n    try:\n{body}    except _FAILURES:\n        return None\n"
    encode: Encode = compiled(text, {**source.names, "_FAILURES": FAILURES}, "encode")
    return encode


def append_code(layout: Layout, fields: Mapping[str, Any], *, is_flexible: bool = False) -> AppendCode | None:
    """Return the code for `append` of rows like one; None where a key cannot be the name of an argument.

    Args:
        layout: As in `compile_row`.
        fields: As in `compile_row`.
        is_flexible: As in `compile_row`.

    Raises:
        NotCompilableError: The row is too odd.
    """
    _check_keys(fields)
    keys = tuple(fields)[:-1]
    if not keys or not all(map(_is_argument, keys)):
        return None
    source = RowSource("raise ValueError", is_flexible=is_flexible)
    pieces = source.row(layout, fields, keys)
    first: list[Piece] = []
    while pieces and pieces[0].format:
        first.append(pieces.pop(0))
    terms = [", ".join(piece.expression for piece in first), *source.terms(pieces)]
    format_ = "".join(piece.format for piece in first)
    return AppendCode(keys, source.statements(), terms, format_, source.names)


def _is_argument(key: str) -> bool:
    """Whether a key can be the name of an argument, and hides no name that the code uses."""
    is_name = key.isascii() and key.isidentifier() and not keyword.iskeyword(key)
    return is_name and not key.startswith("_") and key not in _TAKEN


_TAKEN = {"self", "timestamp", *dir(builtins)}


def compiled(text: str, names: Mapping[str, Any], name: str) -> Any:
    """Return a function from its source.

    Raises:
        NotCompilableError: It has too many levels or names.
    """
    globals_ = dict(names)
    try:
        exec(_code_of(text), globals_)  # only checked names and numbers
    except (SyntaxError, MemoryError, RecursionError) as error:
        raise NotCompilableError from error
    return globals_[name]


@functools.lru_cache(64)
def _code_of(text: str) -> CodeType:
    """Compile a source; topics whose rows are alike have the same."""
    return compile(text, "<compiled row>", "exec")


def _check_keys(fields: Mapping[str, Any]) -> None:
    names = list(fields)
    if not names or names[-1] != TIME_KEY or {*map(type, names)} != {str}:
        raise NotCompilableError
