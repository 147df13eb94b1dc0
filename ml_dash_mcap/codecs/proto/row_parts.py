"""Takes encoded rows apart at their top-level fields, and joins rows of one time stamp."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from ...rows.plain_row import EXACT_KEY, TIME_KEY
from . import exact_values, wire
from .layout import EXACT_NUMBER, TIME_NUMBER, Layout
from .row_encoder import TIME_BYTES, TIME_TAG


def cut(payload: bytes) -> int:
    """Return where a row's time stamp begins.

    Raises:
        ValueError: It does not end with one.
    """
    at = len(payload) - TIME_BYTES
    if at < 0 or payload[at : at + len(TIME_TAG)] != TIME_TAG:
        raise ValueError("the row does not end with its time stamp")
    return at


def time_of(payload: bytes) -> float:
    """Return a row's time stamp, in seconds."""
    time_s: float = struct.unpack_from("<d", payload, cut(payload) + len(TIME_TAG))[0]
    return time_s


def with_time(payload: bytes, time_s: float) -> bytes:
    """Return a row at another time stamp, in seconds."""
    return payload[: cut(payload)] + TIME_TAG + wire.pack_double(time_s)


def keys(layout: Layout, payload: bytes) -> frozenset[str]:
    """Return a row's top-level keys, with `EXACT_KEY` if it has an exact text, which must not be joined as bytes."""
    names = set()
    for field in wire.fields(payload):
        names |= _keys_of_field(layout, payload, field)
    return frozenset(names)


def _keys_of_field(layout: Layout, payload: bytes, field: wire.WireField) -> set[str]:
    if field.number == TIME_NUMBER:
        return {TIME_KEY}
    if field.number == EXACT_NUMBER:
        return {EXACT_KEY, *exact_values.top_level_keys(payload[field.value_start : field.end])}
    return {_key(layout, field)}


def join(layout: Layout, payloads: Sequence[bytes]) -> bytes:
    """Merge rows of one time stamp, the earliest first: for each top-level key, the last row that has it wins."""
    parts: dict[str, bytes] = {}
    exact: dict[str, dict[str, Any]] = {}
    for payload in payloads:
        row_parts, row_exact = _take_apart(layout, payload)
        for key in row_parts.keys() | row_exact.keys():
            exact.pop(key, None)
            parts.pop(key, None)
        parts |= row_parts
        exact |= row_exact
    values = {pointer: value for by_pointer in exact.values() for pointer, value in by_pointer.items()}
    text = wire.delimited(EXACT_NUMBER, exact_values.encode(values, is_read=True)) if values else b""
    return b"".join([*parts.values(), text, payloads[-1][cut(payloads[-1]) :]])


def _take_apart(layout: Layout, payload: bytes) -> tuple[dict[str, bytes], dict[str, dict[str, Any]]]:
    """Return the bytes of each top-level key, and its values in the exact text by pointer."""
    parts: dict[str, bytes] = {}
    exact: dict[str, dict[str, Any]] = {}
    for field in wire.fields(payload):
        if field.number == EXACT_NUMBER:
            for pointer, value in exact_values.decode(payload[field.value_start : field.end]).items():
                exact.setdefault(_top_level(pointer), {})[pointer] = value
        elif field.number != TIME_NUMBER:
            key = _key(layout, field)
            parts[key] = parts.get(key, b"") + payload[field.start : field.end]
    return parts, exact


def _key(layout: Layout, field: wire.WireField) -> str:
    member = layout.by_number.get(field.number)
    if member is None:
        raise ValueError(f"it has the field {field.number}, which its schema does not describe")
    return member.key


def _top_level(pointer: str) -> str:
    return exact_values.tokens(pointer)[0]
