"""Tables and JSON on the standard output; tables are drawn with rich on a terminal, where it is installed."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Sequence
from typing import Any, TextIO

import orjson


def print_json(facts: Any) -> None:
    """Print facts as JSON. NaN and infinities are printed as null."""
    try:
        text = orjson.dumps(facts, option=orjson.OPT_INDENT_2, default=str).decode()
    except TypeError:  # an integer beyond 64 bits
        text = json.dumps(facts, indent=2, default=str)
    print(text)


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> None:
    """Print a table.

    Args:
        headings: Of the columns.
        rows: Their cells.
        right: Headings of the columns that are flush right.
    """
    if is_rich(sys.stdout):
        _draw(headings, rows, right)
        return
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    for row in (headings, *rows):
        cells = [
            cell.rjust(width) if heading in right else cell.ljust(width)
            for cell, width, heading in zip(row, widths, headings, strict=True)
        ]
        print("  ".join(cells).rstrip())


def is_rich(stream: TextIO) -> bool:
    """Whether to draw on a stream with rich."""
    return stream.isatty() and importlib.util.find_spec("rich") is not None


def _draw(headings: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left", no_wrap=heading in right)
    for row in rows:
        # As `Text`, because rich would take square brackets in plain strings for markup.
        table.add_row(*map(Text, row))
    Console().print(table)
