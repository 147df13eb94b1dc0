"""Programs that run with the system's Python, because Debian packages what they judge with for that one only."""

from __future__ import annotations

import functools
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

PYTHON = "/usr/bin/python3"
PROGRAMS = Path(__file__).parent / "ros"


@functools.cache
def is_here() -> bool:
    """Whether anything of ROS is there to judge; in CI it must be."""
    return bool(os.environ.get("CI")) or any(map(_imports, ("rosbag", "rosidl_adapter")))


def _imports(*modules: str) -> bool:
    try:
        done = subprocess.run([PYTHON, "-c", f"import {', '.join(modules)}"], capture_output=True, timeout=60)
    except OSError:
        return False
    return done.returncode == 0


def run(program: str, *arguments: str | Path, needs: tuple[str, ...], package: str) -> Any:
    """Run one of the programs and return the JSON object that it prints in its last line.

    Args:
        program: Its file's name.
        arguments: Its arguments.
        needs: Modules that it imports; the test is skipped where they are not installed, unless this is CI.
        package: Debian's package of them.
    """
    if not os.environ.get("CI") and not _imports(*needs):
        pytest.skip(f"Debian's {package} is not installed; ROS's own code is not asked")
    command = [PYTHON, str(PROGRAMS / program), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])
