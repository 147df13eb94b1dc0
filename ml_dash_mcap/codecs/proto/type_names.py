"""Shortens the names of protobuf types to what a compiler resolves to the same type.

Source: https://protobuf.dev/programming-guides/proto3/#name-resolution
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any


class TypeNames:
    """The names in a set of files."""

    def __init__(self, files: Iterable[Any]) -> None:
        """Collect all names: packages, messages, fields, oneofs, enums and their values."""
        self._names: set[str] = set()
        for file in files:
            parts = file.package.split(".") if file.package else []
            self._names |= {".".join(parts[: count + 1]) for count in range(len(parts))}
            self._names |= set(_names_in_file(file))

    def short(self, type_name: str, scope: str) -> str:
        """Return the shortest name by which a scope finds a type.

        A compiler looks for the first part of a name in the innermost scope, then in those around it, and stays with
        the first scope that has it.

        Args:
            type_name: The full name, with a leading dot.
            scope: The full name of the message or package in which it is used, without one.
        """
        full = type_name.removeprefix(".")
        parts = full.split(".")
        for count in range(1, len(parts) + 1):
            where = self._scope_of(parts[-count], scope)
            if where is not None and _inside(where, ".".join(parts[-count:])) == full:
                return ".".join(parts[-count:])
        return f".{full}"

    def _scope_of(self, name: str, scope: str) -> str | None:
        """Return the innermost scope that has a name."""
        while True:
            if _inside(scope, name) in self._names:
                return scope
            if not scope:
                return None
            scope = scope.rpartition(".")[0]


def _inside(scope: str, name: str) -> str:
    return f"{scope}.{name}" if scope else name


def _names_in_file(file: Any) -> Iterator[str]:
    for message in file.message_type:
        yield from _names_in_message(message, file.package)
    yield from _names_in_enums(file.enum_type, file.package)
    yield from (_inside(file.package, named.name) for named in (*file.extension, *file.service))


def _names_in_message(message: Any, scope: str) -> Iterator[str]:
    full = _inside(scope, message.name)
    yield full
    yield from (f"{full}.{named.name}" for named in (*message.field, *message.oneof_decl, *message.extension))
    yield from _names_in_enums(message.enum_type, full)
    for inner in message.nested_type:
        yield from _names_in_message(inner, full)


def _names_in_enums(enums: Iterable[Any], scope: str) -> Iterator[str]:
    """Yield the names of enums and of their values, which are siblings of their enum."""
    for enum in enums:
        yield _inside(scope, enum.name)
        yield from (_inside(scope, value.name) for value in enum.value)
