"""`cat`: the rows of a topic."""

from __future__ import annotations

import argparse
import sys

from ..formats import registry
from . import reading, times

SUMMARY = "print the rows of a topic"


def add(parser: argparse.ArgumentParser) -> None:
    """Say which arguments it takes."""
    reading.add_path(parser)
    parser.add_argument("topic", metavar="TOPIC", help="its name; `ls PATH` lists them")
    parser.add_argument(
        "--format", choices=registry.names("stream"), default="jsonl", help="JSON lines (the default) or CSV"
    )
    parser.add_argument("--start", metavar="TIME", type=times.parse, help=f"first time stamp, {times.HELP}")
    parser.add_argument("--end", metavar="TIME", type=times.parse, help="last time stamp, included")
    parser.add_argument("--columns", metavar="NAME", nargs="+", help="dotted names; all columns by default")
    parser.add_argument("--limit", metavar="ROWS", type=int, help="how many rows at most")


def run(arguments: argparse.Namespace) -> int:
    """Print them as they are read; returns the exit code."""
    with reading.opened(arguments) as recording:
        topic = recording[arguments.topic]
        part = topic.select(arguments.start, arguments.end, arguments.columns, limit=arguments.limit)
        part.write(sys.stdout.buffer, arguments.format)
        return reading.code(recording)
