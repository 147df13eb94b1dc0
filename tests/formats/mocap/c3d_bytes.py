"""C3D files built by hand, byte by byte, as c3d.org's user guide lays them out."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

BLOCK = 512


def parameter(number: int, name: str, value: Any, order: str = "<") -> bytes:
    """Spell one parameter of a group: text, a list of text, whole numbers, or reals."""
    if isinstance(value, str):
        value = [value]
        dims, data, kind = [len(value[0])], value[0].encode("latin-1"), -1
    elif value and isinstance(value[0], str):
        width = max(len(one.encode()) for one in value)
        dims, kind = [width, len(value)], -1
        data = b"".join(one.encode().ljust(width) for one in value)
    elif value and isinstance(value[0], int):
        dims, data, kind = [len(value)], struct.pack(f"{order}{len(value)}h", *value), 2
    else:
        dims, data, kind = [len(value)], struct.pack(f"{order}{len(value)}f", *value), 4
    body = struct.pack("bB", kind, len(dims)) + bytes(dims) + data + b"\0"
    spelt = name.encode()
    return struct.pack("bb", len(spelt), number) + spelt + struct.pack(f"{order}h", len(body) + 2) + body


def group(number: int, name: str, order: str = "<") -> bytes:
    """Spell a group."""
    return struct.pack("bb", len(name), -number) + name.encode() + struct.pack(f"{order}h", 3) + b"\0"


def build(
    frames: Sequence[bytes],
    parameters: Mapping[str, Mapping[str, Any]],
    *,
    points: int,
    analogs: int = 0,
    samples: int = 0,
    first: int = 1,
    last: int | None = None,
    scale: float = -1.0,
    rate: float = 100.0,
    processor: int = 84,
) -> bytes:
    """Return a file of frames that are spelt already."""
    order = ">" if processor == 86 else "<"
    said = b""
    for number, (name, some) in enumerate(parameters.items(), 1):
        said += group(number, name, order)
        said += b"".join(parameter(number, key, value, order) for key, value in some.items())
    said += b"\0\0"
    blocks = (4 + len(said) + BLOCK - 1) // BLOCK
    section = (bytes((1, 0x50, blocks, processor)) + said).ljust(blocks * BLOCK, b"\0")
    last = first + len(frames) - 1 if last is None else last
    words = struct.pack(f"{order}5H", points, analogs, first & 65535, last & 65535, 10)
    head = bytes((2, 0x50)) + words + struct.pack(f"{order}f", scale)
    head += struct.pack(f"{order}2H", 2 + blocks, samples) + struct.pack(f"{order}f", rate)
    data = b"".join(frames)
    return head.ljust(BLOCK, b"\0") + section + data + b"\0" * (-len(data) % BLOCK)


def frame(points: Sequence[Sequence[float]], analogs: Sequence[float] = (), order: str = "<") -> bytes:
    """Spell a frame of reals; each point has x, y, z and a residual."""
    values = [one for point in points for one in point]
    return struct.pack(f"{order}{len(values) + len(analogs)}f", *values, *analogs)
