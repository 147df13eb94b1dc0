"""Finds where the time stamps of many protobuf rows begin, all at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .row_encoder import TIME_BYTES, TIME_TAG

Offsets = npt.NDArray[np.int64]


def cuts(data: npt.NDArray[np.uint8], starts: Offsets, ends: Offsets) -> Offsets | None:
    """Return where the tag of each row's time stamp begins.

    Args:
        data: The bytes of a block.
        starts: Where in it the rows start, [N].
        ends: Where in it they end, [N].

    Returns:
        Offsets in `data`, [N]; None if a row does not end with its time stamp.
    """
    at = ends - TIME_BYTES
    if (at < starts).any():
        return None
    tags = data[at[:, None] + np.arange(len(TIME_TAG))]
    return at if (tags == np.frombuffer(TIME_TAG, np.uint8)).all() else None
