"""Large arrays are stored packed, and come back as the arrays that they were, whatever way they take."""

from __future__ import annotations

import base64
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ml_dash_mcap import Recorder, RecorderOptions, Recording, convert
from ml_dash_mcap.rows import packed_arrays
from tests.support import disk
from tests.support.examples import examples
from tests.support.viewer_schema import violations

IMAGE = np.random.default_rng(0).integers(0, 256, (120, 200, 3), dtype=np.uint8)
CLOUD = np.random.default_rng(1).random((2000, 3)).astype("f4")
DEPTH = np.random.default_rng(2).integers(0, 5000, (100, 60), dtype=np.uint16)


def payload_nan(dtype: str) -> Any:
    """Numbers with NaN of many payloads and signs, infinities, -0.0 and the smallest ones."""
    bits = np.random.default_rng(3).integers(0, 256, 5000 * np.dtype(dtype).itemsize, dtype=np.uint8)
    return bits.view(dtype)


ARRAYS: dict[str, Any] = {
    "image": IMAGE,
    "fortran": np.asfortranarray(CLOUD),
    "strided": np.arange(30_000)[::3].reshape(100, 100),
    "columns of a matrix": np.arange(30_000.0).reshape(100, 300)[:, ::2],
    "backwards": np.arange(10_000.0)[::-1],
    "mirrored image": IMAGE[:, ::-1, ::-1],
    "transposed": IMAGE.transpose(2, 0, 1),
    "broadcast": np.broadcast_to(np.float32(1.5), (100, 100)),
    "read-only": np.frombuffer(b"abc" * 30_000, np.uint8),
    "big-endian": np.arange(5000, dtype=">i4").reshape(50, 100),
    "big-endian fractions": np.arange(5000, dtype=">f8") / 7,
    **{f"bits of {dtype}": payload_nan(dtype) for dtype in ("f2", "f4", "f8")},
    **{f"{dtype}": np.arange(5000).astype(dtype) for dtype in ("i1", "i2", "i4", "i8", "u2", "u4", "u8", "?")},
    "extremes": np.array([-(2**63), 2**63 - 1] * 3000),
    "unsigned extremes": np.array([0, 2**64 - 1] * 3000, np.uint64),
    "no rows of an image": np.zeros((9000, 0, 3)),
    "many dimensions": np.arange(2.0**13).reshape((2,) * 13),
    "memory map": np.lib.stride_tricks.as_strided(np.arange(5000.0), (4999, 2), (8, 8)),
}

MASKED: dict[str, Any] = {
    "masked": np.ma.MaskedArray(np.arange(5000.0), np.arange(5000) % 7 == 0),
    "masked integers": np.ma.MaskedArray(np.arange(6000).reshape(60, 100), np.arange(6000).reshape(60, 100) % 3 == 0),
    "masked image": np.ma.MaskedArray(IMAGE, IMAGE > 200),
    "masked booleans": np.ma.MaskedArray(np.arange(5000) % 2 == 0, np.arange(5000) % 5 == 0),
    "masked big-endian": np.ma.MaskedArray(np.arange(5000, dtype=">i2"), np.arange(5000) % 5 == 0),
}


def same(one: Any, other: Any) -> bool:
    """Whether two arrays are the same: type, shape and bits; of masked ones, what is masked and all else."""
    if one.dtype != other.dtype or one.shape != other.shape:
        return False
    mask = np.ma.getmaskarray(one)
    if not np.array_equal(mask, np.ma.getmaskarray(other)):
        return False
    return np.ma.getdata(one)[~mask].tobytes() == np.ma.getdata(other)[~mask].tobytes()


