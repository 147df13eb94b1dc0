"""The error for a value that does not fit a schema, while the way to its field is not known yet."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

_SHOWN = 80


class UnfitValueError(Exception):
    """A value that does not fit; becomes a FieldError, which names the topic and the field."""

    def __init__(self, what: str, *path: str | int) -> None:
        """Begin with the innermost part of the way.

        Args:
            what: What is wrong, to be read behind the name of the field.
            path: Names and indices from here to the value.
        """
        super().__init__(what)
        self.what = what
        self.path = path

    def within(self, *outer: str | int) -> UnfitValueError:
        """Return the error as it is one level further out."""
        self.path = (*outer, *self.path)
        return self


def takes(expected: str, value: Any) -> UnfitValueError:
    """Return the error for a value of another type or out of range."""
    return UnfitValueError(f"takes {expected}; {shown(value)} does not fit")


def shown(value: Any) -> str:
    """Return a value as an error message shows it, cut if it is long, with its type if that does not show."""
    try:
        text = repr(value)
    except Exception:  # methods of foreign objects may raise anything
        text = f"<{type(value).__qualname__}>"
    text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    is_plain = value is None or type(value) in (bool, int, float, str, bytes, list, dict)
    return text if is_plain else f"{text} ({type(value).__qualname__})"


def spelled(path: Iterable[str | int]) -> str:
    """Return the way to a value as users write it, such as `poses[3].position.x`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text
