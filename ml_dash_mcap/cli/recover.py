"""`recover`: finishes the recordings that crashed recorders left behind."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from . import output

if TYPE_CHECKING:
    from ..recovery import Recovered

SUMMARY = "make whole what crashed recorders left in a folder and in those below"


def add(parser: argparse.ArgumentParser) -> None:
    """Say which arguments it takes."""
    parser.add_argument("path", metavar="PATH", help="the run's folder, or a folder of many")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Recover it; returns the exit code."""
    from ..recovery import recover  # brings the writer along: other commands start faster without

    done = recover(arguments.path)
    if arguments.json:
        output.print_json(_facts(done))
    else:
        _print(done)
    return 3 if done.lost_bytes or done.left else 0


def _facts(done: Recovered) -> dict[str, Any]:
    return {
        "finished": [str(path) for path in done.finished],
        "rows": done.rows,
        "lost_bytes": done.lost_bytes,
        "left": [str(path) for path in done.left],
    }


def _print(done: Recovered) -> None:
    if not (done.finished or done.rows or done.left):
        print("nothing to recover")
    for path in done.finished:
        print(f"finished {path}")
    if done.rows:
        print(f"{done.rows} rows were in the journal only")
    if done.lost_bytes:
        print(f"lost: {done.lost_bytes} bytes at the end of a file, cut in the middle of a chunk", file=sys.stderr)
    for path in done.left:
        print(f"left: {path} cannot be recovered", file=sys.stderr)
