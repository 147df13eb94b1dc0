"""Definitions that a recording lacks come from whoever gave them, then from the ROS that the recording comes from."""

from __future__ import annotations

import struct
from typing import Any

import mcap_ros2._dynamic
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ml_dash_mcap.codecs.ros import distros, standard_types
from ml_dash_mcap.codecs.ros.definition_sources import Supply, complete
from ml_dash_mcap.codecs.ros.message_decoder import decoder, definition
from ml_dash_mcap.errors import EncodingError
from tests.support import ros_messages
from tests.support.examples import examples

HUMBLE, JAZZY, NOETIC = (get_typestore(one) for one in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS1_NOETIC))
RANGE = "sensor_msgs/msg/Range"
ROW = {"radiation_type": 1, "field_of_view": 0.5, "min_range": 1.0, "max_range": 4.0, "range": 2.0}


def supply(*given: tuple[str, str], distro: str | None = None, version: int | None = None, **more: Any) -> Supply:
    return Supply(given, distros.likely(distro, version), **more)


def a_range(store: Any, **more: float) -> bytes:
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "sonar")
    return bytes(store.serialize_cdr(types[RANGE](header, *ROW.values(), **more), RANGE))


def of(row: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name != "header"}


@pytest.mark.parametrize("distro", ["foxy", "galactic", "humble", "Humble"])
def test_a_message_is_that_of_the_distribution_that_recorded_it(distro: str) -> None:
    assert of(decoder(RANGE, "ros2msg", "", supply=supply(distro=distro))(a_range(HUMBLE))) == ROW
    later = decoder(RANGE, "ros2msg", "", supply=supply(distro="jazzy"))
    assert of(later(a_range(JAZZY, variance=0.25))) == {**ROW, "variance": 0.25}
    with pytest.raises(ValueError, match="before its definition does"):
        later(a_range(HUMBLE))


@pytest.mark.parametrize(
    ("version", "first"),
    [(1, "dashing"), (2, "dashing"), (4, "foxy"), (5, "humble"), (7, "iron"), (9, "jazzy"), (None, "humble")],
)
def test_a_bag_that_names_no_distribution_is_likely_of_one_that_writes_its_version_of_the_metadata(
    version, first
) -> None:
    for name in (None, "rolling", "rosbags"):
        found = distros.likely(name, version)
        assert found.names[0] == first and sorted(found.names) == sorted(distros.NAMES)
    assert distros.likely("iron", version).names[:3] == ("iron", "jazzy", "humble")
    assert distros.likely("iron", version).certain == 1


def test_a_guess_between_distributions_whose_messages_differ_is_told() -> None:
    def guesses(name: str, **more: Any) -> tuple[str, ...]:
        return definition(name, "ros2msg", "", supply(**more)).guesses

    (guess,) = guesses(RANGE)
    assert guess == (
        "sensor_msgs/Range is taken for that of humble; that of iron, jazzy, kilted, lyrical has other fields, and the"
        " recording does not say which it is"
    )
    assert guesses(RANGE, distro="humble") == guesses(RANGE, version=5) == guesses("sensor_msgs/msg/Imu") == ()
    assert guesses("rcl_interfaces/msg/ParameterDescriptor", version=4) and not guesses(RANGE, version=4)
    assert guesses("visualization_msgs/msg/MarkerArray"), "a message in it differs"


def test_a_hash_of_the_type_chooses_the_definition_that_has_it() -> None:
    for store, payload in ((HUMBLE, a_range(HUMBLE)), (JAZZY, a_range(JAZZY, variance=0.25))):
        digest = store.hash_rihs01(RANGE)
        for distro in ("humble", "jazzy", None):
            decode = decoder(RANGE, "ros2msg", "", supply=supply(distro=distro, digest=digest))
            assert of(decode(payload))["range"] == 2.0
        assert definition(RANGE, "ros2msg", "", supply(digest=digest)).guesses == ()
    with pytest.raises(EncodingError, match=r"no distribution has one with the hash RIHS01_00"):
        decoder(RANGE, "ros2msg", "", supply=supply(digest="RIHS01_00"))


def test_a_char_counts_as_uint8_in_a_hash_as_rosidl_has_it() -> None:
    text = JAZZY.generate_msgdef("service_msgs/msg/ServiceEventInfo", ros_version=2)[0].replace("char[16]", "uint8[16]")
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(text, "service_msgs/msg/ServiceEventInfo"))
    digest = own.hash_rihs01("service_msgs/msg/ServiceEventInfo")
    assert (
        "char[16] client_gid"
        in standard_types.find("service_msgs/ServiceEventInfo", distros.likely(), digest=digest).text
    )


