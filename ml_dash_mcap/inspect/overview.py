"""Sums up a recording in a line of text, and as a table in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape

from ..errors import RecorderError
from .topics import TopicInfo

_NAMED = 8
_FIELDS = 12


def line(name: str, files: int, duration_s: float, topics: Mapping[str, Callable[[], int]]) -> str:
    """Return a recording in one line: its name, files, duration, and topics with their rows.

    Args:
        name: Of the recording, as it was opened.
        files: How many there are.
        duration_s: From the first message to the last, in s.
        topics: By name, a function that counts the rows; only the first few are called.
    """
    named = [f"{topic} ({_counted(count)})" for topic, count in list(topics.items())[:_NAMED]]
    more = [f"and {len(topics) - _NAMED} more"] if len(topics) > _NAMED else []
    listed = f": {', '.join([*named, *more])}" if topics else ""
    figures = f"{_number(files, 'file')}, {duration_s:.6g} s, {_number(len(topics), 'topic')}{listed}"
    return f"<Recording {name!r}: {figures}>"


def table(title: str, topics: Mapping[str, TopicInfo]) -> str:
    """Return a table of topics as HTML; every text in it is escaped."""
    heads = "".join(f"<th>{head}</th>" for head in ("topic", "rows", "rate (Hz)", "start (s)", "end (s)", "fields"))
    cells = ("".join(f"<td>{escape(cell)}</td>" for cell in _cells(topics, name)) for name in topics)
    rows = "".join(f"<tr>{row}</tr>" for row in cells)
    return f"<table><caption>{escape(title)}</caption><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"


def _cells(topics: Mapping[str, TopicInfo], name: str) -> list[str]:
    try:
        topic = topics[name]
    except RecorderError as error:  # reading the rows raises this again
        return [name, "?", "", "", "", str(error)]
    fields = [f"{field} {values}" for field, values in topic.fields.items()]
    listed = ", ".join(fields[:_FIELDS]) + (f", and {len(fields) - _FIELDS} more" if len(fields) > _FIELDS else "")
    times = ["" if time is None else repr(time) for time in (topic.start, topic.end)]
    return [name, str(topic.count), f"{topic.rate:.6g}" if topic.rate else "", *times, listed]


def _counted(count: Callable[[], int]) -> str:
    try:
        return str(count())
    except RecorderError:
        return "?"


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
