"""Writes topics as Parquet files: typed, compressed, in time order, with the topic's description in the metadata."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ....inspect import run_metadata, topics
from ....inspect.topics import TopicInfo
from ....query.file import File
from ....query.topic_part import TopicPart
from ....rows.table import Block
from ... import per_topic
from ...export_job import Job, RowCounter
from .. import write_passes
from ..table_about import ABOUT_KEY, TableAbout
from ..table_options import ParquetWriteOptions
from .layout import ParquetLayout

SUFFIX = ".parquet"

_GROUP_ROWS = 131072
_GROUP_BYTES = 64 * 2**20
"""A row group of larger values has fewer rows."""


def export(job: Job, options: ParquetWriteOptions) -> Path:
    """Write one Parquet file a topic: zstd, row groups of 131,072 rows in time order.

    The first column is `_ts`, the exact time stamp in s; the second one the same as `timestamp` (an instant in UTC) if
    the clock shows wall-clock time, else as `timestamp_ns` (an integer). Vectors and matrices of one shape are lists
    of fixed size, the matrices row by row, with their shape in the field's metadata; where rows are without one they
    are lists of variable size, which all readers know nulls of. Nested dicts are structs. What no one type holds is
    JSON text, and the field's metadata says so. Missing values are null.

    Args:
        job: What to export.
        options: How to write it.
    """

    def put(part: TopicPart, info: TopicInfo, path: Path, counter: RowCounter) -> None:
        _write(part, info, lambda: path, options, counter.add)

    return per_topic.write(job, SUFFIX, put)


def render(part: TopicPart) -> bytes:
    """Return the bytes of the file that `export` writes."""
    begun: list[pa.BufferOutputStream] = []

    def begin() -> pa.BufferOutputStream:
        begun.append(pa.BufferOutputStream())
        return begun[-1]

    _write(part, topics.info(part.stored), begin, ParquetWriteOptions(), lambda rows: None)
    data: bytes = begun[-1].getvalue().to_pybytes()
    return data


def _write(
    part: TopicPart,
    info: TopicInfo,
    target: Callable[[], Any],
    options: ParquetWriteOptions,
    count: Callable[[int], None],
) -> None:
    """Write a file.

    Args:
        part: The rows.
        info: Of the topic.
        target: Returns where to write it, anew for each pass over the rows.
        options: How to write it.
        count: Told how many rows more are done.
    """
    layout = ParquetLayout(info, part.columns, flat=options.flatten)
    metadata = {ABOUT_KEY: _about(part.stored.files, info, is_flat=options.flatten).to_json()}

    @contextlib.contextmanager
    def begin() -> Iterator[Callable[[Block], None]]:
        schema = layout.schema().with_metadata(metadata)
        # The sorting column tells readers that row groups are in time order.
        how: dict[str, Any] = {"use_dictionary": _texts(schema), "sorting_columns": [pq.SortingColumn(0)]}
        with pq.ParquetWriter(target(), schema, compression="zstd", write_page_checksum=True, **how) as writer:
            groups = _Groups(writer)
            table = layout.tables()
            yield lambda block: groups.add(table(block))
            groups.finish()

    write_passes.write(part.blocks, layout, begin, count)


class _Groups:
    """Puts small tables together into row groups."""

    def __init__(self, writer: pq.ParquetWriter) -> None:
        self._writer = writer
        self._waiting: list[pa.Table] = []
        self._rows = 0
        self._bytes = 0

    def add(self, table: pa.Table) -> None:
        # Blocks are much smaller than row groups, and small row groups cost readers and compress badly.
        room = _GROUP_ROWS - self._rows
        while table.num_rows >= room:
            self._take(table.slice(0, room))
            self.finish()
            table, room = table.slice(room), _GROUP_ROWS
        if table.num_rows:
            self._take(table)
        if self._bytes >= _GROUP_BYTES:
            self.finish()

    def finish(self) -> None:
        """Write what waits."""
        if self._waiting:
            whole = pa.concat_tables(self._waiting)
            self._writer.write_table(whole, row_group_size=whole.num_rows)
        self._waiting, self._rows, self._bytes = [], 0, 0

    def _take(self, table: pa.Table) -> None:
        self._waiting.append(table)
        self._rows += table.num_rows
        self._bytes += table.nbytes


def _texts(fields: Iterable[pa.Field], parent: str = "") -> list[str]:
    """Return the paths of text columns; dictionaries of numbers would cost time and make files larger."""
    paths: list[str] = []
    for field in fields:
        path, type_ = parent + field.name, field.type
        while pa.types.is_list(type_):
            path, type_ = f"{path}.list.element", type_.value_type
        if pa.types.is_struct(type_):
            paths += _texts([type_.field(at) for at in range(type_.num_fields)], path + ".")
        elif pa.types.is_string(type_):
            paths.append(path)
    return paths


def _about(files: Sequence[File], info: TopicInfo, *, is_flat: bool) -> TableAbout:
    return TableAbout(
        topic=info.name,
        kind=info.kind,
        is_flat=is_flat,
        schema=info.schema,
        schema_name=info.schema_name,
        encoding=info.encoding,
        description=info.description,
        tags=info.tags,
        metadata=info.metadata,
        run={**run_metadata.run(files), "params": run_metadata.parameters(files)},
        source=_source(files[-1]) if files else {},
    )


def _source(file: File) -> dict[str, str]:
    """Return who recorded a file; nothing for a file of another program."""
    about = file.about()
    return {key: about[key] for key in ("prefix", "run", "host", "library") if key in about}
