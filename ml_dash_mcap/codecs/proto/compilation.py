"""Decides when code is compiled for the rows of a channel, and keeps it.

Compiling takes 0.3 to 0.6 ms, during which a control loop waits. So a call compiles one function at most, topics with
rows alike share it, and rows that keep changing are encoded value by value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from . import compiled_rows
from .compiled_rows import AppendCode, Encode
from .layout import Layout
from .row_source import NotCompilableError

Key = tuple[str, ...]

_MOST_VARIANTS, _MOST_COMPILATIONS, _MOST_KEYS = 4, 16, 256
"""Of rows with the same keys, so many functions are kept, and so many compiled until the layout grows; and for so many
different keys."""

_MOST_IN_ALL = 500
"""So many functions are compiled for a channel."""

_MOST_RIGID = 2
"""Of rows with the same keys, so many functions are compiled that take lists of one length only."""


class Compilation:
    """The compiled code of one channel. Any thread may call it."""

    def __init__(self) -> None:
        """Begin without code."""
        self.functions: dict[Key, tuple[Encode, ...]] = {}
        """By the keys of rows, the functions for those that came so far, the last one first."""
        self.install: Callable[[AppendCode | None], None] | None = None
        """Takes the code of an `append`; None when earlier code is out of date."""
        self._counts: dict[Key, int] = {}
        """By the keys of rows, how often there was no function for one under this layout."""
        self._compiled = 0
        """How many functions were compiled."""

    def forget(self) -> None:
        """Forget all code, because the layout has grown: integers may have to go into another field now."""
        self.functions = {}
        self._counts = {}
        if self.install is not None:
            self.install(None)

    def learn(self, layout: Layout, fields: Mapping[str, Any]) -> None:
        """Compile code for rows like one that had none, unless that happened too often.

        Args:
            layout: That has a field for each value of the row.
            fields: The row.
        """
        key = tuple(fields)
        count = self._counts.get(key, 0)
        if count >= _MOST_COMPILATIONS or (not count and len(self._counts) >= _MOST_KEYS):
            return
        if self._compiled >= _MOST_IN_ALL:
            return
        self._compiled += 1
        self._counts[key] = count + 1
        is_flexible = count // 2 >= _MOST_RIGID
        try:
            if count % 2 or not self._install_append(layout, fields, is_flexible):
                encode = compiled_rows.compile_row(layout, fields, is_flexible=is_flexible)
                self.functions[key] = (encode, *self.functions.get(key, ())[: _MOST_VARIANTS - 1])
        except NotCompilableError:
            return

    def _install_append(self, layout: Layout, fields: Mapping[str, Any], is_flexible: bool) -> bool:
        """Hand on the code of an `append`; returns whether there was some, and somebody to take it."""
        code = None if self.install is None else compiled_rows.append_code(layout, fields, is_flexible=is_flexible)
        if code is None or self.install is None:
            return False
        self.install(code)
        return True
