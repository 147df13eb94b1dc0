"""What a compiled `append` returned for is read back after a SIGKILL at full speed, and no half of a row."""

from __future__ import annotations

import mmap
import os
import random
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.topic import Topic
from tests.support import disk
from tests.zygote import Zygote

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="the children are forked"),
    pytest.mark.skipif(sys.platform != "linux", reason="journals are looked for in /dev/shm"),
]

Row = dict[str, Any]


def row(kind: str, number: int) -> Row:
    """A row whose bytes all say its number."""
    time_s = 0.5 + number * 1e-3
    value = float(number)
    if kind == "of one length":
        return {"n": number, "q": [value] * 7, "dq": [value] * 22, "_ts": time_s}
    if kind == "with text":
        return {"n": number, "q": [value] * 7, "mode": f"{number}," * (number % 40), "_ts": time_s}
    # The layout grows, other rows come between, and integers and doubles alternate.
    late: Row = {f"late{number // 400 % 40}": value} if number % 400 == 399 else {}
    return {"n": number, "q": [value] * 3, "x": value if number // 50 % 2 else number, **late, "_ts": time_s}


KINDS: dict[str, dict[str, Any]] = {
    "of one length": {},
    "with text": {"chunk_bytes": 65536, "backlog_bytes": 4 * 65536, "flush_interval_s": 0.02},
    "that change": {"chunk_bytes": 65536, "segment_bytes": 10**6, "sync_interval_s": 0.0},
}
"""The kinds of rows, with the options of their recorder."""


def append_until_killed(folder: str, progress: str, kind: str, signal_at: int, fifo: str) -> None:
    """Append for ever, and say through a fifo when so many rows are taken; the progress says how many are."""
    with open(progress, "r+b") as file, open(fifo, "wb", buffering=0) as started:
        memory = mmap.mmap(file.fileno(), 8)
        topic = Recorder(folder, RecorderOptions(encoding="protobuf", **KINDS[kind])).topic("a")
        number = 0
        while True:
            topic.append(**row(kind, number))
            number += 1
            memory[0:8] = number.to_bytes(8, "little")
            if number == signal_at:
                started.write(b"!" if type(topic).append is not Topic.append or signal_at < 50 else b"?")


@pytest.fixture(scope="module")
def zygote() -> Iterator[Zygote]:
    with Zygote() as process:
        yield process


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(8))
def test_a_kill_in_the_midst_of_compiled_appends_loses_no_row_and_leaves_no_half(
    zygote: Zygote, tmp_path: Path, kind: str, seed: int
) -> None:
    folder, fifo, progress = tmp_path / "run", tmp_path / "fifo", tmp_path / "progress"
    os.mkfifo(fifo)
    progress.write_bytes(bytes(8))
    signal_at = int(10 ** random.Random(f"{kind} {seed}").uniform(0, 4))
    pid = zygote.fork(
        "tests.test_compiled_crash:append_until_killed", str(folder), str(progress), kind, signal_at, str(fifo)
    )
    with fifo.open("rb") as begun:
        assert begun.read(1) in (b"!", b"?" if kind == "that change" else b"!")
    os.kill(pid, signal.SIGKILL)
    assert zygote.wait(pid) == -signal.SIGKILL
    accepted = int.from_bytes(progress.read_bytes(), "little")
    with Recording(folder) as recording:
        rows = list(recording["a"].rows())
    assert len(rows) in (accepted, accepted + 1)
    assert rows == [row(kind, number) for number in range(len(rows))]
    assert [row_["n"] for row_ in disk.rows(folder)["a"]] == list(range(len(rows)))
