"""Writes one SQLite file of a rosbag2 folder, a few thousand messages at a time."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ....errors import ConversionError
from ....mcap.message import MessageBlock
from ..bag_plan import Outlet
from ..rows_out import Sent
from . import layout


class SqliteBagWriter:
    """A file that takes messages until it is finished."""

    room = 0
    """Bytes that each message needs before it."""

    def __init__(
        self, path: Path, outlets: Sequence[Outlet], qos: Callable[[Outlet], str], distro: str, version: int
    ) -> None:
        """Begin a file.

        Args:
            path: Of the file.
            outlets: All topics.
            qos: What a topic was offered with, as YAML.
            distro: Of ROS 2.
            version: Of the metadata.

        Raises:
            ConversionError: Two topics have different definitions of one type.
        """
        _check_types(outlets)
        self._version = version
        self._base = sqlite3.connect(path, isolation_level=None)
        # The file gets its name when it is whole, so nothing has to be undone in it.
        self._base.execute("PRAGMA journal_mode=OFF")
        self._base.execute("PRAGMA synchronous=OFF")
        self._base.executescript(layout.CREATE_TABLES)
        self._base.execute("BEGIN")
        self._base.execute(layout.INSERT_SCHEMA, (layout.SCHEMA_VERSION, distro))
        topics = [(outlet.number, outlet.topic, outlet.type, qos(outlet), outlet.digest) for outlet in outlets]
        self._base.executemany(layout.INSERT_TOPIC, topics)
        by_type = {outlet.type: outlet for outlet in outlets}
        types = [(type_, _encoding(outlet), outlet.text, outlet.digest) for type_, outlet in by_type.items()]
        self._base.executemany(layout.INSERT_DEFINITION, [row for row in types if row[1]])
        self.size = 0
        """Bytes of messages so far."""
        self.counts: dict[int, int] = {}
        self.start_ns = 0
        self.end_ns = 0

    def write(self, sent: Sequence[Sent]) -> None:
        """Write messages, by time."""
        rows = [
            (time, messages.outlet.number, data)
            for messages in sent
            for time, data in zip(messages.times_ns.tolist(), messages.packed.messages(), strict=True)
        ]
        if not rows:
            return
        if len(sent) > 1:
            rows.sort(key=lambda row: row[:2])
        self._base.executemany(layout.INSERT_MESSAGE, rows)
        self.start_ns = min(self.start_ns, rows[0][0]) if self.counts else rows[0][0]
        self.end_ns = max(self.end_ns, rows[-1][0])
        for messages in sent:
            self.counts[messages.outlet.number] = self.counts.get(messages.outlet.number, 0) + len(messages.times_ns)
            self.size += len(messages.packed.data)

    def pack(self, block: MessageBlock) -> MessageBlock:
        """Return messages that are carried: there is nothing to prepare."""
        return block

    def write_packed(self, block: MessageBlock) -> None:
        """Write messages that are carried, in their order."""
        rows = zip(block.times_ns.tolist(), block.channels.tolist(), block.payloads, strict=True)
        try:
            self._base.executemany(layout.INSERT_MESSAGE, rows)
        except OverflowError as error:
            raise ConversionError("SQLite has no room for times after the year 2262; pass storage='mcap'") from error
        first, last = int(block.times_ns.min()), int(block.times_ns.max())
        self.start_ns = min(self.start_ns, first) if self.counts else first
        self.end_ns = max(self.end_ns, last)
        for number, count in zip(*np.unique(block.channels, return_counts=True), strict=True):
            self.counts[int(number)] = self.counts.get(int(number), 0) + int(count)
        self.size += block.size

    def finish(self, information: str) -> None:
        """Write the file's end.

        Args:
            information: The metadata of the file, as YAML.
        """
        self._base.execute(layout.INSERT_METADATA, (self._version, information))
        # Made at the end, once, instead of being kept up to date at each row.
        self._base.execute(layout.CREATE_INDEX)
        self._base.execute("COMMIT")
        self.close()

    def close(self) -> None:
        """Close the file, finished or not. May be called twice."""
        self._base.close()


def _check_types(outlets: Sequence[Outlet]) -> None:
    """Refuse two definitions of one type: the schema has one a name, by which messages of the other would be read."""
    first: dict[str, Outlet] = {}
    for outlet in outlets:
        if not _encoding(outlet):
            continue
        other = first.setdefault(outlet.type, outlet)
        if not _is_same(outlet, other):
            where = (
                f"topic {outlet.topic!r} has"
                if outlet.topic == other.topic
                else f"{other.topic!r} and {outlet.topic!r} have"
            )
            raise ConversionError(
                f"{where} two definitions of the type {outlet.type!r}, and SQLite keeps one a type; pass "
                "storage='mcap', which keeps both"
            )


def _is_same(outlet: Outlet, other: Outlet) -> bool:
    """Whether two outlets of one type say the same of it, but for comments, which no hash counts either."""
    if outlet.digest and outlet.digest == other.digest:
        return True
    return _encoding(outlet) == _encoding(other) and _lines(outlet) == _lines(other)


def _lines(outlet: Outlet) -> list[list[str]]:
    if _encoding(outlet) != "ros2msg":
        return [[outlet.text]]
    return [words for line in outlet.text.splitlines() if (words := line.partition("#")[0].split())]


def _encoding(outlet: Outlet) -> str:
    """Return the language of a type's definition; empty for a type without a definition."""
    return "ros2msg" if outlet.carried is None else outlet.carried.schema_encoding
