"""`export`: topics in another format."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from ..formats import registry
from . import output, progress, reading, times

SUMMARY = "write topics in another format"


def add(parser: argparse.ArgumentParser) -> None:
    """Say which arguments it takes."""
    reading.add_path(parser)
    parser.add_argument("dest", metavar="DEST", help="where to; a suffix such as .parquet says the format")
    formats = registry.names("write")
    parser.add_argument("--format", metavar="FORMAT", choices=formats, help=f"one of {', '.join(formats)}")
    parser.add_argument("--topics", metavar="TOPIC", nargs="+", help="names; all topics by default")
    parser.add_argument("--start", metavar="TIME", type=times.parse, help=f"first time stamp, {times.HELP}")
    parser.add_argument("--end", metavar="TIME", type=times.parse, help="last time stamp, included")
    parser.add_argument(
        "--option",
        metavar="NAME=VALUE",
        type=_option,
        action="append",
        default=[],
        help="an option of the format, such as flatten=true; the guide on exporting lists them",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace what DEST names, once the new one is whole")
    parser.add_argument("--json", action="store_true", help="print what was done as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Write them; returns the exit code."""
    chosen = arguments.format or registry.format_of(Path(arguments.dest))
    with reading.opened(arguments) as recording:
        with progress.shown(f"export {chosen}") as report:
            dest = recording.export(
                arguments.dest,
                format=chosen,
                topics=arguments.topics,
                start=arguments.start,
                end=arguments.end,
                overwrite=arguments.overwrite,
                progress=report,
                **dict(arguments.option),
            )
        if arguments.json:
            output.print_json({"dest": str(dest), "format": chosen})
        else:
            print(dest)
        return reading.code(recording)


def _option(text: str) -> tuple[str, Any]:
    """Return an option's name and its value: what JSON it is, or else the text."""
    name, is_given, value = text.partition("=")
    if not name or not is_given:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name.replace("-", "_"), json.loads(value)
    except ValueError:
        return name.replace("-", "_"), value
