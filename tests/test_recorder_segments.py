"""Segments begin anew by size, time and schema; rows of every size find their place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.errors import FieldError, TopicError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.support import disk

Row = dict[str, Any]

SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=4 * 65536)


def test_a_segment_ends_at_its_size_and_the_next_goes_on(tmp_path: Path) -> None:
    with Recorder(
        tmp_path, RecorderOptions(chunk_bytes=65536, backlog_bytes=262144, segment_bytes=65536, compression="none")
    ) as recorder:
        for number in range(2000):
            recorder.topic("a").append(n=number, fill="x" * 200, _ts=float(number))
    assert len(disk.segments(tmp_path)) > 4
    assert max(path.stat().st_size for path in disk.segments(tmp_path)) < 4 * 65536
    assert [row["n"] for row in disk.rows(tmp_path)["a"]] == list(range(2000))
    numbers = [int(about["segment"]) for about in disk.metadata(tmp_path, "ml_dash")]
    assert numbers == list(range(1, len(numbers) + 1))


def test_a_segment_ends_at_its_duration(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(segment_duration_s=1e-9)) as recorder:
        for number in range(5):
            recorder.topic("a").append(n=number, _ts=float(number)).flush()
    assert len(disk.segments(tmp_path)) == 5
    assert [row["n"] for row in disk.rows(tmp_path)["a"]] == list(range(5))


@pytest.mark.about_json
def test_a_schema_that_outgrows_its_place_begins_a_new_segment(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for number in range(200):
            recorder.topic("a").append(**{f"field_number_{number}": number}, _ts=float(number))
            if number % 20 == 0:
                recorder.flush()
    assert len(disk.segments(tmp_path)) > 1
    schema = json.loads(disk.channel(tmp_path, "a")[1].data)
    assert set(schema["properties"]) == {"_ts", *(f"field_number_{number}" for number in range(200))}


@pytest.mark.about_json
def test_a_schema_that_widens_in_one_segment_covers_all_its_rows_and_stays_one_channel(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("a")
        for number, row in enumerate(
            [{"x": 1}, {"x": 0.5, "y": "a"}, {"x": 2, "z": [1, 2]}, {"z": [0.5], "w": {"v": True}}]
        ):
            topic.append(**row, _ts=float(number)).flush()
    assert len(disk.segments(tmp_path)) == 1
    assert json.loads(disk.channel(tmp_path, "a")[1].data)["properties"] == {
        "x": {"type": "number"},
        "_ts": {"type": "number"},
        "y": {"type": "string"},
        "z": {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 2},
        "w": {"type": "object", "properties": {"v": {"type": "boolean"}}},
    }


@pytest.mark.parametrize("way", ["append", "append_batch", "append_columns"])
def test_a_row_larger_than_a_buffer_gets_one_of_its_own_and_keeps_its_place(tmp_path: Path, way: str) -> None:
    with Recorder(tmp_path, SMALL) as recorder:
        topic = recorder.topic("a")
        for number in range(12):
            row = {
                "n": number,
                "fill": "x" * (100_000 if number % 3 == 1 else 10),
                "_ts": 1.0 if number < 6 else float(number),
            }
            if way == "append":
                topic.append(**row)
            elif way == "append_batch":
                topic.append_batch([row])
            else:
                topic.append_columns(**{name: [value] for name, value in row.items()})
        recorder.set_parameters({"after": 1})
    with Recording(tmp_path) as recording:
        found = list(recording["a"].rows())
        assert recording.params == {"after": 1}
    assert [(row["n"], len(row["fill"])) for row in found] == [(5, 10)] + [
        (n, 100_000 if n % 3 == 1 else 10) for n in range(6, 12)
    ]
    assert recorder.stats() | {"bytes_written": 0, "segments": []} == {
        "accepted": 12,
        "written": 12,
        "waiting": 0,
        "dropped": 0,
        "dropped_by_topic": {},
        "merged": 1,
        "steps_back": 0,
        "steps_back_by_topic": {},
        "fallbacks": {},
        "bytes_written": 0,
        "segments": [],
        "failure": None,
    }


@pytest.mark.parametrize("size", [65536 - 700, 65536 - 600, 65536 - 512, 65536 - 400, 65536 - 300, 65536, 65537])
def test_rows_about_as_large_as_a_buffer_fit_somewhere(tmp_path: Path, size: int) -> None:
    with Recorder(tmp_path, SMALL) as recorder:
        for number in range(5):
            recorder.topic("a").append(n=number, fill="x" * size, _ts=float(number))
            recorder.topic("b").append(n=number, _ts=float(number))
    assert {topic: [row["n"] for row in listed] for topic, listed in disk.rows(tmp_path).items()} == {
        "a": list(range(5)),
        "b": list(range(5)),
    }


def test_a_row_larger_than_the_backlog_is_refused_by_its_size(tmp_path: Path) -> None:
    with Recorder(tmp_path, SMALL) as recorder:
        topic = recorder.topic("a").append(n=1, _ts=1.0)
        with pytest.raises(FieldError, match="backlog"):
            topic.append(fill="x" * 300_000, _ts=2.0)
        topic.append(n=3, _ts=3.0)
    assert disk.rows(tmp_path) == {"a": [{"n": 1, "_ts": 1.0}, {"n": 3, "_ts": 3.0}]}


def test_too_many_topics_for_a_chunk_are_refused_by_name(tmp_path: Path) -> None:
    def open_topics_until_refused(recorder: Recorder) -> None:
        for number in range(1000):
            recorder.topic(f"topic{number}" + "x" * 200).append(n=number, _ts=1.0)

    with Recorder(tmp_path, SMALL) as recorder, pytest.raises(TopicError, match="chunk_bytes"):
        open_topics_until_refused(recorder)
    counted = disk.counts(tmp_path)
    assert len(counted) > 20
    assert set(counted.values()) == {1}


def test_a_recording_without_rows_is_a_file_all_the_same(tmp_path: Path) -> None:
    Recorder(tmp_path / "nothing").close()
    with Recorder(tmp_path / "topic") as recorder:
        recorder.topic("never used")
    assert [len(disk.segments(tmp_path / name)) for name in ("nothing", "topic")] == [1, 1]


def test_an_empty_row_is_a_row(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(_ts=1.0).append(_ts=2.0)
    assert disk.rows(tmp_path) == {"a": [{"_ts": 1.0}, {"_ts": 2.0}]}


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("level", [None, 1, 5])
def test_every_compression_is_read_back(tmp_path: Path, compression: Any, level: int | None) -> None:
    options = RecorderOptions(compression=compression, compression_level=level, chunk_bytes=65536, backlog_bytes=262144)
    with Recorder(tmp_path, options) as recorder:
        for number in range(3000):
            recorder.topic("a").append(n=number, _ts=float(number))
    assert [row["n"] for row in disk.rows(tmp_path)["a"]] == list(range(3000))


def test_without_buffering_every_row_is_in_the_file_when_append_returns(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(buffered=False)) as recorder:
        for number in range(5):
            recorder.topic("a").append(n=number, _ts=float(number))
            assert recorder.stats()["written"] == number + 1
        recorder.topic("a").append_batch([{"n": 5, "_ts": 5.0}]).append_columns(n=[6, 7], _ts=[6.0, 7.0])
        assert recorder.stats()["waiting"] == 0


def test_a_batch_of_rows_is_written_as_soon_as_it_is_full(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(batch_rows=10, flush_interval_s=3600, sync_interval_s=0)) as recorder:
        for number in range(35):
            recorder.topic("a").append(n=number, _ts=float(number))
        recorder.flush()
    with disk._open(disk.segments(tmp_path)[0]) as reader:
        summary = reader.get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 4
