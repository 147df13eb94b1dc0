"""When the writer seals a buffer that is not full, and what it has done before the first block."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

from ml_dash_mcap import Recorder, RecorderOptions

QUIET = RecorderOptions(chunk_bytes=65536, backlog_bytes=4 * 65536, flush_interval_s=60, sync_interval_s=0)


def test_a_buffer_that_began_when_another_was_full_is_sealed_at_the_next_tick_only(tmp_path: Path) -> None:
    """Two blocks at once would hold a thread that appends at full speed up for both."""
    with Recorder(tmp_path, QUIET) as recorder:
        journal, writer = recorder._journal, recorder._writer
        first = journal.active
        number = 0
        while journal.active is first:
            recorder.topic("a").append(n=number, text="x" * 900, _ts=float(number))
            number += 1
        writer._tick()
        assert len(journal.active.starts) == 1
        assert writer._tick_at() == journal.active.begun_s + 60
        writer._tick()
        assert not journal.active.starts
        recorder.topic("a").append(n=number, _ts=float(number))
        writer._tick()
        assert not journal.active.starts


def test_the_first_block_waits_for_no_import(tmp_path: Path) -> None:
    program = f"""
        import sys
        from ml_dash_mcap import Recorder
        with Recorder({str(tmp_path)!r}) as recorder:
            arm = recorder.topic("arm")
            before = set(sys.modules)
            arm.append(q=[1.0, 2.0], _ts=1.0).append(n=1, text="x", _ts=1.0).append(n=2, _ts=1.0).flush()
            print(sorted(name for name in set(sys.modules) - before if "ml_dash_mcap" in name))
    """
    ran = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"
