"""`ls`: the recordings below a folder, or the topics of one recording."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from .. import catalog
from ..catalog import CatalogEntry
from ..recording import Recording
from . import output, reading, times
from .info import topic

SUMMARY = "list the recordings below a folder, or the topics of a recording"


def add(parser: argparse.ArgumentParser) -> None:
    """Say which arguments it takes."""
    parser.add_argument(
        "path", metavar="PATH", nargs="?", default=".", help="a folder or a recording; this folder by default"
    )
    reading.add_no_recover(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print them; returns the exit code."""
    if catalog.is_one_recording(arguments.path):
        return _topics(arguments)
    entries = list(catalog.recordings(arguments.path, recover=arguments.recover))
    if arguments.json:
        output.print_json([_facts(entry) for entry in entries])
    elif not entries:
        print(f"no recordings in {arguments.path}, nor below it")
    else:
        headings = ["recording", "status", "start", "duration", "topics", "size"]
        rows = [_cells(entry, arguments.path) for entry in entries]
        output.print_table(headings, rows, right=("duration", "topics", "size"))
    return 3 if any(entry.problem for entry in entries) else 0


def _topics(arguments: argparse.Namespace) -> int:
    with Recording(arguments.path, recover=arguments.recover) as recording:
        infos = list(recording.topics.values())
    if arguments.json:
        output.print_json([topic(info) for info in infos])
    else:
        rows = [
            [info.name, str(info.count), f"{info.rate:.4g} Hz", times.show_duration(info.duration)] for info in infos
        ]
        output.print_table(["topic", "rows", "rate", "duration"], rows, right=("rows", "rate", "duration"))
    return 0


def _facts(entry: CatalogEntry) -> dict[str, Any]:
    return {
        "path": str(entry.path),
        "status": entry.status,
        "start": entry.start,
        "end": entry.end,
        "duration": entry.duration,
        "topics": entry.topics,
        "files": entry.files,
        "bytes": entry.bytes,
        "problem": entry.problem,
    }


def _cells(entry: CatalogEntry, root: str) -> list[str]:
    status = f"{entry.status}: {entry.problem}" if entry.problem else entry.status
    return [
        os.path.relpath(entry.path, Path(root)),
        status,
        times.show(entry.start),
        times.show_duration(entry.duration),
        str(entry.topics),
        times.show_size(entry.bytes),
    ]
