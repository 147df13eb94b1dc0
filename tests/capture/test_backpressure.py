"""When the disk stands still and the backlog is full, append waits, refuses or raises, and counts what it refuses."""

from __future__ import annotations

import errno
import itertools
import os
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.capture import writer
from ml_dash_mcap.errors import BacklogFullError, RecorderError, StorageError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder, open_topic
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.topic import EventTopic
from tests.faulty_os import calls_go_through, fails
from tests.support import disk

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="calls are told apart through /proc")

FILLER = "x" * 20_000


def options(on_full: Any, **more: Any) -> RecorderOptions:
    return RecorderOptions(chunk_bytes=65536, backlog_bytes=3 * 65536, on_full=on_full, sync_interval_s=0, **more)


@contextmanager
def a_disk_that_stands_still(folder: Path) -> Iterator[Callable[[], None]]:
    """Hold up every write to a segment until what this yields is called; it lets all further ones through."""
    go_on = threading.Event()

    def plan(number: int, name: str, call: Callable[[], Any]) -> Any:
        if name in ("writev", "write"):
            go_on.wait(60)
        return call()

    with calls_go_through(folder, plan):
        try:
            yield go_on.set
        finally:
            go_on.set()


def is_sound(stats: dict[str, Any]) -> bool:
    sums = stats["written"] + stats["waiting"] + stats["dropped"] == stats["accepted"]
    return sums and min(stats["written"], stats["waiting"], stats["dropped"]) >= 0


def test_with_block_append_waits_and_nothing_is_lost(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, options("block"))
    with a_disk_that_stands_still(tmp_path) as go_on:
        done: list[int] = []

        def produce() -> None:
            for number in range(60):
                recorder.topic("a").append(n=number, fill=FILLER, _ts=float(number))
                done.append(number)

        thread = threading.Thread(target=produce)
        thread.start()
        thread.join(0.3)
        assert thread.is_alive()
        assert len(done) < 12
        assert is_sound(recorder.stats())
        go_on()
        thread.join()
    recorder.close()
    assert [row["n"] for row in disk.rows(tmp_path)["a"]] == list(range(60))
    assert disk.metadata(tmp_path, "ml_dash.drops") == []


def test_with_drop_the_newest_rows_are_refused_and_counted_in_the_file(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, options("drop"))
    with a_disk_that_stands_still(tmp_path) as go_on:
        for number in range(100):
            recorder.topic("a").append(n=number, fill=FILLER, _ts=float(number))
        recorder.topic("b").append_batch([{"n": n, "fill": FILLER, "_ts": float(n)} for n in range(10)])
        recorder.topic("c").append_columns(_ts=np.arange(20.0), fill=[FILLER] * 20, n=np.arange(20))
        recorder.topic("d").append(fill=FILLER * 8, _ts=1.0)
        before = recorder.stats()
        go_on()
        recorder.flush()
        recorder.topic("a").append(n=1000, _ts=1000.0)
    recorder.close()
    found = disk.rows(tmp_path)
    taken = {topic: [row["n"] for row in listed] for topic, listed in found.items()}
    assert taken["a"] == [*range(len(taken["a"]) - 1), 1000]
    assert before["dropped_by_topic"] == {"a": 101 - len(taken["a"]), "b": 10, "c": 20, "d": 1}
    assert is_sound(before)
    assert before["accepted"] == 131
    stats = recorder.stats()
    assert (stats["accepted"], stats["waiting"], stats["written"]) == (132, 0, len(taken["a"]))
    assert disk.metadata(tmp_path, "ml_dash.drops") == [
        {topic: str(n) for topic, n in before["dropped_by_topic"].items()}
    ]


def test_with_raise_the_caller_hears_of_it_and_the_row_is_counted(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, options("raise"))
    refused = 0
    with a_disk_that_stands_still(tmp_path) as go_on:
        for number in range(30):
            try:
                recorder.topic("a").append(n=number, fill=FILLER, _ts=float(number))
            except BufferError:
                refused += 1
        with pytest.raises(BacklogFullError, match="'a'") as caught:
            recorder.topic("a").append_columns(_ts=np.arange(5.0), fill=[FILLER] * 5)
        assert isinstance(caught.value, RecorderError)
        with pytest.raises(BacklogFullError):
            recorder.topic("a").append(fill=FILLER * 9, _ts=1.0)
        stats = recorder.stats()
        go_on()
        recorder.close()
    assert refused > 15
    assert stats["dropped"] == refused + 6
    assert is_sound(stats)
    assert len(disk.rows(tmp_path)["a"]) == 30 - refused
    assert disk.metadata(tmp_path, "ml_dash.drops") == [{"a": str(refused + 6)}]