def decode_by_hand(folder: Path, topic: str) -> list[dict[str, Any]]:
    """Read the payloads as the documentation says, with nothing but json, base64 and numpy."""
    found = []
    for channel, payload in disk.payloads(folder):
        if channel != topic:
            continue
        row = json.loads(payload)
        for spelling, containers in row.pop("_exact").items():
            match = re.fullmatch(r"(masked )?(>?)(\w+)\[([\d,]+)\]", spelling)
            assert match is not None
            shape = tuple(int(length) for length in match[4].split(","))
            for key in containers[""]:
                data = base64.b64decode(row[key], validate=True)
                dtype = np.dtype(match[3]).newbyteorder(match[2] or "<")
                size = int(np.prod(shape)) * dtype.itemsize
                row[key] = np.frombuffer(data[:size], dtype).reshape(shape)
                if match[1]:
                    row[key] = np.ma.MaskedArray(row[key], np.frombuffer(data[size:], bool).reshape(shape))
                else:
                    assert len(data) == size
        found.append(row)
    return found


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
@pytest.mark.parametrize("way", ["append", "batch", "columns", "nested"])
def test_an_array_comes_back_as_it_was(tmp_path: Path, way: str, encoding: str) -> None:
    arrays = {**ARRAYS, **MASKED}
    with Recorder(tmp_path, RecorderOptions(encoding=encoding)) as recorder:
        for name, array in arrays.items():
            topic = recorder.topic(name)
            if way == "append":
                topic.append(v=array, n=1, _ts=1.0)
            elif way == "batch":
                topic.append_batch([{"v": array, "n": 1, "_ts": 1.0}])
            elif way == "columns":
                topic.append_columns(v=array[None], n=[1], _ts=[1.0])
            else:
                topic.append(v={"list": [None, array], "nan": float("nan")}, n=1, _ts=1.0)
    with Recording(tmp_path) as recording:
        for name, array in arrays.items():
            (row,) = recording[name].rows()
            value = row["v"]["list"][1] if way == "nested" else row["v"]
            assert same(value, array), name
            assert row["n"] == 1
            assert value.flags.writeable or isinstance(value, np.ma.MaskedArray)


@pytest.mark.about_json
def test_the_file_says_it_as_documented(tmp_path: Path) -> None:
    arrays = {**ARRAYS, **MASKED}
    with Recorder(tmp_path) as recorder:
        for name, array in arrays.items():
            recorder.topic(name).append(v=array, _ts=1.0)
    for name, array in arrays.items():
        (row,) = decode_by_hand(tmp_path, name)
        assert same(row["v"], array), name
        schema = json.loads(disk.channel(tmp_path, name)[1].data)
        assert violations(schema) == []
        described = f"{array.dtype.name}[{','.join(map(str, array.shape))}]"
        said = {"type": "string", "contentEncoding": "base64", "description": described}
        assert schema["properties"]["v"] == said


@pytest.mark.about_json
@pytest.mark.parametrize(
    ("array", "is_packed"),
    [
        (np.zeros(4096), False),
        (np.zeros(4097), True),
        (np.zeros(4097, "f2"), True),
        (np.zeros(4097, "?"), True),
        (np.zeros(4097, "i1"), True),
        (np.zeros(65_536, "u1"), False),
        (np.zeros(65_537, "u1"), True),
        (np.zeros((0, 480, 640, 3)), False),
        (np.zeros((0, 3)), False),
        (np.zeros(9000, "U1"), False),
        (np.zeros(9000, object), False),
        (np.zeros(9000, "M8[s]"), False),
        (np.ma.MaskedArray(np.zeros(4096), np.ones(4096)), False),
    ],
    ids=lambda value: f"{value.dtype}{value.shape}" if hasattr(value, "dtype") else str(value),
)
def test_only_large_arrays_of_numbers_are_packed(tmp_path: Path, array: Any, is_packed: bool) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(v=array, _ts=1.0)
    ((_, payload),) = disk.payloads(tmp_path)
    assert isinstance(json.loads(payload)["v"], str) is is_packed


def test_an_array_without_elements_that_would_be_millions_of_lists_is_packed() -> None:
    assert packed_arrays.is_large(np.zeros((10**9, 0)))
    assert not packed_arrays.is_large(np.zeros((100, 0)))


class Tensor:
    """What has an array, as tensors of torch do."""

    shape = IMAGE.shape

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return IMAGE

    def tolist(self) -> Any:
        raise AssertionError("a large tensor is not listed")


