"""What a user gets to read who misspells a name, or gives a time of another kind."""

from __future__ import annotations

import calendar
import datetime
import re
import time
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ml_dash_mcap import Experiment, Limits, Recorder, RecorderOptions, Recording, Session, convert
from ml_dash_mcap.errors import (
    FormatError,
    NotFoundError,
    OptionError,
    RangeError,
    TimestampError,
    UsageError,
)
from tests.support.case_ids import stable_repr


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append(q=[0.1, 0.2], _ts=1.0).append(q=[0.2, 0.3], _ts=2.0)
    return tmp_path / "run"


def message(error: type[Exception], call: Callable[[], object]) -> str:
    with pytest.raises(error) as caught:
        call()
    return str(caught.value)


# Names


def recorder_of(tmp_path: Path, **given: Any) -> object:
    return Recorder(tmp_path / "new", **given)


def experiment_of(tmp_path: Path, **given: Any) -> object:
    return Experiment("alice/franka/demo", **{"root": tmp_path / "new", **given})


def session_of(tmp_path: Path, **given: Any) -> object:
    return Session("demo", "alice", **{"local_path": tmp_path / "new", **given})


@pytest.mark.parametrize("make", [recorder_of, experiment_of, session_of])
@pytest.mark.parametrize(
    ("given", "option"),
    [
        ({"compression": "lz4"}, "compression='lz4'"),
        ({"compresion": "lz4"}, "compression='lz4'"),
        ({"flush_interval": 0.1}, "flush_interval_s=0.1"),
        ({"chunk_size": 65536}, "chunk_bytes=65536"),
        ({"on_full": "drop"}, "on_full='drop'"),
    ],
    ids=str,
)
def test_an_option_that_is_given_beside_the_options_is_said_to_belong_into_them(
    tmp_path: Path, make: Callable[..., object], given: dict[str, Any], option: str
) -> None:
    said = message(UsageError, lambda: make(tmp_path, **given))
    assert f"{next(iter(given))}=" in said
    assert f"options=RecorderOptions({option})" in said
    assert not (tmp_path / "new").exists(), "nothing is made"


@pytest.mark.parametrize(
    ("make", "wrong", "right"),
    [
        (recorder_of, "metdata", "metadata"),
        (recorder_of, "timestamp", "timestamps"),
        (experiment_of, "dashroot", "dash_root"),
        (experiment_of, "tag", "tags"),
        (experiment_of, "bufferconfig", "buffer_config"),
        (session_of, "localpath", "local_path"),
        (session_of, "desciption", "description"),
    ],
)
def test_a_misspelt_argument_suggests_the_right_one(
    tmp_path: Path, make: Callable[..., object], wrong: str, right: str
) -> None:
    assert f"did you mean {right}=" in message(UsageError, lambda: make(tmp_path, **{wrong: "x"}))


def test_an_argument_like_no_other_is_answered_with_all_there_are(tmp_path: Path) -> None:
    said = message(UsageError, lambda: session_of(tmp_path, zzz=1))
    assert "name=, workspace=, description=" in said


@pytest.mark.parametrize(
    ("call", "right"),
    [
        (lambda: RecorderOptions(compresion="lz4"), "compression="),  # type: ignore[call-arg]
        (lambda: RecorderOptions(flush_interval=0.1), "flush_interval_s="),  # type: ignore[call-arg]
        (lambda: RecorderOptions().with_(backlog=1), "backlog_bytes="),
        (lambda: Limits(chunks_bytes=1), "chunk_bytes="),  # type: ignore[call-arg]
    ],
)
def test_a_misspelt_option_suggests_the_right_one(call: Callable[[], object], right: str) -> None:
    assert f"did you mean {right}?" in message(UsageError, call)


def test_options_without_names_are_told_to_have_names() -> None:
    assert "RecorderOptions(flush_interval_s=...)" in message(
        UsageError,
        lambda: RecorderOptions("lz4"),  # type: ignore[misc]
    )


def test_a_misspelt_entry_of_a_buffer_config_suggests_the_right_one(tmp_path: Path) -> None:
    said = message(OptionError, lambda: experiment_of(tmp_path, buffer_config={"flush_intervall": 1.0}))
    assert "did you mean 'flush_interval_s'?" in said


@pytest.mark.parametrize("options", [{"compression": "lz4"}, "lz4", 5], ids=stable_repr)
def test_options_of_another_type_are_refused_before_anything_is_made(tmp_path: Path, options: Any) -> None:
    for make in (recorder_of, experiment_of, session_of):
        assert "pass RecorderOptions(" in message(UsageError, lambda make=make: make(tmp_path, options=options))  # type: ignore[misc]
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("rosbag", "rosbag1"), ("ROSBAG2", "rosbag2"), ("parket", "parquet"), ("json-lines", "jsonl"), ("CSV", "csv")],
)
def test_a_misspelt_format_suggests_the_right_one_and_names_all(folder: Path, wrong: str, right: str) -> None:
    with Recording(folder) as recording:
        said = message(FormatError, lambda: recording.export(folder.parent / "out", format=wrong))
        assert message(FormatError, lambda: convert(folder, folder.parent / "out", format=wrong)) == said
    assert re.search(rf"did you mean '{right}'( or 'rosbag2')?\?", said)
    assert "c3d, csv, dreamlake, jsonl" in said
    assert not (folder.parent / "out").exists()


