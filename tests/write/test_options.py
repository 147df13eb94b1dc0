"""The recorder's options, from arguments, ml-dash's `buffer_config` and the environment."""

from __future__ import annotations

from typing import Any

import pytest

from ml_dash_mcap import RecorderOptions
from ml_dash_mcap.errors import OptionError, RecorderError


def test_the_environment_counts_where_nothing_else_is_said() -> None:
    environment = {"ML_DASH_FLUSH_INTERVAL": "0.5", "ML_DASH_TRACK_BATCH_SIZE": "10", "ML_DASH_BUFFER_ENABLED": "no"}
    options = RecorderOptions.from_environment(environment, flush_interval_s=2.0)
    assert (options.flush_interval_s, options.batch_rows, options.buffered) == (2.0, 10, False)


def test_the_names_of_ml_dash_work_in_a_buffer_config() -> None:
    class Config:
        def __init__(self) -> None:
            self.flush_interval = 3.0
            self.track_batch_size = 7
            self.buffer_enabled = True
            self.log_batch_size = 100

    expected = RecorderOptions(flush_interval_s=3.0, batch_rows=7, buffered=True)
    assert RecorderOptions.from_environment({}, Config()) == expected
    assert RecorderOptions.from_environment({}, {"flush_interval": 3.0, "batch_rows": 7}) == expected


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("flush_interval_s", 0),
        ("chunk_bytes", 1000),
        ("chunk_bytes", 4_000_001),
        ("compression", "gzip"),
        ("compression_level", 99),
        ("backlog_bytes", 1),
        ("on_full", "explode"),
        ("sync_interval_s", -1),
        ("segment_bytes", 1),
        ("segment_duration_s", 0),
        ("batch_rows", 0),
    ],
)
def test_a_value_that_makes_no_sense_is_named(name: str, value: Any) -> None:
    with pytest.raises(OptionError, match=name) as raised:
        RecorderOptions(**{name: value})
    assert isinstance(raised.value, (ValueError, RecorderError))


@pytest.mark.parametrize("variable", ["ML_DASH_FLUSH_INTERVAL", "ML_DASH_TRACK_BATCH_SIZE", "ML_DASH_BUFFER_ENABLED"])
def test_a_variable_that_cannot_be_read_is_named(variable: str) -> None:
    with pytest.raises(OptionError, match=variable):
        RecorderOptions.from_environment({variable: "often"})


def test_an_unknown_option_names_those_that_exist() -> None:
    with pytest.raises(OptionError, match="flush_interval_s"):
        RecorderOptions.from_environment({}, {"flush_every": 1})
