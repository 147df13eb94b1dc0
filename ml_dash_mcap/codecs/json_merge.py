"""Merges JSON rows of one topic and one time stamp by cutting and joining their bytes; later fields win."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import orjson

from ..rows.plain_row import EXACT_KEY, TIME_KEY

TIME_MARK = b'"_ts":'
"""The time stamp's key. Behind its last occurrence stand the time stamp and the end of the row."""


def time_of(payload: bytes) -> float:
    """Return the time stamp of an encoded row, in seconds, without decoding the rest."""
    return float(payload[payload.rindex(TIME_MARK) + len(TIME_MARK) : -1])


def with_time(payload: bytes, seconds: float) -> bytes:
    """Return an encoded row at another time stamp, in seconds; every other byte of it stays.

    Raises:
        ValueError: It has no time stamp.
    """
    at = payload.rindex(TIME_MARK) + len(TIME_MARK)
    float(payload[at:-1])  # raises where the time stamp is not the last field, or none at all
    return b"".join((payload[:at], orjson.dumps(seconds), b"}"))


def join_disjoint(payloads: Sequence[bytes], cuts: Sequence[int]) -> bytes:
    """Merge encoded rows of one time stamp whose top-level keys differ, by cutting and joining their bytes."""
    fields = [payload[1:at] for payload, at in zip(payloads, cuts, strict=True)]
    return b"".join((b"{", *fields, payloads[0][cuts[0] :]))


def join(payloads: Sequence[bytes]) -> bytes:
    """Merge encoded rows of one time stamp, the earliest first, whatever their keys.

    The side key is cut by top-level field: each field brings the notes of the row it is taken from.
    """
    merged: dict[str, Any] = {}
    notes: dict[str, dict[str, dict[str, list[Any]]]] = {}  # field -> spelling -> pointer -> keys
    for payload in payloads:
        row = orjson.loads(payload)
        row_notes = _notes_by_field(row.pop(EXACT_KEY, {}))
        for field, value in row.items():
            merged[field] = value
            notes[field] = row_notes.get(field, {})
    time = merged.pop(TIME_KEY)
    exact: dict[str, dict[str, list[Any]]] = {}
    for field_notes in notes.values():
        for spelling, containers in field_notes.items():
            for pointer, keys in containers.items():
                exact.setdefault(spelling, {}).setdefault(pointer, []).extend(keys)
    if exact:
        merged[EXACT_KEY] = exact
    merged[TIME_KEY] = time
    return orjson.dumps(merged)


def _notes_by_field(exact: dict[str, dict[str, list[Any]]]) -> dict[str, dict[str, dict[str, list[Any]]]]:
    by_field: dict[str, dict[str, dict[str, list[Any]]]] = {}
    for spelling, containers in exact.items():
        for pointer, keys in containers.items():
            if pointer:
                # RFC 6901 escapes "/" as "~1" and "~" as "~0"; "~0" comes last, so that "~01" becomes "~1".
                field = pointer.split("/")[1].replace("~1", "/").replace("~0", "~")
                by_field.setdefault(field, {}).setdefault(spelling, {})[pointer] = keys
                continue
            for key in keys:
                by_field.setdefault(key, {}).setdefault(spelling, {}).setdefault("", []).append(key)
    return by_field
