"""A file read through a window that moves on, for whoever walks over its records."""

from __future__ import annotations

from ..errors import DamagedFileError
from ..store.file_source import Source
from .limits import Limits, too_long
from .record_layout import PREFIX_BYTES, Fields

_WINDOW_BYTES = 16 * 1024


class Window:
    """Gives a file's bytes, reading some more than it is asked for. One thread uses it."""

    def __init__(self, source: Source, size: int, limits: Limits) -> None:
        """Begin anywhere.

        Args:
            source: The file.
            size: Where it ends, in bytes; what is appended meanwhile is left alone.
            limits: For what is read at once.
        """
        self.source = source
        self.size = size
        self._limits = limits
        self._data = b""
        self._at = 0

    def bytes(self, at: int, length: int) -> bytes:
        """Return the bytes of [at, at + length).

        Raises:
            DamagedFileError: They are not there any more.
        """
        offset = at - self._at
        if offset < 0 or offset + length > len(self._data):
            self._data = self.source.read(at, min(max(length, _WINDOW_BYTES), self.size - at))
            self._at = at
            offset = 0
            if len(self._data) < length:
                raise DamagedFileError(self.source.name, at, "the file was cut while it was read")
        return self._data[offset : offset + length]

    def content(self, at: int, length: int, *, at_most: int | None = None) -> Fields:
        """Return the content of a record, or only its first bytes.

        Args:
            at: Where the record starts.
            length: Of its content.
            at_most: How many bytes of it are wanted; None for all.

        Raises:
            DamagedFileError: It is beyond the limits.
        """
        if at_most is not None:
            length = min(length, at_most)
        if length > self._limits.record_bytes:
            raise DamagedFileError(self.source.name, at, too_long("a record", length, self._limits))
        start = at + PREFIX_BYTES
        return Fields(self.bytes(start, length), self.source.name, start)
