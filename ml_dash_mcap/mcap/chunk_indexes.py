"""Reads the chunk indexes of a summary many at once: a long recording has thousands, and they hardly differ."""

from __future__ import annotations

import functools
from array import array
from collections.abc import Iterator, Sequence
from itertools import repeat
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from . import records
from .chunk_table import NUMBERS, Alike, ChunkTable
from .record_layout import PREFIX_BYTES, Fields, read_prefix, record_at
from .records import Chunk, Opcode

_MAP = "message_index_offsets"
_SHORTEST = records.CHUNK_INDEX.dtype(message_index_offsets=0, compression=0)
_MAP_BYTES_AT = _SHORTEST.fields[f"{_MAP}_bytes"][1] if _SHORTEST.fields else 0
"""Where in the record the length of the map of message indexes stands, in bytes."""
_PAIR_BYTES = 2 + 8
_WORTH_IT = 8
"""So many are worth to be read at once."""
_MOST_AT_ONCE = 4096
_WORTH_A_TABLE = 64
"""Fewer chunks are ready sooner one by one, which counts where a folder has a thousand files."""

Record = tuple[int, int, Fields]


class ChunkIndexes:
    """The chunk indexes of a summary: their places and their contents."""

    def __init__(self, path: str) -> None:
        """Begin with none; `path` is for error messages."""
        self._path = path
        self._runs: list[tuple[memoryview, int, array[int], array[int]]] = []

    def split(self, data: memoryview, start: int) -> Iterator[Record]:
        """Walk a summary's records like `split_records`, but keep the chunk indexes.

        Args:
            data: The records.
            start: Where in the file they do.

        Yields:
            Opcode, offset in the file, content, of all others.

        Raises:
            DamagedFileError: The records do not end where `data` ends.
        """
        places = array("q")
        sizes = array("q")
        self._runs.append((data, start, places, sizes))
        at, end, behind_prefix = 0, len(data), len(data) - PREFIX_BYTES
        last, same = b"", 0
        while at < end:
            head = bytes(data[at : at + PREFIX_BYTES])
            opcode, length = read_prefix(head, 0) if at <= behind_prefix else (0, end)
            size = PREFIX_BYTES + length
            if opcode != Opcode.CHUNK_INDEX or at + size > end:
                opcode, fields = record_at(data, at, self._path, start)
                yield opcode, start + at, fields
                at += size
                continue
            # Chunk indexes of one length stand at equal distances, so numpy finds a whole run of them at once. The
            # stretch that is compared grows with the run, so that short runs cost little.
            same = same + 1 if head == last else 1
            last = head
            count = 1 if same < _WORTH_IT else _repeats(data, at, size, min(same * _WORTH_IT, _MOST_AT_ONCE))
            places.extend(range(at, at + count * size, size))
            sizes.extend(repeat(size, count))
            same += count - 1
            at += count * size

    def chunks(self, data_end: int) -> Sequence[Chunk]:
        """Return the chunks, by where they lie: a table, or a list of them where they are few.

        The arguments and errors are those of `table`.
        """
        if sum(len(places) for _, _, places, _ in self._runs) >= _WORTH_A_TABLE:
            return self.table(data_end)
        chunks = [self._chunk_at(data, start, at, data_end) for data, start, places, _ in self._runs for at in places]
        return sorted(chunks, key=lambda chunk: chunk.offset)

    def table(self, data_end: int) -> ChunkTable:
        """Return the chunks as a table.

        Args:
            data_end: Where the file's data section ends, in bytes.

        Raises:
            DamagedFileError: A chunk index contradicts itself, or points where it cannot point to.
        """
        numbers = [np.zeros(len(places), NUMBERS) for _, _, places, _ in self._runs]
        alike: list[Alike] = []
        others: list[tuple[int, Chunk]] = []
        first = 0
        for (data, start, places, sizes), into in zip(self._runs, numbers, strict=True):
            ats = np.frombuffer(places, np.int64)
            left = np.ones(len(ats), np.bool_)
            for rows, form in _alike(data, ats, np.frombuffer(sizes, np.int64)):
                run = _read(data, form, ats[rows])
                good = _is_sound(run, data_end)
                compression = _compression(run, good)
                if compression is None:
                    continue
                if not good.all():
                    rows, run = rows[good], run[good]
                left[rows] = False
                for name in NUMBERS.names or ():
                    into[name][rows] = run[name]
                alike.append(Alike(first + rows, compression, run[_MAP]["key"], run[_MAP]["value"]))
            for row in np.flatnonzero(left).tolist():
                chunk = self._chunk_at(data, start, places[row], data_end)
                into[row] = tuple(getattr(chunk, name) for name in NUMBERS.names or ())
                others.append((first + row, chunk))
            first += len(ats)
        return ChunkTable(np.concatenate(numbers) if numbers else np.zeros(0, NUMBERS), alike, others)

    def _chunk_at(self, data: memoryview, start: int, at: int, data_end: int) -> Chunk:
        _, fields = record_at(data, at, self._path, start)
        chunk = records.CHUNK_INDEX.read(fields)
        check(chunk, self._path, start + at, data_end)
        return chunk


