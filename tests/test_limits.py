"""Limits stop bombs and not maps: what is large is read, and what is refused names the limit and what to pass."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from ml_dash_mcap import Limits, Recording, convert
from ml_dash_mcap.errors import ConversionWarning, DamagedFileError, OptionError
from ml_dash_mcap.file_names import LARGE_BYTES
from ml_dash_mcap.query import topic_messages
from ml_dash_mcap.query.stored_topic import LAST_NS, StoredTopic

STORE = get_typestore(Stores.ROS2_HUMBLE)
GRID = "nav_msgs/msg/OccupancyGrid"
HEADER = STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](1, 2), "map")


def grid(cells: int) -> bytes:
    """A map of so many cells, all free but for one, as its bytes in ROS 2."""
    types = STORE.types
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    info = types["nav_msgs/msg/MapMetaData"](HEADER.stamp, 0.05, 1000, cells // 1000, pose)
    data = np.zeros(cells, np.int8)
    data[cells // 2] = 100
    return bytes(STORE.serialize_cdr(types[GRID](HEADER, info, data), GRID))


def save(path: Path, cells: int, *, beside: int = 0, compression: CompressionType = CompressionType.ZSTD) -> Path:
    """A file of one chunk with a map and small messages before and behind it; `beside` bytes take room besides."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=10**9, compression=compression)
        writer.start("ros2", "tests")
        definition, _ = STORE.generate_msgdef(GRID, ros_version=2)
        channel = writer.register_channel("/map", "cdr", writer.register_schema(GRID, "ros2msg", definition.encode()))
        small = writer.register_channel("/small", "json", writer.register_schema("s", "jsonschema", b"{}"))
        for time in range(1, 4):
            writer.add_message(small, time * 10**9, b'{"n":%d}' % time, time * 10**9)
            if time == 2:
                writer.add_message(channel, time * 10**9, grid(cells), time * 10**9)
        if beside:
            writer.add_attachment(0, 0, "noise", "x", os.urandom(beside))
        writer.finish()
    return path


def theirs(path: Path) -> list[tuple[str, int, bytes]]:
    """All messages as the mcap package reads them."""
    with path.open("rb") as file:
        return [(channel.topic, one.log_time, one.data) for _, channel, one in make_reader(file).iter_messages()]


@pytest.mark.parametrize(
    ("compression", "on_damage"), [(CompressionType.ZSTD, "raise"), (CompressionType.LZ4, "skip")], ids=str
)
def test_a_map_of_41_mb_and_its_neighbours_are_read(
    tmp_path: Path, compression: CompressionType, on_damage: str
) -> None:
    path = save(tmp_path / "a.mcap", 41_000_000, compression=compression)
    assert path.stat().st_size < 200_000
    with Recording(path, on_damage=on_damage) as rec:
        assert [row["n"] for row in rec["/small"].rows()] == [1, 2, 3]
        [row] = rec["/map"].rows()
        cells = (
            np.frombuffer(row["data"], np.int8) if isinstance(row["data"], bytes) else np.array(row["data"], np.int8)
        )
        assert (len(cells), np.flatnonzero(cells).tolist(), cells[20_500_000]) == (41_000_000, [20_500_000], 100)
        assert rec.losses == []


