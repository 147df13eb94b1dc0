"""The content of a record that may be hostile, field by field."""

from __future__ import annotations

import struct
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from ..errors import DamagedFileError

_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])

Bytes = bytes | memoryview


class Fields:
    """A record's content, read field by field; whatever would leave it is a `DamagedFileError`."""

    __slots__ = ("_base", "_data", "_path", "at", "end", "start")

    def __init__(self, data: Bytes, path: str, base: int = 0, start: int = 0, end: int | None = None) -> None:
        """Begin at the start of a content.

        Args:
            data: The bytes that hold it.
            path: The file, for error messages.
            base: Where in the file `data` starts, for error messages.
            start: Where in `data` the content starts.
            end: Where in `data` it ends; at the end of `data` by default.
        """
        self._data = data
        self._path = path
        self._base = base
        self.end = len(data) if end is None else end
        self.start = start
        self.at = start

    def u8(self) -> int:
        """Read 1 byte as an integer."""
        return self._data[self._take(1)]

    def u16(self) -> int:
        """Read 2 bytes as an integer."""
        return int(_U16.unpack_from(self._data, self._take(2))[0])

    def u32(self) -> int:
        """Read 4 bytes as an integer."""
        return int(_U32.unpack_from(self._data, self._take(4))[0])

    def u64(self) -> int:
        """Read 8 bytes as an integer."""
        return int(_U64.unpack_from(self._data, self._take(8))[0])

    def raw(self, length: int) -> bytes:
        """Read that many bytes."""
        start = self._take(length)
        return bytes(self._data[start : start + length])

    def text(self) -> str:
        """Read a text with its length before it."""
        at = self.at
        try:
            return self.raw(self.u32()).decode()
        except UnicodeDecodeError as error:
            raise DamagedFileError(self._path, self._base + at, "a text that is not UTF-8") from error

    def texts(self) -> dict[str, str]:
        """Read a map of texts to texts."""
        end = self._end_of_map()
        values: dict[str, str] = {}
        while self.at < end:
            key = self.text()
            values[key] = self.text()
        self._check_end_of_map(end)
        return values

    def numbers(self) -> dict[int, int]:
        """Read a map of 2-byte integers to 8-byte integers."""
        end = self._end_of_map()
        values: dict[int, int] = {}
        while self.at < end:
            key = self.u16()
            values[key] = self.u64()
        self._check_end_of_map(end)
        return values

    def entries(self) -> tuple[npt.NDArray[np.uint64], npt.NDArray[np.uint64]]:
        """Read a list of pairs of 8-byte integers as two arrays."""
        length = self.u32()
        if length % _ENTRY.itemsize:
            self.refuse(f"a message index of {length} bytes, which is no multiple of {_ENTRY.itemsize}")
        start = self._take(length)
        pairs = np.frombuffer(self._data, dtype=_ENTRY, count=length // _ENTRY.itemsize, offset=start)
        return pairs["time"].astype(np.uint64), pairs["offset"].astype(np.uint64)

    def refuse(self, what: str) -> NoReturn:
        """Raise the error for something that is wrong here."""
        raise DamagedFileError(self._path, self._base + self.at, what)

    def _end_of_map(self) -> int:
        length = self.u32()
        if length > self.end - self.at:
            self.refuse(f"a map of {length} bytes in a record that has {self.end - self.at} left")
        return self.at + length

    def _check_end_of_map(self, end: int) -> None:
        if self.at != end:
            self.refuse(f"a map whose last entry ends {self.at - end} bytes behind it")

    def _take(self, length: int) -> int:
        start = self.at
        if length > self.end - start:
            self.refuse(f"a field of {length} bytes in a record that has {self.end - start} left")
        self.at = start + length
        return start
