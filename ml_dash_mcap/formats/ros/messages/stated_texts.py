"""Texts that rows state for a standard message, above all the frames of its coordinates."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

from ....codecs.ros.message_columns import Column, Constant, Ragged, texts
from ....errors import ConversionWarning
from . import conventions
from .context import Context, Stated
from .standard import Derived

WORLD = "world"
"""The parent frame of transforms that state none: tf does not accept a transform without a parent."""


def texts_of(stated: Stated, otherwise: str) -> list[str]:
    """Return what each row states, and something else for those that state nothing or an empty text."""
    values: Ragged = stated.values
    data = bytes(values.items)
    spans = zip(values.starts.tolist(), values.lengths.tolist(), stated.is_there.tolist(), strict=True)
    # Most rows state the same text; each is decoded once.
    by_bytes: dict[bytes, str] = {}
    in_rows = []
    for start, length, is_there in spans:
        text = data[start : start + length] if is_there else b""
        if text not in by_bytes:
            by_bytes[text] = text.decode() or otherwise
        in_rows.append(by_bytes[text])
    return in_rows


def texts_or(stated: Stated, otherwise: str) -> Column:
    """Return `texts_of` as a column."""
    in_rows = texts_of(stated, otherwise)
    return Constant(in_rows[0]) if len(set(in_rows)) == 1 else texts(in_rows)


def of_header(derived: Derived, otherwise: Constant, details: Mapping[str, Stated]) -> Column:
    """Return the frame of a message's header: what the topic's metadata says, or else the row.

    Args:
        derived: Which message.
        otherwise: What the metadata, or else the caller says.
        details: What the rows say.
    """
    stated = details.get(conventions.FRAME)
    if stated is None or derived.metadata.get(conventions.FRAME) is not None or not len(stated.is_there):
        return otherwise
    return texts_or(stated, otherwise.value)


def parent(context: Context) -> Column:
    """Return the frame that a transform leads from: that of the header, or one by default."""
    frames = _spelled(context.header["frame_id"], len(context.rows))
    if "" in frames:
        key = context.derived.key(next(iter(context.derived.fields)))
        warnings.warn(
            f"{context.derived.topic}: nobody says which frame the poses of {key!r} are in; it is called {WORLD!r};"
            " pass frame_id=, or say frame_id= with the topic",
            ConversionWarning,
            stacklevel=2,
        )
    return _column([frame or WORLD for frame in frames])


def child(context: Context) -> Column:
    """Return the frame that a transform leads to: what the topic's metadata says, or else the row."""
    of_topic = context.derived.metadata.get(conventions.CHILD_FRAME)
    stated = context.details.get(conventions.CHILD_FRAME)
    otherwise = of_topic if isinstance(of_topic, str) and of_topic.strip("/") else context.derived.child
    if stated is None or of_topic is not None:
        return Constant(otherwise.strip("/"))
    return _column([frame.strip("/") for frame in texts_of(stated, otherwise)])


def _spelled(frames: Column, count: int) -> list[str]:
    """Return each row's frame as tf has it, without a slash before it."""
    if isinstance(frames, Constant):
        return [str(frames.value).lstrip("/")] * count
    data = bytes(frames.items)
    spans = zip(frames.starts.tolist(), frames.lengths.tolist(), strict=True)
    return [data[start : start + length].decode().lstrip("/") for start, length in spans]


def _column(values: list[str]) -> Column:
    return Constant(values[0]) if len(set(values)) == 1 else texts(values)
