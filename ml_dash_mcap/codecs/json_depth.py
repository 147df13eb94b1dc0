"""Tells how deep JSON is nested: its readers call themselves for lists in lists, until there is no stack left."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

MOST = 254
"""Rows nested deeper than this, which orjson would not write, are not read."""

_LARGE_BYTES = 64 * 1024

_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))
_TEXT = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)


def is_within(payload: bytes, most: int) -> bool:
    """Whether no list or dict lies in more than `most` others, counted from the outermost; fast for short payloads."""
    if len(payload) <= most or payload.count(b"[") + payload.count(b"{") <= most:
        return True
    # Brackets in texts do not count, so texts are taken out first.
    marks = np.frombuffer(_TEXT.sub(b"", payload).translate(None, _NO_BRACKETS), np.uint8)
    depth = np.cumsum(np.where((marks == ord("[")) | (marks == ord("{")), 1, -1))
    return not len(depth) or int(depth.max()) <= most


def are_within(payloads: Sequence[bytes], most: int) -> bool:
    """Whether `is_within` is true for all payloads. Faster than asking for each payload."""
    large = [payload for payload in payloads if len(payload) > _LARGE_BYTES]
    if large:  # nothing is gained by joining them, and memory is lost
        rest = [payload for payload in payloads if len(payload) <= _LARGE_BYTES]
        return all(is_within(payload, most) for payload in large) and are_within(rest, most)
    text = np.frombuffer(b"".join(payloads), np.uint8)
    is_opening = (text | 0x20) == ord("{")  # the bit in which "[" differs from "{"
    if np.count_nonzero(is_opening) <= most:
        return True
    counts = np.diff(np.searchsorted(np.flatnonzero(is_opening), np.cumsum(list(map(len, payloads)))), prepend=0)
    return all(is_within(payloads[at], most) for at in np.flatnonzero(counts > most).tolist())
