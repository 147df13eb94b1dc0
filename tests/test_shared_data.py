"""Recordings that other tools made read with the counts, types and times that are known of them."""

from __future__ import annotations

import pytest
from mcap.reader import NonSeekingReader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from rosbags.highlevel import AnyReader

from ml_dash_mcap import Recording
from ml_dash_mcap.rows.dotted import flatten
from tests.support import shared
from tests.support.foreign import as_plain


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.UndecodedWarning")
def test_the_files_of_the_conformance_suite_are_recordings() -> None:
    for path in sorted(shared.file("conformance/TenMessages").glob("*.mcap")):
        with Recording(path) as recording:
            info, table = recording.topics["example"], recording["example"].to_arrow()
            assert (info.count, info.encoding, info.schema_name, info.end) == (10, "a", "Example", 9e-9), path.name
            assert set(table.column("data").to_pylist()) == {b"\1\2\3"}


def test_a_laser_scan_in_protobuf_reads_as_its_own_decoder_has_it() -> None:
    path = shared.file("mcap/a-protobuf-rplidar-laserscan.mcap")
    with path.open("rb") as file:
        factory = ProtobufFactory()
        reader = NonSeekingReader(file, decoder_factories=[factory])
        theirs = [
            {**as_plain(decoded), "_ts": message.log_time / 10**9}
            for _, _, message, decoded in reader.iter_decoded_messages()
        ]
    with Recording(path) as recording:
        info = recording.topics["/laser_scan"]
        assert (info.count, info.encoding, info.schema_name) == (256, "protobuf", "foxglove.LaserScan")
        assert info.duration == pytest.approx(32.0, abs=0.05)
        assert info.rate == pytest.approx(255 / 32.0, rel=0.01)
        rows = list(recording["/laser_scan"].rows())
        assert rows == theirs
        assert 900 < len(rows[0]["ranges"]) < 1100
        ahead = [row["timestamp"]["seconds"] + row["timestamp"]["nanos"] / 1e9 - row["_ts"] for row in rows]
        assert ahead == pytest.approx([1.947] * 256, abs=0.02)
        table = recording["/laser_scan"].to_arrow()
        assert table.to_pylist() == [flatten(row, "_ts") for row in rows]


@pytest.mark.parametrize("name", ["", "/array_msgs_0.mcap"], ids=["as a folder", "as a file"])
def test_a_bag_of_humble_reads_as_rosbags_has_it(name: str) -> None:
    folder = shared.file("rosbag2/a-humble-imu-jointstate-mcap")
    with AnyReader([folder]) as reader:
        theirs = {
            connection.topic: {**as_plain(reader.deserialize(data, connection.msgtype)), "_ts": time / 10**9}
            for connection, time, data in reader.messages()
        }
    with Recording(f"{folder}{name}") as recording:
        types = {topic: info.schema_name for topic, info in recording.topics.items()}
        assert types == {"/one_shot/imu": "sensor_msgs/msg/Imu", "/one_shot/joint_state": "sensor_msgs/msg/JointState"}
        assert {topic: list(recording[topic].rows()) for topic in types} == {
            topic: [row] for topic, row in theirs.items()
        }
        assert recording.duration == pytest.approx(1.302834343)


def test_all_messages_of_a_bag_with_services_decode_though_their_definitions_are_those_of_the_services() -> None:
    with Recording(shared.file("rosbag2/a-rolling2023-services-nometa-mcap")) as recording:
        counts = {topic: info.count for topic, info in recording.topics.items()}
        assert counts == {
            "/add_two_ints/_service_event": 6,
            "/add_two_ints2/_service_event": 0,
            "/events/write_split": 0,
            "/parameter_events": 7,
            "/rosout": 0,
        }
        assert recording.duration == pytest.approx(1.5, abs=0.05)
        events = list(recording["/add_two_ints/_service_event"].rows())
        calls = [(row["info"]["sequence_number"], row["request"], row["response"]) for row in events]
        assert calls == [
            call
            for number in (1, 2, 3)
            for call in ((number, [{"a": number, "b": 3}], []), (number, [], [{"sum": number + 3}]))
        ]
        assert {len(row["info"]["client_gid"]) for row in events} == {16}
        assert all(abs(row["info"]["stamp"]["sec"] - row["_ts"]) < 2 for row in events)
        names = [one["name"] for row in recording["/parameter_events"].rows() for one in row["new_parameters"]]
        assert names[0] == "use_sim_time" and len(names) == 7
