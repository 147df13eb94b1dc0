"""The byte layout of Message and MessageIndex records, for numpy and `struct`: they come by the million.

A `Layout` takes about 2 us a record; `append` as a whole takes less.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .record_layout import PREFIX_BYTES, Fields, pack_prefix
from .records import Opcode

MESSAGE_OPCODE = int(Opcode.MESSAGE)
"""A plain number, which `struct` packs faster than an `Opcode`."""

MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""A Message record up to its payload."""

MESSAGE_HEAD_BYTES = MESSAGE_HEAD.itemsize

MESSAGE_FIXED_BYTES = MESSAGE_HEAD_BYTES - PREFIX_BYTES
"""A Message record's length field counts this much more than its payload."""

pack_message_head = struct.Struct("<QHIQQ").pack
"""(length, channel id, sequence, log time, publish time) -> a Message record's head after its opcode."""

MESSAGE_FIELDS = struct.Struct("<HIQQ")
"""Channel id, sequence, log time, publish time: a Message's content up to its payload."""

INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
"""One entry of a MessageIndex record: log time (ns), offset in the uncompressed chunk."""

ENTRY_BYTES = INDEX_ENTRY.itemsize

MESSAGE_INDEX_HEAD = struct.Struct("<HI")
"""Channel id and length of the entries: a MessageIndex's content up to its entries."""


@dataclass(frozen=True, slots=True)
class MessageIndex:
    """Where the messages of one channel lie in a chunk."""

    channel_id: int
    times_ns: npt.NDArray[np.uint64]
    offsets: npt.NDArray[np.uint64]
    """From the start of the chunk's uncompressed records, in bytes."""


def message(channel_id: int, time_ns: int, payload: bytes) -> bytes:
    """Return a Message record with sequence number 0."""
    head = pack_message_head(len(payload) + MESSAGE_FIXED_BYTES, channel_id, 0, time_ns, time_ns)
    return bytes((MESSAGE_OPCODE,)) + head + payload


def message_heads(
    payload_bytes: npt.NDArray[np.int64], channels: int | npt.NDArray[Any], times_ns: npt.NDArray[Any]
) -> npt.NDArray[np.void]:
    """Return the heads of Message records, [N], with sequence number 0.

    Args:
        payload_bytes: The length of each payload, [N].
        channels: The id of the channel of all of them, or of each, [N].
        times_ns: Log times, which are the publish times too, [N].
    """
    heads = np.zeros(len(payload_bytes), MESSAGE_HEAD)
    heads["opcode"] = MESSAGE_OPCODE
    heads["length"] = payload_bytes + MESSAGE_FIXED_BYTES
    heads["channel"] = channels
    heads["log_time"] = heads["publish_time"] = times_ns
    return heads


def read_message_index(fields: Fields) -> MessageIndex:
    """Read a MessageIndex's content.

    Raises:
        DamagedFileError: It is too short, or contradicts itself.
    """
    (channel_id, length) = fields.numbers(MESSAGE_INDEX_HEAD)
    if length % ENTRY_BYTES:
        fields.refuse(f"a message index of {length} bytes, which is no multiple of {ENTRY_BYTES}")
    entries = np.frombuffer(fields.view(length), INDEX_ENTRY)
    return MessageIndex(channel_id, entries["time"].astype(np.uint64), entries["offset"].astype(np.uint64))


def index_entries(times_ns: npt.NDArray[Any], offsets: npt.NDArray[Any]) -> npt.NDArray[np.void]:
    """Return the entries of a MessageIndex record, [N]."""
    entries = np.empty(len(times_ns), INDEX_ENTRY)
    entries["time"], entries["offset"] = times_ns, offsets
    return entries


def pack_message_index(channel_id: int, entries: npt.NDArray[np.void]) -> bytes:
    """Return a MessageIndex record of entries in `INDEX_ENTRY`."""
    array = entries.tobytes()
    head = pack_prefix(Opcode.MESSAGE_INDEX, MESSAGE_INDEX_HEAD.size + len(array))
    return head + MESSAGE_INDEX_HEAD.pack(channel_id, len(array)) + array
