"""Reads one SQLite file of a rosbag2 folder: versions 1 to 4 of its schema."""

from __future__ import annotations

import errno
import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....codecs.ros_channel import DIGEST_KEYS
from ....errors import DamagedFileError, MissingRecordingError, StorageError
from ....mcap.message import Connection, MessageBlock, Payload
from ..bag_contents import unpacked
from ..bag_metadata.qos_profiles import OFFERED
from . import layout, stored_rows
from .stored_rows import Row

_BESIDE = ("-wal", "-journal")
"""Suffixes of the files that SQLite leaves when a process dies: rows that are not in the file yet, or that must be
undone."""

_BLOCK_BYTES = 1 << 20
_BLOCK_MESSAGES = 8192


class SqliteBag:
    """An opened file. What a crash left beside it is taken in, in a copy: the bag stays as it is."""

    def __init__(
        self, path: Path, *, is_packed: bool = False, salvages: bool = False, shown: Path | None = None
    ) -> None:
        """Open a file.

        Args:
            path: Of the file.
            is_packed: Whether each message is compressed by zstd.
            salvages: Whether to leave out what cannot be read on, and note it in `losses`.
            shown: What to call the file in errors; None for `path`.

        Raises:
            DamagedFileError: It is no SQLite file, is cut, or has not the tables of a bag.
            StorageError: It is not there, or cannot be opened.
        """
        _check_is_readable(path)
        self.name = path.name
        self.losses: list[str] = []
        self.corrections: list[str] = []
        self._path = shown or path
        self._is_packed = is_packed
        self._salvages = salvages
        self._numbers: dict[Any, int] = {}
        """Numbers of the channels, by what the file has as the ids of their topics."""
        self._left_out: set[Any] = set()
        """Ids of topics that are damaged, which `losses` name."""
        self._are_ids = True
        """Whether the ids are those numbers, as in most files."""
        self._copy: tempfile.TemporaryDirectory[str] | None = None
        left = [beside for end in _BESIDE if (beside := Path(f"{path}{end}")).is_file() and beside.stat().st_size]
        if left:
            self._copy = tempfile.TemporaryDirectory(prefix="ml_dash_mcap-")
            # SQLite replays what a crash left as soon as it opens the file, and writes while it does; so it gets a
            # copy.
            for file in (path, *left):
                shutil.copyfile(file, Path(self._copy.name) / file.name)
            self._base = sqlite3.connect(Path(self._copy.name) / path.name)
        else:
            # `immutable` also keeps SQLite from locks and files beside the bag, so that bags on read-only media open.
            self._base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        self._base.text_factory = _text
        try:
            self._tables = {name for (name,) in self._ask(layout.SELECT_TABLES)}
            self._channels = self._read_channels()
            self._are_ids = all(type(topic) is int and topic == number for topic, number in self._numbers.items())
            self.count = self._count()
        except BaseException:
            self.close()
            raise

    @property
    def channels(self) -> Mapping[int, Connection]:
        """All channels by their numbers: from 1 on, in the order of the ids of their topics."""
        return self._channels

    @property
    def distro(self) -> str:
        """The distribution that wrote the file; empty before version 3 of the schema."""
        return self._last(layout.SCHEMA, layout.SELECT_DISTRO)

    @property
    def information(self) -> str:
        """The file's own copy of `metadata.yaml`; empty before version 4 of the schema."""
        return self._last(layout.METADATA, layout.SELECT_METADATA)

    def blocks(self, wanted: Collection[int]) -> Iterator[MessageBlock]:
        """Yield the messages of some channels, in the order in which they were written.

        Raises:
            DamagedFileError: The file is damaged further on.
        """
        numbers: list[int] = []
        times: list[int] = []
        payloads: list[Payload] = []
        size = 0
        for rows in stored_rows.rows(self._base, self._path, self.losses if self._salvages else None):
            more_numbers, more_times, more_payloads = self._columns(rows, wanted)
            numbers.extend(more_numbers)
            times.extend(more_times)
            payloads.extend(more_payloads)
            size += sum(map(len, more_payloads))
            if size >= _BLOCK_BYTES or len(numbers) >= _BLOCK_MESSAGES:
                yield self._block(numbers, times, payloads)
                numbers, times, payloads, size = [], [], [], 0
        if numbers:
            yield self._block(numbers, times, payloads)

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._base.close()
        if self._copy is not None:
            self._copy.cleanup()
            self._copy = None

    def _columns(self, rows: list[Row], wanted: Collection[int]) -> tuple[Sequence[Any], ...]:
        """Return the channels, times and contents of some rows, of those channels that are wanted."""
        topics, times, payloads = zip(*rows, strict=True)
        # SQLite stores any type in any column. Sets of types check a whole list with few steps of Python.
        is_sound = {*map(type, payloads)} == {bytes} and {*map(type, times)} == {int} and min(times) >= 0
        present = {*topics}
        if not is_sound or not self._numbers.keys() >= present:
            return self._columns_but_bad(rows, wanted)
        numbers = topics if self._are_ids else tuple(map(self._numbers.__getitem__, topics))
        if {self._numbers[topic] for topic in present} <= {*wanted}:
            return numbers, times, payloads
        chosen = [row for row in zip(numbers, times, payloads, strict=True) if row[0] in wanted]
        return tuple(zip(*chosen, strict=True)) if chosen else ((), (), ())

    def _columns_but_bad(self, rows: list[Row], wanted: Collection[int]) -> tuple[Sequence[Any], ...]:
        """Return what `_columns` does without the rows that are damaged, or raise where that was not wanted."""
        good: list[Row] = []
        faults: list[str] = []
        for row in rows:
            if row[0] in self._left_out:
                continue
            fault = self._fault(row)
            if fault:
                faults.append(fault)
            else:
                good.append(row)
        if faults and not self._salvages:
            raise DamagedFileError(self._path, 0, faults[0])
        if faults:
            more = f"; {len(faults)} such in all" if len(faults) > 1 else ""
            self.losses.append(f"{self._path}: {faults[0]}{more}")
        return self._columns(good, wanted) if good else ((), (), ())

    def _fault(self, row: Row) -> str:
        """Say what is wrong with a row; nothing if it is sound."""
        topic, time_ns, payload = row
        if topic not in self._numbers:
            return f"a message is on topic {topic!r}, which is not in the table"
        if type(payload) is not bytes or type(time_ns) is not int or time_ns < 0:
            return f"the message of topic {topic!r} at time {time_ns!r} is no bytes at a time of 0 or later"
        return ""

    def _block(self, numbers: list[int], times: list[int], payloads: list[Payload]) -> MessageBlock:
        times_ns = np.array(times, np.uint64)
        sequences = np.zeros(len(times), np.uint32)
        block = MessageBlock(np.array(numbers, np.int64), times_ns, times_ns, sequences, payloads)
        return unpacked(block, self._path, self.losses if self._salvages else None) if self._is_packed else block

    def _read_channels(self) -> dict[int, Connection]:
        if not self._tables >= layout.LEAST_TABLES:
            raise DamagedFileError(self._path, 0, "this SQLite file is no bag: it has no tables of topics and messages")
        defined: dict[str, tuple[str, str]] = {}
        if layout.DEFINITIONS in self._tables:
            rows = self._ask(layout.SELECT_DEFINITIONS)
            defined = {_as_text(type_): (_as_text(encoding), _as_text(text)) for type_, encoding, text in rows}
        columns = {row[1] for row in self._ask(layout.SELECT_TOPIC_COLUMNS)}
        topics = self._ask(layout.select_topics(columns))
        channels: dict[int, Connection] = {}
        for topic, *row in topics:
            fault = self._topic_fault(topic, *row[:2])
            if fault and not self._salvages:
                raise DamagedFileError(self._path, 0, fault)
            if fault:
                self.losses.append(f"{self._path}: {fault}")
                self._left_out |= {topic} - self._numbers.keys()
            else:
                number = self._numbers[topic] = len(channels) + 1
                channels[number] = _channel(defined, *row)
        return channels

    def _topic_fault(self, topic: Any, name: Any, type_: Any) -> str:
        """Say what is wrong with a row of the table of topics; nothing if it is sound."""
        if not isinstance(name, str) or not isinstance(type_, str):
            return (
                f"the topic with the id {topic!r} has the name {name!r} and the type {type_!r}, which are not both text"
            )
        return f"two topics have the id {topic!r}; the second is {name!r}" if topic in self._numbers else ""

    def _count(self) -> int:
        """Return how many messages there are; where that is damaged, how many can be read."""
        try:
            (counted,) = self._ask(layout.COUNT_MESSAGES)[0]
        except DamagedFileError:
            if not self._salvages:
                raise
            return stored_rows.count(self._base)
        return int(counted)

    def _last(self, table: str, question: str) -> str:
        """Return the text in the last row of a table; empty without one."""
        if table not in self._tables:
            return ""
        rows = self._ask(question)
        return _as_text(rows[-1][0]) if rows else ""

    def _ask(self, question: str) -> list[Any]:
        try:
            return self._base.execute(question).fetchall()
        except stored_rows.ERRORS as error:
            raise DamagedFileError(self._path, 0, f"this SQLite bag cannot be read: {error}") from error


