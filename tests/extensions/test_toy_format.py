"""A format that is added in this file alone: everything that knows formats knows it then."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import pytest

from ml_dash_mcap import Recorder, Recording, convert
from ml_dash_mcap.cli import main
from ml_dash_mcap.errors import DestinationExistsError, FormatError, OptionError, UsageError
from ml_dash_mcap.formats import registry
from ml_dash_mcap.formats.export_job import Job
from ml_dash_mcap.formats.file_start import begins_with
from ml_dash_mcap.formats.registry import Format, Progress
from ml_dash_mcap.inspect.topics import TopicInfo
from ml_dash_mcap.query.topic_part import TopicPart

MAGIC = b"toys\n"


@dataclass(frozen=True, kw_only=True)
class ToyReadOptions:
    """How files of toys are read."""

    shift_s: float = 0.0
    """Added to all times."""

    def __post_init__(self) -> None:
        if not isinstance(self.shift_s, (int, float)):
            raise OptionError(f"shift_s={self.shift_s!r}: pass seconds")


@dataclass(frozen=True, kw_only=True)
class ToyWriteOptions:
    """How files of toys are written."""

    digits: int = 6


def read(src: Path, recorder: Recorder, options: ToyReadOptions, progress: Progress | None) -> None:
    """Append a file of lines `topic time value`."""
    lines = src.read_text().splitlines()[1:]
    for number, line in enumerate(lines, 1):
        topic, time, value = line.split()
        recorder.topic(topic).append(_ts=float(time) + options.shift_s, value=float(value))
        if progress is not None:
            progress(number, len(lines))


def write(job: Job, options: ToyWriteOptions) -> Path:
    """Write such lines."""
    with job.dest.open("wb") as file:
        file.write(MAGIC)
        for topic, info in job.topics.items():
            put_rows(job.part(topic), info, file, options.digits)
    return job.dest


def stream(part: TopicPart, info: TopicInfo, out: BinaryIO) -> None:
    """Write the lines of one topic."""
    put_rows(part, info, out, 6)


def put_rows(part: TopicPart, info: TopicInfo, out: BinaryIO, digits: int) -> None:
    for row in part.rows():
        out.write(f"{info.name} {row['_ts']!r} {row['value']:.{digits}g}\n".encode())


def render(part: TopicPart) -> dict[float, float]:
    """Return the values by time."""
    return {row["_ts"]: row["value"] for row in part.rows()}


TOY = Format(
    "toy",
    suffixes=(".toy",),
    detect=begins_with(MAGIC),
    inside=(".toy",),
    read=read,
    read_options=ToyReadOptions,
    write=write,
    write_options=ToyWriteOptions,
    stream=stream,
    render=render,
)


@pytest.fixture(autouse=True)
def _toy() -> Iterator[None]:
    registry.register(TOY)
    yield
    registry.unregister("toy")


@pytest.fixture
def toys(tmp_path: Path) -> Path:
    """Return a file of the format whose name does not say so."""
    path = tmp_path / "toys.txt"
    path.write_bytes(MAGIC + b"car 1.0 0.5\ncar 2.0 0.25\ndoll 1.5 3\n")
    return path


def test_a_file_is_detected_by_its_first_bytes_and_converted(toys: Path, tmp_path: Path) -> None:
    assert registry.detect(toys) == "toy"
    convert(toys, tmp_path / "run", shift_s=10.0)
    with Recording(tmp_path / "run") as recording:
        assert {name: list(topic.rows()) for name, topic in recording.items()} == {
            "car": [{"value": 0.5, "_ts": 11.0}, {"value": 0.25, "_ts": 12.0}],
            "doll": [{"value": 3.0, "_ts": 11.5}],
        }


def test_a_file_opens_as_a_recording(toys: Path) -> None:
    with Recording(toys) as recording:
        assert recording["car"].read(format="toy") == {1.0: 0.5, 2.0: 0.25}


def test_a_recording_goes_out_by_the_suffix_and_comes_back_the_same(toys: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    convert(toys, tmp_path / "run", progress=lambda done, total: seen.append((done, total)))
    convert(tmp_path / "run", tmp_path / "again.toy")
    assert (tmp_path / "again.toy").read_bytes() == toys.read_bytes()
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_one_foreign_format_becomes_the_other(toys: Path, tmp_path: Path) -> None:
    convert(toys, tmp_path / "tables", format="csv")
    convert(tmp_path / "tables", tmp_path / "again.toy")
    assert (tmp_path / "again.toy").read_bytes() == toys.read_bytes()


def test_a_topic_is_streamed(toys: Path) -> None:
    out = io.BytesIO()
    with Recording(toys) as recording:
        recording["car"].write(out, format="toy")
    assert out.getvalue() == b"car 1.0 0.5\ncar 2.0 0.25\n"


def test_options_are_checked_like_those_of_other_formats(toys: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"reading 'toy' has no option 'shift'; it has shift_s. did you mean shift_s="):
        convert(toys, tmp_path / "run", shift=1.0)
    with pytest.raises(OptionError, match="shift_s='x': pass seconds"):
        convert(toys, tmp_path / "run", shift_s="x")
    with Recording(toys) as recording, pytest.raises(UsageError, match=r"has no option 'digit'; it has digits"):
        recording.export(tmp_path / "a.toy", digit=2)
    with Recording(toys) as recording:
        recording.export(tmp_path / "a.toy", topics=["doll"], options=ToyWriteOptions(digits=1))
    assert (tmp_path / "a.toy").read_bytes() == MAGIC + b"doll 1.5 3\n"


def test_errors_name_it(toys: Path, tmp_path: Path) -> None:
    (tmp_path / "plain.txt").write_text("nothing that anybody knows\n")
    with pytest.raises(FormatError, match=r"end it with .*\.toy \(toy\)"):
        registry.format_of(tmp_path / "out.odd")
    with Recording(toys) as recording:
        with pytest.raises(FormatError, match="did you mean 'toy'"):
            recording.export(tmp_path / "a", format="toyy")
        with pytest.raises(FormatError, match=r"read\(\) takes .*toy"):
            recording["car"].read(format="toyy")  # type: ignore[call-overload]


def test_the_command_line_offers_it(toys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    assert "toy" in capsys.readouterr().out
    assert main(["export", str(toys), str(tmp_path / "a"), "--format", "toy", "--option", "digits=1"]) == 0
    capsys.readouterr()
    assert main(["cat", str(toys), "car", "--format", "toy"]) == 0
    assert capsys.readouterr().out == "car 1.0 0.5\ncar 2.0 0.25\n"


def test_overwriting_replaces_a_file_of_it(toys: Path, tmp_path: Path) -> None:
    dest = tmp_path / "a.toy"
    dest.write_bytes(b"older")
    with Recording(toys) as recording:
        with pytest.raises(DestinationExistsError):
            recording.export(dest)
        recording.export(dest, overwrite=True)
    assert dest.read_bytes() == toys.read_bytes()


def test_a_name_is_taken_once() -> None:
    with pytest.raises(UsageError, match="there is a format 'csv' already"):
        registry.register(Format("csv", write=write))


def test_a_format_can_be_forgotten_but_not_those_of_the_library(toys: Path) -> None:
    registry.unregister("toy")
    registry.unregister("csv")
    assert registry.detect(toys) is None
    assert "csv" in registry.names("write")


def test_an_instance_of_options_goes_to_reading_or_writing_by_its_class(toys: Path, tmp_path: Path) -> None:
    convert(toys, tmp_path / "late.toy", options=ToyReadOptions(shift_s=10.0), digits=1)
    assert (tmp_path / "late.toy").read_bytes() == MAGIC + b"car 11.0 0.5\ncar 12.0 0.2\ndoll 11.5 3\n"
    convert(toys, tmp_path / "short.toy", options=ToyWriteOptions(digits=1))
    assert (tmp_path / "short.toy").read_bytes() == MAGIC + b"car 1.0 0.5\ncar 2.0 0.2\ndoll 1.5 3\n"
    convert(toys, tmp_path / "run", options=ToyReadOptions(shift_s=1.0))
    with Recording(tmp_path / "run") as recording:
        assert recording.start == 2.0
    with pytest.raises(UsageError, match="takes ToyWriteOptions as options=, not dict"):
        convert(toys, tmp_path / "odd.toy", options={"digits": 1})


def test_a_folder_with_a_file_of_it_is_asked_about_and_other_folders_are_not(tmp_path: Path) -> None:
    assert not registry.may_be_foreign(tmp_path)
    (tmp_path / "a.toy").write_bytes(MAGIC)
    assert registry.may_be_foreign(tmp_path)
    assert registry.detect(tmp_path) is None
