"""An export is there when it is whole, and not before; it refuses what it cannot do before it reads anything."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, Recording
from ml_dash_mcap.errors import (
    DamagedFileError,
    DestinationExistsError,
    FormatError,
    NotFoundError,
    RangeError,
    StateError,
    StorageError,
    UsageError,
)
from ml_dash_mcap.formats.destination import fresh_file, fresh_folder, name_of, names_of
from tests.support.files import draft, finished, save

FORMATS = ["csv", "dreamlake", "jsonl", "parquet"]
FILES = {"csv": ".csv", "jsonl": ".jsonl", "parquet": ".parquet"}
formats = pytest.mark.parametrize("format", FORMATS)


@pytest.fixture
def rec(tmp_path: Path) -> Recording:
    rows = [{"n": step, "_ts": step / 10} for step in range(20)]
    save(tmp_path / "run/a.mcap", [{"arm": rows[:10]}, {"arm": rows[10:], "cam/left": rows[:3]}])
    return Recording(tmp_path / "run")


def beside(folder: Path) -> list[str]:
    """What lies in a folder besides the recording, hidden files included."""
    return sorted(set(os.listdir(folder)) - {"run"})


@formats
def test_an_existing_destination_is_refused_and_left_alone(rec: Recording, tmp_path: Path, format: str) -> None:
    dest = tmp_path / "out"
    dest.write_text("mine")
    with pytest.raises(DestinationExistsError, match="is there already"):
        rec.export(dest, format=format)
    assert dest.read_text() == "mine"
    assert beside(tmp_path) == ["out"]


@formats
def test_a_folder_with_something_in_it_is_refused_and_an_empty_one_is_taken(
    rec: Recording, tmp_path: Path, format: str
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full/x").touch()
    with pytest.raises(FileExistsError):
        rec.export(tmp_path / "full", format=format)
    (tmp_path / "empty").mkdir()
    assert rec.export(tmp_path / "empty", format=format) == tmp_path / "empty"
    assert any((tmp_path / "empty").iterdir())


def test_a_link_that_leads_nowhere_is_something_too(rec: Recording, tmp_path: Path) -> None:
    (tmp_path / "out").symlink_to(tmp_path / "nowhere")
    with pytest.raises(DestinationExistsError):
        rec.export(tmp_path / "out", format="csv")


@formats
def test_an_existing_destination_is_refused_before_anything_is_read(tmp_path: Path, format: str) -> None:
    rec = Recording(save(tmp_path / "run/a.mcap", [{"arm": [{"_ts": 0.0}]}]))
    read = rec._opened()[0].source.bytes_read  # type: ignore[attr-defined]
    (tmp_path / "out").touch()
    with pytest.raises(DestinationExistsError):
        rec.export(tmp_path / "out", format=format)
    assert rec._opened()[0].source.bytes_read == read  # type: ignore[attr-defined]


class StopError(Exception):
    pass


@formats
@pytest.mark.parametrize("dest", ["out", "deep/er/out"])
def test_an_error_in_the_middle_leaves_nothing_behind(rec: Recording, tmp_path: Path, format: str, dest: str) -> None:
    def stop(done: int, total: int) -> None:
        assert not (tmp_path / dest).exists()
        raise StopError

    with pytest.raises(StopError):
        rec.export(tmp_path / dest, format=format, progress=stop)
    assert beside(tmp_path) == []


@pytest.mark.breaks_files
@formats
def test_a_recording_that_is_damaged_leaves_nothing_behind(tmp_path: Path, format: str) -> None:
    chunks = [{"arm": [{"n": at, "_ts": float(at)}]} for at in range(3)]
    data = bytearray(finished(draft(chunks)))
    at = data.rindex(b'{"n":1')
    data[at + 5 : at + 6] = b"7"
    (tmp_path / "run").mkdir()
    (tmp_path / "run/a.mcap").write_bytes(data)
    with Recording(tmp_path / "run") as rec, pytest.raises(DamagedFileError):
        rec.export(tmp_path / "out", format=format)
    assert beside(tmp_path) == []


@formats
def test_a_folder_that_cannot_be_made_is_a_storage_error_that_names_it(
    rec: Recording, tmp_path: Path, format: str
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="file/out"):
        rec.export(tmp_path / "file/out", format=format)


@formats
def test_progress_goes_up_to_the_number_of_rows(rec: Recording, tmp_path: Path, format: str) -> None:
    said: list[tuple[int, int]] = []
    rec.export(tmp_path / "out", format=format, progress=lambda done, total: said.append((done, total)))
    assert said == sorted(said)
    assert said[-1] == (23, 23)
    assert {total for _, total in said} == {23}


@pytest.mark.parametrize("format", FILES)
def test_each_topic_is_a_file_named_after_it(rec: Recording, tmp_path: Path, format: str) -> None:
    rec.export(tmp_path / "out", format=format)
    assert sorted(os.listdir(tmp_path / "out")) == [f"arm{FILES[format]}", f"cam%2Fleft{FILES[format]}"]


@pytest.mark.parametrize("format", FILES)
def test_one_topic_can_be_one_file(rec: Recording, tmp_path: Path, format: str) -> None:
    dest = rec.export(tmp_path / f"deep/arm{FILES[format]}", format=format, topics=["arm"])
    folder = rec.export(tmp_path / "out", format=format)
    assert dest.read_bytes() == (folder / f"arm{FILES[format]}").read_bytes()


@pytest.mark.parametrize("format", FILES)
def test_several_topics_are_never_one_file(rec: Recording, tmp_path: Path, format: str) -> None:
    with pytest.raises(UsageError, match="there are 2 topics"):
        rec.export(tmp_path / f"arm{FILES[format]}", format=format)
    assert beside(tmp_path) == []


@formats
def test_a_range_is_a_part_of_the_rows_both_ends_included(rec: Recording, tmp_path: Path, format: str) -> None:
    def size(**bounds: Any) -> int:
        folder = rec.export(tmp_path / f"out{len(bounds)}", format=format, topics=["arm"], **bounds)
        return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())

    assert size(start=0.5, end=1.0) < size()
    exported = rec.export(tmp_path / "x.jsonl", format="jsonl", topics=["arm"], start=0.5, end=1.0)
    assert exported.read_bytes().count(b"\n") == 6


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"format": "xml"}, FormatError, "the formats are .*csv"),
        ({"format": "csv", "flatten": True}, UsageError, "no option 'flatten'; it has none"),
        ({"format": "parquet", "flat": True}, UsageError, "no option 'flat'; it has flatten"),
        ({"format": "csv", "topics": ["amr"]}, NotFoundError, "did you mean 'arm'"),
        ({"format": "csv", "start": 2.0, "end": 1.0}, RangeError, "lies after"),
    ],
)
def test_what_cannot_be_exported_is_said(
    rec: Recording, tmp_path: Path, arguments: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        rec.export(tmp_path / "out", **arguments)
    assert beside(tmp_path) == []


def test_a_closed_recording_exports_nothing(rec: Recording, tmp_path: Path) -> None:
    rec.close()
    with pytest.raises(StateError):
        rec.export(tmp_path / "out", format="csv")


@formats
def test_a_recording_without_topics_is_an_empty_export(tmp_path: Path, format: str) -> None:
    Recorder(tmp_path / "run").close()
    save(tmp_path / "run/a.mcap", [])
    with Recording(tmp_path / "run") as rec:
        assert rec.export(tmp_path / "out", format=format).is_dir()


# Streams


@pytest.mark.parametrize(
    ("arguments", "written"),
    [
        ({}, b"".join(b'{"_ts":%.1f,"n":%d}\n' % (step / 10, step) for step in range(20))),
        ({"start": 1.8}, b'{"_ts":1.8,"n":18}\n{"_ts":1.9,"n":19}\n'),
        ({"start_index": 3, "limit": 1}, b'{"_ts":0.3,"n":3}\n'),
        ({"format": "csv", "start": 0.5, "end": 0.6}, b"_ts,n\n0.5,5\n0.6,6\n"),
        ({"format": "csv", "start_index": 19}, b"_ts,n\n1.9,19\n"),
    ],
)
def test_rows_are_written_to_whatever_takes_bytes(rec: Recording, arguments: dict[str, Any], written: bytes) -> None:
    out = io.BytesIO()
    rec["arm"].write(out, **arguments)
    assert out.getvalue() == written


def test_a_stream_in_a_format_that_is_not_known_is_an_error(rec: Recording) -> None:
    with pytest.raises(FormatError, match="the formats are csv, jsonl"):
        rec["arm"].write(io.BytesIO(), format="parquet")


# Destinations


def test_a_fresh_file_and_a_fresh_folder_appear_at_the_end_of_the_block(tmp_path: Path) -> None:
    with fresh_file(tmp_path / "file") as path:
        path.write_text("whole")
        assert not (tmp_path / "file").exists()
    with fresh_folder(tmp_path / "folder") as folder:
        (folder / "x").touch()
        assert not (tmp_path / "folder").exists()
    assert (tmp_path / "file").read_text() == "whole"
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_what_appeared_at_the_destination_meanwhile_is_left_alone(tmp_path: Path) -> None:
    def write() -> None:
        with fresh_file(tmp_path / "file") as path:
            path.write_text("ours")
            (tmp_path / "file").write_text("theirs")

    with pytest.raises(DestinationExistsError):
        write()
    assert (tmp_path / "file").read_text() == "theirs"
    assert os.listdir(tmp_path) == ["file"]


TOPICS = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=40)


@given(st.lists(TOPICS, min_size=2, max_size=5, unique=True))
def test_no_two_topics_share_a_file_on_any_file_system(topics: list[str]) -> None:
    names = list(names_of(topics, ".csv").values())
    assert len({name.casefold() for name in names}) == len(names)
    assert all(name.endswith(".csv") and "/" not in name and "\0" not in name for name in names)
    assert all(not name.startswith(".") and len(name.encode()) <= 255 for name in names)


def test_names_that_differ_in_case_only_get_a_number_behind_them() -> None:
    assert list(names_of(["Arm", "imu"], ".csv").values()) == ["Arm.csv", "imu.csv"]
    first, second = names_of(["Arm", "arm"], ".csv").values()
    assert first == "Arm.csv"
    assert second.startswith("arm~")


@pytest.mark.parametrize(
    ("topic", "name"),
    [
        ("robot", "robot.csv"),
        ("a/b", "a%2Fb.csv"),
        ("../x", "%2E.%2Fx.csv"),
        ("50%", "50%25.csv"),
        ("größe", "größe.csv"),
    ],
)
def test_a_topics_name_is_a_files(topic: str, name: str) -> None:
    assert name_of(topic, ".csv") == name