def _check_is_readable(path: Path) -> None:
    """Raise the system's error for a file that cannot be opened; SQLite's error does not have it."""
    try:
        path.open("rb").close()
    except FileNotFoundError as error:
        raise MissingRecordingError(errno.ENOENT, "a file of the bag is missing", str(path)) from error
    except OSError as error:
        raise StorageError(error.errno, f"cannot be read: {error.strerror}", str(path)) from error


def _text(data: bytes) -> str:
    """Definitions may have comments in any encoding."""
    return data.decode("utf-8", "replace")


def _as_text(value: Any) -> str:
    """Return what a column of text has, which may be nothing, a number or bytes in a file that others wrote."""
    return _text(value) if isinstance(value, bytes) else str(value or "")


def _channel(
    defined: Mapping[str, tuple[str, str]], topic: str, type_: str, format_: Any, qos: Any, digest: Any
) -> Connection:
    encoding, text = defined.get(type_, ("", ""))
    is_known = encoding in ("ros2msg", "ros2idl")  # a type without fields has an empty text
    metadata = {OFFERED: _as_text(qos)}
    if digest:
        metadata[DIGEST_KEYS[False]] = _as_text(digest)
    return Connection(
        topic,
        type_,
        encoding if is_known else "",
        text.encode() if is_known else b"",
        _as_text(format_),
        tuple(metadata.items()),
    )
