"""Looks up definitions that a recording lacks: those that the caller gave, or those of ROS itself."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ...errors import EncodingError
from . import definitions, distros, idl, interfaces
from .definitions import LookedUp
from .distros import Likely
from .message_types import canonical

_PARTS = re.compile(r"^---\s*$", re.MULTILINE)
_IDL = re.compile(r"^\s*(?:module|struct)\s+\w+\s*[:{]", re.MULTILINE)

Given = tuple[tuple[str, str], ...]
"""Types, as `canonical` has them, and their definitions, which somebody gave."""


@dataclass(frozen=True, slots=True)
class Supply:
    """Where the definitions of a channel's messages come from, if its schema lacks them."""

    given: Given = ()
    likely: Likely = field(default_factory=distros.likely)
    """Distributions that it may come from."""
    is_ros1: bool = False
    digest: str = ""
    """The hash of the type that the channel states: "RIHS01_...", or an MD5 sum; empty if it states none."""

    def text(self, name: str) -> str | None:
        """Return the definition that was given for a type, or for the service or action that it is a part of."""
        return _given(dict(self.given), canonical(name))


class Finder:
    """Looks up messages for one definition: among those that were given, then in ROS itself."""

    def __init__(self, supply: Supply, root: str) -> None:
        """Prepare to look up.

        Args:
            supply: Where to look.
            root: The message that the supply's digest is of.
        """
        self._supply = supply
        self._given = dict(supply.given)
        self._root = canonical(root)
        self.guesses: list[str] = []
        """Assumptions that were made, in words."""
        self.borrowed: list[str] = []
        """Messages that were found in ROS itself."""
        self.why = ""
        """Why the last message was not found."""

    @property
    def digest(self) -> str:
        """The hash that the channel states for the message that is looked up."""
        return self._supply.digest

    def __call__(self, name: str) -> LookedUp | None:
        """Return the definition of a message; None if there is none."""
        given = _given(self._given, canonical(name))
        if given is not None:
            return LookedUp(messages=idl.parse(name, given, find=self).messages) if is_idl(given) else LookedUp(given)
        from . import standard_types

        supply = self._supply
        digest = supply.digest if name == self._root else ""
        try:
            standard = standard_types.find(name, supply.likely, is_ros1=supply.is_ros1, digest=digest)
        except EncodingError as error:
            self.why = str(error)
            return None
        if standard.others:
            others = ", ".join(standard.others)
            self.guesses.append(
                f"{name} is taken for that of {standard.distro}; that of {others} has other fields, and the recording"
                " does not say which it is"
            )
        self.borrowed.append(name)
        return LookedUp(standard.text)


def _given(texts: Mapping[str, str], name: str) -> str | None:
    text = texts.get(name)
    if text is None:
        base = texts.get(interfaces.interface_of(name), "")
        text = base if _PARTS.search(base) else None
    return text


def settled(name: str, text: str, supply: Supply) -> Supply:
    """Return the supply whose messages give the completed definition the hash that the channel states.

    The supply that is returned has no hash any more, because it has been checked.

    Args:
        name: Of the message.
        text: Its definition in the .msg language, which lacks messages.
        supply: Where they come from.

    Raises:
        EncodingError: No distribution has such messages.
    """
    from . import standard_types

    names = ("noetic",) if supply.is_ros1 else supply.likely.names
    for first in names:
        rest = tuple(other for other in supply.likely.names if other != first)
        likely = supply.likely if supply.is_ros1 else Likely((first, *rest), 1)
        candidate = replace(supply, likely=likely, digest="")
        find = Finder(candidate, name)
        whole = definitions.complete(name, text, is_ros1=supply.is_ros1, find=find)
        digest = standard_types.digest_of_others(name, whole, is_ros1=supply.is_ros1)
        if digest is None:  # rosbags cannot compute it, so nothing contradicts
            return replace(supply, digest="")
        # ROS 1 accepts "*" for every MD5 sum.
        if supply.digest in (digest, "*"):
            return candidate
    borrowed = ", ".join(find.borrowed)
    raise EncodingError(f"with {borrowed} as ROS has it, the hash of {name} is not {supply.digest}")


def complete(name: str, schema_encoding: str, text: str, supply: Supply) -> tuple[str, str]:
    """Return a schema from which any reader can read a message: its encoding, and its text with all that it needs.

    The text of the schema stays as it is, but a definition that was given for the message itself replaces it.

    Args:
        name: Of the message.
        schema_encoding: Of the text: "ros1msg", "ros2msg", "ros2idl" or "omgidl"; empty without one.
        text: Of the schema; empty without one.
        supply: Where the rest comes from.

    Raises:
        EncodingError: The message, or a message in it, is unknown.
    """
    find = Finder(supply, name)
    given = supply.text(name)
    language = "ros1msg" if supply.is_ros1 else "ros2msg"
    if given is not None:
        text, schema_encoding = given, "ros2idl" if is_idl(given) else language
    elif not text.strip():
        looked_up = find(canonical(name))
        if looked_up is None:
            raise EncodingError(find.why)
        text, schema_encoding = looked_up.text, language
    if schema_encoding.endswith("idl"):
        return schema_encoding, text
    return schema_encoding, definitions.complete(name, text, is_ros1=supply.is_ros1, find=find)


def is_idl(text: str) -> bool:
    """Whether a definition is in IDL, rather than the .msg language."""
    return _IDL.search(text) is not None