def test_a_format_of_export_is_named_where_read_does_not_have_it(folder: Path) -> None:
    with Recording(folder) as recording:
        assert "did you mean 'parquet'?" in message(FormatError, lambda: recording["robot"].read(format="parket"))
        said = message(FormatError, lambda: recording["robot"].read(format="csv"))
    assert said.startswith("Unsupported format: csv; Recording.export(dest, format='csv') writes it")
    assert "json, jsonl, mcap, mocap, parquet" in said


def test_a_misspelt_option_of_a_format_suggests_the_right_one(folder: Path) -> None:
    with Recording(folder) as recording:
        said = message(UsageError, lambda: recording.export(folder.parent / "bag", format="rosbag2", distribution="x"))
        assert "did you mean distro=?" in said
        said = message(UsageError, lambda: recording.export(folder.parent / "x.csv", format="csv", zzz=1))
        assert "it has " in said
        bag = recording.export(folder.parent / "bag", format="rosbag2")
    said = message(UsageError, lambda: convert(bag, folder.parent / "back", on_unknwon="skip"))
    assert str(bag) in said and "did you mean on_unknown=?" in said
    assert not (folder.parent / "back").exists()


def test_a_topic_that_differs_in_case_is_suggested(folder: Path) -> None:
    with Recording(folder) as recording:
        assert "did you mean 'robot'?" in message(NotFoundError, lambda: recording["Robot"])


# Times


class Stamp:
    """Stands for times of ROS, which have methods."""

    def __init__(self, **given: Any) -> None:
        self.__dict__.update(given)


def rospy_time(seconds: float) -> Any:
    return Stamp(secs=int(seconds), nsecs=round(seconds % 1 * 1e9), to_sec=lambda: seconds)


def rclpy_time(seconds: float) -> Any:
    return Stamp(
        nanoseconds=int(seconds) * 10**9 + round(seconds % 1 * 1e9), seconds_nanoseconds=lambda: (int(seconds), 0)
    )


SECONDS = 1_700_000_000.25
WHEN = datetime.datetime.fromtimestamp(SECONDS, datetime.timezone.utc)
OTHERS = [
    pytest.param(WHEN, "when", id="datetime"),
    pytest.param(WHEN.replace(tzinfo=None) + (datetime.datetime.fromtimestamp(SECONDS) - WHEN.replace(tzinfo=None)), "when", id="local datetime"),
    pytest.param(pd.Timestamp(WHEN), "when", id="pandas"),
    pytest.param(np.datetime64(1_700_000_000_250, "ms"), "when", id="datetime64[ms]"),
    pytest.param(np.datetime64(1_700_000_000_250_000_000, "ns"), "when", id="datetime64[ns]"),
    pytest.param(np.timedelta64(1_700_000_000_250, "ms"), "duration", id="timedelta64"),
    pytest.param(datetime.timedelta(seconds=SECONDS), "duration", id="timedelta"),
    pytest.param(WHEN.isoformat(), "text", id="ISO 8601"),
    pytest.param(rospy_time(SECONDS), "stamp", id="rospy"),
    pytest.param(rclpy_time(SECONDS), "stamp", id="rclpy"),
    pytest.param(SimpleNamespace(sec=1_700_000_000, nanosec=250_000_000), "stamp", id="builtin_interfaces"),
    pytest.param(SimpleNamespace(secs=1_700_000_000, nsecs=250_000_000), "stamp", id="ROS 1"),
    pytest.param({"sec": 1_700_000_000, "nanosec": 250_000_000}, "stamp", id="a dict of ROS 2"),
    pytest.param({"sec": 1_700_000_000, "nsec": 250_000_000}, "stamp", id="a dict of foxglove"),
    pytest.param(SimpleNamespace(seconds=1_700_000_000, nanos=250_000_000), "stamp", id="protobuf"),
]  # fmt: skip


def advice(said: str, name: str) -> str:
    found = re.search(rf"pass seconds: {name}=(.+?)(?:, for each row)?$", said)
    assert found, said
    return found[1]


def seconds_by(spelling: str, variable: str, given: Any) -> float:
    """Do what a message says."""
    known = {variable: given, "numpy": np, "datetime": datetime.datetime, "calendar": calendar, "time": time}
    expression, _, ns = spelling.partition(" with ns = ")
    if ns:
        known["ns"] = eval(ns, known)
    return float(eval(expression, known))


