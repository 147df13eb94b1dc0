"""Makes the messages that ROS derives from a service or an action, and knows those that definitions use undefined."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

from ...errors import EncodingError

KNOWN: Mapping[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "unique_identifier_msgs/UUID": "uint8[16] uuid",
    "service_msgs/ServiceEventInfo": (
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number"
    ),
}
"""Messages that a schema may use without defining them, and their definitions."""

KNOWN_ROS1: Mapping[str, str] = {
    "time": "uint32 secs\nuint32 nsecs",
    "duration": "int32 secs\nint32 nsecs",
}
"""The types that are built into ROS 1. The parts have the names that ROS 1's own libraries use."""

_SERVICE = ("Request", "Response")
_ACTION = ("Goal", "Result", "Feedback")

_AROUND_AN_ACTION: Mapping[str, str] = {
    "SendGoal_Request": "unique_identifier_msgs/UUID goal_id\n{0}_Goal goal",
    "SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp",
    "GetResult_Request": "unique_identifier_msgs/UUID goal_id",
    "GetResult_Response": "int8 status\n{0}_Result result",
    "FeedbackMessage": "unique_identifier_msgs/UUID goal_id\n{0}_Feedback feedback",
}
"""https://design.ros2.org/articles/actions.html, section "Topics and services used"."""


def parts(name: str, sections: Sequence[str]) -> dict[str, str]:
    """Return the messages of an interface whose definition has parts, separated by lines of `---`.

    Args:
        name: One of its messages, such as `pkg/AddTwoInts_Event`.
        sections: The parts: two of a service, three of an action.

    Returns:
        Names to definitions.

    Raises:
        EncodingError: There are neither two parts nor three.
    """
    if len(sections) == len(_SERVICE):
        base = _without_suffix(name, ("Event", *_SERVICE))
        return {**_named(base, _SERVICE, sections), f"{base}_Event": _event(base)}
    if len(sections) == len(_ACTION):
        services = {"SendGoal", "GetResult"}
        base = _without_suffix(name, (*(f"{service}_Event" for service in services), *_AROUND_AN_ACTION, *_ACTION))
        around = {f"{base}_{suffix}": text.format(base) for suffix, text in _AROUND_AN_ACTION.items()}
        events = {f"{base}_{service}_Event": _event(f"{base}_{service}") for service in services}
        return {**_named(base, _ACTION, sections), **around, **events}
    raise EncodingError(f"{len(sections)} parts between lines of ---; a service has 2 and an action 3")


def _named(base: str, suffixes: Sequence[str], sections: Sequence[str]) -> dict[str, str]:
    return {f"{base}_{suffix}": section for suffix, section in zip(suffixes, sections, strict=True)}


def _event(service: str) -> str:
    """Return the definition of the message that reports a call of a service (https://www.ros.org/reps/rep-2012.html)."""
    calls = f"{service}_Request[<=1] request\n{service}_Response[<=1] response"
    return f"service_msgs/ServiceEventInfo info\n{calls}"


def _without_suffix(name: str, suffixes: Sequence[str]) -> str:
    for suffix in suffixes:
        if name.endswith("_" + suffix):
            return name.removesuffix("_" + suffix)
    return name


def interface_of(name: str) -> str:
    """Return the service or action that a message is a part of, as far as its name tells.

    Example:
        >>> interface_of("pkg/AddTwoInts_Event")
        'pkg/AddTwoInts'
    """
    around_an_action = ("SendGoal_Event", "GetResult_Event", *_AROUND_AN_ACTION)
    return _without_suffix(name, (*around_an_action, "Event", *_SERVICE, *_ACTION))


def around(name: str, defined: Container[str]) -> str | None:
    """Return the definition of a message that ROS makes of the parts of an interface; None if it is no such message.

    Args:
        name: Such as `pkg/AddTwoInts_Event`.
        defined: The messages that are known.
    """
    if name.endswith("_Event"):
        service = name.removesuffix("_Event")
        return _event(service) if f"{service}_Request" in defined else None
    for suffix, text in _AROUND_AN_ACTION.items():
        base = name.removesuffix(f"_{suffix}")
        if base != name and f"{base}_Goal" in defined:
            return text.format(base)
    return None
