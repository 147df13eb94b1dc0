"""A recording of others is read by the definitions of the ROS that it comes from; what cannot be read is bytes."""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_typestore

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import (
    ConversionWarning,
    DamagedFileError,
    EncodingError,
    OptionError,
    UndecodedWarning,
)
from tests.support import system_python

HUMBLE, JAZZY = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_JAZZY)
RANGE = "sensor_msgs/msg/Range"
METADATA = "version: {version}\nstorage_identifier: mcap\nros_distro: {distro}"


def a_range(store: Any, *more: float) -> bytes:
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "sonar")
    return bytes(store.serialize_cdr(types[RANGE](header, 1, 0.5, 1.0, 4.0, 2.0, *more), RANGE))


class Draft:
    """An MCAP file as another recorder writes it."""

    def __init__(self, path: Path, profile: str = "ros2") -> None:
        self.path = path
        self._file = path.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile)
        self._time = 0

    def record(self, **values: str) -> Draft:
        self._writer.add_metadata("rosbag2", values)
        return self

    def topic(
        self,
        payloads: Iterable[bytes],
        *,
        topic: str = "/t",
        name: str = RANGE,
        schema: str = "",
        text: bytes = b"",
        encoding: str = "cdr",
        metadata: dict[str, str] | None = None,
    ) -> Draft:
        described = self._writer.register_schema(name, schema, text)
        channel = self._writer.register_channel(topic, encoding, described, metadata or {})
        for payload in payloads:
            self._time += 1
            self._writer.add_message(channel, self._time, payload, self._time)
        return self

    def done(self, **options: Any) -> Recording:
        self._writer.finish()
        self._file.close()
        return Recording(self.path, **options)


@pytest.fixture
def draft(tmp_path: Path) -> Draft:
    return Draft(tmp_path / "a.mcap")


def rows(recording: Recording, topic: str = "/t") -> list[dict[str, Any]]:
    found = [{name: value for name, value in row.items() if name != "_ts"} for row in recording[topic].rows()]
    table = recording[topic].to_arrow()
    assert table.num_rows == len(found)
    return found


