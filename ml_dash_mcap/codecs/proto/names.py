"""Names of messages and fields that every compiler of .proto files accepts, from topics and keys of any kind."""

from __future__ import annotations

import re
from collections.abc import Iterable

from .layout import Kind, Layout, Member

PACKAGE = "ml_dash"

TIME_NAME, EXACT_NAME, ARRAY_NAME = "_ts", "_exact", "Array"

_TAKEN = frozenset(
    {
        ARRAY_NAME,
        "__defineGetter__",
        "__defineSetter__",
        "__lookupGetter__",
        "__lookupSetter__",
        "__proto__",
        "constructor",
        "hasOwnProperty",
        "isPrototypeOf",
        "propertyIsEnumerable",
        "toLocaleString",
        "toString",
        "valueOf",
    }
)
"""Names that are no field's: the message of arrays, and what each object of JavaScript has. A field of such a name
loses the whole topic in viewers that use protobufjs 7.2 ("duplicate name 'constructor'")."""

_ODD = re.compile(r"[^A-Za-z0-9_]+")
_LONGEST = 200

_SUFFIXES = {
    Kind.DOUBLE: "float",
    Kind.INT: "int",
    Kind.UINT: "uint",
    Kind.BOOL: "bool",
    Kind.TEXT: "text",
    Kind.BYTES: "bytes",
    Kind.DICT: "dict",
    Kind.ARRAY: "array",
}


def of_topic(topic: str) -> tuple[str, str]:
    """Return the package and the name of the message of a topic's rows: `robot/arm` is `ml_dash.robot` and `Arm`."""
    parts = [_identifier(part).lstrip("_") or "topic" for part in topic.split("/") if part] or ["topic"]
    packages = [part[:1].lower() + part[1:] if not part[0].isdigit() else f"t{part}" for part in parts[:-1]]
    return ".".join([PACKAGE, *packages]), message_name(parts[-1])


def message_name(key: str) -> str:
    """Return the name of a message from a key: `ee_pose` is `EePose`."""
    words = [word for word in _identifier(key).split("_") if word]
    name = "".join(word[0].upper() + word[1:] for word in words) or "Field"
    return f"T{name}" if name[0].isdigit() else name


def of_members(layout: Layout) -> dict[int, str]:
    """Return the name of each field of a layout by its number.

    The first field of a key has the key's name; one of doubles takes it from one of integers, because it is the one
    that goes on. The others have the type as a suffix.
    """
    used = {json_name(TIME_NAME).lower(), json_name(EXACT_NAME).lower()} if layout.is_row else set()
    names: dict[int, str] = {}
    for key, slots in layout.by_key.items():
        members = sorted(slots.values(), key=_precedence)
        for place, member in enumerate(members):
            name = _identifier(key) if not place else f"{_identifier(key)}_{_suffix(member)}"
            names[member.number] = _unused(name, used)
    return names


def _precedence(member: Member) -> tuple[bool, int]:
    """Return what sorts the fields of a key: doubles first, otherwise the first one first."""
    return member.slot.kind is not Kind.DOUBLE, member.number


def _suffix(member: Member) -> str:
    lengths = member.slot.lengths
    shape = "" if lengths is None else "s" + "".join(f"_{length}" for length in lengths)
    return _SUFFIXES[member.slot.kind] + shape


def _unused(name: str, used: set[str]) -> str:
    """Return a name that differs from all others also as JSON spells it, and remember it."""
    candidate, count = name, 1
    while json_name(candidate).lower() in used:
        count += 1
        candidate = f"{name}_{count}"
    used.add(json_name(candidate).lower())
    return candidate


def of_oneof(name: str, used: set[str]) -> str:
    """Return the name of the oneof by which readers tell whether a field is there, as compilers of protobuf make it.

    Args:
        name: Of the field.
        used: Names of the fields and oneofs of the message; the new one is added.
    """
    oneof = name if name.startswith("_") else f"_{name}"
    while oneof in used:
        oneof = f"X{oneof}"
    used.add(oneof)
    return oneof


def of_inner(names: Iterable[str], keys: Iterable[str]) -> list[str]:
    """Return names for the messages inside a message, one for each key.

    Args:
        names: Of the fields, which share a scope with the messages.
        keys: Of the dicts.
    """
    used = {*names, ARRAY_NAME}
    inner: list[str] = []
    for key in keys:
        name = candidate = message_name(key)
        count = 1
        while candidate in used:
            count += 1
            candidate = f"{name}{count}"  # without underscores, which the names of oneofs have
        used.add(candidate)
        inner.append(candidate)
    return inner


def json_name(name: str) -> str:
    """Return the name of a field in protobuf's JSON, which must be unique too."""
    return re.sub("_+(.?)", lambda match: match[1].upper(), name)


def _identifier(key: str) -> str:
    """Return a key as letters, digits and underscores; the same where it has no others and is not taken."""
    name = _ODD.sub("_", key)[:_LONGEST] or "field"
    if name in _TAKEN:
        return f"{name}_"
    return f"_{name}" if name[0].isdigit() else name
