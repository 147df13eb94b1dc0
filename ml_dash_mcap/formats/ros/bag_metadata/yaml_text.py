"""Reads and writes the YAML of a bag's metadata.

The written text is nearly JSON: texts in double quotes with JSON's escapes, which YAML has too.
"""

from __future__ import annotations

import base64
import datetime
import json
import math
from collections.abc import Mapping
from typing import Any


def load(text: str) -> Any:
    """Read YAML.

    Raises:
        ValueError: It is none.
    """
    # Imported here: opening a recording that is no bag should not load it.
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise ValueError(str(error).splitlines()[0]) from error


def text(value: Any) -> str:
    """Spell dicts, lists, texts, numbers and booleans as YAML."""
    return "\n".join(lines(value, 0)) + "\n"


def lines(value: Any, depth: int = 0) -> list[str]:
    """Return the lines of a dict or a list, so deep inside others."""
    blanks = "  " * depth
    spelled: list[str] = []
    if isinstance(value, Mapping):
        for key, inner in value.items():
            is_plain = isinstance(key, str) and key.isidentifier() and key.lower() not in _WORDS
            name = key if is_plain else _scalar(key)
            if isinstance(inner, (Mapping, list)) and inner:
                spelled += [f"{blanks}{name}:", *lines(inner, depth + 1)]
            else:
                spelled.append(f"{blanks}{name}: {_scalar(inner)}")
        return spelled
    for inner in value:
        if isinstance(inner, Mapping) and inner:
            first, *rest = lines(inner, depth + 1)
            spelled += [f"{blanks}- {first.lstrip()}", *rest]
        else:
            spelled.append(f"{blanks}- {_scalar(inner)}")
    return spelled


_WORDS = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
"""Texts that YAML takes for something else without quotes."""


def _scalar(value: Any) -> str:
    """Spell a value in one line: what YAML reads as anything but a list, dict or text as what it is."""
    if value is None:
        return "~"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_scalar(key)}: {_scalar(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_scalar, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    if isinstance(value, datetime.date):  # or a datetime, which is one
        return value.isoformat()
    if isinstance(value, bytes):
        return f"!!binary {json.dumps(base64.b64encode(value).decode())}"
    # A JSON string of ASCII characters is also a YAML text in double quotes, with the same escapes.
    return json.dumps(value if isinstance(value, (str, int, float)) else str(value), ensure_ascii=True)