def check(chunk: Chunk, path: str, at: int, data_end: int) -> None:
    """Check where a chunk index points to, as `_is_sound` does.

    Args:
        chunk: The chunk index.
        path: The file, for error messages.
        at: Where in it the chunk index lies.
        data_end: Where the data section ends.

    Raises:
        DamagedFileError: It points outside the data section, or to message indexes that do not lie behind the chunk.
    """
    behind = chunk.indexes_end
    if not (len(records.MAGIC) <= chunk.offset and behind <= data_end):
        raise DamagedFileError(path, at, "a chunk index that points outside the data section")
    for offset in chunk.message_index_offsets.values():
        if not chunk.end <= offset <= behind - PREFIX_BYTES:
            raise DamagedFileError(path, at, "a chunk index whose message indexes do not lie behind the chunk")


def _alike(
    data: memoryview, ats: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]
) -> Iterator[tuple[npt.NDArray[np.intp], np.dtype[np.void]]]:
    """Yield which records have one form, where enough have, and that form."""
    long_enough = np.flatnonzero(sizes >= _SHORTEST.itemsize)
    if len(long_enough) < _WORTH_IT:
        return
    map_bytes = _strided(data, np.dtype("<u4"))[ats[long_enough] + _MAP_BYTES_AT].astype(np.int64)
    # Both lengths in one number, so that np.unique sees a plain array.
    forms, which, counts = np.unique(sizes[long_enough] << 32 | map_bytes, return_inverse=True, return_counts=True)
    by_form = np.split(np.argsort(which, kind="stable"), np.cumsum(counts)[:-1])
    for form, rows in zip(forms.tolist(), by_form, strict=True):
        size, maps = form >> 32, form & 0xFFFF_FFFF
        channels, rest = divmod(maps, _PAIR_BYTES)
        letters = size - _SHORTEST.itemsize - maps
        if len(rows) >= _WORTH_IT and not rest and letters >= 0:
            yield long_enough[rows], _form(channels, letters)


def _repeats(data: memoryview, at: int, size: int, most: int) -> int:
    """Return how often the prefix that stands at `at` stands every `size` bytes from there on, in whole records."""
    count = min((len(data) - at) // size, most)
    heads = np.ndarray((count, PREFIX_BYTES), np.uint8, data, at, (size, 1))
    differ = (heads != heads[0]).any(axis=1)
    return int(differ.argmax()) if differ.any() else count


@functools.lru_cache(maxsize=64)
def _form(channels: int, letters: int) -> np.dtype[np.void]:
    return records.CHUNK_INDEX.dtype(message_index_offsets=channels, compression=letters)


def _read(data: memoryview, form: np.dtype[np.void], ats: npt.NDArray[np.int64]) -> npt.NDArray[np.void]:
    """Return the records of a form that start at some places, which go up; without a copy if nothing lies between."""
    if ats[-1] - ats[0] == form.itemsize * (len(ats) - 1):
        return np.frombuffer(data, form, len(ats), int(ats[0]))
    return _strided(data, form)[ats]


def _strided(data: memoryview, form: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return a view of `data` as if a record of a form began at each of its bytes."""
    # Records begin at any byte. A view with a stride of 1 copies nothing; indexing it copies the wanted records.
    records_at_each_byte: npt.NDArray[Any] = np.ndarray((len(data) - form.itemsize + 1,), form, data, 0, (1,))
    return records_at_each_byte


def _is_sound(run: npt.NDArray[np.void], data_end: int) -> npt.NDArray[np.bool_]:
    """Tell which pass `check` and are spelt as their form; each number is compared first, so that no sum overflows."""
    offset, length = run["offset"], run["length"]
    behind_chunk, indexes = run["message_index_length"], run[_MAP]["value"]
    names = run["compression"]
    sound: npt.NDArray[np.bool_] = (names == names[0]).all(axis=1) & (run["compression_bytes"] == names.shape[1])
    sound &= (offset >= len(records.MAGIC)) & (offset <= data_end)
    sound &= (length <= data_end) & (behind_chunk <= data_end) & (indexes <= data_end).all(axis=1)
    ends = offset + length
    behind = ends + behind_chunk
    sound &= behind <= data_end
    sound &= (indexes >= ends[:, None]).all(axis=1)
    sound &= (indexes + np.uint64(PREFIX_BYTES) <= behind[:, None]).all(axis=1)
    return sound


def _compression(run: npt.NDArray[np.void], good: npt.NDArray[np.bool_]) -> str | None:
    """Return the compression of the sound records; None if no record is sound, or its name is not text."""
    if not good.any():
        return None
    try:
        name = bytes(run["compression"][0]).decode()
    except UnicodeDecodeError:
        return None
    return None if name == records.LOOSE else name
