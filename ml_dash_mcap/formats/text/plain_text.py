"""Opens text files as UTF-8 with line feeds at the ends of lines, whatever encoding their tool wrote."""

from __future__ import annotations

import codecs
import contextlib
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, BinaryIO, cast

_SNIFFED_BYTES = 1 << 16
_PIECE_BYTES = 1 << 20
_IN_MEMORY_BYTES = 1 << 23
_EXCEL = re.compile(r'"?sep=.{0,2}"?[\t,;]*', re.IGNORECASE)
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def first_line_of(data: bytes) -> str:
    """Return the first line that is not blank of what a file begins with, without a byte order mark."""
    text = data.decode("utf-16", "replace") if data.startswith(_UTF_16) else decoded(data)
    lines = re.split(r"[\r\n]+", text.lstrip("\ufeff"))
    return next((line for line in lines if not is_filler(line)), "")


def is_filler(line: str) -> bool:
    """Whether a line before the header has no content: only blanks, separators, or the word that tells Excel which."""
    return not line.strip(' \t\r\n,;"') or _EXCEL.fullmatch(line.strip()) is not None


@contextlib.contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a text file; one in UTF-16, or with the ends of lines of old Macs, is copied first.

    The copy has the same lines, and is in memory unless it is large.
    """
    with path.open("rb") as file:
        start = file.read(_SNIFFED_BYTES)
        file.seek(0)
        is_wide, is_old = start.startswith(_UTF_16), b"\r" in start and b"\n" not in start
        if not is_wide and not is_old:
            yield cast(BinaryIO, file)
            return
        with tempfile.SpooledTemporaryFile(_IN_MEMORY_BYTES) as copy:
            _copy(cast(BinaryIO, file), cast("IO[bytes]", copy), is_wide=is_wide)
            copy.seek(0)
            yield cast(BinaryIO, copy)


def decoded(raw: bytes) -> str:
    """Return text in UTF-8, or in what Windows' tools wrote before they wrote that."""
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _copy(file: BinaryIO, copy: IO[bytes], *, is_wide: bool) -> None:
    decode = codecs.getincrementaldecoder("utf-16")("replace")
    has_line_feeds = False
    while piece := file.read(_PIECE_BYTES):
        if is_wide:
            piece = decode.decode(piece).encode("utf-8", "replace")
        # Only files without any line feed have the ends of lines of old Macs; in others "\r" belongs to "\r\n".
        has_line_feeds = has_line_feeds or b"\n" in piece[:_SNIFFED_BYTES]
        copy.write(piece if has_line_feeds else piece.replace(b"\r", b"\n"))
