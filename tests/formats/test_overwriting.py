"""`overwrite=True` replaces an earlier result once the new one is whole, and removes nothing else."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from ml_dash_mcap import Experiment, Recorder, Recording, convert
from ml_dash_mcap.cli import main
from ml_dash_mcap.errors import DestinationExistsError, FormatError, OptionError
from ml_dash_mcap.formats import registry, replacing
from ml_dash_mcap.formats import swap_names as exchange_module

NAMES = {
    "parquet": "out", "csv": "out", "jsonl": "out", "dreamlake": "out", "rosbag2": "out", "rosbag1": "out.bag",
    "mocap": "take.csv", "vicon": "take.csv", "qtm": "take.tsv", "trc": "take.trc", "sto": "take.sto", "c3d": "take.c3d",
    "mcap": "out",
}  # fmt: skip
"""What an export of each format is called here."""

SUFFIXES = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".jsonl": "jsonl",
    ".bag": "rosbag1",
    ".trc": "trc",
    ".tsv": "qtm",
    ".sto": "sto",
    ".c3d": "c3d",
    ".CSV": "csv",
}


def record(folder: Path, rows: int) -> Path:
    with Recorder(folder) as recorder:
        hand = recorder.topic("hand", units={"position": "m"})
        arm = recorder.topic("arm", joint_names=["a", "b"], units={"q": "rad"})
        for step in range(rows):
            hand.append(position=[0.1 * step, 0.2, 0.3], orientation=[0.0, 0.0, 0.0, 1.0], _ts=step / 100)
            arm.append(q=[0.1, 0.2], _ts=step / 100)
    return folder


@pytest.fixture
def short(tmp_path: Path) -> Path:
    return record(tmp_path / "short", 10)


@pytest.fixture
def long(tmp_path: Path) -> Path:
    return record(tmp_path / "long", 30)


def options(format: str) -> dict[str, Any]:
    """What the formats of markers and joints are asked for; the others export all."""
    return (
        {"topics": ["hand"]}
        if format in ("vicon", "qtm", "trc", "c3d")
        else {"topics": ["arm"]}
        if format == "sto"
        else {}
    )


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones included."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def without_times(found: dict[str, bytes]) -> dict[str, int]:
    """The names and sizes of files, where a file says when it was written."""
    return {name: len(data) for name, data in found.items()}


def test_every_format_is_tried_here() -> None:
    assert sorted(NAMES) == registry.names("write")


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.ConversionWarning", "ignore:there are messages at time 0")
@pytest.mark.parametrize("format", NAMES)
def test_the_new_result_takes_the_place_of_the_old_one_once_it_is_whole(
    tmp_path: Path, short: Path, long: Path, format: str
) -> None:
    if format == "c3d":
        pytest.importorskip("ezc3d")
    dest, fresh = tmp_path / "a" / NAMES[format], tmp_path / "b" / NAMES[format]
    with Recording(short) as first, Recording(long) as second:
        first.export(dest, format=format, **options(format))
        old = contents(tmp_path / "a")

        def look(done: int, total: int) -> None:
            if done < total:
                assert {name: data for name, data in contents(tmp_path / "a").items() if name in old} == old

        assert second.export(dest, format=format, overwrite=True, progress=look, **options(format)) == dest
        second.export(fresh, format=format, overwrite=True, **options(format))
    new, wanted = contents(tmp_path / "a"), contents(tmp_path / "b")
    assert new != old
    assert without_times(new) == without_times(wanted), "nothing of the old one is left, and nothing beside it"


class StopError(Exception):
    pass


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.ConversionWarning", "ignore:there are messages at time 0")
@pytest.mark.parametrize("format", ["parquet", "csv", "dreamlake", "rosbag1", "rosbag2", "mocap"])
def test_after_an_error_the_old_result_is_there_and_nothing_else(
    tmp_path: Path, short: Path, long: Path, format: str
) -> None:
    dest = tmp_path / "a" / NAMES[format]
    with Recording(short) as first, Recording(long) as second:
        first.export(dest, format=format)
        old = contents(tmp_path / "a")

        def stop(done: int, total: int) -> None:
            raise StopError

        with pytest.raises(StopError):
            second.export(dest, format=format, overwrite=True, progress=stop)
    assert contents(tmp_path / "a") == old


@pytest.mark.parametrize("can_exchange", [True, False])
def test_a_folder_is_replaced_with_and_without_help_of_the_system(
    tmp_path: Path, short: Path, long: Path, can_exchange: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not can_exchange:
        monkeypatch.setattr(exchange_module, "_renameat2", lambda: None)
    dest = tmp_path / "a/out"
    with Recording(short) as first, Recording(long) as second:
        first.export(dest, format="jsonl")
        second.export(dest, format="jsonl", topics=["arm"], overwrite=True)
    assert os.listdir(tmp_path / "a") == ["out"]
    assert os.listdir(dest) == ["arm.jsonl"]
    assert (dest / "arm.jsonl").read_bytes().count(b"\n") == 30


# What stays


def kept(tmp_path: Path, call: Callable[[], object], error: type[Exception], reason: str) -> None:
    """Check that a call is refused and changes nothing."""
    before = contents(tmp_path)
    with pytest.raises(error, match=reason):
        call()
    assert contents(tmp_path) == before


def write(path: Path, text: str = "mine") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_without_overwrite_what_is_there_stays_and_the_error_says_how_to_replace_it(
    tmp_path: Path, short: Path
) -> None:
    dest = write(tmp_path / "arm.csv")
    with Recording(short) as rec:
        kept(tmp_path, lambda: rec.export(dest, topics=["arm"]), DestinationExistsError, "overwrite=True")
        for value in ("yes", 1, None):
            call = lambda value=value: rec.export(dest, topics=["arm"], overwrite=value)  # noqa: E731
            kept(tmp_path, call, OptionError, "must be True or False")


@pytest.mark.parametrize("format", ["parquet", "csv", "jsonl", "dreamlake", "rosbag2"])
def test_a_folder_with_anything_else_in_it_stays(tmp_path: Path, short: Path, format: str) -> None:
    with Recording(short) as rec:
        dest = rec.export(tmp_path / "out", format=format)
        for name in ("notes.txt", "deep/er/photo.png", ".hidden/key"):
            write(dest / name)
            call = lambda: rec.export(dest, format=format, overwrite=True)  # noqa: E731
            kept(tmp_path, call, DestinationExistsError, name)
            (dest / name).unlink()
        write(dest / ".DS_Store")
        assert rec.export(dest, format=format, overwrite=True) == dest
        other = "csv" if format != "csv" else "parquet"
        call = lambda: rec.export(dest, format=other, overwrite=True)  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, "holds more than what")


def test_a_folder_with_too_many_files_to_look_at_stays(
    tmp_path: Path, short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replacing, "_MOST_FILES", 3)
    with Recording(short) as rec:
        dest = rec.export(tmp_path / "out", format="csv", topics=["arm"])
        for name in ("a.csv", "b.csv"):
            write(dest / name)
        assert rec.export(dest, format="csv", topics=["arm"], overwrite=True) == dest
        for name in ("a.csv", "b.csv", "c.csv"):
            write(dest / name)
        call = lambda: rec.export(dest, format="csv", topics=["arm"], overwrite=True)  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, "more than 3 files")


def test_a_recording_is_no_bag_and_mcap_files_of_others_are_no_recording_of_ours(
    tmp_path: Path, short: Path, long: Path
) -> None:
    """All three are folders of `.mcap` files."""
    with Recording(short) as rec:
        call = lambda: rec.export(long, format="rosbag2", overwrite=True)  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, r"without the metadata\.yaml")
        bag = rec.export(tmp_path / "bag", format="rosbag2")
    (tmp_path / "others").mkdir()
    with (tmp_path / "others/field-test.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="another program")
        writer.finish()
    call = lambda: convert(bag, tmp_path / "others", overwrite=True)  # noqa: E731
    kept(tmp_path, call, DestinationExistsError, r"another program wrote: field-test\.mcap")
    kept(tmp_path, lambda: convert(bag, bag.parent / "bag", overwrite=True), DestinationExistsError, "is what is read")


def test_a_folder_is_not_replaced_by_a_file_nor_a_file_by_a_folder(tmp_path: Path, short: Path) -> None:
    with Recording(short) as rec:
        folder = rec.export(tmp_path / "out.d", format="csv").rename(tmp_path / "out.csv")
        call = lambda: rec.export(folder, topics=["arm"], overwrite=True)  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, "it is a folder, and what is written is a file")
        file = write(tmp_path / "out")
        for other in ("csv", "rosbag2", "dreamlake"):
            call = lambda other=other: rec.export(file, format=other, overwrite=True)  # noqa: E731
            kept(tmp_path, call, DestinationExistsError, "it is a file, and what is written is a folder")


def test_what_is_exported_and_what_holds_it_stays(tmp_path: Path, short: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with Recording("short") as rec:
        for dest in ("short", ".", "../" + tmp_path.name, "short/../short", short):
            call = lambda dest=dest: rec.export(dest, format="rosbag2", overwrite=True)  # noqa: E731
            kept(tmp_path, call, DestinationExistsError, "is what is read here, or holds it")
        segment = rec.segments[0]
        call = lambda: rec.export(segment, format="mocap", overwrite=True)  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, "is what is read here")
        bag = rec.export("bag", format="rosbag2")
    kept(tmp_path, lambda: convert(bag, bag, overwrite=True), DestinationExistsError, "is what is read here")
    kept(tmp_path, lambda: convert(bag, tmp_path, overwrite=True), DestinationExistsError, "or holds it")
    call = lambda: convert(bag, bag, format="rosbag2", overwrite=True)  # noqa: E731
    kept(tmp_path, call, DestinationExistsError, "is what is read here")


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="there are no links")
def test_a_link_and_what_it_leads_to_stay(tmp_path: Path, short: Path) -> None:
    target = write(tmp_path / "target.csv")
    (tmp_path / "link.csv").symlink_to(target)
    (tmp_path / "data").mkdir()
    (tmp_path / "folder").symlink_to(tmp_path / "data")
    with Recording(short) as rec:
        call = lambda: rec.export(tmp_path / "link.csv", topics=["arm"], overwrite=True)  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, "is a link")
        write(tmp_path / "data/arm.csv")
        call = lambda: rec.export(tmp_path / "folder", format="csv", overwrite=True)  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, "is a link")
        (tmp_path / "out").mkdir()
        (tmp_path / "out/arm.csv").symlink_to(target)
        rec.export(tmp_path / "out", format="csv", overwrite=True)
    assert target.read_text() == "mine", "the link went, what it led to did not"


def test_a_file_beside_a_take_is_replaced_with_it_and_refused_without(tmp_path: Path, short: Path, long: Path) -> None:
    dest = tmp_path / "take.csv"
    with Recording(short) as first, Recording(long) as second:
        first.export(dest, format="mocap")
        old = (tmp_path / "take.joints.sto").read_bytes()
        dest.unlink()
        call = lambda: second.export(dest, format="mocap")  # noqa: E731
        kept(tmp_path, call, DestinationExistsError, r"overwrite=True.*take\.joints\.sto")
        second.export(dest, format="mocap", overwrite=True)
    assert (tmp_path / "take.joints.sto").read_bytes() != old


# convert


def bag_of(run: Path) -> Path:
    with Recording(run) as rec:
        return rec.export(run.with_suffix(".bag.d"), format="rosbag2")


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.ConversionWarning")
def test_a_conversion_replaces_a_recording(tmp_path: Path, short: Path, long: Path) -> None:
    dest = tmp_path / "runs/from-ros"
    convert(bag_of(short), dest)
    with pytest.raises(DestinationExistsError, match="overwrite=True"):
        convert(bag_of(long), dest)
    assert convert(tmp_path / "long.bag.d", dest, overwrite=True) == dest
    assert os.listdir(tmp_path / "runs") == ["from-ros"]
    with Recording(dest) as rec:
        assert rec["arm"].info.count == 30
    assert {path.suffix for path in dest.iterdir()} == {".mcap"}
    convert(dest, tmp_path / "arm.csv", topics=["arm"])
    convert(dest, tmp_path / "arm.csv", topics=["hand"], overwrite=True)
    assert (tmp_path / "arm.csv").read_text().startswith("_ts,position.0")


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.ConversionWarning")
def test_a_conversion_replaces_no_recording_with_other_things_in_it_nor_one_that_is_recorded(
    tmp_path: Path, short: Path, long: Path
) -> None:
    bag = bag_of(short)
    write(long / "plot.png")
    kept(tmp_path, lambda: convert(bag, long, overwrite=True), DestinationExistsError, r"plot\.png")
    with Experiment("alice/live", root=tmp_path).run as exp:
        exp.tracks("arm").append(q=1.0, _ts=0.0)
        exp.flush()
        with pytest.raises(DestinationExistsError, match="is being recorded"):
            convert(bag, exp.path, overwrite=True)
    with Recording(exp.path) as rec:
        assert rec["arm"].info.count == 1


# The suffix


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.ConversionWarning", "ignore:there are messages at time 0")
@pytest.mark.parametrize(("suffix", "format"), SUFFIXES.items())
def test_a_suffix_says_the_format_for_export_convert_and_the_command_line(
    tmp_path: Path, short: Path, suffix: str, format: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if format == "c3d":
        pytest.importorskip("ezc3d")
    topics = options(format).get("topics", ["arm"])
    with Recording(short) as rec:
        said = rec.export(tmp_path / f"a/out{suffix}", format=format, topics=topics)
        found = rec.export(tmp_path / f"b/out{suffix}", topics=topics)
    converted = convert(short, tmp_path / f"c/out{suffix}", topics=topics)
    printed = tmp_path / f"d/out{suffix}"
    assert main(["export", str(short), str(printed), "--topics", *topics]) == 0
    assert capsys.readouterr().out == f"{printed}\n"
    assert len({path.stat().st_size for path in (said, found, converted, printed)}) == 1


@pytest.mark.parametrize("dest", ["out", "out.xyz", "out.mcap", ".csv"])
def test_a_destination_that_says_no_format_is_answered_with_all(
    tmp_path: Path, short: Path, dest: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with Recording(short) as rec:
        kept(tmp_path, lambda: rec.export(tmp_path / dest), FormatError, r"c3d, csv, .*\.parquet \(parquet\)")
    kept(tmp_path, lambda: convert(short, tmp_path / dest), FormatError, r"pass format=, one of c3d, csv")
    assert main(["export", str(short), str(tmp_path / dest)]) == 2
    assert "pass format=" in capsys.readouterr().err


def test_the_command_line_replaces_a_result_where_it_is_told_to(
    tmp_path: Path, short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dest = write(tmp_path / "arm.csv")
    assert main(["export", str(short), str(dest), "--topics", "arm"]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert main(["export", str(short), str(dest), "--topics", "arm", "--overwrite"]) == 0
    assert dest.read_text().startswith("_ts,q.0,q.1\n")
    shutil.rmtree(short)
    assert main(["export", str(short), str(dest), "--overwrite"]) == 1
    assert dest.exists()
