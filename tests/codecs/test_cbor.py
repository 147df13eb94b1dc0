"""CBOR of ours is read by others, that of others by us; whatever the bytes are, they cost no more than their row."""

from __future__ import annotations

import csv
import os
import signal
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from pyarrow import parquet

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.codecs import codec_table
from ml_dash_mcap.codecs.cbor import CODEC, decode
from ml_dash_mcap.errors import DamagedFileError, EncodingError, OptionError, UndecodedWarning
from tests.support import disk
from tests.support.examples import examples


def foreign(folder: Path, *messages: bytes, schema: bytes | None = None) -> Path:
    """A file of another recorder's CBOR messages, one a second."""
    path = folder / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema_id = 0 if schema is None else writer.register_schema("thing", "cddl", schema)
        channel = writer.register_channel("t", "cbor", schema_id)
        for number, data in enumerate(messages, 1):
            writer.add_message(channel, number * 10**9, data, number * 10**9)
        writer.finish()
    return path


def typed(tag: int, data: bytes) -> cbor2.CBORTag:
    return cbor2.CBORTag(tag, data)


FOREIGN: dict[str, tuple[bytes, dict[str, Any]]] = {
    "map": (cbor2.dumps({"x": 1.5, "n": 7, "b": b"\0", "t": "\u00e9", "l": [1, [2.5]], "d": {"e": None}}), {
        "x": 1.5, "n": 7, "b": b"\0", "t": "\u00e9", "l": [1, [2.5]], "d": {"e": None}}),
    "half and single": (bytes.fromhex("a26178f93e00617af97e00"), {"x": 1.5, "z": float("nan")}),
    "no definite lengths": (bytes.fromhex("bf61789f0102ff6179 7f61616162ff ff".replace(" ", "")), {"x": [1, 2], "y": "ab"}),
    "keys that are no text": (cbor2.dumps({-2: "b", True: "c", None: "d", 1.5: "e", b"k": "f"} | {(1, 2): "g"}), {
        "-2": "b", "true": "c", "null": "d", "1.5": "e", "k": "f", "(1, 2)": "g"}),
    "an integer beyond 64 bits": (cbor2.dumps({"x": [2**64, -(2**63) - 1], "y": 10**400}), {
        "x": [2.0**64, -(2.0**63)], "y": float("inf")}),
    "undefined": (bytes.fromhex("a2617884f7f6e0f8ff6179f7"), {"x": [None, None, 0, 255], "y": None}),
    "a time": (bytes.fromhex("a16174c1fb41d452d9e0000000"), {"t": 1363896192.0}),
    "tags of all kinds": (cbor2.dumps({"x": [cbor2.CBORTag(tag, "1") for tag in (0, 30, 35, 36, 37, 258, 1004, 55799, 9999)]}), {
        "x": ["1"] * 9}),
    "a set": (bytes.fromhex("a16173d9010282820102f5"), {"s": [[1, 2], True]}),
    "a short typed array": (cbor2.dumps({"v": typed(85, struct.pack("<2f", 1.5, 2.5))}), {"v": [1.5, 2.5]}),
    "a short matrix": (cbor2.dumps({"m": cbor2.CBORTag(40, [[2, 2], typed(65, struct.pack(">4H", 1, 2, 3, 4))])}), {
        "m": [[1, 2], [3, 4]]}),
    "a typed array that is none": (cbor2.dumps({"v": [typed(85, b"abc"), typed(85, "x"), cbor2.CBORTag(40, [[3], [1]])]}), {
        "v": [b"abc", "x", [[3], [1]]]}),
    "no map": (cbor2.dumps([1, 2]), {"value": [1, 2]}),
    "nothing": (b"", {}),
}  # fmt: skip


@pytest.mark.parametrize("name", FOREIGN)
@pytest.mark.parametrize("schema", [None, b"thing = {}"])
def test_messages_of_others_become_rows(tmp_path: Path, name: str, schema: bytes | None) -> None:
    payload, meant = FOREIGN[name]
    with Recording(foreign(tmp_path, payload, payload, schema=schema)) as recording:
        rows = list(recording["t"].rows())
        columns = recording["t"].to_arrow()
    assert [repr(row) for row in rows] == [repr({**meant, "_ts": float(time)}) for time in (1, 2)]
    assert columns.column("_ts").to_pylist() == [1.0, 2.0]


