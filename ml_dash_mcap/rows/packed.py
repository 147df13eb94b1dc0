"""Large arrays of numbers as base64 text, whose type and shape stand in the side key.

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
    import numpy as np

    dtype = array.dtype
    is_big_endian = dtype.itemsize > 1 and dtype.byteorder == (">" if sys.byteorder == "little" else "=")
    spelling = f"{'>' if is_big_endian else ''}{dtype.name}[{','.join(map(str, array.shape))}]"
    values = np.ascontiguousarray(np.ma.getdata(array)).reshape(-1).view(np.uint8)
    mask = np.ma.getmask(array)
    if mask is not np.ma.nomask and mask.any():
        values = np.concatenate((values, np.ascontiguousarray(mask).reshape(-1).view(np.uint8)))
        spelling = f"masked {spelling}"
    # 1 ms for 640 x 480 x 3 bytes; a table of pairs of letters in numpy takes 2.4 times that
    return binascii.b2a_base64(values.data, newline=False), spelling


def unpack(text: str, spelling: str) -> npt.NDArray[Any] | None:
    """Return the array that was packed, writable; None where text and spelling do not say one."""
    match = _SPELLING.fullmatch(spelling)
    if match is None:
        return None
    import numpy as np

    masked, big, name, lengths = match.groups()
    dtype = np.dtype(name).newbyteorder(">" if big else "<")
    shape = tuple(map(int, lengths.split(",")))
    count = math.prod(shape)
    if len(text) * 3 < count * 4 * dtype.itemsize:  # before memory is asked for
        return None
    try:
        data = bytearray(binascii.a2b_base64(text))
        if len(data) != count * (dtype.itemsize + bool(masked)):
            return None
        array = np.frombuffer(data, dtype, count).reshape(shape)
        if not masked:
            return array
        return np.ma.MaskedArray(array, np.frombuffer(data, np.bool_, count, count * dtype.itemsize).reshape(shape))
    except ValueError:
        return None


def is_spelling(spelling: str) -> bool:
    """Whether a side key's spelling is that of an array."""
    return _SPELLING.fullmatch(spelling) is not None