def test_ros_1_has_definitions_of_its_own() -> None:
    payload = struct.pack("<IIII5sBffff", 7, 1, 2, 5, b"sonar", *ROW.values())
    md5 = NOETIC.generate_msgdef(RANGE, ros_version=1)[1]
    for digest in ("", "*", md5):
        row = decoder("sensor_msgs/Range", "ros1msg", "", is_ros1=True, supply=supply(is_ros1=True, digest=digest))(
            payload
        )
        header = {"seq": 7, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "sonar"}
        assert row == {"header": header, **ROW}
    with pytest.raises(EncodingError, match=rf"that of Noetic has the MD5 sum {md5}, not 00"):
        decoder("sensor_msgs/Range", "ros1msg", "", is_ros1=True, supply=supply(is_ros1=True, digest="00"))
    with pytest.raises(EncodingError, match="no standard message of ROS 1"):
        decoder("p/Thing", "ros1msg", "", is_ros1=True, supply=supply(is_ros1=True, digest="00"))


@pytest.mark.parametrize("name", ["tf2_msgs/TFMessage", "tf/tfMessage", "std_msgs/Empty"])
def test_ros_1_knows_its_transforms_and_the_empty_message(name: str) -> None:
    payload = b"" if name.endswith("Empty") else bytes(4)
    row = decoder(name, "ros1msg", "", is_ros1=True, supply=supply(is_ros1=True))(payload)
    assert row == ({} if name.endswith("Empty") else {"transforms": []})


def test_a_type_that_nobody_knows_and_that_has_no_text_is_an_empty_message() -> None:
    empty = "d41d8cd98f00b204e9800998ecf8427e"  # md5sum /dev/null
    decode = decoder("p/Nothing", "ros1msg", "", is_ros1=True, supply=supply(is_ros1=True, digest=empty))
    assert decode(b"") == {}
    with pytest.raises(ValueError, match="1 bytes long and its definition ends after 0"):
        decode(b"\1")
    assert decoder("p/msg/Nothing", "ros2msg", "\n")(b"\0\1\0\0\0") == {}
    with pytest.raises(EncodingError, match="no standard message"):
        decoder("p/msg/Nothing", "", "")


def test_messages_that_a_text_lacks_are_those_that_were_given_then_those_of_ros() -> None:
    text = "std_msgs/Header header\ngeometry_msgs/msg/Vector3 v\nq/B b\nC c"
    given = ("q/B", "D[2] d\n===\nMSG: q/D\nuint8 x"), ("p/C", "module p { struct C { double y; }; };")
    payload = b"\0\1\0\0" + struct.pack("<iII2s", 1, 2, 2, b"a\0") + b"\0\0" + struct.pack("<3dBB6xd", 1, 2, 3, 4, 5, 6)
    row = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "a"},
        "v": {"x": 1.0, "y": 2.0, "z": 3.0},
        "b": {"d": [{"x": 4}, {"x": 5}]},
        "c": {"y": 6.0},
    }
    assert decoder("p/msg/A", "ros2msg", text, supply=supply(*given))(payload) == row
    with pytest.raises(EncodingError, match="does not define q/B"):
        decoder("p/msg/A", "ros2msg", text.rpartition("\n")[0])
    own = text + "\n===\nMSG: q/B\nuint16 own\n===\nMSG: p/C\nuint32 own"
    own_payload = payload[:-16] + struct.pack("<HxxI", 7, 8)
    assert decoder("p/msg/A", "ros2msg", own, supply=supply(*given))(own_payload)["b"] == {"own": 7}


def test_a_definition_that_was_given_comes_before_that_of_the_recording() -> None:
    for text in ("uint32 x", "module p { module msg { struct A { unsigned long x; }; }; };"):
        decode = decoder("p/msg/A", "ros2msg", "nonsense!", supply=supply(("p/A", text)))
        assert decode(b"\0\1\0\0\7\0\0\0") == {"x": 7}


def test_idl_may_lack_messages_too() -> None:
    text = "module p { module msg { struct A { geometry_msgs::msg::Vector3 v; q::msg::B b; }; }; };"
    payload = b"\0\1\0\0" + struct.pack("<3dI", 1, 2, 3, 4)
    row = {"v": {"x": 1.0, "y": 2.0, "z": 3.0}, "b": {"n": 4}}
    assert decoder("p/msg/A", "ros2idl", text, supply=supply(("q/B", "uint32 n")))(payload) == row


