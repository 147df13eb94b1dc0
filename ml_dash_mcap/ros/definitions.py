"""Message definitions in the .msg language of both ROS generations."""

from __future__ import annotations

import re
from collections.abc import Mapping

from ..errors import EncodingError
from . import interfaces
from .message_types import (
    CODES,
    ROS1_ALIASES,
    ROS2_ALIASES,
    STRING,
    Array,
    Basic,
    Definitions,
    Fields,
    Named,
    Type,
    canonical,
)

_SEPARATOR = re.compile(r"={3,}")
_HEADER = re.compile(r"(?:MSG|SRV|ACTION):\s*(\S+)")
_PART = "---"
_HEADER_MESSAGE = "std_msgs/Header"
_LINE = re.compile(
    r"""(?P<type>[A-Za-z][A-Za-z0-9_/]*)
        (?:<=[0-9]+)?                             # the bound of a text, which changes nothing on the wire
        (?P<array>\[(?:<=[0-9]+|[0-9]{0,10})\])?\s+
        (?P<name>[A-Za-z_][A-Za-z0-9_]*)
        \s*(?P<rest>(?:(?<=\s)|[=\#]).*|)      # a constant's or default value, a comment""",
    re.VERBOSE,
)


def parse(name: str, text: str, *, is_ros1: bool = False) -> Definitions:
    """Read a definition followed by those that it needs, as recordings carry them.

    Sections are separated by lines of `=`, each but the first with a header `MSG: pkg/Name`. Constants, default values
    and comments say nothing about the bytes of a message and are skipped.

    Args:
        name: Of the message that the first section defines, or a part of the service or action.
        text: The sections.
        is_ros1: Whether it is ROS 1, where a few names mean something else.

    Raises:
        EncodingError: It is no definition, or lacks one of a message that it uses.
    """
    root = canonical(name)
    known = {**interfaces.KNOWN, **(interfaces.KNOWN_ROS1 if is_ros1 else {})}
    texts = _Texts({**known, **_sections(root, text)}, is_ros1)
    messages: dict[str, Fields] = {}
    waiting = [root]
    while waiting:
        current = waiting.pop()
        if current not in messages:
            messages[current] = texts.fields(current)
            waiting += [inner for one in messages[current].values() if (inner := message_in(one)) is not None]
    return Definitions(root, messages)


def _sections(root: str, text: str) -> dict[str, str]:
    """Return each message's own text by its name."""
    found: dict[str, str] = {}
    current, lines = root, list[str]()
    for line in [*text.splitlines(), "==="]:
        stripped = line.strip()
        header = _HEADER.fullmatch(stripped)
        if _SEPARATOR.fullmatch(stripped):
            _add(found, current, lines)
            current, lines = "", []
        elif header and not any(lines):
            current = canonical(header[1])
        else:
            lines.append(stripped)
    return found


def _add(found: dict[str, str], name: str, lines: list[str]) -> None:
    if not name and any(lines):
        raise EncodingError(f"a section without a line 'MSG: package/Name' above {next(filter(None, lines))!r}")
    if _PART in lines:
        parts: list[list[str]] = [[]]
        for line in lines:
            if line == _PART:
                parts.append([])
            else:
                parts[-1].append(line)
        found.update(interfaces.parts(name, ["\n".join(part) for part in parts]))
    elif name and not found.get(name):
        found[name] = "\n".join(lines)


class _Texts:
    """The text of each message, and what names mean in it."""

    def __init__(self, texts: Mapping[str, str], is_ros1: bool) -> None:
        self._texts = texts
        self._is_ros1 = is_ros1
        self._aliases = ROS1_ALIASES if is_ros1 else ROS2_ALIASES
        self._by_last: dict[str, list[str]] = {}
        for name in texts:
            self._by_last.setdefault(name.rpartition("/")[2], []).append(name)

    def fields(self, message: str) -> Fields:
        text = self._texts.get(message)
        if text is None:
            raise EncodingError(f"it does not define {message}")
        fields: dict[str, Type] = {}
        for line in text.splitlines():
            if not line or line.startswith("#"):
                continue
            found = _LINE.fullmatch(line)
            if found is None:
                raise EncodingError(f"{message} has the line {line!r}, which is neither a field nor a constant")
            if found["rest"].startswith("="):
                continue
            name = found["name"]
            if name in fields:
                raise EncodingError(f"{message} has two fields {name!r}")
            fields[name] = _with_length(self._resolve(found["type"], message), found["array"])
        return fields

    def _resolve(self, type_: str, message: str) -> Type:
        """Return the type that a name means in a message: built in, of the message's own package, or of another."""
        basic = self._aliases.get(type_, type_)
        if basic in CODES or basic == STRING:
            return Basic(basic)
        if "/" in type_:
            return Named(canonical(type_))
        if type_ in interfaces.KNOWN_ROS1:
            return Named(type_ if self._is_ros1 else f"builtin_interfaces/{type_.capitalize()}")
        package = message.rpartition("/")[0]
        own = f"{package}/{type_}" if package else type_
        likely = [_HEADER_MESSAGE, own] if type_ == "Header" and self._is_ros1 else [own]
        for name in likely:
            if name in self._texts:
                return Named(name)
        elsewhere = self._by_last.get(type_, [])
        if len(elsewhere) == 1:
            return Named(elsewhere[0])
        raise EncodingError(f"{message} has a field of type {type_!r}, which it does not define")


def _with_length(of: Type, brackets: str | None) -> Type:
    if brackets is None:
        return of
    length = brackets[1:-1]
    return Array(of, int(length) if length.isdecimal() else None)


def message_in(type_: Type) -> str | None:
    """Return the message that a type is, or is several of."""
    while isinstance(type_, Array):
        type_ = type_.of
    return type_.name if isinstance(type_, Named) else None
