"""Programs for Node.js, in which viewers' own readers judge what we write."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

INSTALL_S = 110


def is_here() -> bool:
    """Whether there is what such programs need; in CI it must be there."""
    return bool(os.environ.get("CI")) or (shutil.which("node") is not None and shutil.which("npm") is not None)


def install(program: Path, place: Path) -> Path:
    """Copy a program and those files beside it, and install its packages; returns the copy.

    Args:
        program: The program, beside its `package.json`.
        place: A folder for it.
    """
    if not is_here():
        pytest.skip("node and npm are not installed; the viewers' own readers are not asked")
    for path in program.parent.iterdir():
        if path.is_file():
            shutil.copy(path, place)
    command = ["npm", "ci", "--no-audit", "--no-fund", "--prefer-offline", "--ignore-scripts"]
    installed = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=INSTALL_S)
    assert installed.returncode == 0, installed.stderr
    return place / program.name
