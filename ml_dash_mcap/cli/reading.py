"""Opening a recording for a command, and saying what damage took."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator

from ..recording import Recording


def add_path(parser: argparse.ArgumentParser) -> None:
    """Let a command take a recording."""
    parser.add_argument("path", metavar="PATH", help="a recording: a run's folder, or a file")
    parser.add_argument("--skip-damage", action="store_true", help="leave out what cannot be read, and exit with 3")


@contextlib.contextmanager
def opened(arguments: argparse.Namespace) -> Iterator[Recording]:
    """Give the recording that was asked for."""
    with Recording(arguments.path, on_damage="skip" if arguments.skip_damage else "raise") as recording:
        yield recording


def code(recording: Recording) -> int:
    """Say on the standard error what was lost; returns the exit code."""
    for loss in recording.losses:
        known = "" if loss.messages is None else f" ({loss.messages} messages)"
        print(f"lost: {loss.path}, byte {loss.offset}: {loss.what}{known}", file=sys.stderr)
    return 3 if recording.losses else 0