@pytest.mark.parametrize(
    ("value", "meant"),
    [
        (Tensor(), IMAGE),
        (memoryview(IMAGE), IMAGE),
        (pd.Series(np.arange(5000)), np.arange(5000)),
        (pd.DataFrame({"x": np.arange(5000.0), "y": 1.0}), np.stack([np.arange(5000.0), np.ones(5000)], axis=1)),
        (pl.Series(np.arange(5000)), np.arange(5000)),
        (pa.array(np.arange(5000, dtype="f4")), np.arange(5000, dtype="f4")),
        (__import__("array").array("H", range(5000)), np.arange(5000, dtype="u2")),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_holds_a_large_array_is_stored_as_that(tmp_path: Path, value: Any, meant: Any) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(v=value, _ts=1.0)
    with Recording(tmp_path) as recording:
        (row,) = recording["a"].rows()
    assert same(row["v"], meant)


def test_changing_the_array_after_append_does_not_change_the_row(tmp_path: Path) -> None:
    image = IMAGE.copy()
    with Recorder(tmp_path) as recorder:
        for number in range(3):
            recorder.topic("a").append(v=image, _ts=float(number))
            image += 1
    with Recording(tmp_path) as recording:
        assert [same(row["v"], IMAGE + np.uint8(at)) for at, row in enumerate(recording["a"].rows())] == [True] * 3


@st.composite
def drawn(draw: st.DrawFn) -> Any:
    """An array of any type and layout, a little above what is listed or far above."""
    dtype = np.dtype(
        draw(
            st.sampled_from(
                ["f2", "f4", "f8", ">f4", ">f8", "i1", "i2", ">i2", "i4", "i8", "u1", "u2", "u4", ">u8", "u8", "?"]
            )
        )
    )
    ndim = draw(st.integers(1, 4))
    least = 65_537 if dtype == np.uint8 else 4097
    shape = [draw(st.integers(1, 9)) for _ in range(ndim)]
    at = draw(st.integers(0, ndim - 1))
    shape[at] = 1
    shape[at] = -(-least // int(np.prod(shape))) + draw(st.integers(0, 3))
    bits = np.random.default_rng(draw(st.integers(0, 99))).integers(0, 256, int(np.prod(shape)) * dtype.itemsize)
    bits = bits.astype(np.uint8)
    array = (bits & 1).astype("?") if dtype.kind == "b" else bits.view(dtype)
    array = array.reshape(shape)
    for _ in range(draw(st.integers(0, 2))):
        array = draw(st.sampled_from([np.asfortranarray, np.flip, np.transpose, lambda one: one]))(array)
    if draw(st.booleans()):
        array = np.ma.MaskedArray(array, np.random.default_rng(1).random(array.shape) < draw(st.sampled_from([0, 0.5])))
    return array


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(array=drawn(), encoding=st.sampled_from(["json", "cbor", "protobuf"]))
def test_any_array_comes_back_from_every_read(
    array: Any, encoding: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("any")
    with Recorder(folder, RecorderOptions(encoding=encoding)) as recorder:
        for number in range(2):
            recorder.topic("a").append(v=array, inner={"w": array}, n=number, _ts=float(number))
    native = array.astype(array.dtype.newbyteorder("="))
    is_masked = np.ma.is_masked(array)
    with Recording(folder) as recording:
        topic = recording["a"]
        for row in [*topic.rows(), *recording.read("a")["entries"]]:
            assert same(row["v"], array)
            assert same(row["inner"]["w"] if "inner" in row else row["inner.w"], array)
        columns, frame = topic.to_numpy(), topic.to_pandas()
    for name in ("v", "inner.w"):
        assert columns[name].shape == (2, *array.shape)
        for found in (columns[name][1], frame[name][1]):
            if is_masked and native.dtype.kind == "f":
                native_with_nan = np.where(np.ma.getmaskarray(native), np.nan, np.ma.getdata(native))
                np.testing.assert_array_equal(found, native_with_nan)
            else:
                assert same(found, native)


# Ways into the file and out of it


def record(folder: Path, count: int = 3, encoding: str = "json") -> None:
    options = RecorderOptions(chunk_bytes=200_000, backlog_bytes=800_000, encoding=encoding)
    with Recorder(folder, options) as recorder:
        for number in range(count):
            recorder.topic("cam").append(image=IMAGE + np.uint8(number), cloud=CLOUD, n=number, _ts=float(number))


def check(rows: Any, count: int = 3) -> None:
    rows = list(rows)
    assert [row["n"] for row in rows] == list(range(count))
    for number, row in enumerate(rows):
        assert same(row["image"], IMAGE + np.uint8(number))
        assert same(row["cloud"], CLOUD)


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
def test_rows_of_one_time_merge_with_their_arrays(tmp_path: Path, encoding: str) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding=encoding)) as recorder:
        topic = recorder.topic("cam")
        topic.append(image=IMAGE, nan=float("nan"), _ts=1.0)
        topic.append(image=CLOUD, n=1, _ts=1.0)
        topic.append(cloud=CLOUD, _ts=1.0)
        recorder.flush()
        topic.append(image=DEPTH, later=b"x", _ts=1.0)
    with Recording(tmp_path) as recording:
        (row,) = recording["cam"].rows()
    assert same(row.pop("image"), DEPTH)
    assert same(row.pop("cloud"), CLOUD)
    assert repr(row) == repr({"nan": float("nan"), "n": 1, "later": b"x", "_ts": 1.0})


def test_what_a_killed_recorder_left_is_recovered(tmp_path: Path) -> None:
    program = """
import os, signal, sys
sys.path.insert(0, sys.argv[2])
from tests.test_large_arrays import CLOUD, IMAGE, np
from ml_dash_mcap import Recorder, RecorderOptions
recorder = Recorder(sys.argv[1], RecorderOptions(flush_interval_s=60))
for number in range(3):
    recorder.topic("cam").append(image=IMAGE + np.uint8(number), cloud=CLOUD, n=number, _ts=float(number))
os.kill(os.getpid(), signal.SIGKILL)
"""
    root = str(Path(__file__).parents[1])
    command = [sys.executable, "-c", program, str(tmp_path / "run"), root]
    ended = subprocess.run(command, env={**os.environ, "PYTHONPATH": root}, timeout=120, check=False)
    assert ended.returncode == -signal.SIGKILL
    with Recording(tmp_path / "run") as recording:
        check(recording["cam"].rows())


@pytest.mark.parametrize("encoding", ["json", "cbor"])
def test_fields_say_the_type_and_shape(tmp_path: Path, encoding: str) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding=encoding)) as recorder:
        topic = recorder.topic("cam")
        for number in range(3):
            cloud = np.zeros((2000 + number, 3), "f4")
            topic.append(image=IMAGE, cloud=cloud, mixed=[IMAGE, CLOUD, b"x"][number], odd=[IMAGE, CLOUD, IMAGE][number],
                         listed=[CLOUD, [1.0], None][number], _ts=float(number))  # fmt: skip
    with Recording(tmp_path) as recording:
        fields = {name: str(field) for name, field in recording.topics["cam"].fields.items()}
    assert fields == {"image": "uint8[120,200,3]", "cloud": "float32[,3]", "mixed": "bytes", "odd": "array",
                      "listed": "any"}  # fmt: skip


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
def test_columns_hold_arrays_beside_lists_and_gaps(tmp_path: Path, encoding: str) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding=encoding)) as recorder:
        topic = recorder.topic("a")
        topic.append(v=CLOUD, shorter=np.zeros(5000, "i2"), _ts=0.0)
        topic.append(v=[[1.0, 2.0, 3.0]], shorter=[2**40], _ts=1.0)
        topic.append(v=None, _ts=2.0)
        topic.append(v=CLOUD[:1500], shorter=np.zeros(6000, "i2"), _ts=3.0)
    with Recording(tmp_path) as recording:
        table = recording["a"].to_arrow()
        columns = recording["a"].to_numpy()
    assert table["v"].to_pylist() == [CLOUD.tolist(), [[1.0, 2.0, 3.0]], None, CLOUD[:1500].tolist()]
    assert table["shorter"].to_pylist() == [[0] * 5000, [2**40], None, [0] * 6000]
    assert [None if one is None else len(one) for one in columns["v"]] == [2000, 1, None, 1500]


