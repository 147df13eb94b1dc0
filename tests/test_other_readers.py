"""A recording is read by readers that are not ours: mcap's for Python, and the viewers' for JavaScript."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap import Experiment, RecorderOptions
from tests.support import disk, node_program

NODE_SOURCES = Path(__file__).parent / "support" / "node"

compressions = pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])

Report = dict[str, Any]
ReadInNode = Callable[..., list[Report]]

JOINTS = [{"q": [step / 10, -step / 10], "step": step, "_ts": step / 1000} for step in range(3000)]
ODD = [
    {
        "x": None,
        "y": [1.0, None, None],
        "_exact": {"NaN": {"": ["x"], "/y": [1]}, "-Infinity": {"/y": [2]}},
        "_ts": 0.5,
    },
    {"raw": "AP8=", "_exact": {"bytes": {"": ["raw"]}}, "_ts": 1.0},
    {"größe": '日本語 \U0001f916 "\\\n', "": True, "nothing": None, "_ts": 1.5},
    {"big": 2**63 - 1, "deep": {"a": [{"b": []}]}, "_ts": 2.0},
]
MERGED = [{"left": 2, "right": {"gripper": 0.5}, "_ts": 1.0}, {"left": 3, "_ts": 2.0}]
TOPICS = ["robot/joints", "überall/日本", "merged"]


def record(root: Path, compression: Any, **options: Any) -> Path:
    """Record everything that a file can hold; returns the folder."""
    chosen = RecorderOptions(compression=compression, chunk_bytes=64 * 1024, **options)
    with Experiment("alice/arm", root=root, options=chosen, description="ein Arm").run as exp:
        exp.params.set(lr=1e-3, name="große Hand", nested={"a": [1, 2]})
        exp.tracks("merged").append(left=1, right={"gripper": 0.5}, _ts=1.0)
        exp.tracks("merged").append(left=2, _ts=1.0)
        exp.tracks("merged").append(left=3, _ts=2.0)
        for row in JOINTS:
            exp.tracks("robot/joints").append(**row)
        odd = exp.tracks("überall/日本", description="Vermischtes", tags=["odd"])
        odd.append(x=float("nan"), y=[1.0, float("nan"), float("-inf")], _ts=0.5)
        odd.append(raw=b"\x00\xff", _ts=1.0)
        odd.append_batch([ODD[2], ODD[3]])
        exp.logs.info("Grüße", epoch=1)
        exp.logs.warn("zweitens")
        exp.metrics("train").log(loss=0.5)
        exp.metrics("train").log(loss=0.25)
        exp.metrics("eval").log(accuracy=0.75)
    return exp.path


def merged(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of one time stamp as one, in time order."""
    times: dict[float, dict[str, Any]] = {}
    for row in rows:
        time = times.setdefault(row["_ts"], {})
        time.pop("_ts", None)
        time.update(row)
    return [times[time] for time in sorted(times)]


@compressions
def test_mcaps_own_reader_finds_every_payload_with_the_checksums_right(tmp_path: Path, compression: str) -> None:
    folder = record(tmp_path, compression)
    found = disk.rows(folder)
    assert sorted(found) == sorted([*TOPICS, "ml_dash/log", "ml_dash/metrics/eval", "ml_dash/metrics/train"])
    assert found["robot/joints"] == JOINTS
    assert found["überall/日本"] == ODD
    assert merged(found["merged"]) == MERGED
    assert [(row["level"], row["message"]) for row in found["ml_dash/log"]] == [(2, "Grüße"), (3, "zweitens")]
    assert [row["metadata"] for row in found["ml_dash/log"] if "metadata" in row] == [{"epoch": 1}]
    assert [row["loss"] for row in found["ml_dash/metrics/train"]] == [0.5, 0.25]
    assert [row["accuracy"] for row in found["ml_dash/metrics/eval"]] == [0.75]
    assert disk.counts(folder) == {"robot/joints": 3000, "überall/日本": 4, "merged": 2}


@compressions
def test_mcaps_own_reader_finds_the_payloads_as_compact_utf_8_in_the_order_of_their_keys(
    tmp_path: Path, compression: str
) -> None:
    folder = record(tmp_path, compression)
    odd = [data for topic, data in disk.payloads(folder) if topic == "überall/日本"]
    expected = [json.dumps(row, ensure_ascii=False, separators=(",", ":")).encode() for row in ODD]
    assert odd == expected


@compressions
def test_mcaps_own_reader_finds_the_parameters_and_what_was_said_about_the_run(
    tmp_path: Path, compression: str
) -> None:
    folder = record(tmp_path, compression)
    parameters: dict[str, str] = {}
    for values in disk.metadata(folder, "ml_dash.parameters"):
        parameters.update(values)
    assert {name: json.loads(text) for name, text in parameters.items()} == {
        "lr": 1e-3,
        "name": "große Hand",
        "nested.a": [1, 2],
    }
    runs = disk.metadata(folder, "ml_dash.run")
    assert [values["status"] for values in runs if "status" in values] == ["running", "completed"]
    about = [(values["prefix"], values["description"]) for values in disk.metadata(folder, "ml_dash")]
    assert about == [("alice/arm", "ein Arm")] * len(disk.segments(folder))