STATED = [
    lambda draft: draft.record(ROS_DISTRO="humble"),
    lambda draft: draft.record(serialized_metadata=METADATA.format(version=8, distro="humble")),
    lambda draft: draft.record(serialized_metadata="version: 5\nstorage_identifier: mcap"),
    lambda draft: (draft.path.parent / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 8\n  ros_distro: humble\n"
    ),
    lambda draft: (draft.path.parent / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n"),
]


@pytest.mark.parametrize("state", STATED)
def test_a_type_that_a_file_does_not_define_is_that_of_the_distribution_that_the_file_states(draft, state) -> None:
    state(draft)
    with draft.topic([a_range(HUMBLE)]).done() as recording:
        (row,) = rows(recording)
    assert row["range"] == 2.0 and "variance" not in row


def test_the_channel_knows_its_distribution_best(draft: Draft) -> None:
    draft.record(ROS_DISTRO="humble")
    draft.topic([a_range(JAZZY, 0.25)], metadata={"ros_distro": "jazzy"})
    draft.topic([a_range(HUMBLE)], topic="/humble")
    digest = JAZZY.hash_rihs01(RANGE)
    draft.topic([a_range(JAZZY, 0.25)], topic="/hash", metadata={"topic_type_hash": digest})
    with draft.done() as recording:
        assert [rows(recording, topic)[0].get("variance") for topic in ("/t", "/humble", "/hash")] == [0.25, None, 0.25]


def test_a_file_that_states_no_distribution_is_read_as_of_humble_with_a_warning_where_that_matters(draft) -> None:
    what = r"topic '/t': sensor_msgs/Range is taken for that of humble; .*pass"
    with draft.topic([a_range(HUMBLE)]).done() as recording, pytest.warns(ConversionWarning, match=what):
        assert next(recording["/t"].rows())["range"] == 2.0
    later = Draft(draft.path.with_name("later.mcap")).topic([a_range(HUMBLE), a_range(JAZZY, 0.25), b"\0\1\0\0"])
    what = r"topic '/t' has messages that only the sensor_msgs/msg/Range of iron fits"
    with later.done() as recording, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = list(recording["/t"].rows())
    assert [row.get("variance") for row in found] == [None, 0.25, None] and found[2]["_data"] == b"\0\1\0\0"
    assert any(what in str(one.message) for one in warned)
    with Recording(later.path, on_unknown="raise") as recording, warnings.catch_warnings():
        warnings.simplefilter("ignore", ConversionWarning)
        with pytest.raises(DamagedFileError, match="at 3 ns"):
            list(recording["/t"].rows())
    types = HUMBLE.types
    vector = types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    payload = bytes(HUMBLE.serialize_cdr(vector, "geometry_msgs/msg/Vector3"))
    same = Draft(draft.path.with_name("b.mcap")).topic([payload], name="geometry_msgs/msg/Vector3")
    with same.done() as recording:
        assert rows(recording) == [{"x": 1.0, "y": 2.0, "z": 3.0}]


def test_ros_1_without_a_definition_is_read_by_that_of_ros_1_if_the_md5_sum_is_the_same(draft: Draft) -> None:
    payload = struct.pack("<IIIIdd", 7, 1, 2, 0, 3.0, 0.5)
    md5 = get_typestore(Stores.ROS1_NOETIC).generate_msgdef("sensor_msgs/msg/Temperature", ros_version=1)[1]
    for topic, metadata in {"/t": {"md5sum": md5}, "/any": {"md5sum": "*"}, "/other": {"md5sum": "0" * 32}}.items():
        draft.topic([payload], topic=topic, name="sensor_msgs/Temperature", encoding="ros1", metadata=metadata)
    row = {
        "header": {"seq": 7, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": ""},
        "temperature": 3.0,
        "variance": 0.5,
    }
    with draft.done() as recording:
        assert rows(recording) == rows(recording, "/any") == [row]
        with pytest.warns(UndecodedWarning, match=rf"topic '/other' .*MD5 sum {md5}, not 0000.*pass definitions="):
            assert next(recording["/other"].rows())["data"] == payload


UNKNOWN = struct.pack("<I", 7)


def unknown(draft: Draft) -> Draft:
    draft.topic([b"\0\1\0\0" + UNKNOWN], name="p/msg/Thing")
    return draft.topic([b"\0\1\0\0" + UNKNOWN], topic="/known", name="p/msg/Known", schema="ros2msg", text=b"uint32 x")


def test_an_unknown_type_costs_nothing_but_its_own_fields(draft: Draft, tmp_path: Path) -> None:
    with unknown(draft).done() as recording:
        assert rows(recording, "/known") == [{"x": 7}]
        what = r"topic '/t' .* of the type 'p/msg/Thing'.*bytes of each as 'data'; pass definitions=\{'p/msg/Thing': "
        with pytest.warns(UndecodedWarning, match=what) as warned:
            assert list(recording["/t"].rows()) == [{"data": b"\0\1\0\0" + UNKNOWN, "_ts": 1e-9}]
        assert len(warned) == 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UndecodedWarning)
            recording.export(tmp_path / "out", format="parquet")
    (table,) = (tmp_path / "out").rglob("*t.parquet")
    assert pq.read_table(table).column("data").to_pylist() == [b"\0\1\0\0" + UNKNOWN]


def test_what_becomes_of_an_unknown_type_can_be_said(draft: Draft, tmp_path: Path) -> None:
    unknown(draft).done().close()
    with Recording(draft.path, on_unknown="raise") as recording:
        assert rows(recording, "/known") == [{"x": 7}]
        assert (recording.topics["/t"].count, dict(recording.topics["/t"].fields)) == (1, {})
        for read in (lambda: list(recording["/t"].rows()), recording["/t"].to_arrow, recording["/t"].to_numpy):
            with pytest.raises(EncodingError, match=r"topic '/t' .*pass definitions="):
                read()
    with Recording(draft.path, on_unknown="skip") as recording:
        with pytest.warns(UndecodedWarning, match=r"'/t' .*it is left out"):
            assert list(recording["/t"].rows()) == []
        assert rows(recording, "/known") == [{"x": 7}]
    (tmp_path / "Thing.msg").write_text("float32[] a\nuint8 b\n")
    (tmp_path / "Thing.idl").write_text("module p { module msg { struct Thing { unsigned long y; }; }; };")
    for definition in ("uint32 y", tmp_path / "Thing.idl"):
        for name in ("p/msg/Thing", "p/Thing"):
            with Recording(draft.path, definitions={name: definition}) as recording:
                assert rows(recording) == [{"y": 7}]
    with Recording(draft.path, definitions={"p/Thing": tmp_path / "Thing.msg"}) as recording:
        what = r"topic '/t' has a message of 8 bytes that is no p/msg/Thing in cdr: .*; its rows have the bytes"
        with pytest.warns(UndecodedWarning, match=what):
            assert next(recording["/t"].rows())["_data"] == b"\0\1\0\0" + UNKNOWN


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"on_unknown": "keep"}, r"on_unknown='keep': it must be one of 'bytes', 'skip', 'raise'"),
        ({"definitions": "uint8 x"}, "pass a dict of types"),
        ({"definitions": {"p/A": 7}}, "definitions of 'p/A': pass its text"),
        ({"definitions": {"p/A": Path("missing.msg")}}, "definitions of 'p/A': missing.msg cannot be read"),
    ],
)
def test_an_option_that_makes_no_sense_is_an_error_before_anything_is_opened(tmp_path: Path, options, why: str) -> None:
    with pytest.raises(OptionError, match=why):
        Recording(tmp_path / "missing.mcap", **options)