@settings(max_examples=examples(60), deadline=None)
@given(messages=ros_messages.messages(least=1), data=st.data())
def test_whichever_messages_a_text_lacks_the_row_is_the_same_if_they_were_given(messages, data) -> None:
    row = data.draw(ros_messages.rows(messages))
    store = ros_messages.typestore(messages)
    message = ros_messages.instance(store, messages, row)
    payload, ros1 = (bytes(write(message, "pkg/msg/Outer")) for write in (store.serialize_cdr, store.serialize_ros1))
    inside = [name for name in messages if name != "pkg/Outer"]
    lacking = data.draw(st.sets(st.sampled_from(inside)))
    rest = ros_messages.text({name: fields for name, fields in messages.items() if name not in lacking})
    given = tuple((name, ros_messages.text({name: messages[name]})) for name in lacking)
    assert repr(decoder("pkg/msg/Outer", "ros2msg", rest, supply=supply(*given))(payload)) == repr(row)
    known = supply(*given, is_ros1=True)
    assert repr(decoder("pkg/Outer", "ros1msg", rest, is_ros1=True, supply=known)(ros1)) == repr(row)


def test_every_standard_message_is_the_same_without_the_definitions_of_the_messages_in_it() -> None:
    for name in JAZZY.types:
        text = JAZZY.generate_msgdef(name, ros_version=2)[0]
        alone = text.partition("=" * 80)[0]
        whole = definition(name, "ros2msg", text).messages
        assert definition(name, "ros2msg", alone, supply(distro="jazzy")).messages == whole
        assert definition(name, "ros2msg", "", supply(distro="jazzy")).messages == whole


@pytest.mark.parametrize(("is_ros1", "name"), [(True, "Header"), (True, "std_msgs/Header"), (False, "std_msgs/Header")])
def test_a_header_need_not_be_defined(is_ros1: bool, name: str) -> None:
    found = definition("p/A", "ros1msg" if is_ros1 else "ros2msg", f"{name} h", supply(is_ros1=is_ros1))
    assert list(found.messages["std_msgs/Header"]) == [*(["seq"] if is_ros1 else []), "stamp", "frame_id"]
    assert list(found.messages["std_msgs/Header"].values())[-2].name == (
        "time" if is_ros1 else "builtin_interfaces/Time"
    )


@settings(max_examples=examples(40), deadline=None)
@given(messages=ros_messages.messages(), data=st.data())
def test_a_completed_definition_is_all_that_another_reader_needs(messages, data) -> None:
    row = data.draw(ros_messages.rows(messages))
    lacking = data.draw(st.sets(st.sampled_from([name for name in messages if name != "pkg/Outer"])))
    rest = ros_messages.text({name: fields for name, fields in messages.items() if name not in lacking})
    given = tuple((name, ros_messages.text({name: messages[name]})) for name in lacking)
    encoding, text = complete("pkg/msg/Outer", "ros2msg", rest, supply(*given))
    assert encoding == "ros2msg" and text.startswith(rest)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, "pkg/msg/Outer"))
    original = ros_messages.typestore(messages)
    payload = original.serialize_cdr(ros_messages.instance(original, messages, row), "pkg/msg/Outer")
    decode = mcap_ros2._dynamic.generate_dynamic("pkg/msg/Outer", text)["pkg/msg/Outer"]
    decode(bytes(payload))
    again = store.serialize_cdr(store.deserialize_cdr(payload, "pkg/msg/Outer"), "pkg/msg/Outer")
    assert bytes(again) == bytes(payload)


def test_a_definition_that_is_complete_stays_as_it_is() -> None:
    text = JAZZY.generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)[0]
    assert complete("sensor_msgs/msg/Imu", "ros2msg", text, supply()) == ("ros2msg", text)
    assert complete("sensor_msgs/msg/Imu", "", "", supply(distro="jazzy")) == ("ros2msg", text)
    with pytest.raises(EncodingError, match="no standard message"):
        complete("p/msg/Thing", "", "", supply())
    idl = "module p { struct Thing { long x; }; };"
    assert complete("p/msg/Thing", "", "", supply(("p/Thing", idl))) == ("ros2idl", idl)


SONAR = "sensor_msgs/Range[] all\nuint8 n"


