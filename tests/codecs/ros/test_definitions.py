"""Definitions are read as recordings really carry them, whatever their writers left in or out."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from rosbags.typesys import get_types_from_msg

from ml_dash_mcap.codecs.ros import definitions
from ml_dash_mcap.codecs.ros.message_types import Array, Basic, Fields, Named, canonical
from ml_dash_mcap.errors import EncodingError
from tests.support import ros_messages
from tests.support.examples import examples

INT, DOUBLE, TEXT = Basic("int32"), Basic("float64"), Basic("string")


def fields(text: str, name: str = "p/msg/A", *, is_ros1: bool = False) -> Fields:
    return definitions.parse(name, text, is_ros1=is_ros1).messages[canonical(name)]


@settings(max_examples=examples(100), deadline=None)
@given(messages=ros_messages.messages())
def test_fields_are_those_that_rosbags_finds(messages) -> None:
    text = ros_messages.text(messages)
    theirs = get_types_from_msg(text, "pkg/msg/Outer")
    ours = definitions.parse("pkg/msg/Outer", text).messages
    for name, found in ours.items():
        assert list(found.items()) == [(field, described(what)) for field, what in theirs[f"pkg/msg/{name[4:]}"][1]]


def described(what):
    kind, rest = what
    if kind == 1:
        return Basic(rest[0])
    if kind == 2:
        return Named(canonical(rest))
    return Array(described(rest[0]), rest[1] if kind == 3 else None)


def test_constants_defaults_comments_and_bounds_say_nothing_of_the_bytes() -> None:
    text = """
    # A comment: float64 z
    uint8 MAX=3
    uint8 kLower = 0x1F  # a name that real ROS refuses
    string NAME = "a # b"
    float64 x 1.5        # with a default
    string s 'it''s = # x'
    int32[3] n [1, 2, 3]
    string<=5 bounded# at once
    string<=5[<=3] several "a"
    int32[] many[0]
    """.replace("many[0]", "many [0]")
    assert fields(text) == {
        "x": DOUBLE,
        "s": TEXT,
        "n": Array(INT, 3),
        "bounded": TEXT,
        "several": Array(TEXT, None),
        "many": Array(INT, None),
    }


def test_lines_may_end_as_windows_ends_them() -> None:
    text = "float64 x\r\nB b\r\n" + "=" * 80 + "\r\nMSG: p/B\r\nint32 n\r\n"
    assert definitions.parse("p/msg/A", text).messages == {"p/A": {"x": DOUBLE, "b": Named("p/B")}, "p/B": {"n": INT}}


@pytest.mark.parametrize("header", ["MSG: q/B", "MSG: q/msg/B", "MSG:q/B  "])
@pytest.mark.parametrize("reference", ["q/B", "q/msg/B"])
def test_packages_are_named_with_and_without_msg(header: str, reference: str) -> None:
    found = definitions.parse("p/A", f"{reference}[] b\n====\n{header}\nint32 n").messages
    assert found == {"p/A": {"b": Array(Named("q/B"), None)}, "q/B": {"n": INT}}


def test_a_name_without_a_package_is_of_the_same_one_or_of_the_only_one_that_has_it() -> None:
    text = "B b\nC c\n===\nMSG: q/B\nint8 wrong\n===\nMSG: p/B\nint32 n\n===\nMSG: q/C\nB b"
    found = definitions.parse("p/A", text).messages
    assert found["p/A"] == {"b": Named("p/B"), "c": Named("q/C")}
    assert found["q/C"] == {"b": Named("q/B")}


def test_header_is_that_of_std_msgs_in_ros_1_and_of_the_own_package_in_ros_2() -> None:
    text = "Header h\n===\nMSG: std_msgs/Header\nint32 seq\n===\nMSG: p/Header\nint32 n"
    assert fields(text, is_ros1=True) == {"h": Named("std_msgs/Header")}
    assert fields(text) == {"h": Named("p/Header")}
    assert fields(text.partition("===\nMSG: p/")[0]) == {"h": Named("std_msgs/Header")}


def test_the_first_section_may_have_a_header_too() -> None:
    text = "===\nMSG: p/A\nB b\n===\nMSG: p/B\nint32 n"
    assert fields(text) == {"b": Named("p/B")}
    assert fields(text.removeprefix("===\n")) == {"b": Named("p/B")}


def test_messages_that_are_not_used_may_be_broken() -> None:
    assert fields("int32 n\n===\nMSG: p/B\nnonsense!") == {"n": INT}


SERVICE = "int32 a\n---\nB[] b\n===\nMSG: p/B\nint32 n"


def test_a_service_gives_its_request_its_response_and_its_event() -> None:
    assert fields(SERVICE, "p/srv/Add_Request") == {"a": INT}
    assert fields(SERVICE, "p/srv/Add_Response") == {"b": Array(Named("p/B"), None)}
    event = definitions.parse("p/srv/Add_Event", SERVICE).messages
    assert event["p/Add_Event"] == {
        "info": Named("service_msgs/ServiceEventInfo"),
        "request": Array(Named("p/Add_Request"), None),
        "response": Array(Named("p/Add_Response"), None),
    }
    assert list(event["service_msgs/ServiceEventInfo"]) == ["event_type", "stamp", "client_gid", "sequence_number"]


def test_an_action_gives_the_messages_around_it() -> None:
    action = "int32 goal\n---\nint32 result\n---\nint32 step"
    uuid = Named("unique_identifier_msgs/UUID")
    assert fields(action, "p/action/Go_Goal") == {"goal": INT}
    assert fields(action, "p/action/Go_Result") == {"result": INT}
    assert fields(action, "p/action/Go_FeedbackMessage") == {"goal_id": uuid, "feedback": Named("p/Go_Feedback")}
    assert fields(action, "p/action/Go_SendGoal_Request") == {"goal_id": uuid, "goal": Named("p/Go_Goal")}
    assert fields(action, "p/action/Go_GetResult_Response") == {"status": Basic("int8"), "result": Named("p/Go_Result")}
    event = fields(action, "p/action/Go_SendGoal_Event")
    assert event["request"] == Array(Named("p/Go_SendGoal_Request"), None)


def test_a_service_whose_own_name_is_asked_for_is_no_message() -> None:
    with pytest.raises(EncodingError, match="it does not define p/Add"):
        definitions.parse("p/srv/Add", SERVICE)


@pytest.mark.parametrize("odd", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028", "\u2029", "\r", "\t", "µ", "=" * 80, "---"])
def test_a_comment_may_have_any_character_in_it(odd: str) -> None:
    text = f"# a{odd}b: float64 z\nint32 n # a{odd}b\nuint8 MAX=3 # a{odd}b\nstring NAME=a{odd}b\n"
    assert fields(text) == {"n": INT}


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_may_end_as_any_system_ends_them(end: str) -> None:
    text = end.join(["float64 x", "B b", "=" * 40, "MSG: p/B", "int32 n", ""])
    assert definitions.parse("p/msg/A", text).messages == {"p/A": {"x": DOUBLE, "b": Named("p/B")}, "p/B": {"n": INT}}


def test_a_type_that_is_defined_again_is_the_same_or_refused() -> None:
    once = "B b\n===\nMSG: p/B\nint32 n\n"
    again = {"the same": "int32 n", "without comments": "# a comment\n\nint32 n # more", "as p/msg/B": "int32 n"}
    for how, text in again.items():
        name = "p/msg/B" if how == "as p/msg/B" else "p/B"
        assert definitions.parse("p/A", f"{once}===\nMSG: {name}\n{text}").messages["p/B"] == {"n": INT}
    for text in ("float32 n", "int32 m", "int32 n\nint32 m"):
        with pytest.raises(EncodingError, match="it defines p/B more than once, with other fields each time"):
            fields(f"{once}===\nMSG: p/B\n{text}")
    with pytest.raises(EncodingError, match="p/B more than once"):
        fields("B b\n===\nMSG: p/B\nint32 n\nint32 m\n===\nMSG: p/B\nint32 m\nint32 n")
    assert fields("int32 n\n===\nMSG: p/B\nint32 n\n===\nMSG: p/B\nint32 m") == {"n": INT}, "it is not used"
    assert fields("# only a comment\n===\nMSG: p/A\nint32 n") == {"n": INT}


def test_messages_in_other_folders_of_a_package_have_names_of_their_own() -> None:
    text = "p/odd/B b\n===\nMSG: p/odd/B\nint32 n\n===\nMSG: p/other/B\nfloat64 n"
    assert definitions.parse("p/msg/A", text).messages == {"p/A": {"b": Named("p/odd/B")}, "p/odd/B": {"n": INT}}
    short = definitions.parse("p/msg/A", "p/B b\n===\nMSG: p/odd/B\nint32 n").messages
    assert short == {"p/A": {"b": Named("p/B")}, "p/B": {"n": INT}}


def test_messages_of_services_and_actions_may_be_made_of_parts_that_have_sections_of_their_own() -> None:
    text = "service_msgs/ServiceEventInfo info\nAdd_Request[<=1] request\n===\nMSG: p/srv/Add_Request\nint32 a"
    assert fields(text, "p/srv/Add_Event")["request"] == Array(Named("p/Add_Request"), None)
    goal = "Go_SendGoal_Request r\n===\nMSG: p/action/Go_Goal\nint32 a"
    found = definitions.parse("p/msg/A", goal).messages
    assert found["p/Go_SendGoal_Request"] == {
        "goal_id": Named("unique_identifier_msgs/UUID"),
        "goal": Named("p/Go_Goal"),
    }
    event = "Add_Event e\n===\nMSG: p/Add_Request\nint32 a\n===\nMSG: p/Add_Response\nint32 b"
    assert list(definitions.parse("p/msg/A", event).messages["p/Add_Event"]) == ["info", "request", "response"]


@pytest.mark.timeout(20)
def test_a_long_definition_takes_a_time_that_grows_with_its_length_alone() -> None:
    sections = "".join(f"===\nMSG: q/odd/M{number}\nint8 x\n" for number in range(8_000))
    used = "".join(f"M{number} a{number}\nq/M{number} b{number}\n" for number in range(8_000))
    assert len(definitions.parse("p/A", used + sections).messages) > 8_000
    unknown = "".join(f"N{number} a{number}\n" for number in range(50_000))
    with pytest.raises(EncodingError, match="of type 'N0'"):
        definitions.parse("p/A", unknown + sections)


def test_marks_that_files_begin_or_end_with_mean_nothing() -> None:
    text = "\ufefffloat64 x\n===\n\ufeffMSG: p/B\n\ufeffint32 n\n\0"
    assert fields(text) == {"x": DOUBLE}
    assert fields("B b\n" + text.partition("\n")[2]) == {"b": Named("p/B")}