@compressions
def test_the_chunks_are_compressed_as_was_asked(tmp_path: Path, compression: str) -> None:
    from mcap.reader import make_reader

    folder = record(tmp_path, compression)
    used: set[str] = set()
    for segment in disk.segments(folder):
        with segment.open("rb") as file:
            summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        used |= {index.compression for index in summary.chunk_indexes}
    assert used == {"" if compression == "none" else compression}


# The viewers' reader


@pytest.fixture(scope="session")
def read_in_node(tmp_path_factory: pytest.TempPathFactory) -> ReadInNode:
    """What reads files with @mcap/core, installed for this session."""
    program = node_program.install(NODE_SOURCES / "read_mcap.mjs", tmp_path_factory.mktemp("node"))

    def read(*paths: Path) -> list[Report]:
        done = subprocess.run(["node", str(program), *map(str, paths)], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, "")
        return [json.loads(line) for line in done.stdout.splitlines()]

    return read


@pytest.mark.timeout(300)
@compressions
def test_the_viewers_reader_finds_the_same_topics_counts_and_rows(
    tmp_path: Path, compression: str, read_in_node: ReadInNode
) -> None:
    folder = record(tmp_path, compression)
    [segment] = disk.segments(folder)
    [report] = read_in_node(segment)
    found = disk.rows(folder)
    counts = {topic: len(rows) for topic, rows in found.items()}
    assert report["ok"] is True
    assert report["path"] == str(segment)
    assert {topic: entry["count"] for topic, entry in report["topics"].items()} == counts
    assert report["messageCount"] == report["streamCount"] == sum(counts.values())
    assert {topic: entry["first"] for topic, entry in report["topics"].items() if topic in TOPICS} == {
        "robot/joints": JOINTS[0],
        "überall/日本": ODD[0],
        "merged": MERGED[0],
    }
    last = {topic: entry["last"] for topic, entry in report["topics"].items() if topic in TOPICS}
    assert last.pop("überall/日本") == {**ODD[3], "big": 9223372036854776000}  # JavaScript has doubles only
    assert last == {"robot/joints": JOINTS[-1], "merged": MERGED[-1]}
    assert {topic: entry["last"] for topic, entry in report["topics"].items() if topic.startswith("ml_dash/")} == {
        topic: rows[-1] for topic, rows in found.items() if topic.startswith("ml_dash/")
    }


@pytest.mark.timeout(300)
@compressions
def test_the_viewers_reader_finds_schemas_metadata_and_times(
    tmp_path: Path, compression: str, read_in_node: ReadInNode
) -> None:
    folder = record(tmp_path, compression)
    [report] = read_in_node(disk.segments(folder)[0])
    for topic, entry in report["topics"].items():
        channel, schema = disk.channel(folder, topic)
        assert (entry["messageEncoding"], entry["schemaEncoding"]) == ("json", "jsonschema")
        assert (entry["messageEncoding"], entry["schemaName"]) == (channel.message_encoding, schema.name)
    assert report["metadata"] == ["ml_dash", "ml_dash.run", "ml_dash.parameters", "ml_dash.run"]
    assert report["library"].startswith("ml_dash_mcap ")
    assert report["attachments"] == []
    times = [row["_ts"] for rows in disk.rows(folder).values() for row in rows]
    assert (int(report["startTime"]), int(report["endTime"])) == (round(min(times) * 1e9), round(max(times) * 1e9))


@pytest.mark.timeout(300)
def test_the_viewers_reader_reads_every_segment_of_a_recording_that_was_split(
    tmp_path: Path, read_in_node: ReadInNode
) -> None:
    folder = record(tmp_path, "none", segment_bytes=64 * 1024)
    segments = disk.segments(folder)
    reports = read_in_node(*segments)
    assert len(segments) > 1
    assert [report["path"] for report in reports] == [str(path) for path in segments]
    assert [report["ok"] for report in reports] == [True] * len(segments)
    assert sum(report["topics"].get("robot/joints", {"count": 0})["count"] for report in reports) == 3000


@pytest.mark.timeout(300)
def test_the_viewers_reader_reads_a_recording_without_rows(tmp_path: Path, read_in_node: ReadInNode) -> None:
    with Experiment("alice/empty", root=tmp_path).run as exp:
        exp.params.set(lr=1)
    [report] = read_in_node(*disk.segments(exp.path))
    assert (report["ok"], report["messageCount"], report["topics"]) == (True, 0, {})
    assert set(report["metadata"]) == {"ml_dash", "ml_dash.parameters", "ml_dash.run"}
