"""The tracks of an Experiment: appending, reading, and finding by time."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import StorageError
from ml_dash_mcap.experiment import Experiment
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recording import Recording
from tests.support import disk
from tests.support.rules import problems

PREFIX = "alice/franka/demo"


def experiment(root: Path, **given: Any) -> Experiment:
    return Experiment(PREFIX, root=root, **given)


# Tracks


def test_a_topic_has_one_track_whose_methods_chain(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot")
        assert track.append(q=[0.1], _ts=0.0).append(q=[0.2], _ts=0.1).flush() is track
        assert exp.tracks("robot") is track
        assert track.name == "robot"


def test_threads_that_ask_for_a_topic_at_once_get_the_same_track(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        got: list[object] = []
        barrier = threading.Barrier(8)

        def ask() -> None:
            barrier.wait()
            for number in range(50):
                got.append(exp.tracks(f"t{number}"))
                exp.tracks(f"t{number}").append(n=number, _ts=0.0)

        threads = [threading.Thread(target=ask) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(set(map(id, got))) == 50
    assert disk.counts(exp.path) == {f"t{number}": 1 for number in range(50)}


@pytest.mark.parametrize("topic", ["", " ", "a\0b", "x" * 2000, "ml_dash/log", "\udc80"])
def test_a_topic_that_cannot_be_is_refused(tmp_path: Path, topic: str) -> None:
    with experiment(tmp_path).run as exp, pytest.raises(ValueError, match=r"topic|Unicode"):
        exp.tracks(topic)


@pytest.mark.parametrize("topic", [None, 5, ["a"]])
def test_a_topic_that_is_no_text_is_a_type_error(tmp_path: Path, topic: object) -> None:
    with experiment(tmp_path).run as exp, pytest.raises(TypeError, match="text"):
        exp.tracks(topic)  # type: ignore[arg-type]


def test_what_is_said_about_a_topic_at_any_time_is_kept(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot", description="the arm").append(q=1.0, _ts=0.0)
        exp.tracks.flush()
        assert exp.tracks("robot", tags=["arm"], metadata={"joints": 7}) is track
        track.append(q=2.0, _ts=1.0)
    info = Recording(exp.path).topics["robot"]
    assert (info.description, info.tags, info.metadata) == ("the arm", ("arm",), {"joints": 7})


def test_list_names_the_tracks_that_have_rows_earlier_runs_included(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.tracks("old").append(q=1.0, _ts=0.0)
    with experiment(tmp_path).run as exp:
        exp.tracks("b/new").append(q=1.0, _ts=1.0)
        exp.tracks("empty")
        exp.metrics("train").log(loss=1.0)
        exp.log("hello")
        assert exp.tracks.list() == ["b/new", "old"]


def test_an_array_is_copied_by_append(tmp_path: Path) -> None:
    q = np.zeros(7)
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=q, _ts=0.0)
        q[:] = 9.0
        assert exp.tracks("robot").list_entries() == [{"timestamp": 0.0, "q": [0.0] * 7}]


def test_columns_are_taken_in_bulk(tmp_path: Path) -> None:
    times, q = np.arange(1000) / 1000, np.random.default_rng(0).random((1000, 7))
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append_columns(_ts=times, q=q)
        entries = exp.tracks("robot").read()["entries"]
    assert [entry["timestamp"] for entry in entries] == times.tolist()
    assert [entry["q"] for entry in entries] == q.tolist()
    assert disk.counts(exp.path) == {"robot": 1000}


# Reading


def test_reading_flushes_first_and_gives_ml_dash_s_shape(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=[0.1], _ts=1.5).append(camera={"pos": [1, 2], "on": True}, _ts=2.5)
        assert exp.tracks("robot").read() == {
            "entries": [{"timestamp": 1.5, "q": [0.1]}, {"timestamp": 2.5, "camera.pos": [1, 2], "camera.on": True}],
            "count": 2,
        }


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        ({}, [0.0, 1.0, 2.0, 3.0]),
        ({"start_timestamp": 1.0}, [1.0, 2.0, 3.0]),
        ({"end_timestamp": 2.0}, [0.0, 1.0, 2.0]),
        ({"start_timestamp": 1.0, "end_timestamp": 2.0}, [1.0, 2.0]),
        ({"start_timestamp": 1.1, "end_timestamp": 1.9}, []),
    ],
)
def test_a_time_range_includes_both_ends(tmp_path: Path, window: dict[str, Any], expected: list[float]) -> None:
    with experiment(tmp_path).run as exp:
        for ts in (3.0, 1.0, 2.0, 0.0):
            exp.tracks("robot").append(q=ts, _ts=ts)
        read = exp.tracks("robot").read(**window)
        assert [entry["timestamp"] for entry in read["entries"]] == expected
        assert [entry["timestamp"] for entry in exp.tracks("robot").slice(**window)] == expected
        assert read["count"] == len(expected)


def test_columns_take_dotted_names_and_whole_branches(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=1, camera={"pos": [1], "rot": {"w": 1.0}}, _ts=0.0)
        track = exp.tracks("robot")
        assert track.read(columns=["camera.rot"])["entries"] == [{"timestamp": 0.0, "camera.rot.w": 1.0}]
        assert track.read(columns=["camera", "nope"])["entries"] == [
            {"timestamp": 0.0, "camera.pos": [1], "camera.rot.w": 1.0}
        ]
        assert track.read(columns=[]) == track.read(columns=None) == track.read()


def test_an_unknown_topic_reads_as_empty_in_every_format(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("nothing")
        assert track.read() == {"entries": [], "count": 0}
        assert track.read(format="jsonl") == b""
        assert track.read(format="mocap")["frames"] == []
        assert track.read(format="parquet")[:4] == b"PAR1"
        (tmp_path / "nothing.mcap").write_bytes(track.read(format="mcap"))
        assert problems(tmp_path / "nothing.mcap") == []
        assert len(track.slice()) == 0
        assert exp.tracks.list() == []


def test_a_column_that_no_row_has_is_absent(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot").append(q=[0.1], v=1, _ts=0.5)
        assert track.read(columns=["q", "absent"])["entries"] == [{"timestamp": 0.5, "q": [0.1]}]
        assert track.read(columns=["absent"])["entries"] == [{"timestamp": 0.5}]


def test_an_unknown_format_is_a_value_error(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp, pytest.raises(ValueError, match="Unsupported format: csv"):
        exp.tracks("robot").read(format="csv")


def test_a_reader_sees_what_was_appended_after_its_last_read(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot")
        for count in range(5):
            track.append(q=count, _ts=float(count))
            assert track.read()["count"] == count + 1


def test_one_thread_reads_while_others_append(tmp_path: Path) -> None:
    with experiment(tmp_path, options=RecorderOptions(chunk_bytes=64 * 1024, backlog_bytes=256 * 1024)).run as exp:

        def append(topic: str) -> None:
            for step in range(2000):
                exp.tracks(topic).append(q=[step] * 7, _ts=step / 1000)

        threads = [threading.Thread(target=append, args=(f"t{number}",)) for number in range(3)]
        for thread in threads:
            thread.start()
        seen: list[int] = []
        while any(thread.is_alive() for thread in threads):
            entries = exp.tracks("t1").list_entries()
            assert [entry["q"][0] for entry in entries] == list(range(len(entries)))
            seen.append(len(entries))
        for thread in threads:
            thread.join()
        assert seen == sorted(seen)
        assert exp.tracks("t1").read()["count"] == 2000
    assert disk.counts(exp.path) == {"t0": 2000, "t1": 2000, "t2": 2000}


# Slices


def test_a_slice_is_sized_and_can_be_iterated_again_and_within_itself(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        for ts in (0.0, 1.0, 2.0, 3.0):
            exp.tracks("robot").append(q=ts, _ts=ts)
        part = exp.tracks("robot").slice(1.0, 2.0)
        assert len(part) == 2
        assert [(a["q"], b["q"]) for a in part for b in part] == [(1, 1), (1, 2), (2, 1), (2, 2)]
        assert list(part) == [{"timestamp": 1.0, "q": 1.0}, {"timestamp": 2.0, "q": 2.0}]
        assert repr(part) == "TrackSlice('robot', start=1.0, end=2.0)"


def test_find_by_time_gives_the_last_entry_at_or_before_each_time(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        for ts in (7.0, 1.0, 5.0, 3.0):
            exp.tracks("robot").append(q=ts, _ts=ts)
        part = exp.tracks("robot").slice()
        assert part.findByTime(5.5)["q"] == 5.0
        assert part.findByTime(3.0)["q"] == 3.0
        assert [entry["q"] for entry in part.findByTime([100, 1.0, 6.999])] == [7.0, 1.0, 5.0]
        assert [entry["q"] for entry in part.findByTime(np.array([1.0, 3.5]))] == [1.0, 3.0]


def test_find_by_time_before_the_first_entry_is_both_errors_that_ml_dash_speaks_of(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0)
        part = exp.tracks("robot").slice()
        with pytest.raises(KeyError) as caught:
            part.findByTime(-1)
        assert isinstance(caught.value, StorageError)
        assert str(caught.value) == "No entry found with timestamp <= -1. Earliest timestamp: 0.0"
        with pytest.raises(KeyError, match="No entries in track slice"):
            exp.tracks("empty").slice().findByTime(0)
        with pytest.raises(ValueError, match="a time is a number"):
            part.findByTime(float("nan"))
        with pytest.raises(ValueError, match="a time is a number"):
            part.findByTime("noon")  # type: ignore[arg-type]
        times: list[Any] = [np.array(1.5), np.float32(1.5), 1]
        assert [part.findByTime(one)["q"] for one in times] == [1.0, 1.0, 1.0]
