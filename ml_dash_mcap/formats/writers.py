"""Writes recordings and topics in the formats of others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import FormatError
from ..inspect.topics import TopicInfo
from ..query.topic_part import TopicPart
from ..suggestions import did_you_mean
from . import registry
from .export_job import Job


def export(job: Job, format: str, options: Mapping[str, Any]) -> Path:
    """Write a recording in another format; returns where the result is.

    Raises:
        FormatError: There is no such format.
        UsageError: The format has no such option.
    """
    entry = registry.find(format, "write")
    if entry is None or entry.write is None:
        raise FormatError(f"export() knows no format {format!r}; {registry.hint(format, 'write')}")
    made = registry.make_options(entry.write_options, options, f"export(format={format!r})")
    result: Path = registry.load(entry.write)(job, made)
    return result


def options_of(format: str) -> list[str]:
    """Return the options that writing a format has; none if there is no such format."""
    entry = registry.find(format, "write")
    return [] if entry is None else registry.option_names(entry.write_options)


def stream(part: TopicPart, info: TopicInfo, out: BinaryIO, format: str) -> None:
    """Write rows to an open file or pipe.

    Raises:
        FormatError: There is no such format.
    """
    entry = registry.find(format, "stream")
    if entry is None or entry.stream is None:
        raise FormatError(f"write() knows no format {format!r}; {registry.hint(format, 'stream')}")
    registry.load(entry.stream)(part, info, out)


def render(part: TopicPart, format: str) -> Any:
    """Return rows as a value in a format.

    Raises:
        FormatError: There is no such format; the message says what writes it, if that is an export.
    """
    entry = registry.find(format, "render")
    if entry is None or entry.render is None:
        names = registry.names("render")
        written = f"; Recording.export(dest, format={format!r}) writes it" if registry.find(format, "write") else ""
        meant = "" if written else did_you_mean(format, names)
        raise FormatError(
            f"Unsupported format: {format}{written}{meant and f'; {meant}'}; read() takes {', '.join(names)}"
        )
    return registry.load(entry.render)(part)
