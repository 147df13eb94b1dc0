"""Anybody's MCAP is a recording: whatever is in its messages, however its file is laid out."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path

import pytest
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags import rosbag2
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import DamagedFileError, EncodingError, UndecodedWarning
from ml_dash_mcap.rows.dotted import flatten
from tests.support import foreign, protobuf_messages
from tests.support.foreign import COUNT, TOPICS, seen_by_others, write

pytestmark = pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.UndecodedWarning")

INDEXES = [IndexType.ALL, IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE, IndexType.CHUNK | IndexType.MESSAGE]
SUMMARIES = [
    {},
    {"repeat_channels": False, "repeat_schemas": False},
    {"use_statistics": False},
    {"use_summary_offsets": False, "enable_crcs": False},
    {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False, "use_summary_offsets": False},
]
PLAIN = [
    *({"compression": how, "chunk_size": 1000} for how in CompressionType),
    *({"chunk_size": 1000, "index_types": index} for index in INDEXES[1:]),
    {"chunk_size": 1},
    {"use_chunking": False},
]
LAYOUTS = [
    *PLAIN,
    *({"use_chunking": False, **summary} for summary in SUMMARIES[1:]),
    *({"chunk_size": 1, "index_types": index} for index in INDEXES[1:]),
    *(
        {"chunk_size": 1000, "index_types": index, **summary}
        for index, summary in itertools.product(INDEXES, SUMMARIES[1:])
    ),
]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[foreign.Row]]:
    return seen_by_others(write(tmp_path_factory.mktemp("expected") / "a.mcap"))


@pytest.mark.parametrize("layout", LAYOUTS, ids=str)
def test_rows_are_what_other_decoders_see_in_every_layout(tmp_path: Path, expected, layout) -> None:
    with Recording(write(tmp_path / "a.mcap", **layout)) as recording:
        assert list(recording.topics) == TOPICS
        for topic in TOPICS:
            assert list(recording[topic].rows()) == expected[topic]


@pytest.mark.parametrize("layout", PLAIN, ids=str)
def test_columns_entries_windows_and_counts_are_those_of_the_rows(tmp_path: Path, expected, layout) -> None:
    with Recording(write(tmp_path / "a.mcap", **layout)) as recording:
        for topic in TOPICS:
            reader, rows = recording[topic], expected[topic]
            flat = [flatten(row, "_ts") for row in rows]
            assert reader.to_arrow().to_pylist() == flat
            assert reader.read() == {"entries": [flatten(row, "timestamp") for row in rows], "count": COUNT}
            low, high = rows[5]["_ts"], rows[20]["_ts"]
            inside = [row for row in rows if low <= row["_ts"] <= high]
            assert list(reader.rows(low, high)) == inside
            assert reader.to_arrow(low, high).num_rows == len(inside)
            assert (len(reader), reader.info.start, reader.info.end) == (COUNT, rows[0]["_ts"], rows[-1]["_ts"])
            assert reader.last() == rows[-1]
        assert recording.metadata == [(f"note {number}", {"number": str(number)}) for number in range(2)]


def test_a_file_that_lost_its_end_gives_the_rows_of_its_whole_chunks(tmp_path: Path, expected) -> None:
    whole = write(tmp_path / "a.mcap", chunk_size=1000).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 3])
    with Recording(cut) as recording:
        for topic in recording.topics:
            rows = list(recording[topic].rows())
            assert 0 < len(rows) < COUNT
            assert all(row in expected[topic] for row in rows)


def test_several_files_of_others_are_one_recording(tmp_path: Path, expected) -> None:
    paths = [
        write(tmp_path / f"{name}.mcap", compression=how) for name, how in zip("ab", CompressionType, strict=False)
    ]
    with Recording(paths) as recording:
        twice = [row for row in expected["/cdr"] for _ in range(2)]
        assert sorted(recording["/cdr"].rows(), key=repr) == sorted(twice, key=repr)
        assert recording.topics["/cdr"].count == 2 * COUNT


@pytest.mark.parametrize(
    ("topic", "encoding", "schema_name", "fields"),
    [
        ("/json", "json", "thing", {"n": "integer", "nested.x": "number", "nested.names": "string[2]"}),
        (
            "/cdr",
            "cdr",
            "sensor_msgs/msg/JointState",
            {
                "header.stamp.sec": "integer",
                "header.stamp.nanosec": "integer",
                "header.frame_id": "string",
                "name": "string[7]",
                "position": "number[7]",
                "velocity": "number[7]",
                "effort": "any[0]",
            },
        ),
        (
            "/ros1",
            "ros1",
            "sensor_msgs/JointState",
            {
                "header.seq": "integer",
                "header.stamp.secs": "integer",
                "header.stamp.nsecs": "integer",
                "header.frame_id": "string",
                "name": "string[7]",
                "position": "number[7]",
                "velocity": "number[7]",
                "effort": "any[0]",
            },
        ),
        (
            "/protobuf",
            "protobuf",
            "foxglove.LaserScan",
            {
                "timestamp.seconds": "integer",
                "timestamp.nanos": "integer",
                "frame_id": "string",
                "start_angle": "number",
                "end_angle": "number",
                "ranges": "number[2]",
                "intensities": "any[0]",
            },
        ),
        ("/raw", "secret", "", {"data": "bytes"}),
    ],
)
def test_a_topic_at_a_glance_says_what_its_messages_are(tmp_path: Path, topic, encoding, schema_name, fields) -> None:
    with Recording(write(tmp_path / "a.mcap")) as recording:
        info = recording.topics[topic]
        assert (info.encoding, info.schema_name, info.count, info.kind) == (encoding, schema_name, COUNT, None)
        assert {name: str(field) for name, field in info.fields.items()} == fields
        assert info.rate == pytest.approx((COUNT - 1) / info.duration)


def test_bytes_of_an_image_stay_bytes_in_every_form(tmp_path: Path) -> None:
    with Recording(write(tmp_path / "a.mcap")) as recording:
        image = recording["/image"]
        assert image.last()["data"] == bytes([image.last()["header"]["stamp"]["sec"]] * 300)
        assert str(image.to_arrow().schema.field("data").type) == "binary"
        assert {type(value) for value in image.to_numpy(columns=["data"])["data"]} == {bytes}
        assert all(type(entry["data"]) is bytes for entry in image.read(columns=["data"])["entries"])


def test_columns_of_vectors_become_matrices(tmp_path: Path, expected) -> None:
    with Recording(write(tmp_path / "a.mcap")) as recording:
        for topic in ("/cdr", "/ros1"):
            arrays = recording[topic].to_numpy(columns=["position"])
            assert arrays["position"].shape == (COUNT, 7)
            assert arrays["position"].tolist() == [row["position"] for row in expected[topic]]


def test_a_topic_that_nobody_decodes_is_told_of_once(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    with warnings.catch_warnings(record=True) as warned, Recording(path) as recording:
        warnings.simplefilter("default")
        for topic in TOPICS:
            list(recording[topic].rows())
            recording[topic].to_arrow()
            recording.topics[topic].fields  # noqa: B018
    assert [(one.category, "'/raw'" in str(one.message)) for one in warned] == [(UndecodedWarning, True)]


@pytest.mark.parametrize(
    ("mode", "format_"),
    [(CompressionMode.NONE, None), (CompressionMode.STORAGE, CompressionFormat.ZSTD)],
    ids=["plain", "compressed"],
)
def test_the_folder_of_a_rosbag2_is_a_recording(tmp_path: Path, mode, format_) -> None:
    path, store = tmp_path / "bag", foreign.ROS2
    bag = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    if format_ is not None:
        bag.set_compression(mode, format_)
    with bag:
        joints = bag.add_connection("/joints", foreign.JOINTS, typestore=store)
        image = bag.add_connection("/image", foreign.IMAGE, typestore=store)
        for number in range(COUNT):
            bag.write(
                joints, foreign.time_ns(number), store.serialize_cdr(foreign.joints(store, number), foreign.JOINTS)
            )
            bag.write(image, foreign.time_ns(number), store.serialize_cdr(foreign.image(number), foreign.IMAGE))
    seen: dict[str, list[tuple[int, foreign.Row]]] = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            row = {**foreign.as_plain(reader.deserialize(data, connection.msgtype)), "_ts": time / 10**9}
            seen.setdefault(connection.topic, []).append((time, row))
    with Recording(path) as recording:
        assert list(recording.topics) == ["/image", "/joints"]
        for topic, messages in seen.items():
            in_order = sorted(messages, key=lambda one: one[0])
            assert sorted(recording[topic].rows(), key=repr) == sorted((row for _, row in in_order), key=repr)
            assert [row["_ts"] for row in recording[topic].rows()] == [row["_ts"] for _, row in in_order]


def test_what_mcap_ros2_writes_decodes_to_the_dicts_that_it_was_given(tmp_path: Path) -> None:
    text = "\n".join(
        [
            *("std_msgs/Header header", "float64[3] class", "Inner[] inner", "bool[] flags", "string<=9 s"),
            *("=" * 80, "MSG: p/Inner", "int16 n", "uint8[4] id"),
            *("=" * 80, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id"),
        ]
    )
    rows = [
        {
            "header": {"stamp": {"sec": n, "nanosec": 7}, "frame_id": "ä" * n},
            "class": [n / 3, float("inf"), -0.0],
            "inner": [{"n": -k, "id": bytes([k, n, 0, 255])} for k in range(n)],
            "flags": [True, False][:n],
            "s": "x" * n,
        }
        for n in range(4)
    ]
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Ros2Writer(file)
        schema = writer.register_msgdef("p/msg/Row", text)
        for n, row in enumerate(rows):
            writer.write_message("/rows", schema, row, log_time=n * 1_000_000_000)
        writer.finish()
    with Recording(tmp_path / "a.mcap") as recording:
        assert list(recording["/rows"].rows()) == [{**row, "_ts": float(n)} for n, row in enumerate(rows)]


def test_what_foxglove_writes_decodes_whatever_its_encoding(tmp_path: Path) -> None:
    sdk = pytest.importorskip("foxglove")
    from foxglove.channels import PointCloudChannel
    from foxglove.messages import PackedElementField, PackedElementFieldNumericType, PointCloud, Timestamp

    path = tmp_path / "a.mcap"
    fields = [PackedElementField(name="x", offset=0, type=PackedElementFieldNumericType.Float32)]
    stamp = Timestamp(sec=5, nsec=7)
    cloud = PointCloud(timestamp=stamp, frame_id="f", point_stride=4, fields=fields, data=bytes(range(8)))
    with sdk.open_mcap(str(path)):
        clouds = PointCloudChannel(topic="/cloud")
        dicts = sdk.Channel(topic="/dict", message_encoding="json")
        raw = sdk.Channel(topic="/raw", message_encoding="mine", schema=sdk.Schema(name="x", encoding="y", data=b"z"))
        clouds.log(cloud, log_time=1_000_000_000)
        dicts.log({"a": {"b": [1, 2.5]}}, log_time=2_000_000_000)
        raw.log(b"\0\1", log_time=3_000_000_000)
    with Recording(path) as recording:
        (row,) = recording["/cloud"].rows()
        assert (row["timestamp"], row["data"], row["_ts"]) == ({"seconds": 5, "nanos": 7}, bytes(range(8)), 1.0)
        assert row["fields"] == [{"name": "x", "offset": 0, "type": "FLOAT32"}]
        assert list(recording["/dict"].rows()) == [{"a": {"b": [1, 2.5]}, "_ts": 2.0}]
        assert list(recording["/raw"].rows()) == [{"data": b"\0\1", "_ts": 3.0}]


def test_one_type_name_may_mean_other_fields_in_another_channel_and_file(tmp_path: Path) -> None:
    for name, types in {"a": ["float32 x", "int32 y"], "b": ["uint8[4] z"]}.items():
        with (tmp_path / f"{name}.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start()
            for number, text in enumerate(types):
                schema = writer.register_schema("p/msg/A", "ros2msg", text.encode())
                channel = writer.register_channel("/t", "cdr", schema, {"n": str(number)})
                writer.add_message(channel, number, b"\0\1\0\0\0\0\x80\x3f", number)
            writer.finish()
    with Recording([tmp_path / "a.mcap", tmp_path / "b.mcap"]) as recording:
        found = [{name: value for name, value in row.items() if name != "_ts"} for row in recording["/t"].rows()]
        assert found == [{"x": 1.0}, {"z": b"\0\0\x80\x3f"}, {"y": 0x3F800000}]
        assert recording["/t"].to_arrow().column("x").to_pylist() == [1.0, None, None]


@pytest.mark.parametrize(
    ("encoding", "schema", "data", "payload", "why"),
    [
        ("cdr", "ros2msg", b"float64 x", b"\0\1\0\0\0", "it ends, after 5 bytes, before its definition does"),
        ("cdr", "ros2msg", b"float32 x", b"\0\1\0\0" + bytes(9), "it is 13 bytes long and its definition ends after 8"),
        ("ros1", "ros1msg", b"string s", b"\xff\0\0\0a", "255 bytes follow byte 4, and 1 do"),
        ("protobuf", "protobuf", protobuf_messages.descriptor_set(), b"\xff\xff", "pars"),
    ],
)
def test_a_message_that_contradicts_its_schema_is_bytes_or_damage_with_its_place(
    tmp_path: Path, encoding, schema, data, payload, why
) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        described = writer.register_schema("test.Everything", schema, data)
        writer.add_message(writer.register_channel("/t", encoding, described), 7, payload, 7)
        writer.finish()
    with Recording(tmp_path / "a.mcap") as recording:
        what = rf"topic '/t' has a message of {len(payload)} bytes that is no test.Everything in {encoding}: .*{why}"
        with pytest.warns(UndecodedWarning, match=what):
            assert list(recording["/t"].rows()) == [{"_data": payload, "_ts": 7e-9}]
        assert recording["/t"].to_arrow().column("_data").to_pylist() == [payload]
    with Recording(tmp_path / "a.mcap", on_unknown="skip") as recording, pytest.warns(UndecodedWarning, match=what):
        assert list(recording["/t"].rows()) == []
    with Recording(tmp_path / "a.mcap", on_unknown="raise") as recording:
        for read in (lambda: list(recording["/t"].rows()), recording["/t"].to_arrow, recording["/t"].read):
            with pytest.raises(
                DamagedFileError, match=rf"byte \d+: a message of topic '/t' at 7 ns .* not {encoding}: .*{why}"
            ):
                read()
        assert recording.topics["/t"].count == 1


def test_a_broken_schema_is_an_error_for_its_topic_alone(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, text in {"/good": b"uint32 x", "/bad": b"uint32 x\nB b"}.items():
            schema = writer.register_schema(f"p{topic}", "ros1msg", text)
            writer.add_message(writer.register_channel(topic, "ros1", schema), 7, bytes(4), 7)
        writer.finish()
    what = r"topic '/bad': its schema 'p/bad' is no ros1msg .* of type 'B'"
    with Recording(tmp_path / "a.mcap") as recording:
        assert list(recording["/good"].rows()) == [{"x": 0, "_ts": 7e-9}]
        assert recording.topics["/bad"].count == 1
        with pytest.warns(UndecodedWarning, match=what + r".*its rows have the bytes of each as 'data'; pass def"):
            assert list(recording["/bad"].rows()) == [{"data": bytes(4), "_ts": 7e-9}]
    with Recording(tmp_path / "a.mcap", on_unknown="raise") as recording:
        assert list(recording["/good"].rows()) == [{"x": 0, "_ts": 7e-9}]
        assert (recording.topics["/bad"].count, dict(recording.topics["/bad"].fields)) == (1, {})
        for read in (lambda: list(recording["/bad"].rows()), recording["/bad"].to_arrow):
            with pytest.raises(EncodingError, match=what):
                read()
    with Recording(tmp_path / "a.mcap", definitions={"p/bad": "B b", "p/B": "uint16[2] n"}) as recording:
        assert list(recording["/bad"].rows()) == [{"b": {"n": [0, 0]}, "_ts": 7e-9}]
    with Recording(tmp_path / "a.mcap", definitions={"p/msg/B": ""}) as recording:
        assert list(recording["/bad"].rows()) == [{"x": 0, "b": {}, "_ts": 7e-9}]