BAD = [b"\xff", b"a\xff\xfeb", b"\xc3", b"\xe2\x82", b"\xed\xa0\x80", "é".encode("latin-1"), b"\xf0\x9f\x98"]


def test_a_text_that_is_no_utf_8_has_what_ros_1_itself_puts_in_its_place(draft: Draft, tmp_path: Path) -> None:
    text = "string one\nstring[] more\nuint8 n"
    payloads = [
        struct.pack(f"<I{len(bad)}sIII{len(bad)}sB", len(bad), bad, 2, 0, len(bad), bad, 7) for bad in [b"ok", *BAD]
    ]
    (tmp_path / "cases.json").write_text(json.dumps([["p/A", text, payload.hex()] for payload in payloads]))
    draft.topic(payloads, name="p/A", schema="ros1msg", text=text.encode(), encoding="ros1")
    expected = [
        {"one": word, "more": ["", word], "n": 7} for word in (bad.decode(errors="replace") for bad in [b"ok", *BAD])
    ]
    with draft.done() as recording:
        with pytest.warns(UndecodedWarning, match=r"topic '/t' has texts that are no UTF-8: .* U\+FFFD") as warned:
            found = [{key: row[key] for key in ("one", "more", "n")} for row in recording["/t"].rows()]
        assert {str(one.message) for one in warned} == {str(warned[0].message)}, "one line, which Python shows once"
    assert found == expected
    theirs = system_python.run(
        "decode_messages.py", tmp_path / "cases.json", needs=("genpy", "rosbag"), package="python3-rosbag"
    )
    assert theirs == expected


def test_messages_without_fields_are_what_ros_1_itself_reads(draft: Draft, tmp_path: Path) -> None:
    text = "B one\nB[] some\nB[2] two\nint32 n\nC c\n===\nMSG: p/B\n# nothing\n===\nMSG: p/C\nB b\nuint8 x\n"
    payload = struct.pack("<IiB", 3, -7, 8)
    draft.topic([payload], name="p/A", schema="ros1msg", text=text.encode(), encoding="ros1")
    draft.topic(
        [b""],
        topic="/e",
        name="std_msgs/Empty",
        encoding="ros1",
        metadata={"md5sum": "d41d8cd98f00b204e9800998ecf8427e"},
    )
    row = {"one": {}, "some": [{}, {}, {}], "two": [{}, {}], "n": -7, "c": {"b": {}, "x": 8}}
    with draft.done() as recording:
        assert (rows(recording), rows(recording, "/e")) == ([row], [{}])
    (tmp_path / "cases.json").write_text(json.dumps([["p/A", text.replace("===", "=" * 80), payload.hex()]]))
    program = ("decode_messages.py", tmp_path / "cases.json")
    assert system_python.run(*program, needs=("genpy", "rosbag"), package="python3-rosbag") == [row]


def test_messages_without_fields_are_what_mcap_ros2_reads(draft: Draft) -> None:
    text = "B one\nB[] some\nB[2] two\nint32 n\nstd_msgs/Empty e\nuint8 x\n" + "=" * 80 + "\nMSG: p/B\n# nothing\n"
    payload = b"\0\1\0\0" + struct.pack("<BxxxI3B2BxxxiBB", 0, 3, 0, 0, 0, 0, 0, -7, 0, 8)
    draft.topic([payload], name="p/msg/A", schema="ros2msg", text=text.encode())
    with draft.done() as recording:
        (row,) = rows(recording)
    assert row == {"one": {}, "some": [{}, {}, {}], "two": [{}, {}], "n": -7, "e": {}, "x": 8}
    theirs = generate_dynamic("p/msg/A", text + "=" * 80 + "\nMSG: std_msgs/Empty\n")["p/msg/A"](payload)
    assert (len(theirs.some), len(theirs.two), theirs.n, theirs.x) == (3, 2, -7, 8)


def test_a_text_that_is_no_utf_8_costs_no_row_and_no_column_in_ros_2(draft: Draft) -> None:
    payloads = [b"\0\1\0\0" + struct.pack("<I4sd", 4, word + b"\0", 1.5) for word in (b"abc", b"a\xffc")]
    draft.topic(payloads, name="p/msg/A", schema="ros2msg", text=b"string s\nfloat64 x")
    with draft.done() as recording, warnings.catch_warnings():
        warnings.simplefilter("ignore", UndecodedWarning)
        assert rows(recording) == [{"s": "abc", "x": 1.5}, {"s": "a\ufffdc", "x": 1.5}]
        assert recording["/t"].to_numpy()["x"].tolist() == [1.5, 1.5]


