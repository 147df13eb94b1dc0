"""Payloads of many messages in one array of bytes, for readers that look at all of them at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from ..mcap.chunk_messages import Messages
from ..mcap.message_records import MESSAGE_HEAD_BYTES

BLANKS_BEHIND = 8
"""So many blanks at least lie behind the last payload, so that the 8 bytes that begin at any byte can be looked at."""

_WORTH_HOLDING = 2
"""A chunk is held for messages that are at least one part in so many of it; fewer are copied out of it."""

_LONG = 16 * 1024
"""Payloads of more bytes than this, about, are long ones."""

_LARGE_BYTES = 64 * 1024
"""Payloads of so many bytes on average stay apart: nothing is gained by another copy of them, and memory is lost."""

_HEAD = np.dtype((np.void, MESSAGE_HEAD_BYTES))
_BLANKS = b" " * MESSAGE_HEAD_BYTES
_BLANK_HEAD = np.frombuffer(_BLANKS, _HEAD)[0]


@dataclass(frozen=True, slots=True, eq=False)
class Payloads(Sequence[bytes]):
    """The payloads of some messages: a sequence of bytes like any other, each copied out when it is asked for."""

    data: npt.NDArray[np.uint8]
    """Holds the payloads in their order."""
    starts: npt.NDArray[np.int64]
    """Where each payload starts, [N]."""
    ends: npt.NDArray[np.int64]
    """Where each payload ends, [N]."""
    has_heads: bool = False
    """Whether the heads of messages lie between them. Otherwise, spaces do, one at least, and at least
    `BLANKS_BEHIND` of them lie behind the last."""

    def __len__(self) -> int:
        """How many there are."""
        return len(self.starts)

    def __iter__(self) -> Iterator[bytes]:
        """Yield each payload."""
        return iter(self[:])

    @overload
    def __getitem__(self, which: int) -> bytes: ...

    @overload
    def __getitem__(self, which: slice) -> list[bytes]: ...

    def __getitem__(self, which: int | slice) -> bytes | list[bytes]:
        """Return a payload, or some of them as a list."""
        if not isinstance(which, slice):
            return self.data[self.starts[which] : self.ends[which]].tobytes()
        return self._list(self.starts[which], self.ends[which])

    def _list(self, starts: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]) -> list[bytes]:
        if len(self.data) > _LONG * len(starts):  # a copy of all would take as much memory again
            return [self.data[start:end].tobytes() for start, end in zip(starts.tolist(), ends.tolist(), strict=True)]
        data = self.data.tobytes()  # of which parts are copied faster than of an array
        return [data[start:end] for start, end in zip(starts.tolist(), ends.tolist(), strict=True)]

    @property
    def size(self) -> int:
        """How many bytes all payloads have."""
        return int(self.ends.sum() - self.starts.sum())

    def pick(self, which: npt.NDArray[np.intp]) -> Payloads:
        """Return some of them, copied."""
        return of_list(self._list(self.starts[which], self.ends[which]))


def of_list(payloads: Sequence[bytes]) -> Payloads:
    """Return payloads that are bytes each."""
    data = np.frombuffer(b" ".join([*payloads, _BLANKS[1:BLANKS_BEHIND]]), np.uint8)
    sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
    ends = np.cumsum(sizes + 1) - 1
    return Payloads(data, ends - sizes, ends)


def of_messages(messages: Messages) -> Payloads:
    """Return the payloads of messages, copied out of their chunk unless they are most of it."""
    view = view_of(messages)
    return of_list(messages.payloads) if view is None else view


def view_of(messages: Messages) -> Payloads | None:
    """Return the payloads of messages as they lie in their chunk, if they are most of it and lie next to each other.

    A chunk is not held for long payloads: then it would take as much memory again.
    """
    starts, ends = messages.offsets, messages.ends
    if not len(starts) or int(ends[-1] - starts[0]) * _WORTH_HOLDING < len(messages.data):
        return None
    if len(messages.data) > _LONG * len(starts):
        return None
    if not bool((starts[1:] == ends[:-1]).all()):  # something else lies between them
        return None
    return Payloads(np.frombuffer(messages.data, np.uint8), starts + MESSAGE_HEAD_BYTES, ends, has_heads=True)


def joined(parts: Sequence[Payloads]) -> Payloads:
    """Put payloads behind each other, with nothing but blanks between them."""
    parts = [part for part in parts if len(part)]
    if len(parts) == 1 and not parts[0].has_heads:
        return parts[0]
    sizes = [int(part.ends[-1] - part.starts[0]) for part in parts]
    places = np.cumsum([0, *(size + 1 for size in sizes)]).tolist()
    data = np.empty(places[-1] + BLANKS_BEHIND, np.uint8)
    for part, place, size in zip(parts, places, sizes, strict=False):
        _copy(part, data[place : place + size])
        data[place + size] = _BLANKS[0]
    data[places[-1] :] = _BLANKS[0]
    starts = [part.starts - part.starts[0] + place for part, place in zip(parts, places, strict=False)]
    ends = [part.ends - part.starts[0] + place for part, place in zip(parts, places, strict=False)]
    none = np.empty(0, np.int64)
    return Payloads(data, np.concatenate([none, *starts]), np.concatenate([none, *ends]))


def are_large(payloads: Sequence[bytes]) -> bool:
    """Whether payloads are so large that they are better kept apart."""
    size = payloads.size if isinstance(payloads, Payloads) else sum(map(len, payloads))
    return size >= _LARGE_BYTES * max(1, len(payloads))


def together(parts: Sequence[Payloads]) -> Sequence[bytes]:
    """Put payloads behind each other, in one array unless they are large."""
    if sum(part.size for part in parts) >= _LARGE_BYTES * max(1, sum(map(len, parts))):
        return [payload for part in parts for payload in part]
    return joined(parts)


def _copy(payloads: Payloads, target: npt.NDArray[np.uint8]) -> None:
    """Copy payloads and what lies between them, but for the heads of messages, which become blank."""
    start = int(payloads.starts[0])
    target[:] = payloads.data[start : start + len(target)]
    if payloads.has_heads and len(payloads) > 1:
        # A view with a stride of 1, because heads begin at any byte.
        heads = np.ndarray((len(target) - MESSAGE_HEAD_BYTES + 1,), _HEAD, target, strides=(1,))
        heads[payloads.ends[:-1] - start] = _BLANK_HEAD
