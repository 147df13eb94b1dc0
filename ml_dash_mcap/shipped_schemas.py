"""The JSON Schemas of our own messages and metadata, as shipped in `schemas/`."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from .errors import NotFoundError

_HERE = Path(__file__).resolve().parent
_FOLDER = _HERE / "schemas" if (_HERE / "schemas").is_dir() else _HERE.parent / "schemas"
"""Inside an installed package, beside it in a clone of the repository."""


@cache
def load(name: str) -> dict[str, Any]:
    """Return the JSON Schema of one kind of message or metadata record; treat it as read-only.

    Args:
        name: Such as "ml_dash.log"; `names()` gives all.

    Raises:
        NotFoundError: There is no such schema.
    """
    if name not in names():
        raise NotFoundError(f"no schema {name!r}; there are {', '.join(names())}")
    schema: dict[str, Any] = json.loads((_FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return schema


@cache
def text(name: str) -> bytes:
    """Return the JSON Schema of one kind as a Schema record has it; see `load`."""
    return json.dumps(load(name), ensure_ascii=False, separators=(",", ":")).encode()


def names() -> list[str]:
    """Return the names of all schemas, sorted."""
    return sorted(path.stem for path in _FOLDER.glob("*.json"))
