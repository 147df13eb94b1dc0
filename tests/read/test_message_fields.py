"""What is known about a topic that was recorded in protobuf, without reading its rows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.cli import main


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[Recording]:
    with Recorder(tmp_path / "run", options=RecorderOptions(encoding="protobuf")) as recorder:
        robot = recorder.topic("robot")
        robot.append(q=[1, 2], step=1, T=np.eye(4), ee={"pos": [1.0, 2.0, 3.0]}, image=np.zeros((70, 80)), _ts=0.0)
        robot.append(q=[0.5, 1.5], step=2.5, mode="run", goal=None, ee={"mixed": [1, "a"]}, empty=[], _ts=1.0)
        robot.append(mode=7, later=True, contacts=[{"body": "a"}], _ts=2.0)
        recorder.topic("plain").append(q=[1.0], _ts=0.0)
        recorder.topic("json", encoding="json").append(q=[1.0], goal=None, _ts=0.0)
    with Recording(tmp_path / "run") as opened:
        yield opened


def test_the_fields_are_those_of_all_rows(recording: Recording) -> None:
    assert {name: str(field) for name, field in recording.topics["robot"].fields.items()} == {
        "q": "number[2]",
        "step": "number",
        "T": "number[4,4]",
        "ee.pos": "number[3]",
        "image": "float64[70,80]",
        "mode": "any",
        "later": "boolean",
        "contacts": "object[]",
    }


def test_values_that_no_field_expresses_are_named(recording: Recording) -> None:
    assert recording.topics["robot"].encoding == "protobuf"
    assert recording.topics["robot"].exact_fields == ("goal", "ee.mixed", "empty")


def test_a_topic_whose_values_all_have_fields_names_none(recording: Recording) -> None:
    assert recording.topics["plain"].exact_fields == ()


def test_a_topic_in_json_names_none(recording: Recording) -> None:
    assert recording.topics["json"].encoding == "json"
    assert recording.topics["json"].exact_fields == ()


def test_the_command_line_names_the_encoding_and_the_values_without_a_field(
    recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(recording.path), "--json"]) == 0
    topics = {topic["name"]: topic for topic in json.loads(capsys.readouterr().out)["topics"]}
    assert topics["robot"]["encoding"] == "protobuf"
    assert topics["robot"]["exact_fields"] == ["goal", "ee.mixed", "empty"]
    assert topics["json"]["exact_fields"] == []
