"""Chunk indexes of a summary, many of one form at once: a long recording has thousands, and they hardly differ."""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError
from . import records
from .fields import Fields
from .records import Chunk, Opcode

_BEHIND = records.PREFIX_BYTES + 4 * 8
"""Where the map of message indexes starts in the record, in bytes."""
_PAIR_BYTES = 2 + 8
_SURELY_ALIKE = 8
"""So many are worth to be read at once."""
_MOST_AT_ONCE = 4096
_MOST_PATIENCE = 64

Record = tuple[int, int, Fields]


def split(data: memoryview, path: str, start: int, chunks: list[Chunk]) -> Iterator[Record]:
    """Walk a summary's records like `records.split`, but take runs of like chunk indexes at once.

    Args:
        data: The records.
        path: The file, for error messages.
        start: Where in the file the summary starts.
        chunks: Gets what the chunk indexes of such runs say; the others are yielded.

    Yields:
        Opcode, offset in the file, content.

    Raises:
        DamagedFileError: The records do not end where `data` ends.
    """
    at = 0
    most, patience, waiting = _SURELY_ALIKE, 0, 0
    while at < len(data):
        if not waiting and _begins_run(data, at):
            run, taken = _take(data, at, start, most)
            if run:
                chunks += run
                at += taken
                most = min(4 * most, _MOST_AT_ONCE) if len(run) == most else _SURELY_ALIKE
                patience = 0
                continue
            patience = min(2 * patience + 1, _MOST_PATIENCE)  # whoever alternates forms should not win time by it
            waiting = patience
        waiting = max(waiting - 1, 0)
        opcode, fields = records.one(data, at, path, start)
        yield opcode, start + at, fields
        at = fields.end


def check(chunk: Chunk, path: str, at: int, summary_start: int) -> None:
    """Check where a chunk index points to.

    Args:
        chunk: What it says.
        path: The file, for error messages.
        at: Where in it the chunk index lies.
        summary_start: Where the data section ends.

    Raises:
        DamagedFileError: It points outside the data section, or to message indexes that do not lie behind the chunk.
    """
    behind = chunk.end + chunk.message_index_length
    if not (len(records.MAGIC) <= chunk.offset and behind <= summary_start):
        raise DamagedFileError(path, at, "a chunk index that points outside the data section")
    for offset in chunk.message_index_offsets.values():
        if not chunk.end <= offset <= behind - records.PREFIX_BYTES:
            raise DamagedFileError(path, at, "a chunk index whose message indexes do not lie behind the chunk")


def _begins_run(data: memoryview, at: int) -> bool:
    """Whether several chunk indexes of one length start here."""
    if data[at] != Opcode.CHUNK_INDEX or len(data) - at < records.PREFIX_BYTES:
        return False
    size = records.PREFIX_BYTES + records.prefix(data, at)[1]
    if len(data) - at < _SURELY_ALIKE * size:
        return False
    first = data[at : at + records.PREFIX_BYTES]
    places = range(at + size, at + _SURELY_ALIKE * size, size)
    return all(data[place : place + records.PREFIX_BYTES] == first for place in places)


def _take(data: memoryview, at: int, summary_start: int, most: int) -> tuple[list[Chunk], int]:
    """Read those that have the form of the first and pass `check`; returns also how many bytes they take."""
    size = records.PREFIX_BYTES + records.prefix(data, at)[1]
    channels, rest = divmod(int.from_bytes(data[at + _BEHIND : at + _BEHIND + 4], "little"), _PAIR_BYTES)
    letters = size - _BEHIND - 4 - channels * _PAIR_BYTES - 8 - 4 - 8 - 8
    if rest or letters < 0:
        return [], 0
    run = np.frombuffer(data, _form(channels, letters), min((len(data) - at) // size, most), at)
    good = _are_alike(run, channels, letters) & _are_sound(run, summary_start)
    count = len(good) if good.all() else int(good.argmin())
    try:
        compression = bytes(run["compression"][0]).decode()
    except UnicodeDecodeError:
        return [], 0
    if count < 2 or compression == records.LOOSE:
        return [], 0
    return list(_chunks(run[:count], compression)), count * size


@functools.lru_cache(maxsize=64)
def _form(channels: int, letters: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("prefix", np.uint8, (records.PREFIX_BYTES,)),
            ("times", "<u8", (2,)),
            ("place", "<u8", (2,)),
            ("map_bytes", "<u4"),
            ("map", np.dtype([("channel", "<u2"), ("offset", "<u8")]), (channels,)),
            ("index_bytes", "<u8"),
            ("letters", "<u4"),
            ("compression", np.uint8, (letters,)),
            ("sizes", "<u8", (2,)),
        ]
    )


def _are_alike(run: npt.NDArray[np.void], channels: int, letters: int) -> npt.NDArray[np.bool_]:
    alike: npt.NDArray[np.bool_] = (run["map_bytes"] == channels * _PAIR_BYTES) & (run["letters"] == letters)
    for name in ("prefix", "compression"):
        alike &= (run[name] == run[name][0]).all(axis=1)
    return alike


def _are_sound(run: npt.NDArray[np.void], summary_start: int) -> npt.NDArray[np.bool_]:
    """Tell which pass `check`; each number is compared on its own first, so that no sum can overflow."""
    offset, length = run["place"].T
    behind_chunk, indexes = run["index_bytes"], run["map"]["offset"]
    sound: npt.NDArray[np.bool_] = (offset >= len(records.MAGIC)) & (offset <= summary_start)
    sound &= (length <= summary_start) & (behind_chunk <= summary_start) & (indexes <= summary_start).all(axis=1)
    ends = offset + length
    behind = ends + behind_chunk
    sound &= behind <= summary_start
    sound &= (indexes >= ends[:, None]).all(axis=1)
    sound &= (indexes + np.uint64(records.PREFIX_BYTES) <= behind[:, None]).all(axis=1)
    return sound


def _chunks(run: npt.NDArray[np.void], compression: str) -> Iterator[Chunk]:
    for (start_ns, end_ns), (offset, length), ids, offsets, index_bytes, (packed, unpacked) in zip(
        run["times"].tolist(),
        run["place"].tolist(),
        run["map"]["channel"].tolist(),
        run["map"]["offset"].tolist(),
        run["index_bytes"].tolist(),
        run["sizes"].tolist(),
        strict=True,
    ):
        yield Chunk(
            offset=offset,
            length=length,
            start_ns=start_ns,
            end_ns=end_ns,
            compression=compression,
            compressed_size=packed,
            uncompressed_size=unpacked,
            message_index_offsets=dict(zip(ids, offsets, strict=True)),
            message_index_length=index_bytes,
            indexed=bool(ids),
        )
