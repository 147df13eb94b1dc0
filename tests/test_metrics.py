"""Metrics: numbered points of a run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import FieldError, TopicError, UsageError
from ml_dash_mcap.experiment import Experiment
from tests.support import disk, viewer_schema


@pytest.fixture
def exp(tmp_path: Path) -> Iterator[Experiment]:
    with Experiment("a/b", root=tmp_path).run as started:
        yield started


def test_points_are_numbered_and_come_back_in_ml_dash_s_shape(exp: Experiment) -> None:
    for epoch in range(5):
        assert exp.metrics("train").log(loss=1 / (epoch + 1), epoch=epoch) is exp.metrics("train")
    read = exp.metrics("train").read(start_index=1, limit=2)
    assert [(point["index"], point["data"]["epoch"]) for point in read["data"]] == [(1, 1), (2, 2)]
    assert all(point["createdAt"].endswith("Z") for point in read["data"])
    assert (read["startIndex"], read["endIndex"], read["total"], read["hasMore"]) == (1, 2, 2, True)
    past = exp.metrics("train").read(start_index=5)
    assert past == {"data": [], "startIndex": 5, "endIndex": 4, "total": 0, "hasMore": False}


def test_a_point_may_come_in_a_dict(exp: Experiment) -> None:
    given = {"loss": 0.5, "epoch": 1, "self": 2, "values": 3}
    exp.metrics("train").log(given).log({"loss": 0.25, "_ts": 2.0}, epoch=2).log(
        MappingProxyType({"loss": 0.1}), _ts=3.0
    )
    assert given == {"loss": 0.5, "epoch": 1, "self": 2, "values": 3}, "it is the caller's"
    exp.run.complete()
    rows = disk.rows(exp.path)["ml_dash/metrics/train"]
    assert {"loss": 0.5, "epoch": 1, "self": 2, "values": 3}.items() <= rows[-1].items()
    assert rows[:2] == [{"loss": 0.25, "epoch": 2, "_ts": 2.0}, {"loss": 0.1, "_ts": 3.0}]


@pytest.mark.parametrize(
    ("values", "error"),
    [(0.5, UsageError), ([("loss", 1)], UsageError), ({1: 2}, FieldError), ({"_exact": 1}, FieldError)],
)
def test_a_point_in_what_is_no_dict_of_names_is_refused(exp: Experiment, values: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="metric 'train'"):
        exp.metrics("train").log(values)
    assert exp.metrics("train").read()["total"] == 0


def test_points_lie_on_a_topic_of_their_own_with_a_schema_that_names_their_fields(exp: Experiment) -> None:
    exp.metrics("eval/arm", description="on the robot", tags=["x"]).log(loss=0.5, ok=True)
    exp.run.complete()
    assert [row["loss"] for row in disk.rows(exp.path)["ml_dash/metrics/eval/arm"]] == [0.5]
    channel, schema = disk.channel(exp.path, "ml_dash/metrics/eval/arm")
    assert (channel.metadata["kind"], channel.metadata["description"]) == ("metric", "on the robot")
    shape = json.loads(schema.data)
    assert {"loss", "ok"} <= set(shape["properties"])
    assert viewer_schema.violations(shape) == []


def test_points_of_one_time_are_never_merged(exp: Experiment) -> None:
    exp.tracks("robot").append(q=1.0, _ts=5.0)
    for value in range(3):
        exp.metrics("train").log(value=value)
        exp.flush()
    assert [point["data"] for point in exp.metrics("train").read()["data"]] == [
        {"value": value, "_ts": 5.0} for value in range(3)
    ]
    exp.run.complete()
    assert len(disk.rows(exp.path)["ml_dash/metrics/train"]) == 3


def test_points_are_at_wall_clock_time_unless_the_tracks_run_on_another_clock(exp: Experiment) -> None:
    exp.tracks("robot").append(q=1.0, _ts=1.7e9)
    exp.metrics("train").log(loss=1.0)
    assert (
        exp.metrics("train").read()["data"][0]["data"]["_ts"] == 1.7e9
    )  # of years ago: the tracks say what time it is


def test_a_point_may_have_its_own_time_stamp_and_any_field(exp: Experiment) -> None:
    exp.metrics("train").log(timestamp=3.0, index=7, loss=np.float32(0.5), _ts=2.5)
    assert exp.metrics("train").read()["data"][0]["data"] == {"timestamp": 3.0, "index": 7, "loss": 0.5, "_ts": 2.5}


def test_indexes_go_on_when_the_run_goes_on(tmp_path: Path) -> None:
    for first in (0, 3):
        with Experiment("a/b", root=tmp_path).run as exp:
            for value in range(first, first + 3):
                exp.metrics("train").log(value=value)
            read = exp.metrics("train").read()["data"]
    assert [(point["index"], point["data"]["value"]) for point in read] == [(value, value) for value in range(6)]


def test_stats_and_list_flush_first(exp: Experiment) -> None:
    exp.metrics("train", description="the loss").log(loss=1.0).log(loss=2.0)
    stats = exp.metrics("train").stats()
    assert (stats["metricId"], stats["name"], stats["description"]) == ("train", "train", "the loss")
    assert stats["totalDataPoints"] == "2"
    exp.metrics("eval").log(loss=1.0)
    exp.tracks("robot").append(q=1.0, _ts=0.0)
    assert exp.metrics.list() == ["eval", "train"]
    assert exp.metrics("nothing").stats()["totalDataPoints"] == "0"
    assert exp.metrics("nothing").read()["data"] == []


def test_flush_chains(exp: Experiment) -> None:
    exp.metrics("train").log(loss=1.0).flush()
    assert exp.metrics.flush() is exp.metrics
    assert exp.stats()["waiting"] == 0


@pytest.mark.parametrize("name", ["", "a\0b", "x" * 2000])
def test_a_name_that_cannot_be_is_refused(exp: Experiment, name: str) -> None:
    with pytest.raises(TopicError):
        exp.metrics(name)


def test_a_bad_value_is_named_and_loses_nothing_else(exp: Experiment) -> None:
    metric = exp.metrics("train").log(loss=1.0)
    with pytest.raises(TypeError, match="'bad'"):
        metric.log(loss=2.0, bad=object())
    with pytest.raises(FieldError, match="_exact"):
        metric.log(_exact=1)
    assert [point["data"]["loss"] for point in metric.log(loss=3.0).read()["data"]] == [1.0, 3.0]
