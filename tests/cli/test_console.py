"""The console's entry point: a process with its streams, pipes and terminals."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ml_dash_mcap import Recorder
from ml_dash_mcap.version import __version__

pty = pytest.importorskip("pty")

ROOT = Path(__file__).resolve().parents[2]
MODULE = [sys.executable, "-m", "ml_dash_mcap"]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"}


_WITHOUT_RICH = """
import importlib.util, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "rich" else find(name, *rest)
from ml_dash_mcap.cli import main
sys.exit(main())
"""


def call(*arguments: str | Path, command: list[str] = MODULE) -> subprocess.CompletedProcess[str]:
    words = [*command, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=60, env=ENVIRONMENT)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append_batch([{"text": "x" * 100, "_ts": step / 100} for step in range(5000)])
    return tmp_path / "run"


def on_a_terminal(*arguments: str | Path, without_rich: bool = False) -> str:
    """Run a command on a terminal; returns what it shows, without the codes that move and colour."""
    words = MODULE
    if without_rich:
        words = [sys.executable, "-c", _WITHOUT_RICH]
    ours, theirs = pty.openpty()
    environment = {**ENVIRONMENT, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(
        [*words, *map(str, arguments)], stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    ) as process:
        os.close(theirs)
        shown = b""
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # Linux says so that the other side is closed
                break
            if not part:
                break
            shown += part
        assert process.wait(60) == 0
    os.close(ours)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode())


def test_the_module_is_the_command() -> None:
    done = call("--version")
    assert (done.returncode, done.stdout) == (0, f"ml-dash-mcap {__version__}\n")


def test_the_installed_command_is_the_module(run: Path) -> None:
    script = shutil.which("ml-dash-mcap", path=str(Path(sys.executable).parent))
    if script is None:
        pytest.skip("the package is not installed here")
    assert call("info", run, command=[script]).stdout == call("info", run).stdout


def test_a_failure_has_no_traceback_and_its_code(tmp_path: Path) -> None:
    done = call("info", tmp_path / "nowhere")
    assert done.returncode == 1
    assert done.stderr == f"ml-dash-mcap: error: {tmp_path / 'nowhere'}: no recording here\n"


def test_a_pipe_that_closes_early_is_quiet(run: Path) -> None:
    words = [*MODULE, "cat", str(run), "robot"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith(b'{"_ts":0.0')
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(60) == 0


def test_a_terminal_gets_tables_and_a_pipe_gets_plain_text(run: Path) -> None:
    pytest.importorskip("rich")
    assert "─" in on_a_terminal("info", run)
    assert "─" not in call("info", run).stdout


def test_a_terminal_without_rich_gets_plain_text_and_percents(run: Path, tmp_path: Path) -> None:
    assert "topic  rows    rate  fields" in on_a_terminal("info", run, without_rich=True)
    said = on_a_terminal("export", run, tmp_path / "out", "--format", "csv", without_rich=True)
    assert "export csv: 100 %" in said
    assert said.rstrip().endswith(str(tmp_path / "out"))


def test_an_export_on_a_terminal_leaves_only_the_destination_to_be_read(run: Path, tmp_path: Path) -> None:
    pytest.importorskip("rich")
    said = on_a_terminal("export", run, tmp_path / "out", "--format", "jsonl")
    assert said.split()[-1] == str(tmp_path / "out")
