"""The options that a caller has for decoding messages into rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import OptionError
from .ros.definition_sources import Given
from .ros.message_types import canonical

ON_UNKNOWN = ("bytes", "skip", "raise")


@dataclass(frozen=True, slots=True)
class Decoding:
    """How to decode messages for which a file lacks definitions."""

    definitions: Given = ()
    """ROS types, as `canonical` has them, and their definitions."""
    on_unknown: str = "bytes"
    """How messages are read that cannot be decoded: "bytes" for rows that have them as `data`, "skip" for no rows,
    "raise" for an error."""


DEFAULT = Decoding()


def decoding(definitions: Mapping[str, str | Path] | None = None, on_unknown: str = "bytes") -> Decoding:
    """Check a caller's options and return them.

    Args:
        definitions: ROS types to their definitions: the text, or the path of a `.msg` or `.idl` file.
        on_unknown: How messages are read that cannot be decoded.

    Raises:
        OptionError: An option has a value that it cannot have, or a file cannot be read.
    """
    if on_unknown not in ON_UNKNOWN:
        raise OptionError(f"on_unknown={on_unknown!r}: it must be one of {', '.join(map(repr, ON_UNKNOWN))}")
    if definitions is not None and not isinstance(definitions, Mapping):
        raise OptionError(f"definitions={definitions!r}: pass a dict of types and their definitions")
    return Decoding(tuple(_text(name, text) for name, text in (definitions or {}).items()), on_unknown)


def _text(name: Any, text: Any) -> tuple[str, str]:
    if not isinstance(name, str) or not isinstance(text, (str, Path)):
        raise OptionError(f"definitions of {name!r}: pass its text, or the Path of its .msg file, not {text!r}")
    try:
        return canonical(name), text.read_text(encoding="utf-8") if isinstance(text, Path) else text
    except (OSError, UnicodeDecodeError) as error:
        raise OptionError(f"definitions of {name!r}: {text} cannot be read: {error}") from error
