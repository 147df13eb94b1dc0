"""`info`: a recording at a glance."""

from __future__ import annotations

import argparse
from typing import Any

from ..catalog import run_status
from ..inspect.runs import RunInfo
from ..inspect.topics import TopicInfo
from ..recording import Recording
from . import output, reading, times

SUMMARY = "show a recording at a glance"


def add(parser: argparse.ArgumentParser) -> None:
    """Say which arguments it takes."""
    reading.add_path(parser)
    parser.add_argument("--bytes", action="store_true", help="add up the bytes of each topic's messages, uncompressed")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print it; returns the exit code."""
    with reading.opened(arguments) as recording:
        infos = list(recording.topics.values())
        if arguments.json:
            output.print_json(_facts(recording, infos, with_bytes=arguments.bytes))
        else:
            _print(recording, infos, with_bytes=arguments.bytes)
        return reading.code(recording)


def _facts(recording: Recording, infos: list[TopicInfo], *, with_bytes: bool) -> dict[str, Any]:
    return {
        "path": str(recording.path),
        "files": [{"path": str(path), "bytes": path.stat().st_size} for path in recording.segments],
        "start": recording.start,
        "end": recording.end,
        "duration": recording.duration,
        "run": recording.run,
        "runs": [_run(run) for run in recording.runs],
        "params": recording.params,
        "topics": [topic(info, with_bytes=with_bytes) for info in infos],
    }


def _run(run: RunInfo) -> dict[str, Any]:
    return {
        "index": run.index,
        "id": run.id,
        "status": run.status,
        "start": run.start,
        "end": run.end,
        "files": [str(path) for path in run.segments],
        "counts": dict(run.counts),
        "metadata": dict(run.metadata),
    }


def topic(info: TopicInfo, *, with_bytes: bool = False) -> dict[str, Any]:
    """Return the facts of a topic."""
    return {
        "name": info.name,
        "kind": info.kind,
        "count": info.count,
        "start": info.start,
        "end": info.end,
        "rate": info.rate,
        "encoding": info.encoding,
        "schema_name": info.schema_name,
        "exact_fields": info.exact_fields,
        "fields": {name: str(field) for name, field in info.fields.items()},
        "description": info.description,
        "tags": info.tags,
        "metadata": info.metadata,
        **({"bytes": info.bytes} if with_bytes else {}),
    }


def _print(recording: Recording, infos: list[TopicInfo], *, with_bytes: bool) -> None:
    sizes = [path.stat().st_size for path in recording.segments]
    print(recording.path)
    print(f"{len(sizes)} file{'s' * (len(sizes) != 1)}, {times.show_size(sum(sizes))}")
    if recording.start is not None:
        print(
            f"{times.show(recording.start)} to {times.show(recording.end)}, {times.show_duration(recording.duration)}"
        )
    if "status" in recording.run:
        print(f"status: {run_status(recording)}")
    for name, value in recording.params.items():
        print(f"{name} = {value}")
    print()
    headings = ["topic", "rows", "rate", *(["bytes"] if with_bytes else []), "fields"]
    rows = [
        [
            info.name,
            str(info.count),
            f"{info.rate:.4g} Hz",
            *([times.show_size(info.bytes)] if with_bytes else []),
            ", ".join(f"{name} {field}" for name, field in info.fields.items()) or info.encoding,
        ]
        for info in infos
    ]
    output.print_table(headings, rows, right=("rows", "rate", "bytes"))
    _print_runs(recording.runs)


def _print_runs(runs: list[RunInfo]) -> None:
    """Print the runs, if there are several."""
    if len(runs) < 2:
        return
    print()
    rows = [
        [str(run.index), run.id, run.status, _shown(run.start), _shown(run.end), str(sum(run.counts.values()))]
        for run in runs
    ]
    output.print_table(["run", "id", "status", "start", "end", "rows"], rows, right=("run", "rows"))


def _shown(time: float | None) -> str:
    return "" if time is None else times.show(time)
