"""What lies at a path is told by its name and its first bytes, and no format is imported for it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ml_dash_mcap import Recorder, Recording
from ml_dash_mcap.formats import registry

ROS2_HEADER = b"\x89MCAP0\r\n\x01" + (4 + 4 + 4 + 1).to_bytes(8, "little") + b"\x04\0\0\0ros2" + b"\x01\0\0\0x"
OTHER_HEADER = b"\x89MCAP0\r\n\x01" + (4 + 4 + 4 + 1).to_bytes(8, "little") + b"\x04\0\0\0ros1" + b"\x01\0\0\0x"

FILES: dict[str, tuple[bytes, str | None]] = {
    "a.bag": (b"", "rosbag1"),
    "named-otherwise.dat": (b"#ROSBAG V2.0\n", "rosbag1"),
    "a.db3": (b"SQLite format 3\0", "rosbag2"),
    "a.db3.zstd": (b"", "rosbag2"),
    "a.mcap.zstd": (b"", "rosbag2"),
    "a.mcap": (ROS2_HEADER, "rosbag2"),
    "other.mcap": (OTHER_HEADER, None),
    "motive.csv": (b"Format Version,1.23,Take Name,a\r\n", "mocap"),
    "motive-of-a-spreadsheet.csv": (b'\xef\xbb\xbf"Format Version";"1.23"\r\n', "mocap"),
    "motive-utf-16.csv": ("sep=,\r\n\r\nFormat Version,1.2\r\n".encode("utf-16"), "mocap"),
    "format-versions.csv": (b"Format Versions\n1\n", "csv"),
    "joints.STO": (b"", "sto"),
    "joints.mot": (b"name x\n", "sto"),
    "markers.txt": (b"PathFileType\t4\t(X/Y/Z)\ta.trc\n", "trc"),
    "qtm.tsv": (b"NO_OF_FRAMES\t3\n", "qtm"),
    "table.tsv": (b"NO_OF_FRAMES_A\t3\n", "csv"),
    "vicon.csv": (b"\r\nTrajectories,,\r\n100\r\n", "vicon"),
    "devices.csv": (b"Devices,Names\n1,2\n", "csv"),
    "wide.csv": (b"frame,time,q.0\n0,0.0,1\n", "wide"),
    "frames.csv": (b"frame,times,q.0\n0,0.0,1\n", "csv"),
    "a.c3d": (b"\x02\x50\0\0", "c3d"),
    "a-newline-before.C3D": (b"\n\x50\0\0", "c3d"),
    "no.c3d": (b"\x02\x51\0\0", None),
    "a.pq": (b"", "parquet"),
    "parquet-named-otherwise": (b"PAR1", "parquet"),
    "a.ndjson": (b"{}\n", "jsonl"),
    "a.jsonl": (b"{}\n", "jsonl"),
    "a.csv": (b"t,a\n", "csv"),
    "text.txt": (b"hello\n", None),
}
"""Files, to what they begin with, and their format."""

PROBE = """
import json, sys
from ml_dash_mcap.formats import registry
formats = {path: registry.detect(path) for path in sys.argv[1:]}
print(json.dumps([formats, sorted(sys.modules)]))
"""

LIGHT = {
    "ml_dash_mcap.formats.registry",
    "ml_dash_mcap.formats.file_signs",
    "ml_dash_mcap.formats.file_start",
    "ml_dash_mcap.formats.text",
    "ml_dash_mcap.formats.text.plain_text",
}
"""Modules below `formats` that detection needs; none of them reads or writes a format."""

HEAVY = {"numpy", "pyarrow", "rosbags", "ruamel", "yaml", "orjson", "mcap", "zstandard", "lz4", "google", "sqlite3"}


def test_each_kind_of_file_is_detected_without_importing_a_format(tmp_path: Path) -> None:
    for name, (start, _) in FILES.items():
        (tmp_path / name).write_bytes(start)
    arguments = [sys.executable, "-c", PROBE, *(str(tmp_path / name) for name in FILES)]
    formats, modules = json.loads(subprocess.run(arguments, capture_output=True, check=True, text=True).stdout)
    assert {Path(path).name: name for path, name in formats.items()} == {
        name: wanted for name, (_, wanted) in FILES.items()
    }
    assert not HEAVY & set(modules)
    assert {module for module in modules if module.startswith("ml_dash_mcap.formats.")} == LIGHT


@pytest.mark.parametrize(
    ("names", "format"),
    [
        (["a.csv", "b.tsv", ".DS_Store"], "csv"),
        (["a.csv", "b.jsonl"], None),
        (["a.parquet", "b.pq"], "parquet"),
        (["a.jsonl", "b.ndjson"], "jsonl"),
        (["a.db3", "notes.txt"], "rosbag2"),
        ([".DS_Store"], None),
        ([], None),
    ],
)
def test_a_folder_is_detected_by_the_names_in_it(tmp_path: Path, names: list[str], format: str | None) -> None:
    for name in names:
        (tmp_path / name).write_bytes(b"")
    assert registry.detect(tmp_path) == format


def test_a_folder_with_the_metadata_of_a_bag_is_one(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("something: else\n")
    assert registry.detect(tmp_path) is None
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
    assert registry.detect(tmp_path) == "rosbag2"


def test_nothing_at_a_path_has_no_format(tmp_path: Path) -> None:
    assert registry.detect(tmp_path / "nothing.csv") is None


def test_a_recording_is_no_foreign_folder_whose_files_need_a_look(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("robot").append(_ts=0.0, q=1.0)
    assert not registry.may_be_foreign(tmp_path)
    with Recording(tmp_path) as recording:
        assert recording.topics["robot"].count == 1


def test_every_format_has_a_name_of_its_own_and_what_its_entry_names_is_there() -> None:
    for ability in ("read", "write", "stream", "render"):
        for name in registry.names(ability):  # type: ignore[arg-type]
            entry = registry.find(name, ability)  # type: ignore[arg-type]
            assert entry is not None
            references = (entry.read, entry.carry, entry.as_it_lies, entry.write, entry.stream, entry.render)
            for reference in (*references, entry.read_options, entry.write_options):
                assert reference is None or callable(registry.load(reference))
