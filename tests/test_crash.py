"""What `append` returned for is read back after the process died, whenever and however it died, and nothing twice."""

from __future__ import annotations

import os
import random
import signal
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader

from ml_dash_mcap.catalog import recordings
from ml_dash_mcap.cli import main
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.recovery import recover
from tests.support import disk
from tests.support.records import Message, Opcode
from tests.workload import ARM, IMU, Progress, lost_or_twice
from tests.zygote import Zygote

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="the children are forked"),
    pytest.mark.skipif(sys.platform != "linux", reason="calls are told apart through /proc"),
]


@pytest.fixture(scope="module")
def zygote() -> Iterator[Zygote]:
    with Zygote() as one:
        yield one


def said(folder: Path) -> Progress:
    return Progress(folder.parent / "progress")


def crashed(
    zygote: Zygote,
    folder: Path,
    *,
    seed: int = 0,
    until: int = 1500,
    way: str = "os._exit",
    flush_interval_s: float = 0.02,
) -> dict[str, int]:
    """Leave a crashed recording; returns what was accepted."""
    arguments = str(folder), str(folder.parent / "progress"), seed, until, way, flush_interval_s
    zygote.run("tests.workload:record_and_end", *arguments)
    return said(folder).counts()


def journals(folder: Path) -> list[Path]:
    """The buffers that a recorder of this folder left behind."""
    places = [Path("/dev/shm"), folder]
    sessions = [path.stem.removeprefix(".ml_dash-") for path in folder.glob(".ml_dash-*.json")]
    return [path for place in places for session in sessions for path in place.glob(f".ml_dash-{session}-*.journal")]


@pytest.mark.parametrize("seed", range(50))
def test_a_kill_at_any_moment_loses_no_row_that_was_accepted_and_repeats_none(
    zygote: Zygote, tmp_path: Path, seed: int
) -> None:
    folder, fifo = tmp_path / "run", tmp_path / "fifo"
    os.mkfifo(fifo)
    signal_at = int(10 ** random.Random(seed).uniform(0, 4))
    arguments = str(folder), str(tmp_path / "progress"), seed, signal_at, str(fifo)
    pid = zygote.fork("tests.workload:record_until_killed", *arguments)
    with fifo.open("rb") as begun:
        assert begun.read(1) == b"!"
    os.kill(pid, signal.SIGKILL)
    assert zygote.wait(pid) == -signal.SIGKILL
    assert lost_or_twice(folder, said(folder).counts()) == []
    assert sorted(folder.glob(".ml_dash-*")) + sorted(folder.glob("*.active")) == []


@pytest.mark.parametrize("way", ["os._exit", "segmentation fault", "abort", "SIGKILL", "SIGTERM"])
def test_no_way_of_ending_loses_a_row(zygote: Zygote, tmp_path: Path, way: str) -> None:
    accepted = crashed(zygote, tmp_path / "run", way=way)
    assert sum(accepted.values()) == 1500
    assert lost_or_twice(tmp_path / "run", accepted, in_flight=0) == []


@pytest.mark.parametrize("before", [True, False], ids=["in the middle of", "right after"])
def test_death_at_any_system_call_of_the_writer_loses_nothing(zygote: Zygote, tmp_path: Path, before: bool) -> None:
    wrong, number, ended = [], 0, -signal.SIGKILL
    while ended == -signal.SIGKILL:
        number += 1
        folder = tmp_path / str(number) / "run"
        folder.mkdir(parents=True)
        progress = folder.parent / "progress"
        ended = zygote.run(
            "tests.workload:record_and_die_at_call", str(folder), str(progress), number, 2000, number, before
        )
        if progress.exists():
            wrong += [f"call {number}: {one}" for one in lost_or_twice(folder, said(folder).counts())]
    assert (ended, wrong) == (0, [])
    assert number > 15


@pytest.mark.parametrize("before", [True, False], ids=["in the middle of", "right after"])
def test_death_at_any_system_call_of_a_recovery_loses_nothing(zygote: Zygote, tmp_path: Path, before: bool) -> None:
    wrong, number, ended = [], 0, -signal.SIGKILL
    while ended == -signal.SIGKILL:
        number += 1
        folder = tmp_path / str(number) / "run"
        folder.mkdir(parents=True)
        accepted = crashed(zygote, folder, seed=number)
        ended = zygote.run("tests.workload:recover_and_die_at_call", str(folder), number, before)
        wrong += [f"call {number}: {one}" for one in lost_or_twice(folder, accepted, in_flight=0)]
    assert (ended, wrong) == (0, [])
    assert number > 8


