"""Translates messages of one generation of ROS into those of the other, with the serialisers of rosbags.

A type keeps its definition. If the other generation has a standard message of that name, the
standard definition counts, and fields are matched by name.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from rosbags.convert.converter import is_same_wireformat, migrate_bytes, migrate_message
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from ...codecs.ros import standard_types
from ...errors import ConversionError, ConversionWarning
from ...mcap.message import Payload

_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""Messages that have another name in ROS 2."""

_HEADER = "std_msgs/msg/Header"
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class Translation(NamedTuple):
    """The translation of a type's messages to the other generation."""

    type: str
    """As the other generation spells it."""
    text: str
    """Its definition there, followed by those of the types in it."""
    digest: str
    """ "RIHS01_..." in ROS 2, an MD5 sum in ROS 1."""
    convert: Callable[[Payload], Payload]
    """Translates one message; raises a ValueError for bytes that do not match the type."""
    changes: tuple[str, ...]
    """Descriptions of the fields that only one of the two definitions has."""


def translation(name: str, encoding: str, text: str, *, to_ros1: bool) -> Translation:
    """Return how a type is translated.

    Args:
        name: Of the type, with its package.
        encoding: Of its definition: "ros1msg", "ros2msg" or "ros2idl".
        text: The definition, followed by those of the types in it.
        to_ros1: Whether to translate from ROS 2 to ROS 1, or else the other way.

    Raises:
        ConversionError: It has what the other generation does not know, or its definition cannot be read.
    """
    package, _, rest = name.partition("/")
    source = _in_ros1(name) if to_ros1 else f"{package}/msg/{rest.rpartition('/')[2]}"
    try:
        src = _source(source, name, encoding, text, is_ros1=not to_ros1)
        target = source if to_ros1 else _RENAMED.get(source, source)
        dst, changes = _destination(src, source, target, to_ros1=to_ros1)
        definition, md5 = dst.generate_msgdef(target, ros_version=1 if to_ros1 else 2)
        digest = md5 if to_ros1 else dst.hash_rihs01(target)
    except ConversionError as error:
        raise ConversionError(f"type {name!r}: {error}") from error
    except Exception as error:  # rosbags has several trees of errors
        raise ConversionError(f"type {name!r} cannot be said in ROS {1 if to_ros1 else 2}: {error}") from error
    spelled = target.replace("/msg/", "/") if to_ros1 else target
    return Translation(spelled, definition, digest, _converter(src, dst, source, target, to_ros1), changes)


def _converter(src: Typestore, dst: Typestore, source: str, target: str, to_ros1: bool) -> Callable[[Payload], Payload]:
    is_same = is_same_wireformat(src, dst, source, target)
    # rosbags keeps here what it compiles for a pair of types.
    cache: dict[str, object] = {}
    bounds = {} if to_ros1 else _bounds(src, dst)
    warned: set[str] = set()

    def cut(message: Any) -> None:
        """Say once of each field that a message has more elements than the other definition has room for."""
        for where, size, most in _excess(src, source, message, bounds):
            if where not in warned:
                warned.add(where)
                warnings.warn(
                    f"{where} of a {target} has {size} elements, and ROS 2 has room for {most}: the last {size - most} "
                    "are cut off, as they are in all messages with more than it has room for",
                    ConversionWarning,
                    stacklevel=4,
                )

    def convert(payload: Payload) -> Payload:
        try:
            # Only then must each message become an object: ROS 2 refuses lists that are longer than their bound.
            if bounds:
                message = src.deserialize_ros1(payload, source)
                cut(message)
                return dst.serialize_cdr(
                    migrate_message(src, dst, source, target, cache, message), target, little_endian=True
                )
            # Where both definitions have the same fields, only the alignment changes, for which rosbags has a direct
            # way from little-endian CDR.
            if not is_same or (to_ros1 and bytes(payload[:2]) != b"\0\1"):
                return migrate_bytes(src, dst, source, target, cache, payload, src_is2=to_ros1, dst_is2=not to_ros1)
            return src.cdr_to_ros1(payload, source) if to_ros1 else dst.ros1_to_cdr(payload, target)
        except ConversionWarning:  # of somebody who wants warnings to be errors
            raise
        except Exception as error:
            raise ValueError(str(error)) from error

    return convert


def _bounds(src: Typestore, dst: Typestore) -> dict[tuple[str, str], int]:
    """Return the most elements that a type's field may have there and need not have here."""
    bounds = {}
    for name, (_, fields) in src.fielddefs.items():
        there = dict(dst.fielddefs[name][1]) if name in dst.fielddefs else {}
        for field, kind in fields:
            other = there.get(field)
            if other is not None and other[0] == kind[0] == Nodetype.SEQUENCE and other[1][1]:
                bounds[name, field] = int(other[1][1])
    return bounds


def _excess(
    src: Typestore, name: str, message: Any, bounds: Mapping[tuple[str, str], int]
) -> Iterator[tuple[str, int, int]]:
    """Yield the fields of a message that have more elements than they may: which, how many, and how many they may."""
    fields: Sequence[tuple[str, Any]] = src.fielddefs[name][1]
    for field, kind in fields:
        value = getattr(message, normalize_fieldname(field))
        most = bounds.get((name, field))
        if most is not None and len(value) > most:
            yield f"{name}.{field}", len(value), most
        is_many = kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        inner = kind[1][0] if is_many else kind
        if inner[0] == Nodetype.NAME:
            for inner_message in value if is_many else (value,):
                yield from _excess(src, inner[1], inner_message, bounds)


