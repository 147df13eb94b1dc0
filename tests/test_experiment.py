"""An Experiment: its arguments, and its rules for time stamps."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import OptionError, PrefixError, RecorderError, StorageError, UsageError
from ml_dash_mcap.experiment import Experiment
from ml_dash_mcap.options import RecorderOptions
from tests.support import disk

PREFIX = "alice/franka/demo"


def experiment(root: Path, **given: Any) -> Experiment:
    return Experiment(PREFIX, root=root, **given)


# Arguments


def test_the_prefix_is_positional_or_a_keyword(tmp_path: Path) -> None:
    by_keyword = Experiment(prefix="a/b/c/d", root=tmp_path)
    assert Experiment("a/b/c/d", root=tmp_path).path == by_keyword.path == tmp_path / "a/b/c/d"
    assert (by_keyword.owner, by_keyword.project, by_keyword.name) == ("a", "b", "d")


def test_the_default_root_is_dot_dash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert Experiment("a/b").path == tmp_path / ".dash" / "a" / "b"


@pytest.mark.parametrize("name", ["root", "dash_root", "local_path"])
def test_the_root_has_three_names(tmp_path: Path, name: str) -> None:
    assert Experiment("a/b", **{name: str(tmp_path)}).path == tmp_path / "a/b"  # type: ignore[arg-type]


def test_two_different_roots_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="pass one"):
        Experiment("a/b", root=tmp_path, dash_root=tmp_path / "other")


def test_an_unknown_argument_is_a_type_error_that_names_the_likely_one() -> None:
    with pytest.raises(TypeError, match=r"unknown argument metdata=; did you mean metadata=\?") as caught:
        Experiment("a/b", metdata={})  # type: ignore[arg-type]
    assert isinstance(caught.value, RecorderError)


def test_a_remote_address_is_refused_with_the_reason() -> None:
    with pytest.raises(TypeError, match="recorded to local files"):
        Experiment("a/b", dash_url="http://localhost:3000")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "prefix",
    [
        "",
        "/a/b",
        "..",
        "../evil",
        "a/../../evil",
        "a/./b",
        "a//b",
        "a/",
        "C:/x",
        "C:x",
        "a\\b",
        "a\0b",
        "a" * 256,
        "\udc80",
    ],
)
def test_a_prefix_that_is_malformed_or_leaves_its_root_is_refused_by_name(tmp_path: Path, prefix: str) -> None:
    with pytest.raises(PrefixError) as caught:
        Experiment(prefix, root=tmp_path)
    assert repr(prefix) in str(caught.value)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("prefix", [5, None, b"a/b", Path("a/b")])
def test_a_prefix_that_is_no_text_is_a_type_error(prefix: object) -> None:
    with pytest.raises(TypeError, match="prefix="):
        Experiment(prefix)  # type: ignore[arg-type]


def test_a_prefix_may_have_any_other_character(tmp_path: Path) -> None:
    with Experiment("älice/2026-11-22 12:30/run…#1", root=tmp_path).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0)
    assert disk.counts(tmp_path / "älice" / "2026-11-22 12:30" / "run…#1") == {"robot": 1}


def test_a_root_that_is_a_file_is_an_error_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    exp = Experiment("a/b", root=tmp_path / "file")
    with pytest.raises(StorageError):
        exp.run.start()
    assert exp.run.status is None


def test_what_is_said_about_a_run_is_in_the_first_metadata_record(tmp_path: Path) -> None:
    said = {
        "readme": "# Demo",
        "description": "a demo",
        "tags": ["x", "y"],
        "bindrs": ["z"],
        "metadata": {"a": [1, 2.5]},
    }
    with experiment(tmp_path, **said).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0)
    record = disk.metadata(exp.path, "ml_dash")[0]
    assert record["prefix"] == PREFIX
    assert (record["readme"], record["description"]) == ("# Demo", "a demo")
    assert [json.loads(record[name]) for name in ("tags", "bindrs", "metadata")] == [["x", "y"], ["z"], {"a": [1, 2.5]}]


def test_metadata_of_a_run_that_have_no_json_are_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="metadata="):
        experiment(tmp_path, metadata={"a": object()})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("config", [{"flush_interval": 0.25}, SimpleNamespace(flush_interval=0.25)])
def test_buffer_config_works(tmp_path: Path, config: object) -> None:
    with experiment(tmp_path, buffer_config=config).run as exp:
        assert exp.run.live is not None
        assert exp.run.live.recorder.options.flush_interval_s == 0.25


def test_buffering_can_be_switched_off(tmp_path: Path) -> None:
    with experiment(tmp_path, buffer_config={"buffer_enabled": False}).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0)
        assert exp.stats()["written"] == 1


def test_the_environment_is_honoured_where_an_option_is_not_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ML_DASH_FLUSH_INTERVAL", "0.5")
    monkeypatch.setenv("ML_DASH_TRACK_BATCH_SIZE", "7")
    with experiment(tmp_path, buffer_config={"flush_interval": 0.25}).run as exp:
        assert exp.run.live is not None
        options = exp.run.live.recorder.options
    assert (options.flush_interval_s, options.batch_rows) == (0.25, 7)


def test_options_are_taken_whole(tmp_path: Path) -> None:
    with experiment(tmp_path, options=RecorderOptions(compression="none")).run as exp:
        assert exp.run.live is not None
        assert exp.run.live.recorder.options.compression == "none"
    with pytest.raises(UsageError, match="pass one"):
        experiment(tmp_path, options=RecorderOptions(), buffer_config={})
    with pytest.raises(UsageError, match="pass RecorderOptions"):
        experiment(tmp_path, options={"compression": "none"})
    with pytest.raises(OptionError):
        experiment(tmp_path, buffer_config={"flush_interval": -1})


def test_an_unknown_rule_for_time_stamps_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="timestamps='maybe'"):
        experiment(tmp_path, timestamps="maybe").run.start()


# Time stamps


def test_a_missing_time_stamp_is_a_value_error_and_loses_nothing_else(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        track = exp.tracks("robot").append(q=1.0, _ts=0.0)
        with pytest.raises(ValueError, match=r"Timestamp '_ts' is required for track.append\(\)"):
            track.append(q=2.0)
        track.append(q=3.0, _ts=1.0)
    assert [row["q"] for row in disk.rows(exp.path)["robot"]] == [1.0, 3.0]


@pytest.mark.parametrize("ts", ["abc", None, [1.0], True, np.bool_(True), np.array([1.0, 2.0]), object(), 1j])
def test_a_time_stamp_that_is_no_number_is_a_value_error(tmp_path: Path, ts: object) -> None:
    with (
        experiment(tmp_path).run as exp,
        pytest.raises(ValueError, match="Timestamp '_ts' must be numeric, got: <class"),
    ):
        exp.tracks("robot").append(q=1.0, _ts=ts)


@pytest.mark.parametrize("ts", [float("nan"), float("inf"), float("-inf"), -0.5, 1e300, 10**400])
def test_a_time_stamp_that_mcap_cannot_say_is_a_value_error_with_topic_and_value(tmp_path: Path, ts: float) -> None:
    with experiment(tmp_path).run as exp, pytest.raises(ValueError, match="'robot'"):
        exp.tracks("robot").append(q=1.0, _ts=ts)


def test_an_inherited_time_stamp_is_a_value_error_that_names_the_way_out(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp, pytest.raises(ValueError, match='timestamps="auto"'):
        exp.tracks("robot").append(q=1.0, _ts=-1)


@pytest.mark.parametrize("ts", ["1.5", 1.5, np.float32(1.5), np.float64(1.5), np.array(1.5)])
def test_numbers_of_all_kinds_are_time_stamps(tmp_path: Path, ts: object) -> None:
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=ts).append(q=2.0, _ts=np.int64(3))
    assert [row["_ts"] for row in disk.rows(exp.path)["robot"]] == [1.5, 3.0]


def test_auto_gives_an_experiment_the_rules_of_a_session(tmp_path: Path) -> None:
    with experiment(tmp_path, timestamps="auto").run as exp:
        exp.tracks("pose").append(x=1.0)
        exp.tracks("image").append(frame=0, _ts=-1)
        pose, image = exp.tracks("pose").read()["entries"], exp.tracks("image").read()["entries"]
    assert pose[0]["timestamp"] == image[0]["timestamp"] > 1e9


# The rest of ml-dash's words


def test_flush_gets_everything_into_the_file(tmp_path: Path) -> None:
    with experiment(tmp_path).run as exp:
        exp.tracks("robot").append(q=1.0, _ts=0.0)
        exp.metrics("train").log(loss=1.0)
        exp.flush()
        stats = exp.stats()
        assert (stats["written"], stats["waiting"], stats["dropped"]) == (2, 0, 0)


def test_an_experiment_shows_its_prefix_and_status(tmp_path: Path) -> None:
    exp = experiment(tmp_path)
    assert repr(exp) == "<Experiment 'alice/franka/demo', not started>"
    with exp.run:
        pass
    assert repr(exp) == "<Experiment 'alice/franka/demo', completed>"