@pytest.mark.parametrize("format", ["jsonl", "dreamlake"])
def test_lines_of_json_say_it_as_the_file_does(tmp_path: Path, format: str) -> None:
    record(tmp_path / "run")
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "out", format=format)
    (path,) = (tmp_path / "out").rglob("*.jsonl")
    for number, line in enumerate(path.read_text().splitlines()):
        row = json.loads(line)
        image = row.get("image") or row["data"]["image"]
        assert base64.b64decode(image) == (IMAGE + np.uint8(number)).tobytes()
        assert json.dumps("uint8[120,200,3]") in line


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
def test_a_copy_as_mcap_holds_the_arrays(tmp_path: Path, encoding: str) -> None:
    record(tmp_path / "run", encoding=encoding)
    with Recording(tmp_path / "run") as recording:
        (tmp_path / "copy.mcap").write_bytes(recording.read("cam", format="mcap"))
    with Recording(tmp_path / "copy.mcap") as copy:
        check(copy["cam"].rows())
        assert str(copy.topics["cam"].fields["image"]) == "uint8[120,200,3]"


@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf"])
def test_parquet_holds_the_numbers_in_their_type(tmp_path: Path, encoding: str) -> None:
    record(tmp_path / "run", encoding=encoding)
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "out", format="parquet")
    (path,) = (tmp_path / "out").rglob("*.parquet")
    table = pq.read_table(path)
    images = table["image"].combine_chunks()
    assert images.type.value_type == pa.uint8()
    assert images.flatten().to_numpy().tobytes() == np.stack([IMAGE, IMAGE + 1, IMAGE + 2]).astype("u1").tobytes()
    assert json.loads(table.schema.field("image").metadata[b"ml_dash.shape"]) == list(IMAGE.shape)
    assert table["cloud"].combine_chunks().flatten().to_numpy().tobytes() == np.stack([CLOUD] * 3).tobytes()


