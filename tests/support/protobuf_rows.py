"""Rows as protobuf messages, as a channel records them, and ways to damage them."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from ml_dash_mcap.codecs import protobuf
from ml_dash_mcap.codecs.proto.row_decoder import RowDecoder

Row = dict[str, Any]

ROBOT = {
    "q": [0.5, 1.5, -2.5],
    "n": 3,
    "on": True,
    "name": "arm",
    "raw": b"\x00\xff",
    "pose": {"p": [1.0, 2.0], "frame": {"id": "map", "seq": 7}},
    "m": [[1.0, 2.0], [3.0, 4.0]],
    "flags": [True, False],
    "words": ["a", "bc"],
    "seen": [{"label": "cup", "at": [0.1, 0.2]}, {"label": "pen", "at": [0.3, 0.4]}],
}
"""A row with a value of each kind that becomes a field."""

MUTATIONS = st.lists(
    st.tuples(st.integers(0, 39), st.floats(0, 1), st.integers(0, 255), st.sampled_from(["set", "cut", "insert"])),
    min_size=1,
    max_size=4,
)
"""How to damage some of up to 40 rows: which one, where (0 to 1), the byte, and what is done with it."""


def recorded(rows: list[Row]) -> tuple[list[bytes], RowDecoder]:
    """Encode rows one second apart; returns them, and the decoder of their channel."""
    codec = protobuf.CODEC.for_channel("topic")
    assert isinstance(codec, protobuf.ProtobufCodec)
    payloads = [codec.encode({**row, "_ts": float(time_s)}, "topic") for time_s, row in enumerate(rows)]
    return payloads, RowDecoder(codec.layout)


def damage(payloads: list[bytes], mutations: list[tuple[int, float, int, str]]) -> None:
    """Damage some rows in place, as `MUTATIONS` says."""
    for number, where, byte, how in mutations:
        payloads[number % len(payloads)] = damaged(payloads[number % len(payloads)], where, byte, how)


def damaged(payload: bytes, where: float, byte: int, how: str) -> bytes:
    at = int(where * len(payload))
    if how == "cut":
        return payload[:at]
    if how == "insert":
        return payload[:at] + bytes([byte]) + payload[at:]
    return payload[:at] + bytes([byte]) + payload[at + 1 :]
