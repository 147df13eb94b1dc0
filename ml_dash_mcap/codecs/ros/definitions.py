"""Parses message definitions in the .msg language of both ROS generations."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

from ...errors import EncodingError
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
    Undecoded,
    canonical,
    innermost_of,
    shortened,
)

SEPARATOR = "=" * 80
_SEPARATOR = re.compile(r"={3,}")
_HEADER = re.compile(r"(?:MSG|SRV|ACTION):\s*(\S+)")
_PART = "---"
_BLANKS = " \t\r\v\f\0\ufeff"
"""Characters without meaning at the ends of a line: blanks, the NUL that C puts at the end of a text, Windows' byte
order mark."""
_HEADER_MESSAGE = "std_msgs/Header"
_NOT_DECODED = frozenset({"wstring"})
"""Types that are not decoded. The middleware decides whether a character of a `wstring` has 2 or 4 bytes
(https://github.com/ros2/rosidl_python/issues/104)."""
_LINE = re.compile(
    r"""(?P<type>[A-Za-z][A-Za-z0-9_/]*)
        (?:<=[0-9]+)?                             # the bound of a text, which changes nothing on the wire
        (?P<array>\[(?:<=[0-9]+|[0-9]{0,10})\])?\s+
        (?P<name>[A-Za-z_][A-Za-z0-9_]*)
        \s*(?P<rest>(?:(?<=\s)|[=\#]).*|)      # a constant's or default value, a comment""",
    re.VERBOSE,
)


class LookedUp(NamedTuple):
    """The definition of a message that a text uses and does not define."""

    text: str = ""
    """Its definition, perhaps followed by others."""
    messages: Mapping[str, Fields] = {}
    """Or the fields of messages, where the definition is in another language."""


Find = Callable[[str], "LookedUp | None"]
"""Looks up a message by its canonical name; returns None for an unknown message."""


def nowhere(name: str) -> None:
    """Look a message up where there is none."""


def parse(name: str, text: str, *, is_ros1: bool = False, find: Find = nowhere) -> Definitions:
    """Read a definition followed by those that it needs, as recordings carry them.

    Sections are separated by lines of `=`, each but the first with a header `MSG: pkg/Name`. Constants, default values
    and comments say nothing about the bytes of a message and are skipped.

    Args:
        name: Of the message that the first section defines, or a part of the service or action.
        text: The sections.
        is_ros1: Whether it is ROS 1, where a few names mean something else.
        find: Looks up messages that the text lacks.

    Raises:
        EncodingError: It is no definition, or lacks one of a message that it uses.
    """
    root = canonical(name)
    texts = _Texts(_sections(root, text), is_ros1, find)
    return Definitions(root, closure(root, texts.fields))


def complete(name: str, text: str, *, is_ros1: bool = False, find: Find = nowhere) -> str:
    """Return a definition with those that it lacks behind it, for readers that look nothing up.

    The arguments are those of `parse`.

    Raises:
        EncodingError: It is no definition, or lacks an unknown one.
    """
    root = canonical(name)
    sections = _sections(root, text)
    texts = _Texts(sections, is_ros1, find)
    built_in = interfaces.KNOWN_ROS1 if is_ros1 else {}
    lacking = [
        message for message in closure(root, texts.fields) if message not in sections and message not in built_in
    ]
    return "".join([text, *(f"{_joint(text)}MSG: {message}\n{texts.text(message)}\n" for message in lacking)])


def _joint(text: str) -> str:
    return ("" if text.endswith("\n") else "\n") + SEPARATOR + "\n"


def closure(root: str, fields: Callable[[str], Fields]) -> dict[str, Fields]:
    """Return the fields of a message and of all that it is made of, by name.

    Raises:
        EncodingError: One of them has a type that is not decoded.
    """
    messages: dict[str, Fields] = {}
    waiting = [root]
    while waiting:
        current = waiting.pop()
        if current not in messages:
            messages[current] = fields(current)
            innermost = [innermost_of(type_) for type_ in messages[current].values()]
            for type_ in innermost:
                if isinstance(type_, Undecoded):
                    raise EncodingError(f"it has the type {type_.name!r}, which cannot be decoded")
            waiting += [type_.name for type_ in innermost if isinstance(type_, Named)]
    return messages


def _sections(root: str, text: str) -> dict[str, list[str]]:
    """Return each message's own texts by its name: more than one if it is defined again."""
    texts: dict[str, list[str]] = {}
    current, lines = root, list[str]()
    for line in [*_lines(text), "==="]:
        stripped = line.strip(_BLANKS)
        header = _HEADER.fullmatch(stripped)
        if _SEPARATOR.fullmatch(stripped):
            _add(texts, current, lines)
            current, lines = "", []
        elif header and not any(lines):
            current = canonical(header[1])
        else:
            lines.append(stripped)
    return texts


def _lines(text: str) -> list[str]:
    """Return the lines of a definition.

    `splitlines` would also split at characters that a comment may have, such as U+2028.
    """
    return text.split("\n" if "\n" in text else "\r")


def _add(texts: dict[str, list[str]], name: str, lines: list[str]) -> None:
    if not name and any(lines):
        raise EncodingError(f"a section without a line 'MSG: package/Name' above {next(filter(None, lines))!r}")
    if _PART in lines:
        parts: list[list[str]] = [[]]
        for line in lines:
            if line == _PART:
                parts.append([])
            else:
                parts[-1].append(line)
        for part, text in interfaces.parts(name, ["\n".join(part) for part in parts]).items():
            texts.setdefault(part, []).append(text)
    elif name:
        text = "\n".join(lines)
        own = texts.setdefault(name, [])
        # Recordings repeat the definition of a message that is used twice; only a different one is a contradiction.
        if text not in own:
            own.append(text)


class _Texts:
    """The text of each message, and what names mean in it."""

    def __init__(self, texts: Mapping[str, list[str]], is_ros1: bool, find: Find) -> None:
        self._texts: dict[str, list[str]] = {}
        self._by_last: dict[str, list[str]] = {}
        self._by_short: dict[str, list[str]] = {}
        """Names of messages by their last part (`_by_last`), and by their first and last part together
        (`_by_short`)."""
        self._unknown: set[str] = set()
        self._add(texts)
        self._is_ros1 = is_ros1
        self._find = find
        self._built_in = {**interfaces.KNOWN, **(interfaces.KNOWN_ROS1 if is_ros1 else {})}
        self._aliases = ROS1_ALIASES if is_ros1 else ROS2_ALIASES
        self._messages: dict[str, Fields] = {}
        """Definitions that were looked up in another language."""

    def _add(self, texts: Mapping[str, list[str]]) -> None:
        for name, own in texts.items():
            if name in self._texts:
                continue
            self._texts[name] = own
            self._by_last.setdefault(name.rpartition("/")[2], []).append(name)
            self._by_short.setdefault(shortened(name), []).append(name)

    def fields(self, message: str) -> Fields:
        if not self._is_known(message):
            raise EncodingError(f"it does not define {message}")
        if message in self._messages:
            return self._messages[message]
        texts = self._texts[message]
        first, *others = [self._fields(message, text) for text in filter(_has_lines, texts)] or [{}]
        if any(list(fields.items()) != list(first.items()) for fields in others):
            raise EncodingError(f"it defines {message} more than once, with other fields each time")
        return first

    def text(self, message: str) -> str:
        """Return a message's own text.

        Raises:
            EncodingError: It has none in this language.
        """
        if message not in self._texts:
            raise EncodingError(f"{message} is defined in another language")
        return self._texts[message][0].strip("\n")

    def _is_known(self, message: str) -> bool:
        """Whether there is a message; what the text lacks is looked up, and taken in with all that comes with it."""
        if message in self._texts or message in self._messages:
            return True
        if message not in self._unknown and not self._is_looked_up(message):
            self._unknown.add(message)
        return message not in self._unknown

    def _is_looked_up(self, message: str) -> bool:
        short = shortened(message)
        same = self._by_short.get(short, []) if message == short else [short] if short in self._texts else []
        if len(same) == 1:
            self._add({message: self._texts[same[0]]})
            return True
        text = self._built_in.get(message)
        looked_up = LookedUp(text) if text is not None else self._find(message)
        if looked_up is None and (text := interfaces.around(message, self._texts)) is not None:
            looked_up = LookedUp(text)
        if looked_up is None:
            return False
        self._messages.update({name: fields for name, fields in looked_up.messages.items() if name not in self._texts})
        if not looked_up.messages:
            self._add(_sections(message, looked_up.text))
        return message in self._texts or message in self._messages

    def _fields(self, message: str, text: str) -> Fields:
        fields: dict[str, Type] = {}
        for line in text.split("\n"):
            if not line or line.startswith("#"):
                continue
            match = _LINE.fullmatch(line)
            if match is None:
                raise EncodingError(f"{message} has the line {line!r}, which is neither a field nor a constant")
            if match["rest"].startswith("="):
                continue
            name = match["name"]
            if name in fields:
                raise EncodingError(f"{message} has two fields {name!r}")
            fields[name] = _with_length(self._resolve(match["type"], message), match["array"])
        return fields

    def _resolve(self, type_: str, message: str) -> Type:
        """Return the type that a name means in a message: built in, of the message's own package, or of another."""
        basic = self._aliases.get(type_, type_)
        if basic in CODES or basic == STRING:
            return Basic(basic)
        if type_ in _NOT_DECODED:
            return Undecoded(type_)
        if "/" in type_:
            return Named(canonical(type_))
        if type_ in interfaces.KNOWN_ROS1:
            return Named(type_ if self._is_ros1 else f"builtin_interfaces/{type_.capitalize()}")
        package = message.rpartition("/")[0]
        own = f"{package}/{type_}" if package else type_
        is_header = type_ == "Header"
        # In ROS 1 a plain `Header` always means std_msgs/Header (http://wiki.ros.org/msg). ROS 2 looks in the own
        # package first.
        if is_header and self._is_ros1 and self._is_known(_HEADER_MESSAGE):
            return Named(_HEADER_MESSAGE)
        if self._is_known(own):
            return Named(own)
        # Some recorders leave out the package of a message from another package; a last name that is unique settles
        # it.
        elsewhere = self._by_last.get(type_, [])
        if len(elsewhere) == 1:
            return Named(elsewhere[0])
        if is_header and self._is_known(_HEADER_MESSAGE):
            return Named(_HEADER_MESSAGE)
        raise EncodingError(f"{message} has a field of type {type_!r}, which it does not define")


def _has_lines(text: str) -> bool:
    """Whether there is more than comments."""
    return any(line and not line.startswith("#") for line in text.split("\n"))


def _with_length(of: Type, brackets: str | None) -> Type:
    if brackets is None:
        return of
    length = brackets[1:-1]
    return Array(of, int(length) if length.isdecimal() else None)
