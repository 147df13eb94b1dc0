"""One SQLite file of a rosbag2 folder: versions 1 to 4 of its schema."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DamagedFileError
from ..messages import Channel, MessageBlock, Payload
from .bag_messages import unpacked

MAGIC = b"SQLite format 3\0"

_BESIDE = ("-wal", "-journal")
"""What SQLite leaves beside a file whose process died: rows that are not in it yet, or that have to be undone in it."""

_Row = tuple[int, int, bytes]

_AT_ONCE = 512
_BLOCK_BYTES = 1 << 20
_BLOCK_MESSAGES = 8192


class SqliteBag:
    """An opened file. What a crash left beside it is taken in, in a copy: the bag stays as it is."""

    def __init__(self, path: Path, *, is_packed: bool = False, salvages: bool = False) -> None:
        """Open a file.

        Args:
            path: Of the file.
            is_packed: Whether each message is compressed by zstd.
            salvages: Whether to leave out what cannot be read on, and note it in `losses`.

        Raises:
            DamagedFileError: It is no SQLite file, is cut, or has not the tables of a bag.
        """
        self.name = path.name
        self.losses: list[str] = []
        self._path = path
        self._is_packed = is_packed
        self._salvages = salvages
        self._copy: tempfile.TemporaryDirectory[str] | None = None
        left = [beside for end in _BESIDE if (beside := Path(f"{path}{end}")).is_file() and beside.stat().st_size]
        if left:
            self._copy = tempfile.TemporaryDirectory(prefix="ml_dash_mcap-")
            for one in (path, *left):
                shutil.copyfile(one, Path(self._copy.name) / one.name)
            self._base = sqlite3.connect(Path(self._copy.name) / path.name)
        else:
            self._base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        self._base.text_factory = _text
        try:
            self._tables = {name for (name,) in self._ask("SELECT name FROM sqlite_master WHERE type = 'table'")}
            self._channels = self._read_channels()
            (self.count,) = self._ask("SELECT COUNT(*) FROM messages")[0]
        except BaseException:
            self.close()
            raise

    @property
    def channels(self) -> Mapping[int, Channel]:
        """All channels by the ids of their topics."""
        return self._channels

    @property
    def distro(self) -> str:
        """The distribution that wrote the file; empty before version 3 of the schema."""
        return self._said("schema", "ros_distro")

    @property
    def information(self) -> str:
        """The file's own copy of `metadata.yaml`; empty before version 4 of the schema."""
        return self._said("metadata", "metadata")

    def blocks(self, wanted: Collection[int]) -> Iterator[MessageBlock]:
        """Yield the messages of some channels, in the order in which they were written.

        Raises:
            DamagedFileError: The file is damaged further on.
        """
        numbers: list[int] = []
        times: list[int] = []
        payloads: list[Payload] = []
        size = 0
        cursor = self._base.cursor()
        try:
            cursor.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
            while rows := cursor.fetchmany(_AT_ONCE):
                more_numbers, more_times, more_payloads = self._columns(rows, wanted)
                numbers.extend(more_numbers)
                times.extend(more_times)
                payloads.extend(more_payloads)
                size += sum(map(len, more_payloads))
                if size >= _BLOCK_BYTES or len(numbers) >= _BLOCK_MESSAGES:
                    yield self._block(numbers, times, payloads)
                    numbers, times, payloads, size = [], [], [], 0
        except (sqlite3.Error, DamagedFileError) as error:
            lost = self._broken("this SQLite bag cannot be read on", error)
            if not self._salvages:
                raise lost from error
            self.losses.append(str(lost))
        if numbers:
            yield self._block(numbers, times, payloads)

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._base.close()
        if self._copy is not None:
            self._copy.cleanup()
            self._copy = None

    def _columns(self, rows: list[_Row], wanted: Collection[int]) -> tuple[Sequence[Any], ...]:
        """Return the topics, times and contents of some rows, of those channels that are wanted."""
        numbers, times, payloads = zip(*rows, strict=True)
        if {*map(type, payloads)} != {bytes} or {*map(type, times)} != {int} or min(times) < 0:
            return self._columns_but_bad(rows, wanted)
        known = set(numbers)
        if not known <= self._channels.keys():
            stray = min(known - self._channels.keys())
            raise DamagedFileError(self._path, 0, f"a message is on topic {stray}, which is not in the table")
        if known <= set(wanted):
            return numbers, times, payloads
        chosen = [row for row in rows if row[0] in wanted]
        return tuple(zip(*chosen, strict=True)) if chosen else ((), (), ())

    def _columns_but_bad(self, rows: list[_Row], wanted: Collection[int]) -> tuple[Sequence[Any], ...]:
        good = [row for row in rows if type(row[2]) is bytes and type(row[1]) is int and row[1] >= 0]
        bad = next(row for row in rows if row not in good)
        what = f"the message of topic {bad[0]} at time {bad[1]!r} is no bytes at a time of 0 or later"
        if not self._salvages:
            raise DamagedFileError(self._path, 0, what)
        self.losses.append(
            f"{self._path}: {what}" + f"; {len(rows) - len(good)} such in all" * (len(good) + 1 < len(rows))
        )
        return self._columns(good, wanted) if good else ((), (), ())

    def _block(self, numbers: list[int], times: list[int], payloads: list[Payload]) -> MessageBlock:
        times_ns = np.array(times, np.uint64)
        sequences = np.zeros(len(times), np.uint32)
        block = MessageBlock(np.array(numbers, np.int64), times_ns, times_ns, sequences, payloads)
        return unpacked(block, self._path, self.losses if self._salvages else None) if self._is_packed else block

    def _read_channels(self) -> dict[int, Channel]:
        if not {"topics", "messages"} <= self._tables:
            raise DamagedFileError(self._path, 0, "this SQLite file is no bag: it has no tables of topics and messages")
        defined: dict[str, tuple[str, str]] = {}
        if "message_definitions" in self._tables:
            rows = self._ask("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            defined = {type_: (encoding, text) for type_, encoding, text in rows}
        columns = {row[1] for row in self._ask("PRAGMA table_info(topics)")}
        qos, digest = (name if name in columns else "''" for name in ("offered_qos_profiles", "type_description_hash"))
        topics = self._ask(f"SELECT id, name, type, serialization_format, {qos}, {digest} FROM topics ORDER BY id")
        return {number: _channel(defined, *row) for number, *row in topics}

    def _said(self, table: str, column: str) -> str:
        if table not in self._tables:
            return ""
        rows = self._ask(f"SELECT {column} FROM {table}")
        return str(rows[-1][0] or "") if rows else ""

    def _ask(self, question: str) -> list[Any]:
        try:
            return self._base.execute(question).fetchall()
        except sqlite3.Error as error:
            raise self._broken("this SQLite bag cannot be read", error) from error

    def _broken(self, what: str, error: Exception) -> DamagedFileError:
        return error if isinstance(error, DamagedFileError) else DamagedFileError(self._path, 0, f"{what}: {error}")


def _text(data: bytes) -> str:
    """Definitions may have comments in any encoding."""
    return data.decode("utf-8", "replace")


def _channel(
    defined: Mapping[str, tuple[str, str]], topic: str, type_: str, format_: str, qos: str | None, digest: str | None
) -> Channel:
    encoding, text = defined.get(type_, ("", ""))
    is_known = encoding in ("ros2msg", "ros2idl")  # a type without fields has an empty text
    metadata = {"offered_qos_profiles": qos or ""}
    if digest:
        metadata["topic_type_hash"] = digest
    return Channel(
        topic, type_, encoding if is_known else "", text.encode() if is_known else b"", format_, tuple(metadata.items())
    )
