"""Reads storage files whose cells hold vectors or quaternions: `DataType=Vec3`, elements separated by commas."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ....errors import ForeignFileError
from ...text.dialect import BLANKS, Dialect
from ...text.number_cells import Cells, NumberPart, TextChunk
from ..placement import Placement

_AROUND = '~[]()"'
_AROUND_BYTES = re.compile(rb'[~\[\]()"]')
_COMMAS = re.compile(rb"[ \t]*,[ \t]*")
_BLANKS = re.compile(rb"[ \t]+")


@dataclass(frozen=True, slots=True)
class VectorKind:
    """The kind of value that each column of a file holds."""

    word: str
    """As OpenSim spells it."""
    shape: tuple[int, ...]
    topic: str

    @property
    def size(self) -> int:
        """How many numbers a cell has."""
        return self.shape[0] if len(self.shape) == 1 else self.shape[0] * self.shape[1]

    @property
    def is_rotation(self) -> bool:
        """Whether the numbers are w x y z of a quaternion."""
        return self.word == "Quaternion"


KINDS: Mapping[str, VectorKind] = {
    kind.word.lower(): kind
    for kind in (
        VectorKind("Quaternion", (4,), "orientations"),
        VectorKind("Vec2", (2,), "vectors"),
        VectorKind("Vec3", (3,), "vectors"),
        VectorKind("UnitVec3", (3,), "vectors"),
        VectorKind("Vec4", (4,), "vectors"),
        VectorKind("Vec5", (5,), "vectors"),
        VectorKind("Vec6", (6,), "vectors"),
        VectorKind("Vec7", (7,), "vectors"),
        VectorKind("Vec8", (8,), "vectors"),
        VectorKind("Vec9", (9,), "vectors"),
        VectorKind("SpatialVec", (6,), "vectors"),
        VectorKind("Mat33", (3, 3), "orientations"),
        VectorKind("Rotation", (3, 3), "orientations"),
    )
}
"""Values of `DataType`, in small letters."""


def placements(names: Sequence[str], kind: VectorKind, topic: str) -> list[Placement]:
    """Return a field for each column."""
    size = kind.size
    return [
        Placement(topic, (name,), kind.shape, tuple(range(at * size, (at + 1) * size))) for at, name in enumerate(names)
    ]


class VectorCells(Cells):
    """The same as `Cells` for rows of a time and of cells with several elements."""

    def __init__(self, path: Path, columns: int, dialect: Dialect, kind: VectorKind, on_bad: str) -> None:
        super().__init__(path, 1 + kind.size * (columns - 1), dialect, on_bad=on_bad)
        self._kind = kind

    def _parse(self, chunk: TextChunk) -> NumberPart:
        plain = _AROUND_BYTES.sub(b"", _COMMAS.sub(b",", chunk.data))
        separator = self.dialect.separator
        if separator == " ":
            plain = b"\n".join(_BLANKS.sub(b",", line.strip()) for line in plain.split(b"\n"))
        elif separator != ",":
            plain = plain.replace(separator.encode(), b",")
        return Cells(self.path, self.columns)._fast(plain, chunk) or self._slow(chunk.data, chunk)

    def _split(self, text: str, line: int) -> list[str]:
        size, numbers = self._kind.size, []
        for number, cell in enumerate(self.dialect.split(text)):
            elements = [element.strip(f"{BLANKS}{_AROUND}") for element in cell.strip(f"{BLANKS}{_AROUND}").split(",")]
            if number and elements == [""]:
                elements = [""] * size
            if number and len(elements) != size:
                if self.on_bad == "raise":
                    problem = f"{cell[:40]!r} has {len(elements)} elements, and a {self._kind.word} has {size}"
                    raise ForeignFileError(self.path, problem, line, number + 1)
                elements = ["?"] * size
            numbers += elements
        return numbers

    def _number(self, cell: str, shift: int, line: int, column: int) -> float | None:
        return super()._number(cell, shift, line, column if column == 1 else 2 + (column - 2) // self._kind.size)

    def _hint(self, text: str) -> str:
        return ""