def test_a_map_of_41_mb_is_carried_through_a_conversion_and_back(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", 41_000_000)
    convert(path, tmp_path / "run")
    with Recording(tmp_path / "run") as rec:
        assert {topic: rec.topics[topic].count for topic in rec.topics} == {"/map": 1, "/small": 3}
        [file] = rec.segments
    assert theirs(file) == theirs(path)


TOO_LARGE = LARGE_BYTES + 10_000_000


def test_what_is_refused_names_the_limit_and_what_to_pass(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", TOO_LARGE)
    with Recording(path) as rec, pytest.raises(DamagedFileError, match=r"Limits\.any_ratio_bytes") as caught:
        list(rec["/small"].rows())
    size = int(str(caught.value).split("limits=Limits(any_ratio_bytes=")[1].split(")")[0])
    assert size >= TOO_LARGE
    for limits in (Limits(any_ratio_bytes=size), Limits(ratio=10**6)):
        with Recording(path, limits=limits) as rec:
            assert [row["n"] for row in rec["/small"].rows()] == [1, 2, 3]
            batches = topic_messages.read(StoredTopic(rec._opened(), "/map"), 0, LAST_NS)
            assert [len(batch.payloads[0]) for batch in batches] == [len(grid(TOO_LARGE))]


@pytest.mark.parametrize("limits", [Limits(chunk_bytes=1000), Limits(record_bytes=20)], ids=str)
def test_every_limit_is_named_with_a_value_that_does(tmp_path: Path, limits: Limits) -> None:
    path = save(tmp_path / "a.mcap", 5000)
    data = path.read_bytes()
    path.write_bytes(data[: data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")])  # without its summary, so that it is walked
    with pytest.raises(DamagedFileError, match=r"limits=Limits\((chunk|record)_bytes=\d+\)") as caught:
        opened(path, limits)
    name, value = str(caught.value).split("limits=Limits(")[1].split(")")[0].split("=")
    assert getattr(limits, name) < int(value)


def opened(path: Path, limits: Limits) -> None:
    with Recording(path, limits=limits) as rec:
        if rec.losses:
            raise DamagedFileError(path, rec.losses[0].offset, rec.losses[0].what)
        for topic in rec.topics:
            list(rec[topic].rows())


def test_a_file_that_takes_as_much_on_the_disk_may_unpack_to_as_much(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", TOO_LARGE, beside=TOO_LARGE + 1_000_000)
    with Recording(path) as rec:
        assert rec.topics["/small"].count == len(list(rec["/small"].rows())) == 3
    with Recording(path, limits=Limits(any_ratio_bytes=LARGE_BYTES)) as rec, pytest.raises(DamagedFileError):
        list(rec["/small"].rows())


@pytest.mark.skipif(not hasattr(os.stat_result, "st_blocks"), reason="the system does not say what a file takes")
def test_holes_in_a_file_are_no_room(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", TOO_LARGE)
    os.truncate(path, 2**33)
    with Recording(path) as rec, pytest.raises(DamagedFileError, match="any_ratio_bytes"):
        list(rec["/small"].rows())


# -- the same in convert -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dest", ["run", "out.csv", "bag"])
def test_convert_takes_limits(tmp_path: Path, dest: str) -> None:
    path = save(tmp_path / "a.mcap", TOO_LARGE)
    how = {"format": "rosbag2"} if dest == "bag" else {"topics": ["/small"]} if dest == "out.csv" else {}
    with pytest.raises(DamagedFileError, match=r"Limits\.any_ratio_bytes"):
        convert(path, tmp_path / dest, **how)
    assert not (tmp_path / dest).exists()
    convert(path, tmp_path / dest, limits=Limits(any_ratio_bytes=2 * TOO_LARGE), **how)
    assert (tmp_path / dest).exists()
    if dest == "run":  # what came of it is read without raising a limit
        with Recording(tmp_path / dest) as rec:
            assert [row["n"] for row in rec["/small"].rows()] == [1, 2, 3]
            [file] = rec.segments
        assert theirs(file) == theirs(path)


def damaged(path: Path) -> Path:
    """A file of several chunks of rows, of which the second one is damaged."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=100, compression=CompressionType.NONE)
        writer.start("", "tests")
        channel = writer.register_channel("t", "json", writer.register_schema("s", "jsonschema", b"{}"))
        for number in range(20):
            writer.add_message(channel, number * 10**6, b'{"n":%d}' % number, number * 10**6)
        writer.finish()
    data = path.read_bytes()
    at = data.index(b'{"n":7}')
    path.write_bytes(data[:at] + b"?" + data[at + 1 :])
    return path


@pytest.mark.parametrize("format", ["csv", "jsonl", "parquet", "rosbag2"])
def test_convert_skips_what_is_damaged_as_a_recording_does(tmp_path: Path, format: str) -> None:
    path = damaged(tmp_path / "a.mcap")
    with Recording(path, on_damage="skip") as rec:
        expected = [row["n"] for row in rec["t"].rows()]
        lost = rec.losses[0]
    assert len(expected) < 20
    with pytest.raises(DamagedFileError, match="checksum"):
        convert(path, tmp_path / "out", format=format)
    assert not (tmp_path / "out").exists()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        convert(path, tmp_path / "out", format=format, on_damage="skip")
    assert [str(one.message) for one in caught if issubclass(one.category, ConversionWarning)][-1].startswith(str(lost))
    if format == "jsonl":
        text = "".join(one.read_text() for one in [tmp_path / "out", *(tmp_path / "out").glob("*")] if one.is_file())
        assert text.count('"n"') == len(expected)


def test_a_format_without_chunks_takes_limits_and_on_damage_as_a_recording_does(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,q\n0.0,1\n0.1,2\n")
    with Recording(path, on_damage="skip", limits=Limits(ratio=2)) as rec:
        expected = {topic: list(rec[topic].rows()) for topic in rec.topics}
    convert(path, tmp_path / "run", on_damage="skip", limits=Limits(ratio=2))
    with Recording(tmp_path / "run") as rec:
        assert {topic: list(rec[topic].rows()) for topic in rec.topics} == expected
    assert expected


def test_on_damage_is_one_of_two_words(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="neither"):
        convert(damaged(tmp_path / "a.mcap"), tmp_path / "out.csv", on_damage="ignore")
