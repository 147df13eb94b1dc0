"""The log of a run."""

from __future__ import annotations

import inspect
import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ml_dash_mcap import shipped_schemas
from ml_dash_mcap.experiment import Experiment
from tests.support import disk, viewer_schema


@pytest.fixture
def exp(tmp_path: Path) -> Iterator[Experiment]:
    with Experiment("a/b", root=tmp_path).run as started:
        yield started


def logged(exp: Experiment) -> list[dict[str, object]]:
    exp.run.complete()
    return disk.rows(exp.path)["ml_dash/log"]


def test_a_message_is_recorded_with_its_level_its_fields_and_the_place_of_the_call(exp: Experiment) -> None:
    before = time.time_ns()
    exp.log("Epoch complete", level="WARN", metadata={"epoch": 1}, loss=0.5)
    line = inspect.currentframe().f_lineno - 1  # type: ignore[union-attr]
    (row,) = logged(exp)
    stamp = row.pop("timestamp")
    assert before <= stamp["sec"] * 10**9 + stamp["nsec"] <= time.time_ns()  # type: ignore[index]
    assert row.pop("_ts") == pytest.approx(before / 1e9, abs=60)
    assert row == {
        "level": 3,
        "message": "Epoch complete",
        "name": "a/b",
        "file": __file__,
        "line": line,
        "metadata": {"epoch": 1, "loss": 0.5},
    }


def test_the_log_s_topic_is_what_viewers_show_in_their_log_panel(exp: Experiment) -> None:
    exp.log("hello", epoch=1)
    (row,) = logged(exp)
    channel, schema = disk.channel(exp.path, "ml_dash/log")
    assert (schema.name, schema.encoding, channel.message_encoding) == ("foxglove.Log", "jsonschema", "json")
    assert channel.metadata["kind"] == "log"
    assert viewer_schema.violations(json.loads(schema.data)) == []
    assert json.loads(schema.data) == shipped_schemas.load("ml_dash.log")
    pytest.importorskip("jsonschema").validate(row, shipped_schemas.load("ml_dash.log"))


@pytest.mark.parametrize(("level", "number"), [("debug", 1), ("info", 2), ("warn", 3), ("error", 4), ("fatal", 5)])
def test_every_level_has_its_method_and_foxglove_s_number(exp: Experiment, level: str, number: int) -> None:
    getattr(exp.logs, level)("hello", code=7)
    exp.log("hello", level=level, code=7)
    by_method, by_name = logged(exp)
    assert (by_method["level"], by_name["level"]) == (number, number)
    assert by_method["metadata"] == by_name["metadata"] == {"code": 7}
    assert by_method["file"] == by_name["file"] == __file__


def test_the_default_level_is_info(exp: Experiment) -> None:
    exp.log("hello")
    assert [row["level"] for row in logged(exp)] == [2]


@pytest.mark.parametrize("level", ["nope", "", 5, "warning"])
def test_an_unknown_level_is_a_value_error(exp: Experiment, level: object) -> None:
    with pytest.raises(ValueError, match="Must be one of: info, warn, error, debug, fatal") as caught:
        exp.log("hello", level=level)  # type: ignore[arg-type]
    assert str(caught.value).startswith(f"Invalid log level: {level!r}.")


def test_without_a_message_log_gives_a_log_with_fields(exp: Experiment) -> None:
    log = exp.log(metadata={"epoch": 1}, run=2)
    assert log is not None
    log.info("started", epoch=3)
    exp.logs.info("other")
    first, second = logged(exp)
    assert first["metadata"] == {"epoch": 3, "run": 2}
    assert "metadata" not in second


def test_a_message_that_is_no_text_becomes_it(exp: Experiment) -> None:
    exp.logs.error(ValueError("too far"))
    exp.log(5)
    assert [row["message"] for row in logged(exp)] == ["too far", "5"]


def test_messages_of_one_time_stay_apart(exp: Experiment) -> None:
    exp.tracks("robot").append(q=1.0, _ts=5.0)
    for number in range(3):
        exp.log(f"message {number}")
    rows = logged(exp)
    assert [(row["message"], row["_ts"]) for row in rows] == [(f"message {number}", 5.0) for number in range(3)]


def test_a_message_logged_before_the_first_row_is_on_the_clock_of_the_rows(exp: Experiment) -> None:
    exp.log("starting")
    exp.tracks("robot").append(q=1.0, _ts=0.5)
    assert [row["_ts"] for row in logged(exp)] == [0.5]


def test_nothing_is_printed(exp: Experiment, capfd: pytest.CaptureFixture[str]) -> None:
    exp.logs.error("hello")
    exp.flush()
    assert capfd.readouterr() == ("", "")


def test_a_field_that_cannot_be_stored_is_an_error_that_names_the_topic(exp: Experiment) -> None:
    with pytest.raises(TypeError, match="ml_dash/log"):
        exp.log("hello", bad=object())


def test_every_schema_that_a_channel_gets_lies_within_the_viewers_subset() -> None:
    for name in ("ml_dash.log", "ml_dash.metric", "ml_dash.file", "ml_dash.episode"):
        assert viewer_schema.violations(shipped_schemas.load(name)) == []


def test_every_schema_is_a_schema() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    assert shipped_schemas.names() == [
        "ml_dash.episode",
        "ml_dash.file",
        "ml_dash.log",
        "ml_dash.metadata",
        "ml_dash.metric",
        "ml_dash.parameters",
        "ml_dash.run",
        "ml_dash.topic",
    ]
    for name in shipped_schemas.names():
        jsonschema.Draft202012Validator.check_schema(shipped_schemas.load(name))
        assert shipped_schemas.load(name)["$id"] == name
    with pytest.raises(KeyError, match=r"no schema 'nope'; there are ml_dash\.episode"):
        shipped_schemas.load("nope")


def test_every_metadata_record_that_is_written_is_what_its_schema_says(tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    with Experiment("a/b", root=tmp_path, readme="x", tags=["y"], metadata={"z": 1}).run as exp:
        exp.params.set(lr=0.1)
        exp.tracks("robot").append(q=1.0, _ts=0.0)
        exp.tracks("robot", description="the arm", tags=["x"], metadata={"joints": 7})
    for record, schema in [
        ("ml_dash", "ml_dash.metadata"),
        ("ml_dash.run", "ml_dash.run"),
        ("ml_dash.topic", "ml_dash.topic"),
        ("ml_dash.parameters", "ml_dash.parameters"),
    ]:
        found = disk.metadata(exp.path, record)
        assert found, record
        for values in found:
            jsonschema.validate(values, shipped_schemas.load(schema))
