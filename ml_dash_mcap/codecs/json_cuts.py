"""Finds where the time stamps of many JSON rows begin, all at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .json_merge import TIME_MARK

Bytes = npt.NDArray[np.uint8]
Offsets = npt.NDArray[np.int64]

_TAIL_BYTES = 32
"""A row's last bytes, of which these many are looked at. The head of a Message record and the shortest row have more;
the longest time stamp, `"_ts":1.2345678901234567e-300}`, has less."""

_QUOTE = TIME_MARK[0]


def cuts(data: Bytes, starts: Offsets, ends: Offsets) -> Offsets | None:
    """Return where the key of each row's time stamp begins.

    Args:
        data: The bytes of a block.
        starts: Where in it the rows start, [N].
        ends: Where in it they end, [N].

    Returns:
        Offsets in `data`, [N]; None if the time stamp of a row is not where it is expected.
    """
    if not len(ends) or int(ends.min()) < _TAIL_BYTES:
        return None
    # A view: only the windows that are picked are copied.
    tails = np.lib.stride_tricks.sliding_window_view(data, _TAIL_BYTES)[ends - _TAIL_BYTES]
    # A number has no quotes, so the last quote of a row ends the key of its time stamp.
    from_end = (tails[:, ::-1] == _QUOTE).argmax(axis=1)
    at = ends - from_end - len(TIME_MARK) + 1
    marks = np.lib.stride_tricks.sliding_window_view(data, len(TIME_MARK))[np.minimum(at, len(data) - len(TIME_MARK))]
    are_marks = (marks == np.frombuffer(TIME_MARK, np.uint8)).all() and (at > starts).all()
    return at if are_marks else None
