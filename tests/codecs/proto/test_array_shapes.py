"""The types and shapes of large arrays are known from the schema, whichever way their rows were encoded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from ml_dash_mcap import Recorder, RecorderOptions, Recording


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_the_schema_says_what_all_arrays_have_in_common(tmp_path: Path, encoding: str) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding=encoding)) as recorder:
        topic = recorder.topic("scan")
        for step in range(10):
            points = np.zeros((2000 + (step == 7), 3), "f4")
            image = np.zeros((300, 300), "u1")
            topic.append(points=points, image=image, other=points if step % 2 else image, _ts=float(step))
    with Recording(tmp_path) as recording:
        fields = recording.topics["scan"].fields
        assert {name: str(field) for name, field in fields.items()} == {
            "points": "float32[,3]",
            "image": "uint8[300,300]",
            "other": "array",
        }


def test_arrays_come_back_from_parquet_as_they_went_in(tmp_path: Path) -> None:
    for encoding in ("json", "protobuf"):
        with Recorder(tmp_path / encoding, RecorderOptions(encoding=encoding)) as recorder:
            for step in range(5):
                recorder.topic("scan").append(points=np.full((2000, 3), step, "f4"), _ts=float(step))
        with Recording(tmp_path / encoding) as recording:
            recording.export(tmp_path / f"{encoding}.parquet", format="parquet")
    tables = [pq.read_table(path) for path in sorted(tmp_path.rglob("*.parquet"))]
    assert len(tables) == 2
    assert tables[0].schema.field("points").equals(tables[1].schema.field("points"), check_metadata=True)
    assert tables[0].column("points").equals(tables[1].column("points"))
