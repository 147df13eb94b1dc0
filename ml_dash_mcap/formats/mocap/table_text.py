"""Spells matrices of numbers as the text of tables, with the fewest digits that give the same numbers back."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, repeat

import numpy as np
import numpy.typing as npt
import orjson

Floats = npt.NDArray[np.float64]


class TableText:
    """Spells rows of one table.

    With no limit of decimals, and in metres, a C encoder spells a whole matrix in one call. A shift of the decimal
    point is done in the text, so that millimetres say exactly what the metres were.
    """

    def __init__(
        self,
        *,
        separator: str = ",",
        missing: str = "",
        end: str = "\r\n",
        decimals: int | None = None,
        time_decimals: int | None = None,
    ) -> None:
        """Set how rows look.

        Args:
            separator: Between cells.
            missing: What stands for a number that is missing.
            end: Of a row.
            decimals: Of each number; None for as many as it needs to come back the same.
            time_decimals: The same of times, if `decimals` is given.
        """
        self._separator = separator.encode()
        self._missing = missing.encode()
        self._end = end.encode()
        self._decimals = decimals
        self._time_decimals = decimals if time_decimals is None else time_decimals

    def rows(self, heads: Sequence[bytes], values: Floats, shifts: Sequence[int] | None = None) -> bytes:
        """Spell rows.

        Args:
            heads: What each row begins with, such as its frame and time, without a separator behind it.
            values: [N, C]; NaN where one is missing.
            shifts: By how many places the decimal point of each column moves to the right, [C].
        """
        if not len(heads):
            return b""
        if not values.shape[1]:
            return self._end.join([*heads, b""])
        if self._decimals is not None:
            lines = self._fixed(values, shifts)
        elif shifts is not None and any(shifts):
            lines = self._shifted(values, shifts)
        else:
            lines = self._plain(values)
        parts = zip(heads, repeat(self._separator, len(heads)), lines, repeat(self._end, len(heads)), strict=True)
        return b"".join(chain.from_iterable(parts))

    def heads(self, frames: npt.NDArray[np.int64], times: Floats, *more: str) -> list[bytes]:
        """Spell the frame and the time of each row, and what all rows have behind them."""
        behind = [repeat(text.encode(), len(frames)) for text in more]
        return list(map(self._separator.join, zip(numbers(frames), self.times(times), *behind, strict=True)))

    def times(self, times: Floats) -> list[bytes]:
        """Spell the time of each row."""
        if self._decimals is None:
            return numbers(times)
        return [f"{time:.{self._time_decimals}f}".encode() for time in times.tolist()]

    def _plain(self, values: Floats) -> list[bytes]:
        # orjson writes the shortest spelling of each double and NaN as null, a whole matrix in one call.
        text, border = orjson.dumps(np.ascontiguousarray(values), option=orjson.OPT_SERIALIZE_NUMPY), b"],["
        if self._separator != b",":
            # Only numbers, commas and brackets are in the text, so every comma separates cells.
            table = bytes.maketrans(b",", self._separator)
            text, border = text.translate(table), border.translate(table)
        rows = text.split(border)
        rows[0] = rows[0].removeprefix(b"[[")
        rows[-1] = rows[-1].removesuffix(b"]]")
        for at in np.flatnonzero(np.isnan(values).any(axis=1)).tolist():
            rows[at] = rows[at].replace(b"null", self._missing)
        return rows

    def _fixed(self, values: Floats, shifts: Sequence[int] | None) -> list[bytes]:
        scaled = values if shifts is None else values * 10.0 ** np.asarray(shifts)
        line = self._separator.decode().join([f"%.{self._decimals}f"] * values.shape[1])
        missing = self._missing
        lines = [(line % tuple(row)).encode() for row in scaled.tolist()]
        return lines if missing == b"nan" else [row.replace(b"nan", missing) for row in lines]

    def _shifted(self, values: Floats, shifts: Sequence[int]) -> list[bytes]:
        missing = self._missing.decode()
        join = self._separator.decode().join
        return [
            join(
                [missing if number != number else shifted(number, by) for number, by in zip(row, shifts, strict=True)]
            ).encode()
            for row in values.tolist()
        ]


def numbers(values: Floats | npt.NDArray[np.int64]) -> list[bytes]:
    """Spell numbers one by one, [N]; none may be missing."""
    if not len(values):
        return []
    return orjson.dumps(np.ascontiguousarray(values), option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].split(b",")


def shifted(value: float, places: int) -> str:
    """Spell a finite number with its decimal point so many places to the right; exact.

    Example:
        >>> shifted(0.391888, 3), shifted(-1.5e-7, 3), shifted(2.0, 3)
        ('391.888', '-0.00015', '2000.0')
    """
    if not places:
        return repr(value)
    sign = "-" if value < 0 else ""
    mantissa, _, exponent = repr(abs(value)).partition("e")
    whole, _, fraction = mantissa.partition(".")
    digits = whole + fraction
    point = len(whole) + int(exponent or 0) + places
    # Very small and very large numbers keep an exponent instead of a long row of zeros.
    if not -20 < point < 40:
        return f"{sign}{mantissa}e{int(exponent or 0) + places}"
    if point <= 0:
        text = "0." + "0" * -point + digits
    else:
        digits = digits.ljust(point, "0")
        text = f"{digits[:point].lstrip('0') or '0'}.{digits[point:] or '0'}"
    return sign + (text.rstrip("0") + "0" if text.endswith("0") else text)
