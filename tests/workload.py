"""A recording that says about itself what must be in it: rows by number, merges among them, metrics, parameters."""

from __future__ import annotations

import mmap
import os
import random
import signal
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder, open_topic
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.topic import EventTopic
from tests.faulty_os import calls_go_through, dies_at
from tests.support import disk

Row = dict[str, Any]

ARM, IMU, METRIC, STEP = "arm", "imu", "ml_dash/metrics/train", "step"
KINDS = (ARM, IMU, METRIC, STEP)
"""What is recorded: a track whose rows merge three by three, one whose rows do not, a metric, a parameter."""

OPTIONS: dict[str, Any] = {"chunk_bytes": 65536, "backlog_bytes": 4 * 65536, "flush_interval_s": 0.02}


def encoding_of(seed: int) -> str:
    """What tracks are encoded in: every third recording in CBOR or protobuf."""
    return ("json", "cbor", "protobuf")[seed % 3]


def arm(number: int) -> Row:
    """One of three rows of one time stamp, with a field of its own and one that the next one replaces."""
    return {"abc"[number % 3]: number, "last": {"number": number}, "_ts": number // 3 / 30}


def imu(number: int) -> Row:
    """A row alone at its time; its schema widens on the way."""
    extra = {"late": [number, 0.5]} if number > 300 else {}
    return {"a": [number, None, 0.1 * number], **extra, "_ts": number * 1e-3}


def recorded(kind: str, count: int) -> list[Row]:
    """What a reader is to find after `count` rows of a track."""
    merged: dict[float, Row] = {}
    for number in range(count):
        row = arm(number) if kind == ARM else imu(number)
        merged.setdefault(row["_ts"], {}).update(row)
    return [merged[time] for time in sorted(merged)]


class Progress:
    """How many rows of each kind `append` has returned for; kept in a file, so that it outlives its process."""

    _layout = struct.Struct("<4Q")

    def __init__(self, path: Path) -> None:
        if not path.exists():
            path.write_bytes(bytes(self._layout.size))
        descriptor = os.open(path, os.O_RDWR)
        self._memory = mmap.mmap(descriptor, self._layout.size)
        os.close(descriptor)

    def note(self, kind: str, count: int) -> None:
        at = 8 * KINDS.index(kind)
        self._memory[at : at + 8] = count.to_bytes(8, "little")  # at once; struct.pack_into writes zeros first

    def counts(self) -> dict[str, int]:
        return dict(zip(KINDS, self._layout.unpack(self._memory), strict=True))


def actions(recorder: Recorder, seed: int) -> Iterator[tuple[str, int]]:
    """Record for ever, in an order that the seed makes; yields what was taken and how many of it there are now."""
    chance = random.Random(seed)
    tracks = {ARM: recorder.topic(ARM), IMU: recorder.topic(IMU)}
    metric = open_topic(recorder, METRIC, "metric", EventTopic)
    counts = dict.fromkeys(KINDS, 0)
    while True:
        kind = chance.choices(KINDS, (50, 50, 5, 1))[0]
        number = counts[kind]
        if kind in tracks:
            tracks[kind].append(**(arm(number) if kind == ARM else imu(number)))
        elif kind == METRIC:
            metric.add({"loss": number})
        else:
            recorder.set_parameters({"step": number + 1})
        counts[kind] = number + 1
        yield kind, number + 1


def record(folder: str, progress: str, seed: int, until: int, **options: Any) -> Recorder:
    """Record some actions, with a flush before the last third of them, and return without closing."""
    said = Progress(Path(progress))
    recorder = Recorder(folder, RecorderOptions(**{**OPTIONS, "encoding": encoding_of(seed), **options}))
    taken = actions(recorder, seed)
    for number in range(until):
        said.note(*next(taken))
        if number == until * 2 // 3:
            recorder.flush()
    return recorder


def lost_or_twice(folder: Path, accepted: dict[str, int], in_flight: int = 1) -> list[str]:
    """What is wrong with a recording of which so much was accepted: one sentence each.

    Args:
        folder: The run's folder; its recorder is dead or closed.
        accepted: By kind, how many `append` returned for.
        in_flight: How many more there may be, whose `append` had not returned.
    """
    wrong: list[str] = []
    with Recording(folder) as recording:
        for kind in (ARM, IMU):
            found = list(recording[kind].rows()) if kind in recording else []
            possible = [recorded(kind, accepted[kind] + more) for more in range(in_flight + 1)]
            if found not in possible:
                wrong.append(f"{kind}: {len(found)} rows were read for {len(possible[0])} accepted, or other ones")
        parameters = recording.params.get("step", 0)
    if not accepted[STEP] <= parameters <= accepted[STEP] + in_flight:
        wrong.append(f"the parameter is {parameters} after {accepted[STEP]} settings")
    return wrong + _repeated(folder, accepted, in_flight)


def _repeated(folder: Path, accepted: dict[str, int], in_flight: int) -> list[str]:
    """What stands in the files twice, which a reader that merges would not show; mcap's own reader is asked."""
    wrong: list[str] = []
    raw = disk.rows(folder)
    losses = sorted(row["loss"] for row in raw.get(METRIC, []))
    if losses not in [list(range(accepted[METRIC] + more)) for more in range(in_flight + 1)]:
        wrong.append(f"the metric has {len(losses)} rows ({losses[:3]} ... {losses[-3:]}) after {accepted[METRIC]}")
    for kind, fields in ((ARM, "abc"), (IMU, ["_ts"])):
        for field in fields:
            values = [row[field] for row in raw.get(kind, []) if field in row]
            if len(values) != len(set(values)):
                wrong.append(f"{kind}: {len(values) - len(set(values))} values of {field} are in the files twice")
    return wrong


# -- what children of the zygote do ------------------------------------------------------------------------------------


def record_until_killed(folder: str, progress: str, seed: int, signal_at: int, fifo: str) -> None:
    """Record for ever; say through a fifo when so many actions are done."""
    with open(fifo, "wb", buffering=0) as said_when:
        said = Progress(Path(progress))
        taken = actions(Recorder(folder, RecorderOptions(**OPTIONS, encoding=encoding_of(seed))), seed)
        for count, (kind, number) in enumerate(taken, 1):
            said.note(kind, number)
            if count == signal_at:
                said_when.write(b"!")


def record_and_end(folder: str, progress: str, seed: int, until: int, way: str, flush_interval_s: float) -> None:
    """Record and then end in one of the ways in which a process ends without being asked."""
    import ctypes

    record(folder, progress, seed, until, flush_interval_s=flush_interval_s)
    ends = {
        "os._exit": lambda: os._exit(0),
        "segmentation fault": lambda: ctypes.string_at(0),
        "abort": os.abort,
        "SIGKILL": lambda: os.kill(os.getpid(), signal.SIGKILL),
        "SIGTERM": lambda: os.kill(os.getpid(), signal.SIGTERM),
    }
    ends[way]()


def record_and_die_at_call(folder: str, progress: str, seed: int, until: int, number: int, before: bool) -> None:
    """Record and close, and be killed at one of the system calls on the segments, if there are so many."""
    with calls_go_through(Path(folder), dies_at(number, before=before)):
        recorder = record(folder, progress, seed, until, segment_bytes=65536)
        recorder.flush()
        recorder.close()


def recover_and_die_at_call(folder: str, number: int, before: bool) -> None:
    """Open a recording, which recovers it, and be killed at one of the system calls on the segments."""
    with calls_go_through(Path(folder), dies_at(number, before=before)):
        Recording(folder).close()


def recover_until_killed(folder: str, fifo: str) -> None:
    """Say that recovery begins, and recover."""
    with open(fifo, "wb", buffering=0) as said_when:
        said_when.write(b"!")
        Recording(folder).close()