def test_each_channel_of_a_topic_is_read_by_its_own_definition(draft: Draft) -> None:
    payload = struct.pack("<ii", 1, 2)
    texts = (
        b"int32 left\nint32 right",
        b"int32 right\nint32 left",
        b"float32 left\nint32 right",
        b"int32 left\nint32 right",
    )
    for number, text in enumerate(texts):
        more = {"callerid": f"/node{number}"}
        draft.topic([payload], name="p/A", schema="ros1msg", text=text, encoding="ros1", metadata=more)
    small = float(np.array([1], np.int32).view(np.float32)[0])
    with draft.done() as recording:
        assert rows(recording) == [
            {"left": 1, "right": 2},
            {"right": 1, "left": 2},
            {"left": small, "right": 2},
            {"left": 1, "right": 2},
        ]
        assert recording["/t"].to_arrow().column("right").to_pylist() == [2, 1, 2, 2]
        assert recording["/t"].to_arrow().column("left").to_pylist() == [1, 2, small, 1]


def test_a_json_channel_among_those_of_ros_is_read_as_json(draft: Draft) -> None:
    schema = b'{"type": "object", "properties": {"x": {"type": "number"}}}'
    draft.topic([b'{"x": 1.5}'], name="p/msg/A", schema="jsonschema", text=schema, encoding="json")
    draft.topic([b"\0\1\0\0\0"], topic="/empty", name="std_msgs/msg/Empty", schema="ros2msg")
    draft.topic([b"\0\1\0\0\0"], topic="/own", name="p/msg/Nothing", schema="ros2msg")
    with draft.done() as recording:
        assert rows(recording) == [{"x": 1.5}]
        assert rows(recording, "/empty") == rows(recording, "/own") == [{}]


def test_a_message_in_another_form_than_its_neighbours_is_read_in_its_own_or_bytes(draft: Draft) -> None:
    value = struct.pack("<Bxxxd", 7, 1.5)
    forms = [
        b"\0\1\0\0" + struct.pack("<B7xd", 7, 1.5),
        b"\0\0\0\0" + struct.pack(">B7xd", 7, 1.5),
        b"\0\7\0\0" + value,
        b"\0\x09\0\0" + struct.pack("<I", len(value)) + value,
        b"\0\3\0\0" + value,
        b"\0\1\0\0" + struct.pack("<B7xd", 7, 1.5) + bytes(4),
    ]
    draft.topic(forms, name="p/msg/A", schema="ros2msg", text=b"uint8 a\nfloat64 b")
    draft.done().close()
    with Recording(draft.path) as recording:
        with pytest.warns(UndecodedWarning, match=r"announces a list of parameters.*; its rows have the bytes"):
            found = list(recording["/t"].rows())
        assert [row.get("b") for row in found] == [1.5, 1.5, 1.5, 1.5, None, None]
        assert [row["_data"] for row in found[4:]] == forms[4:]
    with Recording(draft.path, on_unknown="raise") as recording, pytest.raises(DamagedFileError, match="at 5 ns"):
        list(recording["/t"].rows())


def test_a_message_that_is_not_decoded_costs_its_neighbours_no_type(draft: Draft) -> None:
    odd = b"\0\3\0\0" + bytes(8)
    payloads = [b"\0\1\0\0" + struct.pack("<d", 1.5), odd, b"\0\1\0\0" + struct.pack("<d", 2.5)]
    draft.topic(payloads, name="std_msgs/msg/Float64", schema="ros2msg", text=b"float64 data")
    with draft.done() as recording, warnings.catch_warnings():
        warnings.simplefilter("ignore", UndecodedWarning)
        table = recording["/t"].to_arrow()
        assert table.schema.field("data").type == pa.float64()
        assert table.column("data").to_pylist() == [1.5, None, 2.5]
        assert table.column("_data").to_pylist() == [None, odd, None]


def test_a_type_without_a_text_that_is_not_empty_after_all_is_unknown(draft: Draft) -> None:
    draft.topic([b"\0\1\0\0" + bytes(8)], name="p/msg/Thing", schema="ros2msg")
    what = r"that is no p/msg/Thing .* as 'data'; pass definitions="
    with draft.done() as recording, pytest.warns(UndecodedWarning, match=what):
        assert next(recording["/t"].rows())["data"] == b"\0\1\0\0" + bytes(8)