def test_parquet_comes_back_as_the_arrays_that_it_was_made_of(tmp_path: Path) -> None:
    masked = MASKED["masked integers"]
    listed = [[number + 0.5 for number in range(5000)], [0.5] * 6000]
    with Recorder(tmp_path / "run") as recorder:
        topic, plain = recorder.topic("cam"), recorder.topic("plain")
        for number in range(3):
            cloud = CLOUD[: 2000 - number]
            beside = {"text": "a", "masked": masked} if number else {}
            topic.append(
                image=IMAGE, deep={"er": {"cloud": cloud}}, **beside, listed=listed[number % 2], _ts=float(number)
            )
            plain.append(image=IMAGE, depth=DEPTH, half=CLOUD.astype("f2"), flag=np.ones(5000, "?"), _ts=float(number))
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "out", format="parquet")
        expected = {name: list(recording[name].rows()) for name in ("cam", "plain")}
    for name, meant in expected.items():
        convert(tmp_path / "out" / f"{name}.parquet", tmp_path / f"back {name}")
        with Recording(tmp_path / f"back {name}") as back:
            (topic_name,) = back.topics
            rows = list(back[topic_name].rows())
        assert [compared(row) for row in rows] == [compared(row) for row in meant]


def compared(value: Any) -> Any:
    """A value to be compared with another: arrays by type, shape and what is not masked, fields in any order."""
    if isinstance(value, dict):
        return {key: compared(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tolist()
    return type(value), value


def test_topics_with_images_are_aligned(tmp_path: Path) -> None:
    record(tmp_path / "run")
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("arm").append_columns(_ts=np.arange(0.25, 3.0, 0.5), x=np.arange(6.0))
    with Recording(tmp_path / "run") as recording:
        table = recording.align(["arm", "cam"], on="arm")
    assert [image[0][0] for image in table["cam.image"].to_pylist()] == [
        (IMAGE + np.uint8(at))[0, 0].tolist() for at in (0, 0, 1, 1, 2, 2)
    ]


def test_csv_holds_the_numbers_as_json(tmp_path: Path) -> None:
    record(tmp_path / "run")
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "out", format="csv")
    (path,) = (tmp_path / "out").rglob("*.csv")
    frame = pl.read_csv(path, infer_schema_length=0)
    assert [json.loads(text) for text in frame["image"]] == [(IMAGE + np.uint8(at)).tolist() for at in range(3)]
    assert json.loads(frame["cloud"][0]) == CLOUD.astype(float).tolist()


@pytest.mark.parametrize("format", ["rosbag2", "rosbag1"])
def test_a_bag_holds_the_arrays_and_an_image_for_ros(tmp_path: Path, format: str) -> None:
    with Recorder(tmp_path / "run") as recorder:
        topic = recorder.topic("cam")
        for number in range(3):
            topic.append(image=IMAGE, cloud=CLOUD, depth=DEPTH, half=CLOUD.astype("f2"), n=number, _ts=number + 1.0)
        topic.append(n=3, _ts=4.0)
    bag = tmp_path / ("bag" if format == "rosbag2" else "bag.bag")
    with Recording(tmp_path / "run") as recording:
        recording.export(bag, format=format)
        expected = list(recording["cam"].rows())
    store = get_typestore(Stores.ROS2_JAZZY if format == "rosbag2" else Stores.ROS1_NOETIC)
    with AnyReader([bag], default_typestore=store) as reader:
        found = {}
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    image = found["/cam/image"][0]
    assert (image.encoding, image.height, image.width, image.step) == ("rgb8", 120, 200, 600)
    assert bytes(image.data) == IMAGE.tobytes()
    assert found["/cam/depth"][0].encoding == "16UC1"
    assert np.array_equal(np.frombuffer(bytes(found["/cam/depth"][0].data), "<u2").reshape(DEPTH.shape), DEPTH)
    assert np.array_equal(found["/cam"][0].cloud, CLOUD.reshape(-1))
    assert found["/cam"][0].cloud.dtype == np.float32
    convert(bag, tmp_path / "back", encoding="json")
    with Recording(tmp_path / "back") as back:
        rows = list(back["cam"].rows())
    assert len(rows) == 4
    for row, meant in zip(rows[:3], expected[:3], strict=True):
        assert list(row) == list(meant)
        for name in ("image", "cloud", "depth", "half"):
            assert same(row[name], meant[name]), name
    assert rows[3] == {"n": 3, "_ts": 4.0}


def test_long_lists_stay_lists_through_a_bag(tmp_path: Path) -> None:
    listed = [number + 0.5 for number in range(5000)]
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("a").append(v=listed, _ts=1.0).append(v=listed, _ts=2.0)
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "bag", format="rosbag2")
    convert(tmp_path / "bag", tmp_path / "back", encoding="json")
    with Recording(tmp_path / "back") as back:
        assert [row["v"] for row in back["a"].rows()] == [listed, listed]


