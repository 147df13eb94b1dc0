"""Finds the messages in the content of a chunk of a ROS 1 bag."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .... import clock
from ....mcap.message import MessageBlock, Payload
from .layout import (
    ENTRY,
    LENGTH,
    MESSAGE_OP,
    BrokenRecordError,
    Fields,
    parse_fields,
)

Numbers = npt.NDArray[np.int64]

_HEADS_BYTES = 2 * LENGTH.size
"""The bytes of the two sizes of a record: that of its header and that of its data."""


class Index(NamedTuple):
    """The messages of a chunk."""

    times_ns: Numbers
    connections: Numbers
    places: Numbers
    """Where in the chunk's content their records start."""


def of_entries(entries: list[npt.NDArray[np.void]], connections: list[int]) -> Index:
    """Return the index that the bag has behind a chunk.

    Args:
        entries: Of each connection.
        connections: Their numbers.
    """
    whole = np.concatenate([np.zeros(0, ENTRY), *entries])
    times_ns: Numbers = whole["sec"].astype(np.int64) * clock.NS_PER_S + whole["nsec"]
    numbers = np.repeat(np.array(connections, np.int64), list(map(len, entries)))
    return Index(times_ns, numbers, whole["offset"].astype(np.int64))


def pick(content: bytes, index: Index, wanted: Collection[int]) -> MessageBlock:
    """Return the messages of some connections, in the order in which they lie in a chunk.

    Raises:
        BrokenRecordError: Something else lies there.
    """
    chosen = np.isin(index.connections, list(wanted))
    order = np.flatnonzero(chosen)[np.argsort(index.places[chosen], kind="stable")]
    times_ns = index.times_ns[order].astype(np.uint64)
    payloads = _payloads(content, index.places[order])
    return MessageBlock(index.connections[order], times_ns, times_ns, np.zeros(len(order), np.uint32), payloads)


def records(content: bytes) -> Iterator[tuple[int, Fields, bytes]]:
    """Yield the records in a chunk: the place, the fields and the data of each.

    Raises:
        BrokenRecordError: A record is broken, or cut.
    """
    at = 0
    while at < len(content):
        try:
            (header_size,) = LENGTH.unpack_from(content, at)
            (size,) = LENGTH.unpack_from(content, at + LENGTH.size + header_size)
        except struct.error as error:
            raise BrokenRecordError(f"a record at byte {at} of it is cut") from error
        start = at + _HEADS_BYTES + header_size
        if start + size > len(content):
            raise BrokenRecordError(f"a record at byte {at} of it is cut")
        yield at, parse_fields(content[at + LENGTH.size : start - LENGTH.size]), content[start : start + size]
        at = start + size


def _payloads(data: bytes, places: Numbers) -> list[Payload]:
    """Return the messages whose records start at some places in a chunk.

    Raises:
        BrokenRecordError: Something else is there.
    """
    if not len(places):
        return []
    if int(places.max()) + _HEADS_BYTES > len(data):
        raise BrokenRecordError(f"a message at byte {int(places.max())} of it lies behind its end")
    # A window of 4 bytes at every byte, without a copy: numbers lie at any place, and indexing reads them all at
    # once.
    lengths = np.ndarray((len(data) - 3,), "<u4", data, strides=(1,))
    starts = places + _HEADS_BYTES + lengths[places].astype(np.int64)
    if int(starts.max()) > len(data):
        raise BrokenRecordError(f"a message at byte {int(places[np.argmax(starts)])} of it lies behind its end")
    ends = starts + lengths[starts - 4]
    if int(ends.max()) > len(data):
        raise BrokenRecordError(f"there is no whole message at byte {int(places[np.argmax(ends)])} of it")
    # The fast check holds for one writer's order of fields. Other bags are legal too and are searched record by
    # record.
    if not _are_messages(data, places, starts):
        for place, start in zip(places.tolist(), starts.tolist(), strict=True):
            if data.find(MESSAGE_OP, place, start) < 0:
                raise BrokenRecordError(f"there is no whole message at byte {place} of it")
    view = memoryview(data)
    return [view[start:end] for start, end in zip(starts.tolist(), ends.tolist(), strict=True)]


def _are_messages(data: bytes, places: Numbers, starts: Numbers) -> bool:
    """Whether the records are messages whose headers have the fields in one order, as those of one writer have."""
    at = data.find(MESSAGE_OP, int(places[0]), int(starts[0])) - int(places[0])
    if at < 0 or bool((places + at + len(MESSAGE_OP) > starts).any()):
        return False
    words = np.ndarray((len(data) - 3,), "<u4", data, strides=(1,))
    return bool((words[places + at] == int.from_bytes(MESSAGE_OP, "little")).all())
