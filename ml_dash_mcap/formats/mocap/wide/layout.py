"""How wide tables are laid out: `frame,time,q.0,q.1,...`, with several topics `frame,time,robot:q.0,...`."""

from __future__ import annotations

COLUMNS = ("frame", "time")
"""Before the others; the time is `_ts` itself."""

TOPIC_END = ":"
"""Stands between a topic and a field."""