# Files from outside


@settings(max_examples=examples(200), deadline=None)
@given(
    st.one_of(st.text(max_size=20), st.from_regex(r"(masked )?>?(u?int8|float64|bool)\[\d{1,19}(,\d{0,19}){0,3}\]")),
    st.binary(max_size=40).map(lambda data: base64.b64encode(data).decode()) | st.text(max_size=20),
)
@example("uint8[99999999999999]", "AAAA")
@example("uint8[0,99999999999999999]", "")
@example("float64[9999999999,9999999999]", "AAAA")
@example("uint8" + "[" + ",".join("1" * 90) + "]", "AA==")
def test_a_spelling_that_does_not_fit_is_no_array_and_takes_no_memory(spelling: str, text: str) -> None:
    found = packed_arrays.unpack(text, spelling)
    if found is not None:
        assert found.nbytes <= len(text)
        name, _, lengths = re.sub(r"masked |>", "", spelling)[:-1].partition("[")
        assert (found.dtype.name, found.shape) == (name, tuple(map(int, lengths.split(","))))


def test_parameters_stay_lists(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.set_parameters({"weights": CLOUD})
        recorder.topic("a").append(x=1, _ts=1.0)
    with Recording(tmp_path) as recording:
        assert recording.params["weights"] == CLOUD.tolist()
