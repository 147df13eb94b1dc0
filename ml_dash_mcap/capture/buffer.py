"""One buffer of the journal: rows in shared memory, laid out as an MCAP file without an end.

It holds magic, header, a metadata record with the session and the number of the block, schemas, channels, and then
messages. A record becomes valid with its first byte, which is written last. The byte after the last record is 0, with
which no MCAP record begins. So neither a half-written record nor a record of an earlier use is ever read.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import time
from pathlib import Path

import numpy as np

from ..mcap.row_arrays import SealedBuffer


class Buffer:
    """Appending threads fill a buffer under the journal's lock. Once it is sealed, only the writer thread uses it."""

    __slots__ = (
        "begun_s",
        "end",
        "gaps",
        "has_extras",
        "is_large",
        "is_sealed",
        "limit",
        "map",
        "path",
        "prologue",
        "size",
        "starts",
        "uniform",
    )

    def __init__(self, path: Path | None, size: int, *, is_large: bool = False) -> None:
        """Reserve a buffer.

        Args:
            path: Its file, which must not be there yet; None makes a buffer that takes nothing.
            size: In bytes.
            is_large: Whether the buffer is made for a single row, and discarded with that row.

        Raises:
            OSError: There is no room for it.
        """
        self.path = path
        self.size = size
        self.is_large = is_large
        self.limit = size - 1 if path is not None else -1
        """The last offset that a record may end at; the byte there stays 0. Below 0: nothing is taken."""
        self.is_sealed = False
        """Whether a large buffer has been handed to the writer."""
        self.begun_s = 0.0
        """When its first row could come, by the monotonic clock."""
        self.end = 0
        """Where the next record goes."""
        self.prologue = 0
        """Where the first record after the prologue went."""
        self.starts: list[int] = []
        """Where each Message record starts."""
        self.gaps: list[tuple[int, int, bool]] = []
        """Start and end of every record that is not a Message, and whether it is a Metadata record."""
        self.has_extras = False
        """Whether one of the gaps is a Metadata record."""
        self.uniform: list[tuple[int, int]] = []
        """Runs of `starts`, by the first index and the index after the last, whose rows are all of one form."""
        # mmap refuses a length of 0, so a buffer that takes nothing has a page, too.
        self.map = mmap.mmap(-1, mmap.PAGESIZE) if path is None else _reserve(path, size)

    def begin(self, prologue: bytes) -> None:
        """Make an empty buffer the start of an MCAP file."""
        # The first byte of the magic goes last: a recovery passes over a buffer that does not begin with the magic.
        self.begun_s = time.monotonic()
        self.map[1 : len(prologue)] = prologue[1:]
        self.map[0] = prologue[0]
        self.end = self.prologue = len(prologue)

    def fill(self, prologue: bytes, record: bytes) -> None:
        """Put its single row into a large buffer. If that was interrupted, call it again."""
        self.starts.clear()
        self.begin(prologue)
        start, self.end = self.end, self.end + len(record)
        self.map[start + 1 : self.end] = record[1:]
        self.map[start] = record[0]
        self.starts.append(start)

    def clear(self) -> None:
        """Empty the buffer for its next use: first make it invalid, then set all its bytes to 0."""
        self.map[0] = 0
        np.frombuffer(self.map, np.uint8)[: self.end] = 0  # lets other threads run, unlike a slice of the map
        self.end = self.prologue = 0
        self.starts = []
        self.gaps = []
        self.has_extras = False
        self.uniform = []

    def block(self) -> SealedBuffer:
        """Return the records in it, as views of its memory: the memory must stay as long as they are used."""
        return SealedBuffer(
            np.frombuffer(self.map, np.uint8),
            self.prologue,
            self.end,
            self.starts,
            [(start, end) for start, end, _ in self.gaps],
            [(start, end) for start, end, is_extra in self.gaps if is_extra],
            self.uniform,
        )

    def discard(self) -> None:
        """Delete its file and give its memory back."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)
        with contextlib.suppress(BufferError):  # a view of it is in use; the memory goes with the view
            self.map.close()


def _reserve(path: Path, size: int) -> mmap.mmap:
    """Make a file whose every byte has its place in memory or on disk, so that writing to it cannot fail later."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), 0o600)
    try:
        if hasattr(os, "posix_fallocate"):
            # Not ftruncate: with a hole, shared memory that runs out later is a SIGBUS, which kills the process.
            os.posix_fallocate(descriptor, 0, size)
        else:
            # macOS and Windows: bytes that are written have their place, too.
            os.write(descriptor, bytes(size))
        # MAP_POPULATE maps all pages now, so that no append waits for a page fault. Windows has neither flag.
        flags = getattr(mmap, "MAP_SHARED", 0) | getattr(mmap, "MAP_POPULATE", 0)
        return mmap.mmap(descriptor, size, flags=flags) if flags else mmap.mmap(descriptor, size)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)
