"""Opens a recording for a command, and reports the damage that it has."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator

from ..recording import Recording

_DIGITS = 6
"""The most digits of a run's number. A run's id has 16 digits, so the two cannot be confused."""


def add_path(parser: argparse.ArgumentParser) -> None:
    """Let a command take a recording."""
    parser.add_argument("path", metavar="PATH", help="a recording: a run's folder, or a file")
    parser.add_argument(
        "--run",
        dest="chosen_run",
        metavar="RUN",
        type=_run,
        help="of several runs, read one: its number (0, or -1 for the last) or its id",
    )
    add_no_recover(parser)
    parser.add_argument("--skip-damage", action="store_true", help="leave out what cannot be read, and exit with 3")


def add_no_recover(parser: argparse.ArgumentParser) -> None:
    """Let a command write nothing into what it reads."""
    parser.add_argument(
        "--no-recover",
        dest="recover",
        action="store_false",
        help="leave what a dead recorder left as it lies, and write nothing there",
    )


def _run(text: str) -> str | int:
    """Return a run's number, or its id. An id of digits only is recognised by its length."""
    digits = text.removeprefix("-")
    return int(text) if digits.isdecimal() and len(digits) <= _DIGITS else text


@contextlib.contextmanager
def opened(arguments: argparse.Namespace) -> Iterator[Recording]:
    """Give the recording that was asked for."""
    on_damage = "skip" if arguments.skip_damage else "raise"
    recover: bool = arguments.recover
    with Recording(arguments.path, run=arguments.chosen_run, recover=recover, on_damage=on_damage) as recording:
        yield recording


def code(recording: Recording) -> int:
    """Say on the standard error what was lost, and what was wrong and corrected; returns the exit code."""
    for loss in recording.losses:
        count = "" if loss.messages is None or loss.corrected else f" ({loss.messages} messages)"
        print(f"{'corrected' if loss.corrected else 'lost'}: {loss}{count}", file=sys.stderr)
    return 0 if all(loss.corrected for loss in recording.losses) else 3
