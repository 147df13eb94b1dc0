"""The text in which a row keeps what none of its fields expresses: JSON of values by RFC 6901 pointer.

    {"/goal": null, "/q/2": 1, "/mixed": [1, "a", null]}

says that `goal` is None, that the third element of `q` is the integer 1 (its field holds doubles), and what `mixed` is.
Bytes, arrays and numbers that are not finite are spelled as `rows.json_text` says.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...rows import json_text

_END = b',"_ts":null}'
_LENIENT_END = b',"_ts": null}'


def encode(values: Mapping[str, Any], *, is_read: bool = False) -> bytes:
    """Encode values by pointer.

    Args:
        values: Plain values by pointer.
        is_read: Whether they were read, so that texts may have lone surrogates.

    Raises:
        FieldError: A text has lone surrogates.
    """
    text = json_text.exact_as_read(values) if is_read else json_text.exact(values, "")
    end = text.rindex(b",")
    return text[:end] + b"}"


def decode(text: bytes) -> dict[str, Any]:
    """Decode values by pointer.

    Raises:
        ValueError: It is no such text.
    """
    values = json_text.loads_any(text)
    if not isinstance(values, dict):
        raise ValueError("its exact text is no object")
    return json_text.restore(values)


def top_level_keys(text: bytes) -> set[str]:
    """Return the top-level keys of the values of a text.

    Raises:
        ValueError: It is no such text.
    """
    return {tokens(pointer_text)[0] for pointer_text in decode(text)}


def pointer(parent: str, key: str | int) -> str:
    """Return the pointer of a value in a dict or a list."""
    return f"{parent}/{key.replace('~', '~0').replace('/', '~1') if isinstance(key, str) else key}"


def tokens(pointer_text: str) -> list[str]:
    """Return the keys and indices of a pointer."""
    return [token.replace("~1", "/").replace("~0", "~") for token in pointer_text.split("/")[1:]]


def put(row: dict[str, Any], values: Mapping[str, Any]) -> None:
    """Put values in their places in a row; a place that the row does not have is a new key of the dict there.

    Raises:
        ValueError: A pointer leads nowhere.
    """
    for pointer_text, value in values.items():
        path = tokens(pointer_text)
        if not path:
            raise ValueError("its exact text has a value without a place")
        container: Any = row
        for token in path[:-1]:
            container = _inside(container, token)
        if isinstance(container, dict):
            container[path[-1]] = value
        else:
            container[_index(container, path[-1])] = value


def _inside(container: Any, token: str) -> Any:
    if isinstance(container, dict) and token in container:
        return container[token]
    return container[_index(container, token)]


def _index(container: Any, token: str) -> int:
    if isinstance(container, list) and token.isascii() and token.isdecimal() and int(token) < len(container):
        return int(token)
    raise ValueError(f"its exact text has no place {token!r}")
