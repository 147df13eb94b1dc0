"""The parser of the command line."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Protocol

from ..version import __version__
from . import cat, export, info, ls, recover

NAME = "ml-dash-mcap"


class Command(Protocol):
    """A module of this folder."""

    SUMMARY: str
    """One line, for the list of commands."""

    def add(self, parser: argparse.ArgumentParser) -> None:
        """Say which arguments it takes."""

    def run(self, arguments: argparse.Namespace) -> int:
        """Do it; returns the exit code."""


COMMANDS: Mapping[str, Command] = {"info": info, "ls": ls, "cat": cat, "export": export, "recover": recover}
"""By name, in the order of the help."""

_ENDING = "Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done, but something was lost."


def build() -> argparse.ArgumentParser:
    """Return the parser of the whole command line; what it parses says in `run` what to call."""
    parser = argparse.ArgumentParser(NAME, description="Look into robot recordings and convert them.", epilog=_ENDING)
    parser.add_argument("--version", action="version", version=f"{NAME} {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        subparser = commands.add_parser(name, help=command.SUMMARY, description=f"{command.SUMMARY.capitalize()}.")
        command.add(subparser)
        subparser.add_argument("--debug", action="store_true", help="show where in the code an error came from")
        subparser.set_defaults(run=command.run)
    return parser
