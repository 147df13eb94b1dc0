"""Wall-clock times as text: ISO 8601, UTC, with a Z at the end."""

from __future__ import annotations

import time
from datetime import datetime, timezone


def text_of(seconds: float) -> str:
    """Spell a time given in seconds since 1970."""
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat().replace("+00:00", "Z")


def now_text() -> str:
    """Spell the time that it is now."""
    return text_of(time.time())
