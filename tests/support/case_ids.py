"""Names of parametrized cases that are the same in every process, as tests that run side by side need."""

from __future__ import annotations

import re

_ADDRESS = re.compile(r" at 0x[0-9a-f]+")


def stable_repr(value: object) -> str:
    """Return a value's repr without the addresses in it, which differ from process to process."""
    return _ADDRESS.sub("", repr(value))
