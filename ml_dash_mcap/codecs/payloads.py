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

_BETWEEN = np.frombuffer(b"\n".ljust(MESSAGE_HEAD_BYTES), np.uint8)
"""Takes the place of the head of a message."""

_BEHIND = np.frombuffer(b"\n".ljust(BLANKS_BEHIND), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Payloads(Sequence[bytes]):
    """The payloads of some messages: a sequence of bytes like any other, each copied out when it is asked for."""

    data: npt.NDArray[np.uint8]
    """The payloads, in their order. A newline and perhaps spaces lie between two of them and behind the last."""
    starts: npt.NDArray[np.int64]
    """Where each payload starts, [N]."""
    ends: npt.NDArray[np.int64]
    """Where each payload ends, [N]."""

    def __len__(self) -> int:
        """How many there are."""
        return len(self.starts)

    def __iter__(self) -> Iterator[bytes]:
        """Yield each payload."""
        text = self.data.tobytes()
        return iter([text[start:end] for start, end in zip(self.starts.tolist(), self.ends.tolist(), strict=True)])

    @overload
    def __getitem__(self, which: int) -> bytes: ...

    @overload
    def __getitem__(self, which: slice) -> list[bytes]: ...

    def __getitem__(self, which: int | slice) -> bytes | list[bytes]:
        """Return a payload, or some of them as a list."""
        if not isinstance(which, slice):
            return self.data[self.starts[which] : self.ends[which]].tobytes()
        spans = zip(self.starts[which].tolist(), self.ends[which].tolist(), strict=True)
        return [self.data[start:end].tobytes() for start, end in spans]

    @property
    def size(self) -> int:
        """How many bytes all payloads have."""
        return int((self.ends - self.starts).sum())

    def pick(self, which: npt.NDArray[np.intp]) -> Payloads:
        """Return some of them, copied."""
        starts, ends = self.starts[which].tolist(), self.ends[which].tolist()
        return of_list([self.data[start:end].tobytes() for start, end in zip(starts, ends, strict=True)])


def of_list(payloads: Sequence[bytes]) -> Payloads:
    """Return payloads that are bytes each."""
    data = np.frombuffer(b"\n".join([*payloads, _BEHIND[1:].tobytes()]), np.uint8)
    sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
    ends = np.cumsum(sizes + 1) - 1
    return Payloads(data, ends - sizes, ends)


def of_messages(messages: Messages) -> Payloads:
    """Copy the payloads of messages out of their chunk."""
    starts, ends = messages.offsets, messages.ends
    if not len(starts) or not bool((starts[1:] == ends[:-1]).all()):
        return of_list(messages.payloads)
    # Nothing else lies between them: all are copied at once, and the heads between them are then made blank.
    first, size = int(starts[0]), int(ends[-1] - starts[0])
    data = np.empty(size + BLANKS_BEHIND, np.uint8)
    data[:size] = np.frombuffer(messages.data, np.uint8, size, first)
    data[size:] = _BEHIND
    head = np.dtype((np.void, MESSAGE_HEAD_BYTES))
    # A view with a stride of 1, because messages begin at any byte.
    heads = np.ndarray((size - MESSAGE_HEAD_BYTES + 1,), head, data, strides=(1,))
    heads[starts - first] = _BETWEEN.view(head)[0]
    return Payloads(data, starts - first + MESSAGE_HEAD_BYTES, ends - first)


def joined(parts: Sequence[Payloads]) -> Payloads:
    """Put payloads behind each other."""
    if len(parts) == 1:
        return parts[0]
    shifts = np.cumsum([0, *(len(part.data) for part in parts)]).tolist()
    starts = [part.starts + shift for part, shift in zip(parts, shifts, strict=False)]
    ends = [part.ends + shift for part, shift in zip(parts, shifts, strict=False)]
    return Payloads(np.concatenate([part.data for part in parts]), np.concatenate(starts), np.concatenate(ends))