def test_a_large_typed_array_of_others_is_an_array(tmp_path: Path) -> None:
    image = np.arange(300_000, dtype=">u2").reshape(300, 1000)
    message = cbor2.dumps({"image": cbor2.CBORTag(40, [image.shape, typed(65, image.tobytes())])})
    with Recording(foreign(tmp_path, message)) as recording:
        (row,) = recording["t"].rows()
    assert (row["image"].dtype, row["image"].shape) == (image.dtype, image.shape)
    assert (row["image"] == image).all()


BROKEN = {
    "cut off": cbor2.dumps({"x": [1.5, 2.5]})[:-1],
    "followed by more": cbor2.dumps({"x": 1}) + b"\0",
    "text that is no UTF-8": b"\xa1\x61x\x61\xff",
    "longer than there is memory": b"\xa1\x61x\x5b\0\0\0\xff\xff\xff\xff\xff",
    "an array longer than there is memory": b"\xa1\x61x\x9b\0\0\0\xff\xff\xff\xff\xff\x01",
    "nested without end": b"\xa1\x61x" + b"\x81" * 100_000 + b"\1",
    "a value that holds itself": bytes.fromhex("a16178d81c8201d81d00"),
    "a text that stands elsewhere": bytes.fromhex("a16178d9010082636161 61d81900".replace(" ", "")),
    "a reserved head": b"\xa1\x61x\xfc",
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_message_that_is_none_is_damage_and_others_stay(tmp_path: Path, name: str) -> None:
    path = foreign(tmp_path, cbor2.dumps({"x": 1}), BROKEN[name], cbor2.dumps({"x": 3}))
    with Recording(path) as recording, pytest.raises(DamagedFileError, match="not cbor"):
        list(recording["t"].rows())
    with Recording(path, on_damage="skip") as recording:
        assert list(recording["t"].rows()) == [{"x": 1, "_ts": 1.0}, {"x": 3, "_ts": 3.0}]
        assert recording["t"].to_arrow().column("x").to_pylist() == [1, 3]


@given(st.binary(max_size=60) | st.binary(max_size=30).map(lambda junk: b"\xa1\x61x" + junk))
@settings(deadline=None, max_examples=examples(2000))
def test_whatever_the_bytes_are_they_are_a_row_or_a_value_error(payload: bytes) -> None:
    try:
        row = decode(payload)
    except (ValueError, RecursionError):
        return
    assert CODEC.decode_plain([payload]) is not None
    assert all(type(name) is str for name in row)
    CODEC.encode_read({**row, "_ts": 1.0})


def record(folder: Path, encoding: str, name: str = "arm") -> None:
    with Recorder(folder, RecorderOptions(encoding=encoding), prefix="run") as recorder:
        arm = recorder.topic(name, units={"q": "rad"}, joint_names=["a", "b"])
        for n in range(300):
            arm.append(q=[n / 7, -n / 3], grip=n % 40, ok=n % 2 == 0, tag=f"t{n % 12}", _ts=n / 100)
            arm.append(pose={"xyz": [1.0, n / 9, 0.0]}, extra=b"\0\1" if n % 5 else None, _ts=n / 100)
            if n % 50 == 0:
                arm.append(late=float("nan"), image=np.full((300, 300), n % 2, np.uint8), big=2**64 - 1, _ts=n / 100)
        arm.append_columns(_ts=np.arange(10.0, 40.0), q=np.ones((30, 2)), n=np.arange(30, dtype=np.int16))


@pytest.mark.parametrize("format", ["parquet", "jsonl", "csv", "rosbag2", "rosbag1"])
def test_exports_are_those_of_the_same_rows_in_json(tmp_path: Path, format: str) -> None:
    tables: dict[str, Any] = {}
    for encoding in ("json", "cbor"):
        (tmp_path / encoding).mkdir()
        record(tmp_path / encoding / "run", encoding)
        with Recording(tmp_path / encoding / "run") as recording, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            path = recording.export(tmp_path / encoding / "out", format=format)
        tables[encoding] = contents(path)
    assert tables["cbor"] == tables["json"]


def contents(path: Path) -> dict[str, Any]:
    """What other tools read in the files of an export; the order of columns is that in which fields became known."""
    found: dict[str, Any] = {}
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.suffix == ".parquet":
            table = parquet.read_table(file)
            types = {field.name: str(field.type) for field in table.schema}
            found[file.name] = (types, [repr(sorted(row.items())) for row in table.to_pylist()])
        elif file.suffix == ".csv":
            with file.open(newline="") as lines:
                csv.field_size_limit(10**7)
                found[file.name] = [sorted(row.items()) for row in csv.DictReader(lines)]
        elif file.is_file():
            found[file.name] = file.read_bytes()
    return found


def test_windows_are_those_of_the_same_rows_in_json(tmp_path: Path) -> None:
    reads: dict[str, list[str]] = {}
    for encoding in ("json", "cbor"):
        record(tmp_path / encoding, encoding)
        with Recording(tmp_path / encoding) as recording:
            arm = recording["arm"]
            part = arm.select(start=0.5, end=1.5, columns=["q", "pose.xyz"])
            found = [list(part.rows()), part.arrow().to_pydict(), len(part), arm.at(1.003), arm.last(), len(arm)]
            fields = sorted(recording.topics["arm"].fields.items())
            reads[encoding] = [repr(one) for one in [*found, fields, part.arrow().schema]]
    assert reads["cbor"] == reads["json"]


def test_others_read_what_we_wrote(tmp_path: Path) -> None:
    record(tmp_path, "cbor")
    channel, schema = disk.channel(tmp_path, "arm")
    assert (channel.message_encoding, schema.encoding) == ("cbor", "jsonschema")
    rows = [cbor2.loads(payload) for _, payload in disk.payloads(tmp_path)]
    assert rows[1] == {
        "q": [1 / 7, -1 / 3],
        "grip": 1,
        "ok": False,
        "tag": "t1",
        "pose": {"xyz": [1.0, 1 / 9, 0.0]},
        "extra": b"\0\1",
        "_ts": 0.01,
    }
    shape, content = rows[50]["image"].value
    assert (rows[50]["image"].tag, content.tag, list(shape)) == (40, 64, [300, 300])
    assert content.value == bytes(90_000)


def killed(folder: Path) -> None:
    """Leave a recorder's journal behind."""
    program = """
import os, signal, sys
from ml_dash_mcap import Recorder, RecorderOptions
recorder = Recorder(sys.argv[1], RecorderOptions(flush_interval_s=60, encoding="cbor"))
for n in range(10):
    recorder.topic("arm").append(n=n, _ts=float(n)).append(q=[0.5], _ts=float(n))
os.kill(os.getpid(), signal.SIGKILL)
"""
    root = str(Path(__file__).parents[2])
    command = [sys.executable, "-c", program, str(folder)]
    ended = subprocess.run(command, env={**os.environ, "PYTHONPATH": root}, timeout=120, check=False)
    assert ended.returncode == -signal.SIGKILL


def test_what_a_killed_recorder_left_is_recovered(tmp_path: Path) -> None:
    killed(tmp_path / "run")
    with Recording(tmp_path / "run") as recording:
        assert list(recording["arm"].rows()) == [{"n": n, "q": [0.5], "_ts": float(n)} for n in range(10)]
        assert {name: str(field) for name, field in recording.topics["arm"].fields.items()} == {
            "n": "integer",
            "q": "number[1]",
        }
    assert len(list(disk.payloads(tmp_path / "run"))) == 10


@pytest.fixture
def without_package(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Take the package away, as where the extra is not installed."""

    def take_away() -> None:
        codec_table._load.cache_clear()
        monkeypatch.setitem(sys.modules, "cbor2", None)
        monkeypatch.delitem(sys.modules, "ml_dash_mcap.codecs.cbor")

    return take_away


def test_without_the_package_rows_are_recovered_and_carried_as_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without_package: Callable[[], None]
) -> None:
    killed(tmp_path / "run")
    without_package()
    with Recording(tmp_path / "run") as recording, pytest.warns(UndecodedWarning, match=r"ml-dash-mcap\[cbor\]"):
        rows = list(recording["arm"].rows())
    assert len(rows) == 20
    assert {type(row["data"]) for row in rows if "data" in row} <= {bytes}
    with pytest.raises(OptionError, match=r"needs the package cbor2.*ml-dash-mcap\[cbor\]"):
        Recorder(tmp_path / "new", RecorderOptions(encoding="cbor"))
    with pytest.raises(EncodingError, match="cbor2"):
        codec_table.find("cbor")
    monkeypatch.undo()
    codec_table._load.cache_clear()
    with Recording(tmp_path / "run") as recording:
        assert list(recording["arm"].rows()) == [{"n": n, "q": [0.5], "_ts": float(n)} for n in range(10)]