@pytest.mark.parametrize(("given", "variable"), OTHERS)
def test_a_time_of_another_kind_is_answered_with_how_to_make_seconds_of_it(
    tmp_path: Path, given: Any, variable: str
) -> None:
    with Recorder(tmp_path / "strict") as strict, Recorder(tmp_path / "auto", timestamps="auto") as auto:
        for recorder in (strict, auto):
            topic = recorder.topic("robot")
            said = message(TimestampError, lambda topic=topic: topic.append(q=1.0, _ts=given))  # type: ignore[misc]
            assert seconds_by(advice(said, "_ts"), variable, given) == SECONDS
            said = message(TimestampError, lambda topic=topic: topic.append_columns(q=[1.0], _ts=[given]))  # type: ignore[misc]
            assert seconds_by(advice(said, "_ts"), variable, given) == SECONDS


@pytest.mark.parametrize(("given", "variable"), OTHERS)
def test_a_range_of_another_kind_is_answered_with_how_to_make_seconds_of_it(
    folder: Path, given: Any, variable: str
) -> None:
    with Recording(folder) as recording:
        said = message(RangeError, lambda: recording["robot"].read(start=given))
        assert seconds_by(advice(said, "start"), variable, given) == SECONDS
        said = message(RangeError, lambda: recording.export(folder.parent / "x.csv", format="csv", end=given))
        assert seconds_by(advice(said, "end"), variable, given) == SECONDS


def test_columns_of_dates_are_answered_with_how_to_make_seconds_of_them(tmp_path: Path) -> None:
    times = pd.to_datetime([SECONDS, SECONDS + 1], unit="s").to_numpy()
    with Recorder(tmp_path) as recorder:
        said = message(TimestampError, lambda: recorder.topic("robot").append_columns(q=[1.0, 2.0], _ts=times))
        spelling, ns = advice(said, "_ts").split(" with ns = ")
        given = eval(spelling, {"ns": eval(ns, {"when": times})})
        recorder.topic("robot").append_columns(q=[1.0, 2.0], _ts=given)
    with Recording(tmp_path) as recording:
        assert recording["robot"].to_numpy()["_ts"].tolist() == [SECONDS, SECONDS + 1]


@pytest.mark.parametrize(
    ("given", "unit", "factor"), [(SECONDS * 1e9, "ns", 1e9), (SECONDS * 1e6, "us", 1e6), (SECONDS * 1e3, "ms", 1e3)]
)
def test_a_time_stamp_in_a_smaller_unit_is_answered_with_the_factor(
    tmp_path: Path, given: float, unit: str, factor: float
) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("robot")
        for call in (lambda: topic.append(q=1.0, _ts=given), lambda: topic.append_columns(q=[1.0], _ts=[given])):
            spelling = message(TimestampError, call).split("pass _ts=")[1]
            assert eval(spelling, {unit: given}) == pytest.approx(SECONDS, abs=1e-6)


def test_times_of_many_rows_are_sent_to_append_columns(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for given in ([1.0, 2.0], np.array([1.0, 2.0])):
            said = message(TimestampError, lambda given=given: recorder.topic("robot").append(q=1.0, _ts=given))  # type: ignore[misc]
            assert "append_columns" in said


# ml-dash's BufferConfig


MlDashConfig = namedtuple("MlDashConfig", "flush_interval track_batch_size")


def config_of_ml_dash(**more: Any) -> Any:
    """What `ml_dash.buffer.BufferConfig()` holds in ml-dash 0.6.27 to 0.11.0."""
    cls = type("BufferConfig", (), {"__module__": "ml_dash.buffer", "_MAX_QUEUE_SIZE": 100_000})
    config = cls()
    config.__dict__.update(
        flush_interval=5.0,
        log_batch_size=100,
        metric_batch_size=1000,
        track_batch_size=100,
        file_upload_workers=4,
        buffer_enabled=True,
        max_retries=3,
        retry_base_delay=1.0,
        retry_max_delay=30.0,
        **more,
    )
    return config


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "config", [config_of_ml_dash(), config_of_ml_dash(retry_jitter=0.1, _lock=None)], ids=["0.11", "later"]
)
def test_the_buffer_config_of_ml_dash_is_taken_as_it_is(tmp_path: Path, config: Any) -> None:
    with Experiment("alice/franka/demo", root=tmp_path, buffer_config=config).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0)
        assert exp.tracks("robot").read()["count"] == 1
    assert RecorderOptions.from_environment({}, config) == RecorderOptions(flush_interval_s=5.0, batch_rows=100)
    as_dict = dict(vars(config_of_ml_dash()))
    assert RecorderOptions.from_environment({}, as_dict) == RecorderOptions(flush_interval_s=5.0, batch_rows=100)


def test_a_named_tuple_is_a_buffer_config_too() -> None:
    config = MlDashConfig(flush_interval=2.0, track_batch_size=7)
    assert RecorderOptions.from_environment({}, config) == RecorderOptions(flush_interval_s=2.0, batch_rows=7)
