"""The schemas of the library's own rows: logs, files and episodes, as JSON."""

from __future__ import annotations

from functools import cache

from .. import shipped_schemas
from . import json
from .given.given_schema import GivenSchema


@cache
def own_schema(shipped: str, name: str | None = None) -> GivenSchema:
    """Return a schema whose rows the library makes itself, so that nobody checks them.

    Args:
        shipped: Its name among those in `schemas/`.
        name: Its name in files; the same by default.
    """
    return GivenSchema(name or shipped, shipped_schemas.text(shipped), json.CODEC)
