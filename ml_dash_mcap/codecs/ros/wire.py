"""The serialization formats of ROS and DDS, and the heads by which a payload announces its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Wire:
    """A serialization format."""

    order: Literal["<", ">"]
    """The byte order of numbers: "<" for little-endian, ">" for big-endian."""
    alignment: int
    """Numbers lie at multiples of their size, or of so many bytes if they are larger. Nothing is aligned to 1."""
    is_version_2: bool = False
    """Whether it is XCDR2: lists of anything but numbers, and appendable messages, begin with their size in bytes, and
    members may be absent."""

    @property
    def is_cdr(self) -> bool:
        """Whether it is CDR of any kind, rather than ROS 1's format."""
        return self.alignment > 1


ROS1 = Wire("<", 1)
"""http://wiki.ros.org/ROS/Technical%20Overview: little-endian, packed."""

CDR = Wire("<", 8)
"""The format that ROS 2 sends (https://www.omg.org/spec/DDSI-RTPS/2.5, section 10.2)."""

CDR_HEAD = b"\0\1\0\0"
"""The first bytes of a payload that ROS 2 sends in CDR (section 10.2 too). Alignment counts from behind them."""

CDR_HEAD_BYTES = len(CDR_HEAD)

CDR_PADDING = 3
"""Bytes that may follow a CDR message, so that its length is a multiple of 4."""

_CDR_BIG = Wire(">", 8)
_CDR2, _CDR2_BIG = Wire("<", 4, is_version_2=True), Wire(">", 4, is_version_2=True)

BY_HEAD: Mapping[bytes, Wire] = {
    b"\0\0": _CDR_BIG,
    b"\0\1": CDR,
    b"\0\6": _CDR2_BIG,
    b"\0\7": _CDR2,
    b"\0\x08": _CDR2_BIG,
    b"\0\x09": _CDR2,
}
"""The first two bytes of a payload, to what follows its head of four (https://www.omg.org/spec/DDS-XTypes/1.3, section
7.6.3.1.2): plain CDR, plain CDR2 and delimited CDR2. In the last one the message itself is appendable."""

DELIMITED = frozenset({b"\0\x08", b"\0\x09"})
"""Those heads that say that the message itself begins with its size."""

PARAMETER_LISTS = frozenset({b"\0\2", b"\0\3", b"\0\x0a", b"\0\x0b"})
"""Heads of messages whose members are numbered, which need a definition with these numbers and are not decoded."""
