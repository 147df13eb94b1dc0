"""Reads the header and the parameters of C3D files (The C3D File Format, User Guide, c3d.org)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ....errors import ForeignFileError

BLOCK = 512
"""Bytes; positions in the file count in blocks, from 1."""

_MAGIC = 0x50
_PROCESSORS = {84: "intel", 85: "dec", 86: "mips"}
_TYPES = {-1: 1, 1: 1, 2: 2, 4: 4}
"""Types of a parameter's values, to their size in bytes: characters, bytes, integers, reals."""


@dataclass(frozen=True, slots=True)
class NumberForm:
    """How a processor spells numbers."""

    processor: str

    @property
    def _order(self) -> str:
        return ">" if self.processor == "mips" else "<"

    def words(self, data: bytes | memoryview) -> npt.NDArray[np.uint16]:
        """Return unsigned integers of 16 bits."""
        return np.frombuffer(data, f"{self._order}u2").astype(np.uint16)

    def integers(self, data: bytes | memoryview) -> npt.NDArray[np.int16]:
        """Return signed integers of 16 bits."""
        return np.frombuffer(data, f"{self._order}i2").astype(np.int16)

    def reals(self, data: bytes | memoryview) -> npt.NDArray[np.float32]:
        """Return reals of 32 bits; those of DEC have their halves swapped, and an exponent that is larger by 2."""
        if self.processor != "dec":
            return np.frombuffer(data, f"{self._order}f4").astype(np.float32)
        # DEC's exponent has another bias, so the same bits mean four times the number in IEEE's form.
        halves = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
        reals: npt.NDArray[np.float32] = np.ascontiguousarray(halves).view("<f4").reshape(-1) / np.float32(4)
        return reals


@dataclass(frozen=True, slots=True)
class Head:
    """The header and the parameters of a file."""

    numbers: NumberForm
    points: int
    """In a frame."""
    analogs: int
    """Values in a frame: channels times samples."""
    first: int
    """Number of the first frame."""
    last: int
    scale: float
    """The factor for points that are stored as integers; negative if points are reals."""
    data_block: int
    samples: int
    """Samples of each analog channel in a frame."""
    rate: float
    parameters: Mapping[str, Mapping[str, Any]]
    """By group and name: text, lists of text, or arrays of numbers."""

    def text(self, group: str, name: str) -> list[str]:
        """Return the texts of a parameter, and of those that continue it, such as LABELS2; none if it is not there."""
        texts: list[str] = []
        for value in self._values(group, name):
            texts += [value] if isinstance(value, str) else value if isinstance(value, list) else []
        return texts

    def array(self, group: str, name: str) -> npt.NDArray[np.float64]:
        """Return the numbers of a parameter and of those that continue it, flat; none if it is not there."""
        values = [value for value in self._values(group, name) if isinstance(value, np.ndarray)]
        flat = [np.ravel(value).astype(np.float64) for value in values]
        return np.concatenate(flat) if flat else np.empty(0)

    def _values(self, group: str, name: str) -> Iterator[Any]:
        values = self.parameters.get(group, {})
        number, key = 1, name
        while key in values:
            yield values[key]
            number += 1
            key = f"{name}{number}"

    def first_number(self, group: str, name: str) -> float | None:
        """Return the first number of a parameter; None if it has none."""
        values = self.array(group, name)
        return float(values[0]) if len(values) else None


def read(path: Path, data: memoryview) -> Head:
    """Read the header and the parameters.

    Raises:
        ForeignFileError: They are damaged.
    """
    if len(data) < BLOCK or data[1] != _MAGIC or not data[0]:
        raise ForeignFileError(path, f"it is no whole C3D file: its header has {len(data)} bytes, and should have 512")
    at = (data[0] - 1) * BLOCK
    if at + 4 > len(data):
        raise ForeignFileError(path, f"it is no whole C3D file: its parameters should begin at byte {at}")
    processor = _PROCESSORS.get(data[at + 3])
    if processor is None:
        raise ForeignFileError(path, f"it is no whole C3D file: byte {at + 3} names the processor {data[at + 3]}")
    numbers = NumberForm(processor)
    words = numbers.words(data[:BLOCK])
    end = min(at + max(data[at + 2], 1) * BLOCK, len(data))
    parameters = _parameters(path, data[at + 4 : end], numbers, end < at + data[at + 2] * BLOCK)
    return Head(
        numbers, int(words[1]), int(words[2]), int(words[3]), int(words[4]), _real(numbers, data, 12), int(words[8]),
        int(words[9]), _real(numbers, data, 20), parameters,
    )  # fmt: skip


def _real(numbers: NumberForm, data: memoryview, at: int) -> float:
    return float(numbers.reals(data[at : at + 4])[0])


def _parameters(path: Path, data: memoryview, numbers: NumberForm, is_cut: bool) -> dict[str, dict[str, Any]]:
    groups: dict[int, str] = {}
    entries: list[tuple[int, str, Any]] = []
    at = 0
    try:
        while at + 2 <= len(data):
            # A negative length marks a locked parameter, and a negative number is that of a group (User Guide,
            # Parameter section).
            length, group = abs(_signed(data[at])), _signed(data[at + 1])
            if not length or not group:
                break
            name = bytes(data[at + 2 : at + 2 + length]).decode("latin-1").strip(" \0").upper()
            behind = at + 2 + length
            step = int(numbers.integers(data[behind : behind + 2])[0])
            if group < 0:
                groups[-group] = name
            else:
                entries.append((group, name, _value(data, behind + 2, numbers)))
            if step <= 0:
                break
            at = behind + step
        else:
            is_cut = is_cut or at > len(data)
    except (IndexError, ValueError) as error:
        raise ForeignFileError(path, f"it is no whole C3D file: its parameters end within {name!r}") from error
    if is_cut and at >= len(data):
        raise ForeignFileError(path, "it is no whole C3D file: its parameters are cut")
    parameters: dict[str, dict[str, Any]] = {}
    for group, name, value in entries:
        parameters.setdefault(groups.get(group, str(group)), {})[name] = value
    return parameters


def _value(data: memoryview, at: int, numbers: NumberForm) -> Any:
    """Return a parameter's value: text, a list of text, or an array with the first dimension first."""
    kind, dimensions = _signed(data[at]), data[at + 1]
    shape = [int(length) for length in data[at + 2 : at + 2 + dimensions]]
    start = at + 2 + dimensions
    size = _TYPES[kind] * int(np.prod(shape, dtype=np.int64)) if kind in _TYPES else 0
    raw = data[start : start + size]
    if len(raw) < size:
        raise ValueError("cut")
    if kind == -1:
        return _text(bytes(raw), shape)
    if kind == 1:
        values: npt.NDArray[Any] = np.frombuffer(raw, np.uint8)
    elif kind == 2:
        values = numbers.integers(raw)
    else:
        values = numbers.reals(raw)
    # C3D stores the first dimension fastest, as Fortran does.
    return values.reshape(shape, order="F")


def _text(raw: bytes, shape: list[int]) -> str | list[str]:
    if len(shape) < 2:
        return _decoded(raw)
    width = shape[0]
    return [_decoded(raw[at : at + width]) for at in range(0, len(raw), width)] if width else []


def _decoded(raw: bytes) -> str:
    raw = raw.split(b"\0", 1)[0].strip(b" \t\r\n")
    try:
        return raw.decode()
    except UnicodeDecodeError:
        # The format says ASCII, and Windows tools write their own letters. Latin-1 decodes any bytes.
        return raw.decode("latin-1")


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte
