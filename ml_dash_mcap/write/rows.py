"""The rows of a sealed buffer, as arrays over its bytes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from . import records

Bytes = npt.NDArray[np.uint8]
Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Rows:
    """Message records somewhere in a block of bytes, in the order in which they were appended."""

    data: Bytes
    """The block; writable."""
    starts: Numbers
    """Offset of each record, [N]."""
    ends: Numbers
    """Offset after each record, [N]."""
    channels: Numbers
    """Channel id of each row, [N]."""
    times: Numbers
    """Log time of each row, [N], ns."""

    def __len__(self) -> int:
        return len(self.starts)

    def payload(self, row: int) -> bytes:
        """Return one encoded row."""
        return self.data[self.starts[row] + records.MESSAGE_HEAD : self.ends[row]].tobytes()

    def number(self, sequence: npt.NDArray[np.uint32]) -> Rows:
        """Write a sequence number into each record, in place; returns self."""
        at = (self.starts + 11)[:, None] + np.arange(4)
        self.data[at] = sequence.astype("<u4").view(np.uint8).reshape(-1, 4)
        return self

    def packed(self) -> Rows:
        """Return the same rows with nothing between them, copying only where there is something."""
        gaps = np.flatnonzero(self.starts[1:] != self.ends[:-1]) + 1
        if not len(gaps):
            return self
        firsts = self.starts[np.concatenate(([0], gaps))]
        lasts = self.ends[np.concatenate((gaps - 1, [len(self) - 1]))]
        lengths = self.ends - self.starts
        ends = np.cumsum(lengths)
        data = np.concatenate([self.data[a:b] for a, b in zip(firsts, lasts, strict=True)])
        return replace(self, data=data, starts=ends - lengths, ends=ends)

    def contiguous(self) -> Bytes:
        """Return the bytes of packed rows."""
        return self.data[self.starts[0] : self.ends[-1]]


def of_buffer(data: Bytes, starts: list[int]) -> Rows:
    """Read the heads of the Message records that start at some offsets of a block."""
    at: Numbers = np.array(starts, dtype=np.int64)
    at.sort()
    heads = data[at[:, None] + np.arange(records.MESSAGE_HEAD)].view(records.MESSAGE_HEAD_DTYPE).ravel()
    ends = at + heads["length"].astype(np.int64) + 9
    return Rows(data, at, ends, heads["channel"].astype(np.int64), heads["log_time"].astype(np.int64))


def replaced(rows: Rows, keep: npt.NDArray[np.bool_], payloads: dict[int, tuple[int, bytes]]) -> Rows:
    """Return rows with some left out and some rewritten.

    Args:
        rows: What to start from.
        keep: Which of them stay, [N].
        payloads: By row number, the new log time (ns) and payload.
    """
    pieces: list[Bytes] = []
    for row in np.flatnonzero(keep).tolist():
        changed = payloads.get(row)
        if changed is None:
            pieces.append(rows.data[rows.starts[row] : rows.ends[row]])
        else:
            time, payload = changed
            pieces.append(np.frombuffer(message(int(rows.channels[row]), time, payload), np.uint8))
    times = rows.times.copy()
    for row, (time, _) in payloads.items():
        times[row] = time
    lengths = np.array([len(piece) for piece in pieces], dtype=np.int64)
    ends = np.cumsum(lengths)
    data = np.concatenate(pieces) if pieces else np.empty(0, np.uint8)
    return Rows(data, ends - lengths, ends, rows.channels[keep], times[keep])


def message(channel: int, time_ns: int, payload: bytes) -> bytes:
    """Return a Message record with sequence number 0."""
    length = len(payload) + records.MESSAGE_LENGTH_EXCESS
    head = records.pack_message_head(length, channel, 0, time_ns, time_ns)
    return bytes((records.MESSAGE_OPCODE,)) + head + payload
