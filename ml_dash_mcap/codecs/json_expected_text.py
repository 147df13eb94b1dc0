"""The text that rows have when they are like others before, as it is without numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from .json_bones import Offsets

_LOST_BY_NUMBERS = re.compile(rb"[-0-9]|(?<=[0-9])e")


@dataclass(frozen=True, slots=True)
class ExpectedText:
    """The rows of one skeleton, as `Bones.bare` has them: keys are without digits there, and are looked at apart."""

    skeleton: bytes
    form: int
    """Of the rows."""
    bare: bytes
    """A row without numbers, and without digits in any text."""
    whole_at: Offsets
    """Where in `bare` the keys begin that have nothing to lose, with their quotes, [K]."""
    whole_bytes: Offsets
    """How long these are, [K]."""
    cut: tuple[tuple[int, bytes], ...]
    """Where the other keys begin, and their text in rows, with quotes and colon."""

    @classmethod
    def of(cls, skeleton: bytes, form: int) -> ExpectedText | None:
        """Return the text of rows of a skeleton and a form; None if a quote in it may be part of a text."""
        if b"\\" in skeleton:
            return None
        # Between quotes, every second part is a text; a colon follows those that are keys.
        parts = skeleton.split(b'"')
        bare, whole, cut = _bare(parts[0]), [], []
        for text, behind in zip(parts[1::2], parts[2::2], strict=True):
            text_bare = b'"%b"' % _bare(text)
            if behind.startswith(b":"):
                if len(text_bare) == len(text) + 2:
                    whole.append((len(bare), len(text_bare)))
                else:
                    cut.append((len(bare), b'"%b":' % text))
            bare += text_bare + _bare(behind)
        places = np.array(whole, np.int64).reshape(-1, 2)
        return cls(skeleton, form, bare, places[:, 0], places[:, 1], tuple(cut))


def _bare(text: bytes) -> bytes:
    return _LOST_BY_NUMBERS.sub(b"", text)
