"""What ml-dash 0.11 and dreamlake get wrong, each with the test that it is right here."""

from __future__ import annotations

import io
import math
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from ml_dash_mcap.errors import DamagedFileError, StateError
from ml_dash_mcap.experiment import Experiment
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.session import Session
from tests.support import disk, strict_json


def experiment(root: Path, options: RecorderOptions | None = None) -> Experiment:
    return Experiment("a/b", root=root, options=options)


# 1. Parquet silently drops columns that the first row does not have; mixed types raise.


def test_1_parquet_has_the_columns_of_all_rows(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0).append(v=[1, 2], camera={"on": True}, _ts=1.0)
        table = parquet.read_table(io.BytesIO(exp.tracks("robot").read(format="parquet")))
    assert table.column_names[0] == "timestamp"
    assert set(table.column_names) == {"timestamp", "q", "v", "camera.on"}
    assert table.column("q").to_pylist() == [1.0, None]
    assert table.column("v").to_pylist() == [None, [1, 2]]


def test_1_parquet_takes_a_column_of_mixed_types(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot")
        for ts, value in enumerate([1, 2.5, "text", [1, 2], None, True]):
            track.append(x=value, _ts=float(ts))
        table = parquet.read_table(io.BytesIO(track.read(format="parquet")))
        assert [entry["x"] for entry in track.read()["entries"]] == [1, 2.5, "text", [1, 2], None, True]
    assert table.column("timestamp").to_pylist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert len(table.column("x")) == 6


# 2. Rows of one time stamp that a flush splits never merge; late data stays unsorted, so that findByTime errs.


def test_2_rows_of_one_time_merge_whatever_was_flushed_between_them(tmp_path: Path) -> None:
    for field in ("q", "v"):  # the second one in a run of its own
        with experiment(tmp_path).run as exp:
            track = exp.tracks("robot")
            track.append(**{field: 1, "last": field}, _ts=1.0).flush()
            track.append(**{field: 2}, _ts=1.0).flush()
    with Recording(exp.path) as recording:
        assert recording.read("robot") == {"entries": [{"timestamp": 1.0, "q": 2, "last": "v", "v": 2}], "count": 1}
    assert disk.counts(exp.path) == {"robot": 1}


def test_2_late_rows_are_sorted_and_found(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot")
        for ts in (3.0, 1.0, 2.0, 0.0):
            track.append(q=ts, _ts=ts).flush()
        part = track.slice()
        assert [entry["timestamp"] for entry in part] == [0.0, 1.0, 2.0, 3.0]
        assert part.findByTime(1.5)["q"] == 1.0


# 3. Topics a/b and a_b share one folder and mix; a topic ../../../evil writes outside the root.


def test_3_topics_never_mix_and_never_become_paths(tmp_path: Path) -> None:
    topics = ["a/b", "a_b", "../../../evil", "/absolute", "a//b", ".", "a\\b", "CON", "*?", "ä/ö"]
    with Experiment("x", root=tmp_path / "deep" / "er" / "root").run as exp:
        for number, topic in enumerate(topics):
            exp.tracks(topic).append(n=number, _ts=0.0)
        for number, topic in enumerate(topics):
            assert exp.tracks(topic).list_entries() == [{"timestamp": 0.0, "n": number}]
    assert disk.counts(exp.path) == dict.fromkeys(topics, 1)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == set(disk.segments(exp.path))


# 4. A field named timestamp overwrites the row's time; time corrupts mocap frames.


def test_4_an_experiment_refuses_a_field_called_timestamp(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot").append(q=1.0, _ts=1.0)
        with pytest.raises(ValueError, match="'timestamp' is taken"):
            track.append(timestamp=5.0, _ts=2.0)
        with pytest.raises(ValueError, match="'timestamp' is taken"):
            track.append_batch([{"timestamp": 5.0, "_ts": 2.0}])
        with pytest.raises(ValueError, match="'timestamp' is taken"):
            track.append_columns(timestamp=[5.0], _ts=[2.0])
        track.append(nested={"timestamp": 5.0}, _ts=3.0)
        assert [entry["timestamp"] for entry in track.list_entries()] == [1.0, 3.0]


def test_4_a_session_takes_a_field_called_timestamp(tmp_path: Path) -> None:
    with Session("n", "w", local_path=tmp_path) as session:
        session.track("system").append(timestamp=5.0, _ts=1.0)
        assert session.track("system").read()["data"][0]["data"] == {"timestamp": 5.0, "_ts": 1.0}
        assert session.track("system").read_by_time(end_time=2.0)["total"] == 1


def test_4_a_field_called_time_leaves_mocap_frames_their_time(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(time=99.0, q=1.0, _ts=0.5)
        mocap = exp.tracks("robot").read(format="mocap")
        assert exp.tracks("robot").list_entries() == [{"timestamp": 0.5, "time": 99.0, "q": 1.0}]
    (frame,) = mocap["frames"]
    assert frame["time"] == 0.5
    assert 99.0 in frame.values()
    assert set(mocap["channels"]) == set(frame) - {"time"}


# 5. One bad value loses the rest of its batch.


def test_5_a_bad_value_is_an_error_at_its_line_and_loses_no_other_row(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot")
        for step in range(10):
            value = object() if step == 5 else step
            if step == 5:
                with pytest.raises(TypeError, match=r"'robot'.*'q'"):
                    track.append(q=value, _ts=float(step))
            else:
                track.append(q=value, _ts=float(step))
    assert [row["q"] for row in disk.rows(exp.path)["robot"]] == [0, 1, 2, 3, 4, 6, 7, 8, 9]


# 6. append after close is silently lost.


def test_6_append_after_the_end_raises(tmp_path: Path) -> None:
    with experiment(tmp_path / "e").run as exp:
        track = exp.tracks("robot").append(q=1.0, _ts=0.0)
    with Session("n", "w", local_path=tmp_path / "s") as session:
        point = session.track("loss").append(value=1.0)
    for call in (
        lambda: track.append(q=2.0, _ts=1.0),
        lambda: track.append_batch([{"q": 2.0, "_ts": 1.0}]),
        lambda: track.append_columns(q=[2.0], _ts=[1.0]),
        lambda: point.append(value=2.0),
        lambda: point.append_batch([{"value": 2.0}]),
    ):
        with pytest.raises(StateError, match="closed"):
            call()
    assert disk.counts(exp.path) == {"robot": 1}


# 7. NaN makes invalid JSON.


@pytest.mark.about_json
def test_7_numbers_that_are_not_finite_are_valid_json_on_the_disk_and_come_back(tmp_path: Path) -> None:
    values = [math.nan, math.inf, -math.inf, 1.5]
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=values, x=np.float64("nan"), _ts=0.0)
        exp.metrics("train").log(loss=math.nan)
        exp.log("diverged", loss=math.inf)
        (entry,) = exp.tracks("robot").list_entries()
    assert repr(entry["q"]) == repr(values)
    assert math.isnan(entry["x"])
    for topic, payload in disk.payloads(exp.path):
        strict_json.parse(payload), topic


# 8. dreamlake: description and tags are lost when flushed through tracks.flush(); sparse fields come back as None.


def test_8_what_is_said_about_a_track_survives_a_flush_of_all_tracks(tmp_path: Path) -> None:
    with Session("n", "w", local_path=tmp_path) as session:
        session.track("pose", description="the pose", tags=["arm"], metadata={"hz": 100}).append(x=1.0)
        session.tracks.flush()
        stats = session.track("pose").stats()
        assert (stats["description"], stats["tags"], stats["metadata"]) == ("the pose", ["arm"], {"hz": 100})
    assert disk.channel(session.path, "pose")[0].metadata["description"] == "the pose"


def test_8_absent_fields_stay_absent(tmp_path: Path) -> None:
    with Session("n", "w", local_path=tmp_path) as session:
        session.track("pose").append(x=1.0, _ts=0.0).append(y=2.0, _ts=1.0).append(z=None, _ts=2.0)
        data = [point["data"] for point in session.track("pose").read()["data"]]
    assert data == [{"x": 1.0, "_ts": 0.0}, {"y": 2.0, "_ts": 1.0}, {"z": None, "_ts": 2.0}]


# 9. params.set refuses numpy values.


def test_9_parameters_may_be_numpy_values(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.params.set(gain=np.float32(0.5), stiffness=np.array([600.0, 250.0]), steps=np.int64(3))
        assert exp.params.get() == {"gain": 0.5, "stiffness": [600.0, 250.0], "steps": 3}


# 10. Every read scans everything. Track buffers have no bound. An exit without close loses the last second, or all.


@pytest.mark.breaks_files
def test_10_a_time_window_reads_only_the_chunks_that_hold_it(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        for second in range(5):
            exp.tracks("robot").append_columns(_ts=second + np.arange(100) / 100, q=np.arange(100.0)).flush()
    (segment,) = disk.segments(exp.path)
    content = bytearray(segment.read_bytes())
    first_chunk = disk.chunk_starts(segment)[0]
    content[first_chunk + 60 : first_chunk + 160] = bytes(100)  # whoever looks into it notices
    segment.write_bytes(content)
    with experiment(tmp_path).run as exp:
        window = exp.tracks("robot").read(start_timestamp=3.0, end_timestamp=3.5)
        assert window["count"] == 51
        with pytest.raises(DamagedFileError):
            exp.tracks("robot").read()


def test_10_more_rows_than_the_backlog_holds_all_arrive_in_bounded_memory(tmp_path: Path) -> None:
    options = RecorderOptions(chunk_bytes=64 * 1024, backlog_bytes=128 * 1024, on_full="block")
    with experiment(tmp_path, options).run as exp:
        for step in range(5000):
            exp.tracks("robot").append(q=[float(step)] * 20, _ts=step / 100)
        stats = exp.stats()
        assert stats["accepted"] == stats["written"] + stats["waiting"] == 5000
    assert disk.counts(exp.path) == {"robot": 5000}


@pytest.mark.parametrize("death", ["os._exit(1)", "os.kill(os.getpid(), signal.SIGKILL)"])
def test_10_a_process_that_dies_loses_nothing(tmp_path: Path, death: str) -> None:
    program = f"""
        import os, signal
        from ml_dash_mcap.experiment import Experiment
        from ml_dash_mcap.session import Session
        exp = Experiment("a/b", root={str(tmp_path)!r}).run.start()
        session = Session("n", "w", local_path={str(tmp_path)!r}).open()
        exp.params.set(lr=0.1)
        for step in range(100):
            exp.tracks("robot").append(q=[step], _ts=step / 100)
            session.track("loss").append(value=step)
        exp.log("about to die")
        {death}
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=False, timeout=60)
    with experiment(tmp_path).run as exp:
        assert [entry["q"] for entry in exp.tracks("robot").list_entries()] == [[step] for step in range(100)]
        assert exp.params.get() == {"lr": 0.1}
    with Session("n", "w", local_path=tmp_path) as session:
        assert [point["data"]["value"] for point in session.track("loss").read()["data"]] == list(range(100))
    assert disk.counts(exp.path) == {"robot": 100}
    assert [row["message"] for row in disk.rows(exp.path)["ml_dash/log"]] == ["about to die"]
