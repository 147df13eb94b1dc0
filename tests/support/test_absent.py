"""Tests whose judge is not on a machine are left out there, and said to be."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def collected(tmp_path: Path, *files: str) -> tuple[str, list[str]]:
    """What pytest says at its start, and the tests that it finds, where there is no program but Python."""
    environment = {name: value for name, value in os.environ.items() if name not in ("CI", "PYTEST_ADDOPTS")}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--collect-only", *files],
        cwd=ROOT,
        env={**environment, "PATH": str(tmp_path), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode in (0, 5), done.stdout + done.stderr  # 5: none was found
    lines = [line.strip() for line in done.stdout.splitlines()]
    assert "skipped" not in lines[-1]
    return done.stdout, [line for line in lines if line.startswith("<Function")]


def test_tests_for_node_are_left_out_where_there_is_none_and_the_others_are_not(tmp_path: Path) -> None:
    said, found = collected(tmp_path, "tests/test_node.py", "tests/test_other_readers.py")
    assert "left out: the tests that ask Node.js" in said
    names = {name.removeprefix("<Function ").rstrip(">").partition("[")[0] for name in found}
    assert "test_mcaps_own_readers_find_every_row" in names
    assert "test_mcaps_own_reader_finds_every_payload_with_the_checksums_right" in names
    assert not [name for name in names if "viewers_reader" in name]
