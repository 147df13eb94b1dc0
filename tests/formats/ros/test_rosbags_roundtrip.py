"""A recording that became a bag and a recording again has the same rows, bit for bit."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.conversion import convert
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.support.bags import export, record, robot_rows, smooth_columns
from tests.support.examples import examples
from tests.support.row_shapes import tables, typed

Row = dict[str, Any]

KINDS: dict[str, dict[str, Any]] = {
    "mcap": {"format": "rosbag2", "storage": "mcap"},
    "sqlite3": {"format": "rosbag2", "storage": "sqlite3"},
    "ros1": {"format": "rosbag1"},
    "ros1-lz4": {"format": "rosbag1", "compression": "lz4"},
    "json": {"format": "rosbag2", "profile": "json"},
    "lossless": {"format": "rosbag2", "profile": "lossless", "compression": "none"},
}


def there_and_back(folder: Path, kind: str, **options: Any) -> dict[str, list[Row]]:
    """Return the rows of a recording after it was a bag, by topic."""
    name = "out.bag" if kind.startswith("ros1") else "out"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        export(folder, folder.parent / name, on_bad="lossless", **KINDS[kind], **options)
    convert(folder.parent / name, folder.parent / "back")
    with Recording(folder.parent / "back") as recording:
        return {topic: list(recording[topic].rows()) for topic in recording.topics}


@given(st.sampled_from(sorted(KINDS)), tables(), tables(), st.integers(1, 3))
@settings(max_examples=examples(25), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_rows_come_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, kind: str, first: list[Row], second: list[Row], repeats: int
) -> None:
    folder = tmp_path_factory.mktemp("bag") / "run"
    topics = {"robot/arm": first * repeats, "cam-1": second}
    given_rows = {
        name: [{**row, "_ts": 0.1 * number} for number, row in enumerate(rows)] for name, rows in topics.items()
    }
    record(folder, given_rows)
    assert typed(there_and_back(folder, kind)) == typed(given_rows)


@pytest.mark.parametrize("kind", KINDS)
def test_many_rows_of_many_chunks_come_back(tmp_path: Path, kind: str) -> None:
    columns = smooth_columns(900)
    with Recorder(tmp_path / "run") as recorder:
        for first in range(0, 900, 150):  # a chunk each
            part = slice(first, first + 150)
            recorder.topic("robot").append_columns(
                _ts=np.arange(900)[part] / 30, **{name: column[part] for name, column in columns.items()}
            )
            recorder.topic("words").append_batch(
                [{"text": "x" * (number % 50), "_ts": number / 7} for number in range(900)[part]]
            )
            recorder.flush()
        recorder.topic("robot").append(note="late", q=None, _ts=1000.0)
    with Recording(tmp_path / "run") as recording:
        before = {topic: list(recording[topic].rows()) for topic in recording.topics}
    assert typed(there_and_back(tmp_path / "run", kind)) == typed(before)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_what_was_said_of_topics_comes_back(tmp_path: Path, kind: str) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.set_parameters({"gain": 0.5})
        said = {"units": {"q": "rad"}, "joint_names": ["a", "b"], "quat_order": "wxyz"}
        topic = recorder.topic("robot [1]", description="an \u00e4rm", tags=["left"], metadata=said)
        topic.append(q=[0.5, 0.5], _ts=1.0)
    there_and_back(tmp_path / "run", kind)
    with Recording(tmp_path / "back") as recording:
        info = recording.topics["robot [1]"]
        assert (info.description, info.tags, dict(info.metadata)) == ("an \u00e4rm", ("left",), said)
        assert recording.params == ({} if kind == "ros1" else {"gain": 0.5})


def test_rows_come_back_with_their_own_times_from_a_bag_whose_times_were_shifted(tmp_path: Path) -> None:
    record(tmp_path / "run", {"robot": robot_rows(10)})
    back = there_and_back(tmp_path / "run", "mcap", time_offset=1.7e9)
    assert [row["_ts"] for row in back["robot"]] == [0.01 * number for number in range(10)]


def test_a_split_bag_comes_back_whole(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        for first in range(0, 2000, 500):
            part = {name: column[first : first + 500] for name, column in smooth_columns(2000).items()}
            recorder.topic("robot").append_columns(_ts=np.arange(first, first + 500) / 100, **part)
            recorder.flush()
    assert len(there_and_back(tmp_path / "run", "mcap", split_bytes=100_000)["robot"]) == 2000
    assert len(list((tmp_path / "out").glob("*.mcap"))) > 2
