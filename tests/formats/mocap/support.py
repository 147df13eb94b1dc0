"""What the tests of motion capture share: recordings of a few rows, and what comes back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ml_dash_mcap.formats import readers
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording

UNIT = [0.5, 0.5, 0.5, 0.5]

Rows = dict[str, list[dict[str, Any]]]


def record(folder: Path, rows: Rows, **metadata: dict[str, Any]) -> Recording:
    """Record rows by topic, and open what was recorded."""
    with Recorder(folder) as recorder:
        for topic, some in rows.items():
            recorder.topic(topic, metadata=metadata.get(topic)).append_batch(some)
    return Recording(folder)


def rows_of(folder: Path) -> Rows:
    with Recording(folder) as recording:
        return {topic: list(recording[topic].rows()) for topic in recording.topics}


def read_back(file: Path, folder: Path, **options: Any) -> Rows:
    """Read a foreign file into a recording, and return its rows by topic."""
    with Recorder(folder) as recorder:
        readers.record(file, recorder, **options)
    return rows_of(folder)
