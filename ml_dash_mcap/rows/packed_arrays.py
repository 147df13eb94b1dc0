"""Packs large arrays of numbers into base64 text; their type and shape stand in the side key.

    {"image": "AAEC...", "_exact": {"uint8[480,640,3]": {"": ["image"]}}, "_ts": 1.5}

The text is the base64 of the array's bytes in C order; the spelling says what they are: the type's name in numpy, the
lengths of the dimensions. The bytes are little-endian unless `>` stands before the name. `masked ` before it says that
the array's bytes are followed by one byte for each element, 1 where it is masked.
"""

from __future__ import annotations

import binascii
import math
import re
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy.typing as npt

MOST_LISTED = 4096
"""Arrays of numbers with more elements than this are packed."""

MOST_LISTED_UINT8 = 64 * 1024
"""The same for bytes as numbers, which take few letters in a list."""

_DESCRIPTION = re.compile(r"(bool|u?int(?:8|16|32|64)|float(?:16|32|64))\[([\d,]*)\]", re.ASCII)
_SPELLING = re.compile(r"(masked )?(>)?(bool|u?int(?:8|16|32|64)|float(?:16|32|64))\[(\d{1,19}(?:,\d{1,19})*)\]")


def is_large(array: npt.NDArray[Any]) -> bool:
    """Whether an array is stored packed instead of as lists."""
    dtype = array.dtype
    if dtype.kind not in "fiub" or dtype.itemsize > 8:
        return False
    most = MOST_LISTED_UINT8 if dtype.kind == "u" and dtype.itemsize == 1 else MOST_LISTED
    return array.size > most or (not array.size and _inner_lists(array.shape) > most)


def _inner_lists(shape: tuple[int, ...]) -> int:
    """Return how many lists an array without elements would become."""
    return math.prod(shape[: shape.index(0)])


def pack(array: npt.NDArray[Any]) -> tuple[bytes, str]:
    """Return an array as base64, and the spelling of its type and shape.

    Args:
        array: Numbers or booleans, of any layout; masked ones too.
    """
    # 1 ms for 640 x 480 x 3 bytes; a table of pairs of letters in numpy takes 2.4 times that
    return binascii.b2a_base64(content(array), newline=False), spelling(array)


def content(array: npt.NDArray[Any]) -> memoryview:
    """Return the bytes of an array as its spelling says them."""
    import numpy as np

    # A view as bytes keeps the array's own byte order, which the spelling says.
    values = np.ascontiguousarray(np.ma.getdata(array)).reshape(-1).view(np.uint8)
    if np.ma.is_masked(array):
        mask = np.ascontiguousarray(np.ma.getmaskarray(array))
        values = np.concatenate((values, mask.reshape(-1).view(np.uint8)))
    return values.data


def spelling(array: npt.NDArray[Any]) -> str:
    """Return the spelling of an array's type and shape."""
    import numpy as np

    dtype = array.dtype
    is_big_endian = dtype.itemsize > 1 and dtype.byteorder == (">" if sys.byteorder == "little" else "=")
    masked, big = "masked " if np.ma.is_masked(array) else "", ">" if is_big_endian else ""
    return f"{masked}{big}{dtype.name}[{','.join(map(str, array.shape))}]"


def unpack(text: str, spelled: str) -> npt.NDArray[Any] | None:
    """Return the array that was packed, writable; None where text and spelling do not say one."""
    try:
        # bytearray, because arrays over bytes are read-only.
        return of_content(bytearray(binascii.a2b_base64(text)), spelled)
    except ValueError:
        return None


def of_content(data: bytearray, spelled: str) -> npt.NDArray[Any] | None:
    """Return the array of some bytes, which are not copied; None where bytes and spelling do not go together."""
    match = _SPELLING.fullmatch(spelled)
    if match is None:
        return None
    import numpy as np

    masked, big, name, lengths = match.groups()
    dtype = np.dtype(name).newbyteorder(">" if big else "<")
    shape = tuple(map(int, lengths.split(",")))
    count = math.prod(shape)
    if len(data) != count * (dtype.itemsize + bool(masked)):
        return None
    try:
        array = np.frombuffer(data, dtype, count).reshape(shape)
        if not masked:
            return array
        return np.ma.MaskedArray(array, np.frombuffer(data, np.bool_, count, count * dtype.itemsize).reshape(shape))
    except ValueError:  # more dimensions than numpy has
        return None


class Spelling(str):
    """Stands for an array of which only the spelling is wanted."""

    __slots__ = ()


def spelling_of(spelled: str) -> Spelling | None:
    """Return a spelling of a side key as a `Spelling` if it is that of an array; else None."""
    return Spelling(spelled) if _SPELLING.fullmatch(spelled) else None


def described(spelled: str) -> str:
    """Return the part of a spelling that a schema says: the type and the shape."""
    return spelled.removeprefix("masked ").removeprefix(">")


def is_plain(spelled: str) -> bool:
    """Whether an array of a spelling is little-endian and has no masked elements."""
    return not spelled.startswith(("masked ", ">"))


def parse(description: str) -> tuple[str, tuple[int | None, ...]] | None:
    """Return the type and the shape that a description says, None for a length that differs."""
    match = _DESCRIPTION.fullmatch(description)
    if match is None:
        return None
    return match[1], tuple(int(length) if length else None for length in match[2].split(","))
