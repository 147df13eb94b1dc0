"""Reads files of JSON lines: our own as the rows that they were, those of others row by row."""

from __future__ import annotations

import codecs
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pyarrow as pa

from ....capture.topic_registry import TopicAbout
from ....errors import ConversionWarning, ForeignFileError, UsageError
from ....file_names import MESSAGE
from ....recorder import Recorder, open_topic
from ....rows.dotted import FIELD_PREFIX
from ....rows.json_text import restore
from ....rows.plain_row import EXACT_KEY, TIME_KEY
from ....topic import Topic
from ...registry import Progress
from .. import table_files, table_times
from ..our_tables import put
from ..row_entries import TIME_NAME
from ..table_intake import TableProgress
from ..table_options import TableReadOptions

_BATCH_BYTES = 1 << 20
_LONGEST_BYTES = 1 << 28
_ROW_BYTES = 100
_SAMPLE = 1000


def record(src: Path, recorder: Recorder, options: TableReadOptions, progress: Progress | None) -> None:
    """Append files of JSON lines, one topic a file and one object a row.

    Dotted names are those of nested dicts if the first key is `_ts`, as in files of `export(format="jsonl")`, or
    `timestamp`, as in those of earlier versions and in what `read(format="jsonl")` of a track returns. The side
    key `_exact` then says which nulls were NaN and which text was bytes.

    Args:
        src: A file, or a folder of such.
        recorder: Where to.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: A line is no JSON object, or has no time; says which.
        NotFoundError: There is no such `time_column`.
    """
    files = table_files.of(src)
    if options.topic is not None and len(files) > 1:
        raise UsageError(f"{src}: topic={options.topic!r} names one topic, but there are {len(files)} files")
    total = sum(path.stat().st_size // _ROW_BYTES for path in files)
    counter = TableProgress(progress, total)
    for path in files:
        _LinesFile(path, recorder, options).run(counter)
    counter.finish()


class _LinesFile:
    """One file and the topic that it becomes."""

    def __init__(self, path: Path, recorder: Recorder, options: TableReadOptions) -> None:
        self._path, self._recorder, self._options = path, recorder, options
        self._own_time: str | None = None
        """The key of the time stamp in a file of ours; None for those of others."""
        self._left_out = 0

    def run(self, counter: TableProgress) -> None:
        """Append its rows."""
        sample: list[tuple[int, dict[str, Any]]] = []
        topic: Topic | None = None
        waiting = sample
        size = 0
        for line, text in self._lines():
            row = self._row(line, text)
            if row is None:
                continue
            if not waiting and topic is None:
                self._own_time = _own_time(text)
            waiting.append((line, row))
            size += len(text)
            if size >= _BATCH_BYTES or (topic is None and len(waiting) >= _SAMPLE):
                topic = topic or self._open([row for _, row in waiting])
                self._append(topic, waiting)
                counter.add(len(waiting))
                waiting, size = [], 0
        if topic is None and not waiting:
            problem = f"{self._path}: the file has no rows, so there is no topic of it"
            warnings.warn(problem, ConversionWarning, stacklevel=4)
        else:
            topic = topic or self._open([row for _, row in waiting])
            self._append(topic, waiting)
            counter.add(len(waiting))
        if self._left_out:
            warnings.warn(
                f"{self._path}: {self._left_out} lines without a row or a time were left out",
                ConversionWarning,
                stacklevel=4,
            )

    def _lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield the lines that are not blank, each with its number."""
        with self._path.open("rb") as file:
            number = 0
            while text := file.readline(_LONGEST_BYTES):
                number += 1
                if len(text) >= _LONGEST_BYTES:
                    raise ForeignFileError(self._path, f"the line has more than {_LONGEST_BYTES} bytes", number)
                text = text.removeprefix(codecs.BOM_UTF8).strip() if number == 1 else text.strip()
                if text:
                    yield number, text

    def _row(self, line: int, text: bytes) -> dict[str, Any] | None:
        """Return the row of a line; None for a line that is no JSON object, where such lines are left out."""
        try:
            row = _loads(text)
            problem = f"the line is {text[:40].decode('utf-8', 'replace')!r}, which is no JSON object"
        except ValueError as error:
            row, problem = None, f"the line is no JSON: {error}"
        if isinstance(row, dict):
            return row
        if self._options.on_bad == "raise":
            raise ForeignFileError(
                self._path, f"{problem}; pass on_bad='missing' to convert() to leave such lines out", line
            )
        self._left_out += 1
        return None

    def _open(self, sample: list[dict[str, Any]]) -> Topic:
        options = self._options
        if self._own_time == TIME_NAME and any(row.get(TIME_KEY) is not None for row in sample):
            self._own_time = TIME_KEY  # releases that wrote `timestamp` wrote no `_ts`: `timestamp` is a field here
        has_dicts = any(
            isinstance(value, dict) and value for row in sample for key, value in row.items() if key != EXACT_KEY
        )
        if has_dicts or options.time_column not in (None, self._own_time):
            self._own_time = None
        is_ours = self._own_time is not None
        self._time = table_times.find(
            self._path,
            _schema(sample),
            lambda name: _range(sample, name),
            time_column=options.time_column or self._own_time,
            time_unit=options.time_unit or ("s" if is_ours else None),
            units={},
        )
        name = table_files.topic_name(self._path, is_ours=is_ours)
        metadata = None if is_ours else {"source": self._path.name, "time_column": self._time.name}
        return open_topic(self._recorder, options.topic or name, MESSAGE, Topic, TopicAbout(metadata=metadata))

    def _append(self, topic: Topic, numbered: list[tuple[int, dict[str, Any]]]) -> None:
        rows = [row for _, row in numbered]
        times = self._seconds([row.get(self._time.name) for row in rows]) + self._options.start
        good = table_times.are_times(times)
        if not good.all() and self._options.on_bad == "raise":
            at = int((~good).argmax())
            value = rows[at].get(self._time.name)
            hint = table_times.hint(float(times[at]))
            problem = f"the time is {value!r} under the key {self._time.name!r}, which is no time stamp; {hint}"
            raise ForeignFileError(self._path, problem, numbered[at][0])
        self._left_out += int((~good).sum())
        keeps = not (self._time.unit == "s" and self._time.is_number)
        made = [
            {**self._fields(row, keeps), TIME_KEY: time}
            for row, time, is_good in zip(rows, times.tolist(), good.tolist(), strict=True)
            if is_good
        ]
        if made:
            topic.append_batch(made)

    def _fields(self, row: dict[str, Any], keeps: bool) -> dict[str, Any]:
        """Return a row's fields, without its time where `_ts` says the same."""
        if not keeps:
            row = {name: value for name, value in row.items() if name != self._time.name}
        if self._own_time is not None:
            row = restore(row)
            # A `_ts` may come first behind the rows that were looked at.
            late = row.pop(TIME_KEY, None) if self._own_time == TIME_NAME else None
            nested = _nested(row, self._own_time)
            return nested if late is None else {**nested, FIELD_PREFIX + TIME_KEY: late}
        if TIME_KEY in row or EXACT_KEY in row:
            return {
                FIELD_PREFIX + name if name in (TIME_KEY, EXACT_KEY) else name: value for name, value in row.items()
            }
        return row

    def _seconds(self, values: list[Any]) -> table_times.Floats:
        if self._time.is_number:
            by = table_times.UNITS[self._time.unit]
            return np.array([value / by if type(value) in (int, float) else np.nan for value in values])
        texts = pa.array([value if isinstance(value, str) else None for value in values], pa.string())
        return table_times.seconds(self._path, texts, self._time)


def _own_time(text: bytes) -> str | None:
    """Return the first key of a file's first line, if it is spelt as `formats.tables.jsonl.text` does."""
    for name in (TIME_KEY, TIME_NAME):
        start = b'{"%b":' % name.encode()
        if text.startswith(start) and text[len(start) : len(start) + 1].isdigit():
            return name
    return None


def _loads(text: bytes) -> Any:
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:  # orjson refuses NaN and Infinity, and Python reads them
        return json.loads(text)


def _schema(sample: list[dict[str, Any]]) -> pa.Schema:
    """Return a schema with the types of the keys that may be the time; all others are null."""
    kinds: dict[str, set[type]] = {}
    for row in sample:
        for name, value in row.items():
            kinds.setdefault(name, set()).add(type(value))
    return pa.schema([(name, _type(value_types - {type(None)})) for name, value_types in kinds.items()])


def _type(kinds: set[type]) -> pa.DataType:
    if kinds == {int}:
        return pa.int64()
    if kinds and kinds <= {int, float}:
        return pa.float64()
    return pa.string() if kinds == {str} else pa.null()


def _range(sample: list[dict[str, Any]], name: str) -> tuple[Any, Any]:
    values = [row[name] for row in sample if type(row.get(name)) in (int, float)]
    return (min(values), max(values)) if values else (None, None)


def _nested(row: dict[str, Any], time_name: str) -> dict[str, Any]:
    """Return a row whose dotted names are dicts again, and whose field of the name of the time has it again."""
    nested: dict[str, Any] = {}
    for name, value in row.items():
        plain = name.removeprefix(FIELD_PREFIX)
        if name.startswith(FIELD_PREFIX) and plain == time_name:
            nested[plain] = value
            continue
        parts = tuple(name.split("."))
        put(nested, parts if all(parts) else (name,), value)
    return nested
