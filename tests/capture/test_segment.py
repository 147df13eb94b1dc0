"""Segments: named in the order of writing, in progress until they are whole, each complete in itself."""

from __future__ import annotations

import json
import logging
import math
import time
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import Summary
from mcap.records import ChunkIndex

from ml_dash_mcap.capture.topic_registry import TopicAbout
from ml_dash_mcap.codecs.own_rows import own_schema
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder, open_topic
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.topic import EventTopic
from tests.support import disk

LOG = "ml_dash/log"


def summary(path: Path) -> Summary:
    with disk._open(path) as reader:
        found = reader.get_summary()
    assert found is not None
    return found


def chunks(folder: Path) -> list[ChunkIndex]:
    return [index for path in disk.segments(folder) for index in summary(path).chunk_indexes]


def test_a_segment_in_progress_has_a_name_that_no_viewer_opens(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(x=1, _ts=1.0).flush()
        (active,) = (path for path in tmp_path.iterdir() if not path.name.startswith("."))
        assert active.name.endswith(".mcap.active")
    (finished,) = tmp_path.iterdir()
    assert finished.name == active.name.removesuffix(".active")


def test_a_name_says_when_in_utc_and_sorts_in_the_order_of_writing(tmp_path: Path) -> None:
    before = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    for _ in range(3):
        with Recorder(tmp_path, RecorderOptions(segment_duration_s=1e-9)) as recorder:
            for number in range(4):
                recorder.topic("a").append(n=number, _ts=float(number)).flush()
    abouts = disk.metadata(tmp_path, "ml_dash")
    assert len(disk.segments(tmp_path)) == 12
    assert disk.segments(tmp_path)[0].name[:15] >= before
    starts = [about["start"] for about in disk.metadata(tmp_path, "ml_dash")]
    assert starts == sorted(starts)
    assert {"prefix", "run", "segment", "start", "host", "library", "clock", "first_block"} <= abouts[0].keys()


def test_a_clock_that_was_set_back_does_not_put_new_segments_before_old_ones(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(x="old", y="old", _ts=1.0)
    (old,) = disk.segments(tmp_path)
    old.rename(tmp_path / "29990101T000000.000000Z_000001.mcap")
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(x="new", _ts=1.0)
    assert len(disk.segments(tmp_path)) == 2
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{"x": "new", "y": "old", "_ts": 1.0}]


def test_nothing_that_has_the_name_of_a_segment_is_overwritten(tmp_path: Path) -> None:
    for suffix in ("", ".active"):
        (tmp_path / f"29990101T000000.000000Z_000001.mcap{suffix}").mkdir()
        (tmp_path / f"29990101T000000.000000Z_000003.mcap{suffix}").mkdir()
    code_name = "29990101T000000.000000Z"
    recorder = Recorder(tmp_path, RecorderOptions(segment_duration_s=1e-9))
    for number in range(3):
        recorder.topic("a").append(n=number, _ts=float(number)).flush()
    recorder.close()
    names = sorted(path.name for path in tmp_path.glob("*.mcap") if path.is_file())
    assert names == [f"{code_name}_{number:06d}.mcap" for number in (2, 4, 5)]


def test_every_chunk_has_rows_an_index_and_no_more_than_a_buffer(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=262144)) as recorder:
        for number in range(3000):
            recorder.topic("ab"[number % 2]).append(n=number, _ts=float(number))
            if number % 1000 == 0:
                recorder.flush()
                recorder.flush()
                recorder.set_parameters({"n": number})
    found = chunks(tmp_path)
    assert len(found) > 3
    assert all(65536 > index.uncompressed_size > 0 and index.message_index_offsets for index in found)
    assert [index.compression for index in found] == ["zstd"] * len(found)
    assert found[0].message_start_time == 0


def test_the_sequence_counts_the_rows_of_a_topic(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(segment_duration_s=1e-9)) as recorder:
        for number in range(20):
            recorder.topic("ab"[number % 2]).append(n=number, _ts=float(number))
            if number % 7 == 0:
                recorder.flush()
    sequences: dict[str, list[int]] = {}
    for path in disk.segments(tmp_path):
        with disk._open(path) as reader:
            for _, channel, message in reader.iter_messages():
                sequences.setdefault(channel.topic, []).append(message.sequence)
    assert sequences == {"a": list(range(10)), "b": list(range(10))}