def _source(name: str, full: str, encoding: str, text: str, *, is_ros1: bool) -> Typestore:
    """Return a type and all in it as they are defined, but as ROS 1 can say them where they go to ROS 1.

    Args:
        name: Of the type, in the store.
        full: Its own name, which may be one of a service or an action.
        encoding: Of its definition.
        text: The definition, followed by those of the types in it.
        is_ros1: Whether they come from ROS 1.
    """
    store = get_typestore(Stores.EMPTY)
    standard: Mapping[str, Any] = standard_types.store(is_ros1=is_ros1).fielddefs
    root = name if is_ros1 else full
    types: dict[str, Any] = dict(get_types_from_idl(text) if encoding == "ros2idl" else get_types_from_msg(text, root))
    if not is_ros1:
        standard, types = _plain(standard), _plain(types)
    for type_name in (*_TIMES, _HEADER):
        if type_name in standard:
            types[type_name] = standard[type_name]
    missing = list(_inner(types, name))
    while missing:
        type_name = missing.pop()
        if type_name in types:
            continue
        if type_name not in standard:
            short = type_name.rpartition("/")[2]
            raise ConversionError(
                f"it has a {short}, which ROS {1 if not is_ros1 else 2} does not have"
                if short == "wstring"
                else f"it has a {type_name!r}, which nobody defines"
            )
        types[type_name] = standard[type_name]
        missing += _inner(types, type_name)
    store.register(types)
    return store


def _plain(types: Mapping[str, Any]) -> dict[str, Any]:
    """Return types of ROS 2 under names, and with fields, that ROS 1 knows."""
    return {
        _in_ros1(name): (constants, [(field, _unbounded(kind)) for field, kind in fields])
        for name, (constants, fields, *_) in types.items()
    }


def _in_ros1(name: str) -> str:
    """Return the name of a type, where messages, services and actions have one folder, and must not take one name.

    `p/srv/Foo_Request` becomes `p/msg/srv_Foo_Request`: names of messages begin with a capital letter.
    """
    package, *folders, last = name.split("/")
    kind = next((folder for folder in folders if folder in ("srv", "action")), "")
    return f"{package}/msg/{kind}_{last}" if kind else f"{package}/msg/{last}"


def _unbounded(kind: Any) -> Any:
    """Return the type of a field without bounds, which ROS 1 does not have and messages do not spell."""
    if kind[0] == Nodetype.BASE:
        return (kind[0], (kind[1][0], 0))
    if kind[0] == Nodetype.NAME:
        return (kind[0], _in_ros1(kind[1]))
    inner, size = kind[1]
    return (kind[0], (_unbounded(inner), size if kind[0] == Nodetype.ARRAY else 0))


def _destination(src: Typestore, source: str, target: str, *, to_ros1: bool) -> tuple[Typestore, tuple[str, ...]]:
    """Return a type and all in it as the other generation has them, and where that differs."""
    store = get_typestore(Stores.EMPTY)
    standard = standard_types.store(is_ros1=to_ros1).fielddefs
    types = {type_name: standard[type_name] for type_name in (*_TIMES, _HEADER) if type_name in standard}
    waiting = [target]
    changes: list[str] = []
    while waiting:
        type_name = waiting.pop()
        source_name = source if type_name == target else type_name
        if type_name not in types:
            if type_name in standard:
                types[type_name] = standard[type_name]
            elif source_name in src.fielddefs:
                types[type_name] = src.fielddefs[source_name]
            _check(types, type_name, to_ros1=to_ros1)
        if type_name in standard and source_name in src.fielddefs and type_name != _HEADER:
            changes += _differences(type_name, src.fielddefs[source_name][1], types[type_name][1])
        waiting += [inner for inner in _inner(types, type_name) if inner not in types]
    store.register(types)
    return store, tuple(changes)


def _check(types: Mapping[str, Any], name: str, *, to_ros1: bool) -> None:
    fields = types[name][1]
    for field, kind in fields:
        while kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind = kind[1][0]
        if to_ros1 and kind[0] == Nodetype.BASE and kind[1][0] == "wstring":
            raise ConversionError(f"the field {field!r} of {name!r} is a wstring, which ROS 1 does not have")


def _differences(name: str, before: Sequence[tuple[str, Any]], after: Sequence[tuple[str, Any]]) -> Iterator[str]:
    """Yield the fields that only one of two definitions has. Upper and lower case and bounds are ignored."""
    old, new = ([(field.lower(), _unbounded(kind)) for field, kind in fields] for fields in (before, after))
    if old != new:
        for field, kind in old:
            if (field, kind) not in new:
                yield f"{name} lacks the field {field!r}"
        for field, kind in new:
            if (field, kind) not in old:
                yield f"{name} has a field {field!r}, which is 0 or empty"


def _inner(types: Mapping[str, Any], name: str) -> Iterator[str]:
    for _, kind in types[name][1]:
        while kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind = kind[1][0]
        if kind[0] == Nodetype.NAME:
            yield kind[1]