def test_logs_and_parameters_wait_for_room_or_are_counted_like_rows(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, options("drop"))
    metric = open_topic(recorder, "ml_dash/metrics/m", "metric", EventTopic)
    with a_disk_that_stands_still(tmp_path) as go_on:
        kept = sum(metric.add({"n": number, "fill": FILLER}) for number in range(50))
        waiting = threading.Thread(target=recorder.set_parameters, args=({f"p{n}": FILLER for n in range(3)},))
        waiting.start()
        waiting.join(0.2)
        assert waiting.is_alive()
        go_on()
        waiting.join()
    recorder.close()
    assert len(disk.rows(tmp_path)["ml_dash/metrics/m"]) == kept
    assert disk.metadata(tmp_path, "ml_dash.drops") == [{"ml_dash/metrics/m": str(50 - kept)}]
    with Recording(tmp_path) as recording:
        assert recording.params == {f"p{n}": FILLER for n in range(3)}


@pytest.mark.parametrize("on_full", ["block", "drop", "raise"])
def test_the_figures_add_up_at_every_moment(tmp_path: Path, on_full: str) -> None:
    recorder = Recorder(tmp_path, options(on_full))
    stop, samples = threading.Event(), []

    def sample() -> None:
        while not stop.is_set():
            samples.append(recorder.stats())

    def produce(number: int) -> None:
        topic = recorder.topic(f"t{number}")
        for row in range(80):
            try:
                topic.append(n=row, fill=FILLER, _ts=float(row))
                topic.append_columns(_ts=np.array([row + 0.5]), n=[row])
            except BacklogFullError:
                pass

    sampler = threading.Thread(target=sample)
    producers = [threading.Thread(target=produce, args=(number,)) for number in range(2)]
    for thread in [sampler, *producers]:
        thread.start()
    for thread in producers:
        thread.join()
    stop.set()
    sampler.join()
    recorder.close()
    samples.append(recorder.stats())
    assert [one for one in samples if not is_sound(one)] == []
    for name in ("accepted", "written", "dropped"):
        values = [one[name] for one in samples]
        assert values == sorted(values), f"{name} went back"
    last = samples[-1]
    assert last["waiting"] == 0
    assert sum(len(listed) for listed in disk.rows(tmp_path).values()) == last["written"]


def test_drops_are_said_once_even_if_the_end_of_the_file_has_to_be_written_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "_FIRST_RETRY_S", 0.001)
    for call in itertools.count(1):
        folder = tmp_path / str(call)
        recorder = Recorder(folder, options("drop"))
        with a_disk_that_stands_still(folder) as go_on:
            for number in range(20):
                recorder.topic("a").append(n=number, fill=FILLER, _ts=float(number))
            go_on()
            recorder.flush()
        dropped = recorder.stats()["dropped"]
        with calls_go_through(folder, fails(lambda number, name, call=call: number == call, errno.ENOSPC)) as calls:
            recorder.close()
        said = [int(count) for record in disk.metadata(folder, "ml_dash.drops") for count in record.values()]
        assert said == [dropped]
        if calls.count < call:
            return


def test_a_file_may_not_grow_beyond_the_systems_limit_but_the_recording_does(tmp_path: Path) -> None:
    code = """
        import resource, signal, sys
        from ml_dash_mcap.options import RecorderOptions
        from ml_dash_mcap.recorder import Recorder
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        options = RecorderOptions(chunk_bytes=65536, backlog_bytes=1 << 20, compression="none")
        with Recorder(sys.argv[1], options) as recorder:
            for number in range(2000):
                recorder.topic("a").append(n=number, fill="x" * 300, _ts=float(number))
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert [row["n"] for row in disk.rows(tmp_path)["a"]] == list(range(2000))
    assert len(disk.segments(tmp_path)) < 12


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"no small file system can be mounted here: {mounted.stderr.decode().strip()}")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


def test_a_real_disk_that_fills_up_and_gets_room_again_loses_nothing(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(900_000))
    run = small_disk / "run"
    noise = np.random.default_rng(0)
    recorder = Recorder(run, RecorderOptions(chunk_bytes=65536, backlog_bytes=1 << 20, flush_interval_s=0.02))
    for number in range(30):
        recorder.topic("a").append(n=number, fill=noise.bytes(9000), _ts=float(number))
    with pytest.raises(StorageError, match="space"):
        recorder.flush()
    ballast.unlink()
    recorder.close()
    assert [row["n"] for row in disk.rows(run)["a"]] == list(range(30))


def test_a_full_disk_with_a_full_backlog_is_an_error_and_no_hang(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "_CLOSE_PATIENCE_S", 0.1)
    recorder = Recorder(tmp_path, options("block"))
    with calls_go_through(tmp_path, fails(lambda number, name: name == "writev", errno.ENOSPC)):
        taken: list[int] = []

        def record() -> None:
            for number in range(100):
                recorder.topic("a").append(n=number, fill=FILLER, _ts=float(number))
                taken.append(number)

        with pytest.raises(StorageError, match="No space") as caught:
            record()
        assert isinstance(caught.value, OSError)
        assert is_sound(recorder.stats())
        with pytest.raises(StorageError):
            recorder.close()
    with Recording(tmp_path) as recording:
        assert [row["n"] for row in recording["a"].rows()] == taken
    assert os.listdir(tmp_path) == [path.name for path in disk.segments(tmp_path)]
