"""Describes the fields of an MCAP record once, for reading and for writing.

"Records may be extended by adding new fields at the end of existing fields. Readers should ignore any unknown fields.":
whatever follows the last field of a layout does not matter. (https://mcap.dev/spec, section "Records")
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Generic, NoReturn, TypeVar

import numpy as np

from ..errors import DamagedFileError

Bytes = bytes | memoryview

PREFIX_BYTES = 9
"""A record starts with its opcode (1 byte) and the length of its content (8 bytes)."""

_PREFIX = struct.Struct("<BQ")
_U32 = struct.Struct("<I")
_NUMBER_PAIR = struct.Struct("<HQ")
_NUMBER_PAIR_TYPE = np.dtype([("key", "<u2"), ("value", "<u8")])

Record = TypeVar("Record")


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

    def numbers(self, form: struct.Struct) -> tuple[int, ...]:
        """Read numbers that lie one behind the other."""
        return form.unpack_from(self._data, self._take(form.size))

    def u32(self) -> int:
        """Read 4 bytes as a number."""
        return int(_U32.unpack_from(self._data, self._take(4))[0])

    def raw(self, length: int) -> bytes:
        """Read that many bytes."""
        start = self._take(length)
        return bytes(self._data[start : start + length])

    def view(self, length: int) -> memoryview:
        """Read that many bytes without copying them."""
        start = self._take(length)
        return memoryview(self._data)[start : start + length]

    def data(self) -> bytes:
        """Read bytes with their length before them."""
        return self.raw(self.u32())

    def text(self) -> str:
        """Read a text with its length before it."""
        at, start = self.at, self.at + 4
        # A file of 1,000 topics has 6,000 texts: without calls in between, its summary takes two thirds of the time.
        end = start + _U32.unpack_from(self._data, at)[0] if start <= self.end else start
        if end > self.end:
            self.raw(self.u32())  # raises the error for the field that ends behind the record
        self.at = end
        try:
            return str(self._data[start:end], "utf-8")
        except UnicodeDecodeError as error:
            raise DamagedFileError(self._path, self._base + at, "a text that is not UTF-8") from error

    def text_map(self) -> dict[str, str]:
        """Read a map of texts to texts."""
        end = self._end_of_map()
        values: dict[str, str] = {}
        while self.at < end:
            key = self.text()
            values[key] = self.text()
        self._check_end_of_map(end)
        return values

    def number_map(self) -> dict[int, int]:
        """Read a map of 2-byte numbers to 8-byte numbers."""
        end = self._end_of_map()
        length = end - self.at
        # iter_unpack takes whole pairs only. What is left is read below, which raises the error for it.
        pairs_end = end - length % _NUMBER_PAIR.size
        values: dict[int, int] = dict(_NUMBER_PAIR.iter_unpack(self._data[self.at : pairs_end]))
        self.at = pairs_end
        if pairs_end != end:
            self.numbers(_NUMBER_PAIR)
            self._check_end_of_map(end)
        return values

    def refuse(self, reason: str) -> NoReturn:
        """Raise the error for something that is wrong here."""
        raise DamagedFileError(self._path, self._base + self.at, reason)

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


@dataclass(frozen=True, slots=True)
class FieldKind:
    """How a field is read and written. Numbers have a `struct` format instead."""

    read: Callable[[Fields], Any] = Fields.text
    write: Callable[[Any], bytes] = bytes
    number: str = ""
    """The format of a number, as `struct` spells it."""


def _data_bytes(data: bytes) -> bytes:
    return _U32.pack(len(data)) + data


def _text_bytes(text: str) -> bytes:
    return _data_bytes(text.encode())


def _text_map_bytes(texts: Mapping[str, str]) -> bytes:
    return _data_bytes(b"".join(_text_bytes(key) + _text_bytes(value) for key, value in texts.items()))


def _number_map_bytes(numbers: Mapping[int, int]) -> bytes:
    return _data_bytes(b"".join(_NUMBER_PAIR.pack(key, value) for key, value in numbers.items()))


U8, U16, U32, U64 = (FieldKind(number=code) for code in "BHIQ")
TEXT = FieldKind(Fields.text, _text_bytes)
DATA = FieldKind(Fields.data, _data_bytes)
TEXT_MAP = FieldKind(Fields.text_map, _text_map_bytes)
NUMBER_MAP = FieldKind(Fields.number_map, _number_map_bytes)


class RecordLayout(Generic[Record]):
    """The fields of one kind of record, in their order."""

    def __init__(self, opcode: int, record: Callable[..., Record], /, **fields: FieldKind) -> None:
        """Describe a kind of record.

        Args:
            opcode: The first byte of the record.
            record: Makes the value, by the names of the fields.
            fields: The kind of each field, in the order of the bytes.
        """
        self.opcode = opcode
        self._record = record
        self._fields = fields
        self._steps: list[tuple[struct.Struct | None, tuple[FieldKind, ...]]] = []
        """Numbers that follow each other are read and written at once: half of the time of a chunk index."""
        for is_number, run in groupby(fields.values(), lambda kind: bool(kind.number)):
            kinds = tuple(run)
            if is_number:
                self._steps.append((struct.Struct("<" + "".join(kind.number for kind in kinds)), kinds))
            else:
                self._steps += [(None, (kind,)) for kind in kinds]

    def read(self, fields: Fields, **others: Any) -> Record:
        """Read a record's content.

        Args:
            fields: The content.
            others: Attributes of the value that are not in the record.

        Raises:
            DamagedFileError: The content is too short, or contradicts itself.
        """
        values: list[Any] = []
        for numbers, kinds in self._steps:
            if numbers is not None:
                values += fields.numbers(numbers)
            else:
                values.append(kinds[0].read(fields))
        return self._record(**dict(zip(self._fields, values, strict=True)), **others)

    def dtype(self, **counts: int) -> np.dtype[np.void]:
        """Return the type of whole records whose maps and texts have some sizes, for reading many at once.

        Args:
            counts: By field, the number of pairs of a map, or of bytes of a text. What precedes these, the length in
                bytes, is the field `<name>_bytes`.
        """
        fields: list[Any] = [("prefix", np.uint8, (PREFIX_BYTES,))]
        for name, kind in self._fields.items():
            if kind.number:
                fields.append((name, f"<{kind.number}"))
            else:
                element = _NUMBER_PAIR_TYPE if kind is NUMBER_MAP else np.dtype(np.uint8)
                fields += [(f"{name}_bytes", "<u4"), (name, element, (counts[name],))]
        return np.dtype(fields)

    def content(self, record: Record) -> bytes:
        """Return a record without its prefix."""
        values = iter([getattr(record, name) for name in self._fields])
        parts = []
        for numbers, kinds in self._steps:
            if numbers is not None:
                parts.append(numbers.pack(*(next(values) for _ in kinds)))
            else:
                parts.append(kinds[0].write(next(values)))
        return b"".join(parts)

    def pack(self, record: Record) -> bytes:
        """Return a whole record."""
        content = self.content(record)
        return _PREFIX.pack(self.opcode, len(content)) + content


def pack_prefix(opcode: int, length: int) -> bytes:
    """Return the prefix of a record: its opcode, and the length of its content."""
    return _PREFIX.pack(opcode, length)


def read_prefix(data: Bytes, at: int) -> tuple[int, int]:
    """Return the opcode and the content's length of the record that starts at `at`; its 9 bytes must be there."""
    opcode, length = _PREFIX.unpack_from(data, at)
    return opcode, length


def split_records(data: Bytes, path: str, base: int) -> Iterator[tuple[int, int, Fields]]:
    """Walk records that lie one behind the other and fill `data`.

    Yields:
        Opcode, offset in the file, content.

    Raises:
        DamagedFileError: The records do not end where `data` ends.
    """
    at = 0
    while at < len(data):
        opcode, fields = record_at(data, at, path, base)
        yield opcode, base + at, fields
        at = fields.end


def record_at(data: Bytes, at: int, path: str, base: int) -> tuple[int, Fields]:
    """Return the opcode and the content of the record that starts at `at`, which is `base + at` in the file.

    Raises:
        DamagedFileError: It does not end where `data` ends, or before.
    """
    content = at + PREFIX_BYTES
    if len(data) < content:
        raise DamagedFileError(path, base + at, f"{len(data) - at} bytes where a record should start")
    opcode, length = read_prefix(data, at)
    if length > len(data) - content:
        raise DamagedFileError(path, base + at, f"a record of {length} bytes where {len(data) - content} are left")
    return opcode, Fields(data, path, base, content, content + length)
