"""Makes names that ROS accepts from names that anybody may have chosen.

The rules are those of `rosidl_adapter` 3.3 for messages and fields, and those of
https://design.ros2.org/articles/topic_and_service_names.html for topics.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Collection, Iterable

from ...errors import ConversionError

_PACKAGE = re.compile(r"^(?!.*__)(?!.*_$)[a-z][a-z0-9_]*$")
_TOPIC = re.compile(r"^/[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$")

_ROS_PACKAGES = frozenset(
    re.findall(
        r"\w+",
        "actionlib_msgs builtin_interfaces diagnostic_msgs geometry_msgs nav_msgs rcl_interfaces rosgraph_msgs"
        " sensor_msgs shape_msgs std_msgs std_srvs stereo_msgs tf2_msgs trajectory_msgs visualization_msgs",
    )
)

TAKEN_FIELDS = frozenset({"header", "ts", "field_state"})
"""The fields that each of our messages has beside those of its row."""

_CPP_KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        "alignas alignof and asm auto bitand bitor bool break case catch char class compl concept const"
        " constexpr continue decltype default delete do double else enum explicit export extern false final"
        " float for friend goto if import inline int long module mutable namespace new noexcept not nullptr"
        " operator or override private protected public register requires return short signed sizeof static"
        " struct switch template this throw true try typedef typeid typename union unsigned using virtual void"
        " volatile wchar while xor",
    )
)
_KEYWORDS = frozenset(word.lower() for word in keyword.kwlist) | _CPP_KEYWORDS
"""The parser takes these as names, the compilers of the generated code do not."""


def fields(keys: Iterable[str]) -> dict[str, str]:
    """Return the name of a message's field for each key of a row; no two are the same.

    Example:
        >>> fields(["eeQuat", "joint positions", "class"])
        {'eeQuat': 'ee_quat', 'joint positions': 'joint_positions', 'class': 'f_class'}
    """
    names: dict[str, str] = {}
    taken = set(TAKEN_FIELDS)
    for key in keys:
        names[key] = free(field(key), taken, "_")
        taken.add(names[key])
    return names


def field(key: str) -> str:
    """Return the name of a message's field for a key of a row."""
    snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", key)
    name = _words(snake.lower())
    return name if name[:1].isalpha() and name not in _KEYWORDS and name not in TAKEN_FIELDS else _words(f"f_{name}")


def message(topic: str, taken: Iterable[str] = ()) -> str:
    """Return the name of a message type for a topic, or for a key in it, that is not among those taken.

    Example:
        >>> message("cam/wrist")
        'CamWrist'
    """
    words = re.findall(r"[A-Za-z0-9]+", topic)
    name = "".join(word[0].upper() + word[1:] for word in words)
    if not name[:1].isalpha():
        name = f"Topic{name}"
    return free(name, set(taken), "V")


def topic(name: str, taken: Iterable[str] = ()) -> str:
    """Return a ROS topic for a topic of ours that is not among those taken.

    Example:
        >>> topic("cam/left-camera.0")
        '/cam/left_camera_0'
    """
    tokens = [_words(part) for part in name.split("/")]
    tokens = [token if token[0].isalpha() else f"t_{token}" for token in tokens if token]
    return free("/" + ("/".join(tokens) or "topic"), set(taken), "_")


def check_package(name: str) -> str:
    """Return the name of a package.

    Raises:
        ConversionError: ROS refuses it.
    """
    if not isinstance(name, str) or not _PACKAGE.match(name):
        raise ConversionError(f"package={name!r}: a ROS package is lower-case letters, digits and single underscores")
    if name in _ROS_PACKAGES:
        raise ConversionError(f"package={name!r}: ROS has one of that name, whose messages ours would be mistaken for")
    return name


def check_topic(name: str) -> str:
    """Return the name of a ROS topic.

    Raises:
        ConversionError: ROS refuses it.
    """
    if not isinstance(name, str) or not _TOPIC.match(name) or "__" in name or name.endswith("_"):
        raise ConversionError(
            f"{name!r} is no ROS topic: it starts with '/', and its parts are letters, digits and single underscores"
        )
    return name


def _words(text: str) -> str:
    """Keep letters, digits and single underscores inside."""
    return re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", text)).strip("_")


def free(name: str, taken: Collection[str], mark: str) -> str:
    """Return a name, with a number behind it if it is taken."""
    number = 1
    free = name
    while free in taken:
        number += 1
        free = f"{name}{mark}{number}"
    return free