@pytest.mark.parametrize("store", [HUMBLE, JAZZY], ids=["humble", "jazzy"])
@pytest.mark.parametrize("distro", ["humble", "jazzy", None])
def test_a_hash_also_chooses_the_messages_that_a_definition_lacks(store: Any, distro: str | None) -> None:
    text = SONAR + "\n" + "=" * 80 + "\nMSG: sensor_msgs/Range\n" + store.generate_msgdef(RANGE, ros_version=2)[0]
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(text, "p/msg/Sonar"))
    inner = a_range(store, **({"variance": 0.25} if store is JAZZY else {}))
    message = own.types["p/msg/Sonar"]([own.deserialize_cdr(inner, RANGE)], 7)
    payload = bytes(own.serialize_cdr(message, "p/msg/Sonar"))
    known = supply(distro=distro, digest=own.hash_rihs01("p/msg/Sonar"))
    row = decoder("p/msg/Sonar", "ros2msg", SONAR, supply=known)(payload)
    assert (row["n"], row["all"][0].get("variance")) == (7, 0.25 if store is JAZZY else None)
    assert definition("p/msg/Sonar", "ros2msg", SONAR, known).guesses == ()
    with pytest.raises(
        EncodingError, match="with sensor_msgs/Range as ROS has it, the hash of p/msg/Sonar is not RIHS01_0"
    ):
        definition("p/msg/Sonar", "ros2msg", SONAR, supply(distro=distro, digest="RIHS01_0"))


def test_an_md5_sum_is_held_against_what_ros_1_has_for_the_messages_that_a_definition_lacks() -> None:
    text = "Header header\ngeometry_msgs/Pose pose\nuint8 MODE=3"
    whole = NOETIC.generate_msgdef("geometry_msgs/msg/PoseStamped", ros_version=1)[0]
    named = "geometry_msgs/PoseStamped", "ros1msg", whole.partition("=" * 80)[0]
    md5 = "d3812c3cbc69362b77dc0b19b345f8f5"  # rosmsg md5 geometry_msgs/PoseStamped
    for digest in (md5, "*", ""):
        found = definition(*named, supply(is_ros1=True, digest=digest))
        assert list(found.messages["geometry_msgs/Pose"]) == ["position", "orientation"]
    with pytest.raises(EncodingError, match="the hash of geometry_msgs/PoseStamped is not 0000"):
        definition(*named, supply(is_ros1=True, digest="0000"))
    with pytest.raises(EncodingError, match="the hash of p/A is not"):
        definition("p/A", "ros1msg", text, supply(is_ros1=True, digest=md5))
    given = ("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id"), ("geometry_msgs/Pose", "uint8 own")
    found = definition("p/A", "ros1msg", text, supply(*given, is_ros1=True, digest=md5))
    assert list(found.messages["geometry_msgs/Pose"]) == ["own"], "what was given is taken at its word"


def test_a_service_or_an_action_is_given_by_its_own_name() -> None:
    service, action = "int64 a\n---\nint64 sum\n", "uint8 g\n---\nuint8 r\n---\nuint8 f\n"
    known = supply(("p/Add", service), ("p/Go", action), ("p/No", "uint8 x"))
    info = struct.pack("<BxxxiI16s4xq", 1, 2, 3, bytes(16), 4)
    payload = b"\0\1\0\0" + info + struct.pack("<I4xqI", 1, 7, 0)
    row = decoder("p/srv/Add_Event", "", "", supply=known)(payload)
    assert (row["request"], row["response"]) == ([{"a": 7}], [])
    assert decoder("p/srv/Add_Response", "", "", supply=known)(b"\0\1\0\0" + struct.pack("<q", 9)) == {"sum": 9}
    feedback = decoder("p/action/Go_FeedbackMessage", "", "", supply=known)
    assert feedback(b"\0\1\0\0" + bytes(range(16)) + b"\5") == {
        "goal_id": {"uuid": bytes(range(16))},
        "feedback": {"f": 5},
    }
    assert list(definition("p/action/Go_SendGoal_Event", "", "", known).messages["p/Go_SendGoal_Request"]) == [
        "goal_id",
        "goal",
    ]
    with pytest.raises(EncodingError, match="no standard message"):
        decoder("p/msg/No_Event", "", "", supply=known)


def test_a_hash_that_cannot_be_compared_settles_nothing() -> None:
    service = "sensor_msgs/Range range\n---\nbool ok\n"
    found = definition("p/srv/Ask_Request", "ros2msg", service, supply(digest="RIHS01_00"))
    assert list(found.messages["p/Ask_Request"]) == ["range"]
    assert "sensor_msgs/Range is taken for that of humble" in found.guesses[0]
