"""The table of encodings: a new one is a file and a line here."""

from __future__ import annotations

import contextlib
import functools
import importlib

from ..errors import EncodingError, OptionError
from ..suggestions import hint
from .codec import Codec, MessageCodec

CODECS: dict[str, str] = {
    "json": f"{__package__}.json",
    "cbor": f"{__package__}.cbor",
    "protobuf": f"{__package__}.protobuf",
    "ros1": f"{__package__}.ros1",
    "cdr": f"{__package__}.cdr",
}
"""Message encodings to the modules that have them; each has a `CODEC`, and is imported when it is first asked for."""

_EXTRAS = {"cbor2": "cbor"}
"""Packages that an encoding needs and not everybody has, to the extra that brings them."""


def find(encoding: str) -> MessageCodec | None:
    """Return the codec of a message encoding; None where there is none.

    Raises:
        EncodingError: The package that it needs is not installed.
    """
    module = CODECS.get(encoding)
    return None if module is None else _load(module)


@functools.cache
def _load(module: str) -> MessageCodec:
    try:
        codec: MessageCodec = importlib.import_module(module).CODEC
    except ModuleNotFoundError as error:
        extra = _EXTRAS.get(error.name or "")
        if extra is None:
            raise
        what = f"needs the package {error.name}, which is not installed: pip install 'ml-dash-mcap[{extra}]'"
        raise EncodingError(f"the encoding {what}") from error
    return codec


def to_record(encoding: str) -> Codec:
    """Return the codec that rows are to be recorded with.

    Raises:
        OptionError: There is none, or the package that it needs is not installed.
    """
    try:
        codec = find(encoding) if isinstance(encoding, str) else None
    except EncodingError as error:
        raise OptionError(f"encoding={encoding!r}: {error}") from error
    if not isinstance(codec, Codec):
        raise OptionError(f"encoding={encoding!r}: rows cannot be recorded in that; {hint(encoding, recordable())}")
    return codec


def recordable() -> list[str]:
    """Return the encodings that rows can be recorded in here."""
    names = []
    for name in CODECS:
        with contextlib.suppress(EncodingError):
            if isinstance(find(name), Codec):
                names.append(name)
    return names
