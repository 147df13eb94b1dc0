"""Reads the data of C3D files: points, analog channels and rotations, some frames at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ....errors import ForeignFileError
from ...text.number_cells import Floats
from . import layout
from .file_parameters import BLOCK, Head

_ROTATION_VALUES = 17
"""A matrix, column by column, and its residual."""


class Frames(NamedTuple):
    """Some frames."""

    points: Floats
    """[N, P, 3] in the unit of the file; NaN where a point is invalid."""
    analogs: Floats
    """[N * samples, C], scaled."""


@dataclass(frozen=True, slots=True)
class Data:
    """Where the data stands."""

    head: Head
    count: int
    """Of frames."""
    samples: int
    """Of each channel in a frame."""
    channels: int

    @property
    def is_real(self) -> bool:
        """Whether the numbers are reals rather than integers."""
        return self.head.scale < 0

    @property
    def frame_bytes(self) -> int:
        """How long a frame is."""
        return _frame_bytes(self.head)

    def read(self, data: memoryview, first: int, stop: int) -> Frames:
        """Return the frames [first, stop)."""
        head, numbers = self.head, self.head.numbers
        start = (head.data_block - 1) * BLOCK
        raw = data[start + first * self.frame_bytes : start + stop * self.frame_bytes]
        values = (numbers.reals(raw) if self.is_real else numbers.integers(raw)).reshape(stop - first, -1)
        points = values[:, : 4 * head.points].reshape(stop - first, head.points, 4).astype(np.float64)
        places = points[:, :, :3] * (1.0 if self.is_real else np.float64(np.float32(head.scale)))
        # A negative residual marks a point that is missing or invalid (c3d.org, User Guide).
        places[points[:, :, 3] < 0] = np.nan
        analogs = values[:, 4 * head.points :].reshape(-1, self.channels) if self.channels else np.empty((0, 0))
        return Frames(places, self._scaled(analogs))

    def _scaled(self, values: npt.NDArray[Any]) -> Floats:
        """Return analog values in the unit of their channel."""
        head, count = self.head, self.channels
        if not count:
            return np.empty((0, 0))
        is_unsigned = head.text("ANALOG", "FORMAT")[:1] == ["UNSIGNED"]
        if is_unsigned and not self.is_real:
            values = values.astype(np.uint16)
        scale = head.first_number("ANALOG", "GEN_SCALE")
        scales = _padded(head.array("ANALOG", "SCALE"), count, 1.0)
        offsets = _padded(head.array("ANALOG", "OFFSET"), count, 0.0)
        if is_unsigned:
            # Parameters have signed 16 bits only, so an unsigned offset above 32,767 was stored as a negative number.
            offsets = np.where(offsets < 0, offsets + 65536, offsets)
        scaled: Floats = (values.astype(np.float64) - offsets) * scales * (1.0 if scale is None else scale)
        return scaled


def lay_out(path: Path, head: Head, data: memoryview, *, is_lenient: bool) -> tuple[Data, bool]:
    """Find out how many frames there are; returns where the data stands, and whether frames are missing.

    The header has 16 bits for a frame's number, and other parameters repeat the count. Where they differ, the largest
    that the file is long enough for counts, unless its last frames are the zeros that fill the file's last block.

    Args:
        path: The file.
        head: The header and the parameters of the file.
        data: The whole file.
        is_lenient: Whether a file that ends too early is read up to there.

    Raises:
        ForeignFileError: The file ends too early.
    """
    samples = _samples(head)
    channels = head.analogs // samples if samples else 0
    frame_bytes = _frame_bytes(head)
    start, end = (head.data_block - 1) * BLOCK, len(data)
    if not frame_bytes:
        return Data(head, 0, samples, channels), False
    if start < 0 or start > end:
        raise ForeignFileError(path, f"it is no whole C3D file: its data should begin at byte {start}")
    rotations_at = _rotations_at(head)
    if rotations_at is not None and start < rotations_at <= end:
        end = rotations_at
    room = (end - start) // frame_bytes
    stated = _stated(head)
    if stated and max(stated) == layout.MOST_FRAMES and room > layout.MOST_FRAMES:  # more than 16 bits can say
        last_block = data[max(end - BLOCK, start) : end]
        filling = len(last_block) - len(bytes(last_block).rstrip(b"\0"))
        stated.append(room - filling // frame_bytes)
    fitting = sorted(count for count in stated if count <= room)
    for less, count in zip([0, *fitting][::-1][1:], fitting[::-1], strict=True):
        if not less or any(data[start + less * frame_bytes : start + count * frame_bytes]):
            return Data(head, count, samples, channels), False
    wanted = min(stated, default=0)
    if not is_lenient:
        raise ForeignFileError(
            path,
            f"it is no whole C3D file: it has {room} of {wanted} frames; pass on_bad='missing' to read those it has",
        )
    return Data(head, room, samples, channels), True


def rotations(path: Path, head: Head, data: memoryview, count: int) -> tuple[Floats, int]:
    """Return the matrices of bodies, [N, B, 4, 4], NaN where one is invalid, and how many there are in a frame.

    Raises:
        ForeignFileError: The file ends before them.
    """
    bodies, at = int(head.first_number("ROTATION", "USED") or 0), _rotations_at(head)
    ratio = max(int(head.first_number("ROTATION", "RATIO") or 1), 1)
    if bodies < 1 or at is None:
        return np.empty((0, 0, 4, 4)), ratio
    size = count * ratio * bodies * _ROTATION_VALUES * 4
    if at < 0 or at + size > len(data):
        raise ForeignFileError(path, f"it is no whole C3D file: its rotations end at byte {len(data)} of {at + size}")
    values = head.numbers.reals(data[at : at + size]).reshape(-1, bodies, _ROTATION_VALUES).astype(np.float64)
    # The copy makes the swapped matrices contiguous, for the many products that follow.
    matrices = values[:, :, :16].reshape(-1, bodies, 4, 4).swapaxes(2, 3).copy()
    matrices[values[:, :, 16] < 0] = np.nan
    return matrices, ratio


def parts(data: Data, raw: memoryview, size: int) -> Iterator[tuple[int, Frames]]:
    """Yield all frames, `size` at a time, each time with the number of the first, from 0."""
    for first in range(0, data.count, size):
        yield first, data.read(raw, first, min(first + size, data.count))


def _frame_bytes(head: Head) -> int:
    return (4 * head.points + head.analogs) * (4 if head.scale < 0 else 2)


def _rotations_at(head: Head) -> int | None:
    """Return where the rotations stand, in bytes; None if there are none."""
    block = head.first_number("ROTATION", "DATA_START")
    return None if block is None or block == 0 else (int(block) % 65536 - 1) * BLOCK


def _samples(head: Head) -> int:
    """Return how many samples of each channel a frame has."""
    used = head.first_number("ANALOG", "USED")
    if used and used > 0 and head.analogs % int(used) == 0:
        return max(head.analogs // int(used), 1)
    return max(head.samples, 1)


def _stated(head: Head) -> list[int]:
    """Return the counts of frames that a file names."""
    counts: list[float] = []
    first, last = _field(head, "ACTUAL_START_FIELD"), _field(head, "ACTUAL_END_FIELD")
    if first is not None and last is not None:
        counts.append(last - first + 1)
    for name in ("LONG_FRAMES", "FRAMES"):
        value = head.first_number("POINT", name)
        if value is not None:
            # More than 32,767 frames look negative in a signed 16-bit parameter.
            counts.append(value + 65536 if value < 0 else value)
    counts.append(head.last - head.first + 1)
    return [int(count) for count in dict.fromkeys(counts) if count > 0]


def _field(head: Head, name: str) -> int | None:
    """Return a frame's number that stands in two words of 16 bits, the lower first."""
    # Programs store long frame numbers as two signed words, each of which may look negative.
    words = head.array("TRIAL", name)
    if not len(words):
        return None
    low, high = (int(word) % 65536 for word in (*words[:2], 0)[:2])
    return low + 65536 * high


def _padded(values: Floats, count: int, default: float) -> Floats:
    return np.concatenate((values[:count], np.full(max(count - len(values), 0), default)))
