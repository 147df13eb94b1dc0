"""What ROS's own messages are made of, and the hashes by which ROS knows a type; rosbags has them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..errors import ConversionError, EncodingError
from .columns import Struct, from_definitions

_TF = "tf2_msgs/msg/TFMessage"
_TF_TEXT = "geometry_msgs/TransformStamped[] transforms\n"


class Definition(NamedTuple):
    """A type as a bag describes it."""

    text: str
    """Its definition, followed by those of the messages in it."""
    digest: str
    """ "RIHS01_..." in ROS 2, an MD5 sum in ROS 1."""


@cache
def store(*, is_ros1: bool = False) -> Typestore:
    """Return the standard messages of a generation of ROS."""
    found = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
    if _TF not in found.fielddefs:
        found.register(get_types_from_msg(_TF_TEXT, _TF))
    return found


def struct(name: str, *, is_ros1: bool = False) -> Struct:
    """Return the type of a standard message.

    Raises:
        ConversionError: ROS has no such message.
    """
    found = store(is_ros1=is_ros1)
    if name not in found.fielddefs:
        raise ConversionError(f"{name!r} is no standard message of ROS")

    def fields(inner: str) -> Iterator[tuple[str, Any]]:
        return iter(found.fielddefs[inner][1])

    return from_definitions(fields, name)


@cache
def definition(name: str, *, is_ros1: bool = False) -> Definition:
    """Return how a bag describes a standard message."""
    found = store(is_ros1=is_ros1)
    text, md5 = found.generate_msgdef(name, ros_version=1 if is_ros1 else 2)
    return Definition(text, md5 if is_ros1 else found.hash_rihs01(name))


def known(name: str) -> str:
    """Return the definition of a standard message of any distribution, for bags that do not have it.

    Raises:
        EncodingError: No distribution has it.
    """
    parts = name.split("/")
    full = f"{parts[0]}/msg/{parts[-1]}"
    for which in (Stores.ROS2_JAZZY, Stores.ROS2_HUMBLE, Stores.ROS2_FOXY):
        found = get_typestore(which)
        if full in found.fielddefs:
            return found.generate_msgdef(full, ros_version=2)[0]
    raise EncodingError("the bag does not define it, and it is no standard message")


def digest(name: str, text: str, *, is_ros1: bool = False) -> str:
    """Return the hash of a type of our own.

    Args:
        name: With its package, such as "ml_dash_msgs/msg/Robot".
        text: Its definition, followed by those of the messages in it.
        is_ros1: Whether to return ROS 1's MD5 sum, instead of ROS 2's RIHS01.
    """
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(text, name))
    if is_ros1:
        time = "builtin_interfaces/msg/Time"
        own.register({time: store(is_ros1=True).fielddefs[time]})
        return own.generate_msgdef(name, ros_version=1)[1]
    return own.hash_rihs01(name)