def test_a_recovery_killed_again_and_again_loses_nothing(zygote: Zygote, tmp_path: Path) -> None:
    folder, fifo = tmp_path / "run", tmp_path / "fifo"
    os.mkfifo(fifo)
    accepted = crashed(zygote, folder, until=4000)
    for _ in range(10):
        pid = zygote.fork("tests.workload:recover_until_killed", str(folder), str(fifo))
        with fifo.open("rb") as begun:
            begun.read(1)
        os.kill(pid, signal.SIGKILL)
        zygote.wait(pid)
    assert lost_or_twice(folder, accepted, in_flight=0) == []


def test_every_new_recorder_on_the_folder_goes_on_where_the_dead_one_ended(zygote: Zygote, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    for start in range(0, 30, 10):
        zygote.run("tests.test_crash:append_and_die", str(folder), start, 10)
    with Recorder(folder) as recorder:
        recorder.topic("a").append(n=30, _ts=30.0)
    with Recording(folder) as recording:
        assert [row["n"] for row in recording["a"].rows()] == list(range(31))
        assert {row["merged"] for row in recording["b"].rows()} == {20}


def append_and_die(folder: str, start: int, count: int) -> None:
    recorder = Recorder(folder)
    for number in range(start, start + count):
        recorder.topic("a").append(n=number, _ts=float(number))
    recorder.topic("b").append(**{f"from{start}": start, "merged": start}, _ts=1.0)
    os._exit(0)


def test_a_torn_segment_is_cut_where_it_is_sound_and_the_journal_still_folded_in(
    zygote: Zygote, tmp_path: Path
) -> None:
    wrong = []
    for seed in range(12):
        folder = tmp_path / str(seed) / "run"
        folder.mkdir(parents=True)
        # The rows after the flush stay in the journal, however slow the machine is.
        accepted = crashed(zygote, folder, seed=seed, until=1200, flush_interval_s=3600.0)
        (active,) = folder.glob("*.active")
        torn = random.Random(seed).randint(0, active.stat().st_size) if seed > 2 else seed * 7
        os.truncate(active, torn)
        with Recording(folder) as recording:
            for kind in (ARM, IMU):
                found = list(recording[kind].rows()) if kind in recording else []
                times = [row["_ts"] for row in found]
                if times != sorted(set(times)):
                    wrong.append(f"seed {seed}, {kind}: not in order")
                last = accepted[kind] - 1
                if not found or found[-1]["_ts"] != (last // 3 / 30 if kind == ARM else last * 1e-3):
                    wrong.append(f"seed {seed}, torn at {torn}, {kind}: the journal's rows are missing")
        if left := sorted(path.name for path in [*folder.glob("*.active"), *folder.glob(".ml_dash-*")]):
            wrong.append(f"seed {seed}, torn at {torn}: {left} stay behind")
    assert wrong == []


def test_an_empty_segment_without_a_header_does_not_stop_a_recovery(zygote: Zygote, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    accepted = crashed(zygote, folder)
    (folder / "20200101T000000.000000Z_000001.mcap.active").touch()
    (folder / "20200101T000000.000000Z_000002.mcap.active").write_bytes(b"\x89MC")
    stray = folder / "20200101T000000.000000Z_000003.mcap.active"
    stray.write_bytes(b"no mcap at all, but long enough for a header")
    recover(folder)
    stray.unlink()
    assert lost_or_twice(folder, accepted, in_flight=0) == []


def test_a_damaged_session_file_does_not_keep_the_others_from_being_recovered(zygote: Zygote, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    accepted = crashed(zygote, folder)
    for number, content in enumerate(
        [b"", b"{", b"[1]", b"null", b'{"session": 5, "journals": 7, "about": [1]}', b"\xff\xfe"]
    ):
        (folder / f".ml_dash-0{number}.json").write_bytes(content)
    assert lost_or_twice(folder, accepted, in_flight=0) == []


def test_a_damaged_journal_buffer_does_not_keep_the_others_from_being_recovered(zygote: Zygote, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    zygote.run("tests.test_crash:append_and_die", str(folder), 0, 10)
    (first, *_) = journals(folder)
    header = bytes.fromhex("894d434150300d0a")
    for number, junk in enumerate(
        [b"", header, header + b"\x01" + b"\xff" * 8, header + b"\x03" + bytes(8) + b"\x05" * 99]
    ):
        first.with_name(first.name.replace("-0.journal", f"-9{number}.journal")).write_bytes(junk)
    with Recording(folder) as recording:
        assert [row["n"] for row in recording["a"].rows()] == list(range(10))


def test_a_dead_recording_is_read_as_it_lies_and_left_so_if_nothing_is_to_be_recovered(
    zygote: Zygote, tmp_path: Path
) -> None:
    accepted = crashed(zygote, tmp_path / "run", until=20_000)
    [active] = (tmp_path / "run").glob("*.active")
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in (tmp_path / "run").iterdir()}
    left = journals(tmp_path / "run")
    with Recording(tmp_path / "run", recover=False) as rec:
        assert active in rec.segments
        assert not rec.finished
        assert 0 < sum(len(rec[name]) for name in rec) < sum(accepted.values())
    [entry] = recordings(tmp_path, recover=False)
    assert entry.status == "unfinished"
    assert main(["info", str(tmp_path / "run"), "--no-recover"]) == 0
    assert main(["ls", str(tmp_path), "--no-recover"]) == 0
    after = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in (tmp_path / "run").iterdir()}
    assert after == before
    assert journals(tmp_path / "run") == left != []
    assert lost_or_twice(tmp_path / "run", accepted, in_flight=0) == []  # opening it as usual has them all


def test_recovery_leaves_a_living_recorder_alone(zygote: Zygote, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    accepted = crashed(zygote, folder, until=500)
    living = Recorder(folder)
    living.topic("living").append(x=1, _ts=1.0)
    Recording(folder).close()
    living.topic("living").append(x=2, _ts=2.0)
    living.close()
    assert disk.rows(folder)["living"] == [{"x": 1, "_ts": 1.0}, {"x": 2, "_ts": 2.0}]
    assert lost_or_twice(folder, accepted, in_flight=0) == []


def test_the_segments_that_a_recovery_makes_say_so_and_keep_the_recordings_metadata(
    zygote: Zygote, tmp_path: Path
) -> None:
    zygote.run("tests.test_crash:append_and_die", str(tmp_path / "run"), 0, 10)
    Recording(tmp_path / "run").close()
    about = disk.metadata(tmp_path / "run", "ml_dash")[-1]
    assert (about["prefix"], about["recovered"]) == ("run", "true")
    assert sorted(path for path in Path("/dev/shm").glob(f".ml_dash-{about['run']}*")) == []


def test_a_leftover_buffer_is_an_mcap_file_without_an_end_that_any_walker_reads(zygote: Zygote, tmp_path: Path) -> None:
    zygote.run("tests.test_crash:append_and_die", str(tmp_path / "run"), 0, 10)
    found = [
        journal
        for journal in journals(tmp_path / "run")
        if journal.read_bytes()[:8] == bytes.fromhex("894d434150300d0a")
    ]
    (journal,) = found
    kinds, topics, rows = [], {}, []
    try:
        with journal.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True).records:
                kinds.append(type(record).__name__)
                if kinds[-1] == "Channel":
                    topics[record.id] = record.topic
                elif kinds[-1] == "Message":
                    rows.append((topics[record.channel_id], record.log_time))
    except (McapError, EOFError, struct.error):
        pass  # it has no end
    assert kinds[:2] == ["Header", "Metadata"]
    assert rows == [("a", number * 10**9) for number in range(10)] + [("b", 10**9)]


def test_a_half_written_record_in_a_leftover_buffer_is_not_read(zygote: Zygote, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    zygote.run("tests.test_crash:append_and_die", str(folder), 0, 10)
    (journal,) = [one for one in journals(folder) if one.read_bytes()[:1] == b"\x89"]
    data = bytearray(journal.read_bytes())
    end = len(data.rstrip(b"\0"))
    length = 22 + 30
    data[end + 1 : end + 9 + length] = length.to_bytes(8, "little") + bytes((1, 0)) + b"\x01" * (length - 2)
    journal.write_bytes(data)  # all of a Message but its first byte, the opcode
    assert Opcode.MESSAGE == 5
    assert Message.__name__ == "Message"
    with Recording(folder) as recording:
        assert len(list(recording["a"].rows())) == 10
