"""Definitions of ROS's own messages, and the hashes by which ROS identifies a type. rosbags supplies both."""

from __future__ import annotations

import re
from functools import cache
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ...errors import EncodingError
from .distros import Likely

_TF = "tf2_msgs/msg/TFMessage"
_TF_OLD = "tf/msg/tfMessage"
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
    types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
    for name in (_TF, _TF_OLD) if is_ros1 else ():  # rosbags lacks them
        types.register(get_types_from_msg(_TF_TEXT, name))
    return types


@cache
def definition(name: str, *, is_ros1: bool = False) -> Definition:
    """Return how a bag describes a standard message."""
    types = store(is_ros1=is_ros1)
    text, md5 = types.generate_msgdef(name, ros_version=1 if is_ros1 else 2)
    return Definition(text, md5 if is_ros1 else types.hash_rihs01(name))


class StandardDefinition(NamedTuple):
    """A standard message as a distribution of ROS has it."""

    text: str
    """Its definition, followed by those of the messages in it."""
    distro: str
    others: tuple[str, ...]
    """Other distributions that are just as likely, and whose message of this name has other fields."""


def find(name: str, likely: Likely, *, is_ros1: bool = False, digest: str = "") -> StandardDefinition:
    """Return the definition of a standard message, for bags that do not have it.

    Args:
        name: With its package, such as "sensor_msgs/Range".
        likely: The distributions of ROS 2 to look at.
        is_ros1: Whether it is ROS 1, of which Noetic is looked at.
        digest: The hash that the bag states: "RIHS01_...", or an MD5 sum in ROS 1; empty if it states none.

    Raises:
        EncodingError: No distribution has it, or has it with that digest.
    """
    parts = name.split("/")
    full = f"{parts[0]}/msg/{parts[-1]}"
    if is_ros1:
        return _find_ros1(full, digest)
    having = [distro for distro in likely.names if full in _distribution(distro).fielddefs]
    if not having:
        raise EncodingError("the recording does not define it, and it is no standard message")
    if digest.startswith(_RIHS):
        same = [distro for distro in having if _rihs(distro, full) == digest]
        if not same:
            raise EncodingError(f"the recording does not define it, and no distribution has one with the hash {digest}")
        return StandardDefinition(_text(same[0], full), same[0], ())
    chosen = having[0]
    layout = _layout(chosen, full)
    others = [
        distro for distro in likely.names[: likely.certain] if distro in having and _layout(distro, full) != layout
    ]
    return StandardDefinition(_text(chosen, full), chosen, tuple(others))


def _find_ros1(full: str, digest: str) -> StandardDefinition:
    types = store(is_ros1=True)
    if full not in types.fielddefs:
        raise EncodingError("the recording does not define it, and it is no standard message of ROS 1")
    text, md5 = types.generate_msgdef(full, ros_version=1)
    if digest not in ("", "*", md5):
        raise EncodingError(f"the recording does not define it, and that of Noetic has the MD5 sum {md5}, not {digest}")
    return StandardDefinition(text, "noetic", ())


_RIHS = "RIHS01_"


@cache
def _distribution(name: str) -> Typestore:
    return get_typestore(Stores(f"ros2_{name}"))


@cache
def _text(distro: str, full: str) -> str:
    return _distribution(distro).generate_msgdef(full, ros_version=2)[0]


@cache
def _rihs(distro: str, full: str) -> str:
    """Return the hash of a type as ROS has it."""
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(_without_char(_text(distro, full)), full))
    return own.hash_rihs01(full)


@cache
def _layout(distro: str, full: str) -> Any:
    """Return the types of a message's fields without its constants.

    Two messages of the same layout have the same bytes.
    """
    types = _distribution(distro)

    def described(kind: Any, what: Any) -> Any:
        # rosbags numbers its kinds of nodes: 1 is a basic type, 2 a message, 3 an array, 4 a sequence.
        if int(kind) == 2:
            return _layout(distro, what)
        return (int(kind), what) if int(kind) == 1 else (int(kind), described(*what[0]), what[1])

    return tuple((field, described(*what)) for field, what in types.fielddefs[full][1])


def digest_of_others(name: str, text: str, *, is_ros1: bool = False) -> str | None:
    """Return the hash of a type of others, as `digest` does; None where rosbags cannot say it."""
    parts = name.split("/")
    full = f"{parts[0]}/msg/{parts[-1]}" if is_ros1 or len(parts) < 3 else name
    try:
        return digest(full, text if is_ros1 else _without_char(text), is_ros1=is_ros1)
    except Exception:  # rosbags raises errors of several trees, AssertionError among them
        return None


def _without_char(text: str) -> str:
    """Return a definition as rosidl has it, for which a `char` is a `uint8`."""
    return re.sub(r"^char\b", "uint8", text, flags=re.MULTILINE)


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
        # rosbags spells ROS 1's built-in `time` as this message and needs it for the MD5 sum.
        own.register({time: store(is_ros1=True).fielddefs[time]})
        return own.generate_msgdef(name, ros_version=1)[1]
    return own.hash_rihs01(name)