def test_a_later_segment_repeats_the_parameters_and_the_topics_it_has_rows_of(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(segment_duration_s=1e-9)) as recorder:
        recorder.set_parameters({"lr": 0.1, "bad": math.nan})
        recorder.topic("a", description="one").append(x=1, _ts=1.0).flush()
        recorder.topic("b").append(x=1, _ts=1.0).flush()
    first, second = disk.segments(tmp_path)
    assert [channel.topic for channel in summary(first).channels.values()] == ["a"]
    assert [channel.topic for channel in summary(second).channels.values()] == ["b"]
    said = json.loads(disk.metadata(tmp_path, "ml_dash")[-1]["parameters"])
    assert repr(said) == "{'lr': 0.1, 'bad': nan}"
    with Recording(second) as recording:
        assert recording.params["lr"] == 0.1


def test_a_run_that_was_opened_three_times_is_one_recording(tmp_path: Path) -> None:
    for number in range(3):
        with Recorder(tmp_path) as recorder:
            recorder.topic("a").append(**{f"f{number}": number, "last": number}, _ts=1.0)
            recorder.topic("a").append(n=number, _ts=2.0 + number)
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [
            {"f0": 0, "f1": 1, "f2": 2, "last": 2, "_ts": 1.0},
            {"n": 0, "_ts": 2.0},
            {"n": 1, "_ts": 3.0},
            {"n": 2, "_ts": 4.0},
        ]


class Events(EventTopic):
    __slots__ = ()


def log(recorder: Recorder, message: str) -> None:
    about = TopicAbout(schema=own_schema("ml_dash.log", "foxglove.Log"))
    open_topic(recorder, LOG, "log", Events, about).add({"message": message})


@pytest.mark.parametrize("flushed", [False, True], ids=["in one block", "flushed before"])
def test_logs_made_before_tracks_that_start_near_zero_do_not_stretch_a_file_to_today(
    tmp_path: Path, flushed: bool
) -> None:
    with Recorder(tmp_path) as recorder:
        log(recorder, "before")
        if flushed:
            recorder.flush()
        recorder.topic("a").append(x=1, _ts=0.5)
        log(recorder, "after")
        recorder.topic("a").append(x=2, _ts=1.5)
    for path in disk.segments(tmp_path):
        with disk._open(path) as reader:
            times = [message.log_time for _, _, message in reader.iter_messages()]
        assert max(times) - min(times) <= 10**9
    assert [row["message"] for row in disk.rows(tmp_path)[LOG]] == ["before", "after"]
    assert disk.metadata(tmp_path, "ml_dash")[-1]["clock"] in ("relative", "unknown")


def test_tracks_on_the_wall_clock_and_their_logs_are_in_one_file(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        log(recorder, "before")
        recorder.topic("a").append(x=1, _ts=time.time())
        log(recorder, "after")
    assert len(disk.segments(tmp_path)) == 1
    assert {topic: len(rows) for topic, rows in disk.rows(tmp_path).items()} == {LOG: 2, "a": 1}


def test_tracks_that_mix_clocks_are_warned_about_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING), Recorder(tmp_path) as recorder:
        for number in range(3):
            recorder.topic("a").append(x=1, _ts=float(number))
            recorder.topic("b").append(x=1, _ts=1.7e9 + number)
            recorder.flush()
    assert [record.levelname for record in caplog.records if "clock" in record.message] == ["WARNING"]
    assert disk.counts(tmp_path) == {"a": 3, "b": 3}


@pytest.mark.parametrize(
    "options", [{}, {"chunk_bytes": 65536, "backlog_bytes": 131072, "compression": "lz4"}], ids=["zstd", "lz4"]
)
def test_a_segment_in_progress_is_read_while_it_grows(tmp_path: Path, options: dict[str, Any]) -> None:
    with Recorder(tmp_path, RecorderOptions(**options)) as recorder, Recording(tmp_path) as recording:
        for number in range(5):
            recorder.topic("a").append(n=number, _ts=float(number)).flush()
            assert recording.refresh()
            assert [row["n"] for row in recording["a"].rows()] == list(range(number + 1))
