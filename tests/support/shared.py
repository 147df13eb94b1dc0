"""Files of other tools that lie beside the project on some machines."""

from __future__ import annotations

from pathlib import Path

import pytest

_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def is_here() -> bool:
    """Whether they are on this machine."""
    return _DATA.is_dir()


def file(name: str) -> Path:
    """Return the path of a file or folder below `../shared/data`; skips the test where it is not there."""
    path = _DATA / name
    if not path.exists():
        pytest.skip(f"../shared/data/{name} is not here")
    return path
