"""Each knob takes what makes sense, from each place it may come from, and says its name when it does not."""

from __future__ import annotations

import math
import types
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.errors import OptionError
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.support import disk
from tests.support.case_ids import stable_repr

BAD: list[tuple[str, Any]] = [
    *[
        (name, value)
        for name in ("flush_interval_s", "segment_duration_s")
        for value in (0, -1, math.nan, "1", None, [1])
    ],
    *[("sync_interval_s", value) for value in (-0.1, math.nan, "1", None)],
    *[("chunk_bytes", value) for value in (0, -1, 65535, 4_000_001, 1e5, "65536", None, True)],
    *[("backlog_bytes", value) for value in (0, 65536, 2 * 1024 * 1024 - 1, 4e6, "lots", None)],
    *[("segment_bytes", value) for value in (0, 1024, -1, "1", None)],
    *[("compression", value) for value in ("gzip", "", None, "ZSTD", 5, ["zstd"])],
    *[("compression_level", value) for value in (-101, 23, 1.5, "1", math.nan)],
    *[("on_full", value) for value in ("wait", "", None, True, ["block"])],
    *[("batch_rows", value) for value in (0, -5, 2.5, "7")],
    *[("buffered", value) for value in ("no", 2, None)],
    *[("journal_dir", value) for value in (5, b"x")],
]


@pytest.mark.parametrize(("name", "value"), BAD, ids=lambda value: stable_repr(value)[:20])
def test_a_value_that_makes_no_sense_is_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(OptionError, match=name) as caught:
        RecorderOptions(**{name: value})
    assert isinstance(caught.value, ValueError)
    with pytest.raises(OptionError, match=name):
        RecorderOptions().with_(**{name: value})
    with pytest.raises(OptionError, match=name):
        RecorderOptions.from_environment({}, **{name: value})


EDGES: list[dict[str, Any]] = [
    {"chunk_bytes": 65536, "backlog_bytes": 131072, "segment_bytes": 65536},
    {"chunk_bytes": 4_000_000},
    {"flush_interval_s": 1e-9},
    {"flush_interval_s": 1e12, "sync_interval_s": 0},
    {"flush_interval_s": math.inf, "sync_interval_s": 0},
    {"sync_interval_s": 1e-9},
    {"sync_interval_s": math.inf, "flush_interval_s": math.inf, "segment_duration_s": math.inf},
    {"flush_interval_s": 1, "sync_interval_s": 1, "segment_duration_s": 1},
    {"batch_rows": 1},
    {"buffered": False, "on_full": "raise"},
    {"compression": "zstd", "compression_level": 22},
    {"compression": "zstd", "compression_level": -100},
    {"compression": "lz4", "compression_level": -100},
    {"compression": "lz4", "compression_level": 22},
    {"compression": "none", "compression_level": 3},
]


@pytest.mark.parametrize("given", EDGES, ids=stable_repr)
def test_the_outermost_values_work(tmp_path: Path, given: dict[str, Any]) -> None:
    with Recorder(tmp_path, RecorderOptions(**given)) as recorder:
        for number in range(50):
            recorder.topic("a").append(n=number, _ts=float(number))
        recorder.flush()
        recorder.topic("a").append(n=50, _ts=50.0)
    assert [row["n"] for row in disk.rows(tmp_path)["a"]] == list(range(51))


def test_options_come_from_the_environment_where_nothing_else_says_them() -> None:
    environment = {
        "ML_DASH_FLUSH_INTERVAL": " 5.0 ",
        "ML_DASH_TRACK_BATCH_SIZE": "100",
        "ML_DASH_BUFFER_ENABLED": "False",
    }
    assert RecorderOptions.from_environment(environment) == RecorderOptions(
        flush_interval_s=5.0, batch_rows=100, buffered=False
    )
    config = {
        "flush_interval": 2.0,
        "track_batch_size": 7,
        "log_batch_size": 3,
        "metric_batch_size": 4,
        "file_upload_workers": 5,
    }
    assert RecorderOptions.from_environment(environment, config) == RecorderOptions(
        flush_interval_s=2.0, batch_rows=7, buffered=False
    )
    assert RecorderOptions.from_environment(
        environment, config, buffered=True, flush_interval_s=3.0
    ) == RecorderOptions(flush_interval_s=3.0, batch_rows=7)
    assert RecorderOptions.from_environment({"ML_DASH_FLUSH_INTERVAL": "", "OTHER": "x"}) == RecorderOptions()


def test_the_encoding_comes_from_the_environment_as_other_options_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ML_DASH_ENCODING", " cbor ")
    assert RecorderOptions.from_environment(encoding="json").encoding == "json"
    with Recorder(tmp_path / "cbor") as recorder:
        recorder.topic("a").append(n=1, _ts=0.0)
    with Recording(tmp_path / "cbor") as rec:
        assert rec.topics["a"].encoding == "cbor"
    monkeypatch.setenv("ML_DASH_ENCODING", "morse")
    with pytest.raises(OptionError, match="morse"):
        Recorder(tmp_path / "morse")


def test_a_buffer_config_may_be_an_object_and_name_our_own_options() -> None:
    config = types.SimpleNamespace(flush_interval=2.0, buffer_enabled=False, chunk_bytes=65536)
    assert RecorderOptions.from_environment({}, config) == RecorderOptions(
        flush_interval_s=2.0, buffered=False, chunk_bytes=65536
    )


@pytest.mark.parametrize("text", ["true", "1", "YES", "on"])
def test_words_for_yes(text: str) -> None:
    assert RecorderOptions.from_environment({"ML_DASH_BUFFER_ENABLED": text}).buffered is True


@pytest.mark.parametrize("text", ["false", "0", "No", "OFF"])
def test_words_for_no(text: str) -> None:
    assert RecorderOptions.from_environment({"ML_DASH_BUFFER_ENABLED": text}).buffered is False


@pytest.mark.parametrize(
    ("variable", "text"),
    [
        ("ML_DASH_FLUSH_INTERVAL", "soon"),
        ("ML_DASH_FLUSH_INTERVAL", "0"),
        ("ML_DASH_FLUSH_INTERVAL", "nan"),
        ("ML_DASH_TRACK_BATCH_SIZE", "1.5"),
        ("ML_DASH_TRACK_BATCH_SIZE", "-1"),
        ("ML_DASH_BUFFER_ENABLED", "maybe"),
    ],
)
def test_a_bad_variable_is_an_error_and_not_ignored(variable: str, text: str) -> None:
    with pytest.raises(OptionError):
        RecorderOptions.from_environment({variable: text})


@pytest.mark.parametrize("config", [{"flush_intervall": 1}, {"colour": "red"}])
def test_an_unknown_name_is_refused_with_the_names_that_there_are(config: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match="flush_interval_s"):
        RecorderOptions.from_environment({}, config)


@pytest.mark.parametrize("config", [5, "fast", [1]], ids=stable_repr)
def test_a_buffer_config_that_is_neither_mapping_nor_object_is_refused(config: Any) -> None:
    with pytest.raises(OptionError):
        RecorderOptions.from_environment({}, config)


def test_a_recorder_without_options_asks_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ML_DASH_FLUSH_INTERVAL", "7.5")
    with Recorder(tmp_path) as recorder:
        assert recorder.options.flush_interval_s == 7.5


def test_a_recorder_with_bad_variables_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ML_DASH_FLUSH_INTERVAL", "x")
    with pytest.raises(OptionError):
        Recorder(tmp_path)
    assert list(tmp_path.iterdir()) == []
