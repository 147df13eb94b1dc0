"""The tracks of a Session: batches, flushes, and reading by index and by time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import NotFoundError, RangeError
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.session import Session


def session(root: Path, **given: Any) -> Session:
    return Session(name="demo", workspace="robotics", local_path=root, **given)


# Batches and flushes


def test_a_batch_says_what_it_added(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        assert opened.track("loss").append_batch([{"value": 0.5}, {"value": 0.4}]) == {
            "trackId": "loss",
            "startIndex": "0",
            "endIndex": "1",
            "count": 2,
            "bufferedDataPoints": "2",
            "chunkSize": 10000,
        }


def test_a_batch_keeps_its_place_among_appends(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        track = opened.track("loss").append(value=0)
        assert track.append_batch([{"value": 1}, {"value": 2}])["startIndex"] == "1"
        track.append(value=3)
        assert [point["data"]["value"] for point in track.read()["data"]] == [0, 1, 2, 3]


def test_a_batch_takes_time_stamps_as_append_does_and_merges_as_it_does(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("other").append(x=1, _ts=4.0)
        opened.track("robot").append_batch([{"q": 1, "_ts": 5.0}, {"v": 2, "_ts": -1}, {"q": 3, "_ts": 4.0}])
        data = [point["data"] for point in opened.track("robot").read()["data"]]
    assert data == [{"q": 3, "_ts": 4.0}, {"q": 1, "v": 2, "_ts": 5.0}]


def test_an_empty_batch_is_a_value_error(tmp_path: Path) -> None:
    with session(tmp_path) as opened, pytest.raises(ValueError, match="the batch is empty"):
        opened.track("loss").append_batch([])


@pytest.mark.parametrize("bad", [{"value": object()}, {"value": 1.0, "_ts": "abc"}, 5, {"_exact": 1}])
def test_a_bad_point_is_named_and_nothing_of_its_batch_is_taken(tmp_path: Path, bad: Any) -> None:
    with session(tmp_path) as opened:
        track = opened.track("loss").append(value=0)
        with pytest.raises((TypeError, ValueError), match="row 1"):
            track.append_batch([{"value": 1}, bad, {"value": 2}])
        assert track.append_batch([{"value": 3}])["startIndex"] == "1"
        assert [point["data"]["value"] for point in track.read()["data"]] == [0, 3]


def test_a_batch_may_be_any_iterable_of_mappings_and_is_copied(tmp_path: Path) -> None:
    array, point = np.zeros(3), {"value": 1}
    with session(tmp_path) as opened:
        track = opened.track("loss")
        assert track.append_batch(row for row in ({"q": array}, point))["count"] == 2
        array[:], point["value"] = 9.0, 9
        data = [point["data"] for point in track.read()["data"]]
        assert (data[0]["q"], data[1]["value"]) == ([0.0, 0.0, 0.0], 1)
        assert point == {"value": 9}


def test_flush_says_what_it_flushed_or_none(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        track = opened.track("loss")
        assert track.flush() is None
        track.append(value=1).append(value=2)
        flushed = track.flush()
        assert flushed is not None
        assert (flushed["startIndex"], flushed["endIndex"], flushed["count"]) == ("0", "1", 2)
        assert track.flush() is None
        track.append_columns(value=[3, 4, 5], _ts=[1.0, 2.0, 3.0])
        flushed = track.flush()
        assert flushed is not None
        assert (flushed["startIndex"], flushed["endIndex"], flushed["count"]) == ("2", "4", 3)


def test_reads_and_flushes_of_all_tracks_leave_nothing_to_flush(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        for act in (opened.tracks.flush, opened.track("loss").read, opened.track("loss").stats, opened.tracks.list):
            opened.track("loss").append(value=1)
            act()
            assert opened.track("loss").flush() is None, act


def test_indexes_go_on_from_an_earlier_session(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("loss").append_batch([{"value": value} for value in range(5)])
    with session(tmp_path) as opened:
        assert opened.track("loss").append_batch([{"value": 5}])["startIndex"] == "5"
        assert [point["index"] for point in opened.track("loss").read()["data"]] == list(range(6))


def test_flushed_rows_are_on_the_disk_while_the_session_is_open(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("loss").append(value=1, _ts=1.0)
        opened.track("loss").flush()
        with Recording(opened.path) as recording:
            assert list(recording["loss"].rows()) == [{"value": 1, "_ts": 1.0}]


# Reading


def hundred(opened: Session) -> Any:
    track = opened.track("loss")
    track.append_batch([{"value": i, "nested": {"a": i, "b": -i}, "_ts": i / 10} for i in range(100)])
    return track


def test_reading_by_index_gives_dreamlake_s_shape(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("robot").append(q=[0.1], _ts=1.5)
        read = opened.track("robot").read()
        created = read["data"][0].pop("createdAt")
        assert read == {
            "data": [{"index": 0, "data": {"q": [0.1], "_ts": 1.5}}],
            "startIndex": 0,
            "endIndex": 0,
            "total": 1,
            "hasMore": False,
        }
        assert created.endswith("Z")


@pytest.mark.parametrize(
    ("arguments", "indexes", "more"),
    [
        ({}, range(100), False),
        ({"limit": 10}, range(10), True),
        ({"start_index": 95, "limit": 10}, range(95, 100), False),
        ({"start_index": 90, "limit": 10}, range(90, 100), False),
        ({"start_index": 200}, range(0), False),
        ({"limit": 0}, range(0), True),
        ({"start_index": np.int64(3), "limit": np.int64(2)}, range(3, 5), True),
    ],
)
def test_an_index_range(tmp_path: Path, arguments: dict[str, int], indexes: range, more: bool) -> None:
    with session(tmp_path) as opened:
        read = hundred(opened).read(**arguments)
    assert [point["index"] for point in read["data"]] == list(indexes)
    assert [point["data"]["value"] for point in read["data"]] == list(indexes)
    start = int(arguments.get("start_index", 0))
    assert (read["startIndex"], read["endIndex"]) == (start, start + len(indexes) - 1)
    assert (read["total"], read["hasMore"]) == (len(indexes), more)


def test_the_default_limit_is_a_thousand(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("loss").append_columns(_ts=np.arange(1001.0), value=np.arange(1001))
        read = opened.track("loss").read()
        assert (read["total"], read["hasMore"]) == (1000, True)
        assert opened.track("loss").read(format="jsonl").count(b"\n") == 1000


def test_one_read_takes_an_index_range_a_time_range_columns_and_a_format(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        track = hundred(opened)
        window = {"start_timestamp": 1.0, "end_timestamp": 2.0, "start_index": 3, "limit": 2}
        read = track.read(**window, columns=["nested.a"])
        assert [(point["index"], point["data"]) for point in read["data"]] == [
            (3, {"nested": {"a": 13}, "_ts": 1.3}),
            (4, {"nested": {"a": 14}, "_ts": 1.4}),
        ]
        assert read["hasMore"]
        jsonl = track.read(**window, columns=["nested.a"], format="jsonl")
        assert jsonl == b'{"timestamp":1.3,"nested.a":13}\n{"timestamp":1.4,"nested.a":14}'
        assert [frame["time"] for frame in track.read(**window, format="mocap")["frames"]] == [1.3, 1.4]
        assert track.read(start_index=100, format="jsonl") == b""


@pytest.mark.parametrize("arguments", [{"start_index": -1}, {"limit": -1}, {"start_index": 1.5}, {"limit": "10"}])
def test_an_index_that_is_none_is_a_value_error(tmp_path: Path, arguments: dict[str, Any]) -> None:
    with session(tmp_path) as opened, pytest.raises(ValueError, match=r"it must be an integer, 0 or more"):
        opened.track("loss").read(**arguments)


def test_points_of_an_unknown_column_are_an_error_and_those_of_a_track_without_points_are_none(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        with pytest.raises(NotFoundError, match=r"column 'valeu'.*value"):
            hundred(opened).read(columns=["valeu"])
        assert opened.track("empty").read(columns=["no"])["data"] == []


def test_an_unknown_argument_of_read_is_named_beside_the_method(tmp_path: Path) -> None:
    with (
        session(tmp_path) as opened,
        pytest.raises(TypeError, match=r"SessionTrack\.read\(\) got an unexpected .*'foo'"),
    ):
        opened.track("loss").read(foo=1)  # type: ignore[call-overload]


def test_a_time_range_that_ends_before_it_starts_is_a_value_error(tmp_path: Path) -> None:
    with session(tmp_path) as opened, pytest.raises(RangeError):
        hundred(opened).read(start_timestamp=2.0, end_timestamp=1.0)


def test_reading_by_time_leaves_the_end_out(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        track = hundred(opened)
        read = track.read_by_time(start_time=1.0, end_time=1.3)
        assert [point["data"]["_ts"] for point in read["data"]] == [1.0, 1.1, 1.2]
        assert (read["startTime"], read["endTime"], read["total"], read["hasMore"]) == (1.0, 1.3, 3, False)
        last = track.read_by_time(limit=2, reverse=True)
        assert [point["data"]["_ts"] for point in last["data"]] == [9.9, 9.8]
        assert last["hasMore"]
        assert track.read_by_time(start_time=1.0, end_time=1.0)["data"] == []
        assert track.read_by_time(limit=3)["total"] == 3
        with pytest.raises(RangeError, match="end_time='noon'"):
            track.read_by_time(end_time="noon")


def test_a_track_without_points_reads_as_empty(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        read = opened.track("nothing").read()
        assert read == {"data": [], "startIndex": 0, "endIndex": -1, "total": 0, "hasMore": False}
        assert opened.track("nothing").read_by_time()["data"] == []
        assert opened.track("nothing").stats()["totalDataPoints"] == "0"
        assert opened.tracks.list() == []


def test_stats_count_points_after_merging_and_say_what_was_said(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        track = opened.track("pose", description="the pose", tags=["arm"], metadata={"hz": 100})
        track.append(x=1, _ts=1.6e9).append(y=2, _ts=1.6e9).append(x=3, _ts=1.6e9 + 1)
        assert track.stats() == {
            "trackId": "pose",
            "name": "pose",
            "description": "the pose",
            "tags": ["arm"],
            "metadata": {"hz": 100},
            "totalDataPoints": "2",
            "bufferedDataPoints": "2",
            "chunkedDataPoints": "0",
            "totalChunks": 0,
            "chunkSize": 10000,
            "firstDataAt": "2020-09-13T12:26:40Z",
            "lastDataAt": "2020-09-13T12:26:41Z",
            "createdAt": "2020-09-13T12:26:40Z",
            "updatedAt": "2020-09-13T12:26:41Z",
        }


def test_points_on_a_clock_that_starts_near_0_were_created_when_the_session_was_opened(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        opened.track("robot").append(q=1, _ts=1.5)
        assert opened.track("robot").read()["data"][0]["createdAt"].startswith(time.strftime("%Y-", time.gmtime()))


def test_a_name_has_one_track(tmp_path: Path) -> None:
    with session(tmp_path) as opened:
        track = opened.track("loss")
        assert opened.track("loss", tags=["x"]) is track
        assert opened.tracks("loss") is track
        assert track.append(value=1) is track
