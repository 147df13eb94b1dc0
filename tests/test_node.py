"""What we record is read by the code that Foxglove and Lichtblick read with, and by mcap's own."""

from __future__ import annotations

import json
import math
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, SeekingReader

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder, open_topic
from ml_dash_mcap.topic import EventTopic
from tests.support import disk, node_program

NODE = Path(__file__).parent / "support" / "node"


@pytest.fixture(scope="session")
def reader_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program with its packages, installed once."""
    return node_program.install(NODE / "read_mcap.mjs", tmp_path_factory.mktemp("node"))


def record(folder: Path, options: RecorderOptions) -> dict[str, int]:
    """Record something of everything; returns how many messages each topic has."""
    with Recorder(folder, options, prefix="me/run") as recorder:
        recorder.set_parameters({"lr": 0.1, "none": math.nan})
        robot = recorder.topic("robot/arm", description="an arm", tags=["a"], metadata={"unit": "rad"})
        for number in range(2000):
            robot.append(q=[0.1 * number] * 7, nested={"a": {"b": number}}, ok=True, _ts=number / 30)
            robot.append(image=b"\0\xff", nan=math.nan, text="\u00e4\U0001f916", _ts=number / 30)
            if number == 1000:
                recorder.flush()
        recorder.topic("bulk").append_columns(
            _ts=np.arange(3000) / 100, q=np.random.default_rng(0).normal(size=(3000, 4))
        )
        recorder.topic("sparse").append(_ts=1.0).append(a=[], b=None, _ts=2.0)
        recorder.topic("large").append(fill="x" * 100_000, _ts=1.0)
        recorder.topic("never used")
        for number in range(10):
            open_topic(recorder, "ml_dash/metrics/train", "metric", EventTopic).add({"loss": number})
    found: dict[str, int] = {}
    for topic, _ in disk.payloads(folder):
        found[topic] = found.get(topic, 0) + 1
    return found


OPTIONS = {
    "zstd": {"compression": "zstd"},
    "lz4": {"compression": "lz4", "chunk_bytes": 65536, "backlog_bytes": 262144},
    "uncompressed": {"compression": "none", "chunk_bytes": 65536, "backlog_bytes": 262144, "segment_bytes": 262144},
}


@pytest.fixture(params=OPTIONS)
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, dict[str, int]]:
    return tmp_path, record(tmp_path, RecorderOptions(**OPTIONS[request.param]))


def test_the_viewers_reader_finds_every_row_through_the_index_and_in_the_stream(
    recording: tuple[Path, dict[str, int]], reader_program: Path
) -> None:
    folder, counts = recording
    command = ["node", str(reader_program), *map(str, disk.segments(folder))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    reports: list[dict[str, Any]] = [json.loads(line) for line in done.stdout.splitlines()]
    found: dict[str, int] = {}
    for report in reports:
        assert report["ok"]
        assert report["library"].startswith("ml_dash_mcap ")
        assert report["profile"] == ""
        assert report["metadata"][0] == "ml_dash"
        for topic, said in report["topics"].items():
            found[topic] = found.get(topic, 0) + said["count"]
            assert (said["messageEncoding"], said["schemaEncoding"]) == ("json", "jsonschema")
    assert found == counts
    first = reports[0]["topics"]["robot/arm"]["first"]
    assert {name: first[name] for name in ("nested", "ok", "image", "nan", "text", "_ts")} == {
        "nested": {"a": {"b": 0}},
        "ok": True,
        "image": "AP8=",
        "nan": None,
        "text": "\u00e4\U0001f916",
        "_ts": 0,
    }


@pytest.mark.parametrize("kind", [SeekingReader, NonSeekingReader])
def test_mcaps_own_readers_find_every_row(recording: tuple[Path, dict[str, int]], kind: Any) -> None:
    folder, counts = recording
    found: dict[str, int] = {}
    for path in disk.segments(folder):
        with path.open("rb") as file:
            reader = kind(file, validate_crcs=True)
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                assert schema.encoding == "jsonschema"
                json.loads(message.data)
                found[channel.topic] = found.get(channel.topic, 0) + 1
    assert found == counts
