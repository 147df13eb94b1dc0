"""One SQLite file of a rosbag2 folder: versions 1 to 4 of its schema."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from ..errors import DamagedFileError
from .bag_messages import Batch, Channel, Collector

MAGIC = b"SQLite format 3\0"


class SqliteBag:
    """An opened file."""

    def __init__(self, path: Path, unpack: Callable[[bytes], bytes] | None = None) -> None:
        """Open a file.

        Args:
            path: Of the file.
            unpack: Decompresses a message, where each is compressed.

        Raises:
            DamagedFileError: It is no SQLite file, is cut, or has not the tables of a bag.
        """
        self._path = path
        self._unpack = unpack
        self.custom: Mapping[str, str] = {}
        self.losses: list[str] = []
        self._base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            self._channels = self._read_channels()
            (self.count,) = self._ask("SELECT COUNT(*) FROM messages")[0]
        except BaseException:
            self._base.close()
            raise

    @property
    def channels(self) -> list[Channel]:
        """All channels."""
        return list(self._channels.values())

    def batches(self, wanted: Collection[Channel]) -> Iterator[Batch]:
        """Yield the messages of some channels, each channel's by time.

        Raises:
            DamagedFileError: The file is damaged further on.
        """
        collector = Collector()
        cursor = self._base.cursor()
        try:
            for number, time_ns, data in cursor.execute(
                "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"
            ):
                channel = self._channels.get(number)
                if channel is None:
                    raise DamagedFileError(self._path, 0, f"a message is on topic {number}, which is not in the table")
                if channel not in wanted:
                    continue
                payload = data if self._unpack is None else self._unpack(data)
                yield from collector.add(number, channel, time_ns, payload)
        except sqlite3.Error as error:
            raise DamagedFileError(self._path, 0, f"this SQLite bag cannot be read on: {error}") from error
        yield from collector.rest()

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._base.close()

    def _read_channels(self) -> dict[int, Channel]:
        tables = {name for (name,) in self._ask("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= tables:
            raise DamagedFileError(self._path, 0, "this SQLite file is no bag: it has no tables of topics and messages")
        defined: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            said = self._ask("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            defined = {type_: (encoding, text) for type_, encoding, text in said}
        topics = self._ask("SELECT id, name, type, serialization_format FROM topics")
        return {number: _channel(topic, type_, format_, defined) for number, topic, type_, format_ in topics}

    def _ask(self, question: str) -> list[Any]:
        try:
            return self._base.execute(question).fetchall()
        except sqlite3.Error as error:
            raise DamagedFileError(self._path, 0, f"this SQLite bag cannot be read: {error}") from error


def _channel(topic: str, type_: str, format_: str, defined: Mapping[str, tuple[str, str]]) -> Channel:
    encoding, text = defined.get(type_, ("", ""))
    known = encoding if encoding in ("ros2msg", "ros2idl") and text else ""
    return Channel(topic, type_, known, text if known else "", is_ros1=format_ == "ros1")
