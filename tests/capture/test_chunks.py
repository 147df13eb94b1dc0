"""Which topics share a chunk: those with much in a block have one of their own, so that a reader unpacks no other."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.recovery import recover
from tests.support import disk


def topics_by_chunk(path: Path) -> list[list[str]]:
    """The topics of each chunk, in the order of the file, as mcap's own reader sees them."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    found = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
    return [sorted(summary.channels[one].topic for one in index.message_index_offsets) for index in found]


def record(folder: Path, options: RecorderOptions | None = None, flushes: int = 1) -> None:
    random = np.random.default_rng(0)
    with Recorder(folder, options) as recorder:
        for step in range(200 * flushes):
            time = step / 1000
            recorder.topic("arm").append(q=random.random(29), n=step, _ts=time)
            recorder.topic("hand").append(q=random.random(29), n=step, _ts=time)
            if step % 10 == 0:
                recorder.topic("battery").append(volts=24.0, n=step, _ts=time)
                recorder.topic("mode").append(name="reach", n=step, _ts=time)
            if step % 200 == 199:
                recorder.flush()


def test_topics_with_much_in_a_block_have_a_chunk_of_their_own_and_the_others_share_one(tmp_path: Path) -> None:
    record(tmp_path, flushes=3)
    (path,) = disk.segments(tmp_path)
    assert topics_by_chunk(path) == 3 * [["arm"], ["hand"], ["battery", "mode"]]


def test_topics_with_little_in_a_block_share_one_chunk(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for step in range(50):
            recorder.topic("a").append(n=step, _ts=step / 10)
            recorder.topic("b").append(n=step, _ts=step / 10)
    (path,) = disk.segments(tmp_path)
    assert topics_by_chunk(path) == [["a", "b"]]


def test_rows_that_were_taken_apart_come_back_whole_and_in_their_order(tmp_path: Path) -> None:
    record(tmp_path, flushes=3)
    rows = disk.rows(tmp_path)
    assert [row["n"] for row in rows["arm"]] == [row["n"] for row in rows["hand"]] == list(range(600))
    assert [row["n"] for row in rows["battery"]] == list(range(0, 600, 10))
    with Recording(tmp_path) as recording:
        assert list(recording["arm"].rows()) == rows["arm"]


def test_a_window_of_one_topic_reads_no_other_topics_chunk(tmp_path: Path) -> None:
    record(tmp_path, flushes=5)
    (path,) = disk.segments(tmp_path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    names = {one: channel.topic for one, channel in summary.channels.items()}
    with Recording(tmp_path) as recording:
        (file_read,) = recording._opened()
        before = file_read.source.bytes_read
        assert len(list(recording["arm"].rows(0.25, 0.35))) == 101
        taken = file_read.source.bytes_read - before
    arms = [index for index in summary.chunk_indexes if [names[one] for one in index.message_index_offsets] == ["arm"]]
    own = [index for index in arms if index.message_start_time <= 350_000_000 and index.message_end_time >= 250_000_000]
    assert len(own) == 1
    assert taken == sum(index.chunk_length + index.message_index_length for index in own)


def test_a_power_cut_inside_a_block_leaves_those_of_its_chunks_that_are_whole(tmp_path: Path) -> None:
    record(tmp_path, flushes=2)
    (path,) = disk.segments(tmp_path)
    topics = topics_by_chunk(path)
    starts = disk.chunk_starts(path)
    (run,) = [about["run"] for about in disk.metadata(tmp_path, "ml_dash")]
    active = path.with_name(path.name + ".active")
    path.rename(active)
    assert topics[4] == ["hand"]
    os.truncate(active, starts[4] + 100)  # in the second block: behind the arm, in the hand
    (tmp_path / f".ml_dash-{run}.json").write_text(f'{{"session": "{run}"}}')
    done = recover(tmp_path)
    assert [found.name for found in done.finished] == [path.name]
    with Recording(tmp_path) as recording:
        assert [row["n"] for row in recording["arm"].rows()] == list(range(400))
        assert [row["n"] for row in recording["hand"].rows()] == list(range(200))
        assert [row["n"] for row in recording["mode"].rows()] == list(range(0, 200, 10))
