"""How deep JSON is nested: who reads it calls itself for lists in lists, until there is no stack left."""

from __future__ import annotations

import re

import numpy as np

MOST = 254
"""Rows nested deeper than this, which orjson would not write, are not read."""

_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))
_TEXT = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)


def is_within(payload: bytes, most: int) -> bool:
    """Whether no list or dict lies in more than `most` others, counted from the outermost; fast for what is short."""
    if len(payload) <= most or payload.count(b"[") + payload.count(b"{") <= most:
        return True
    marks = np.frombuffer(_TEXT.sub(b"", payload).translate(None, _NO_BRACKETS), np.uint8)
    depth = np.cumsum(np.where((marks == ord("[")) | (marks == ord("{")), 1, -1))
    return not len(depth) or int(depth.max()) <= most
