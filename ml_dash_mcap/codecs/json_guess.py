"""Tells the forms of many rows at once where all topics go on as they did lately, which is cheap to see."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import cycle

import numpy as np
import numpy.typing as npt

from .json_bones import Bones, Offsets
from .json_expected_text import ExpectedText
from .json_skeleton import Skeletons

_MOST_KINDS = 64
"""Kinds of rows in a block whose keys are looked at kind by kind."""


def guess(
    bones: Bones, channels: npt.NDArray[np.int64], of_channel: Mapping[int, Skeletons]
) -> npt.NDArray[np.int32] | None:
    """Find the form of each row of a block if all topics go on as they did lately.

    Args:
        bones: Of the block.
        channels: The channel id of each row, [N].
        of_channel: The skeletons of each topic.

    Returns:
        The form of each row, [N]: its index in its topic's `forms`. None if some row is not as expected.
    """
    kinds: list[ExpectedText] = []
    turns: dict[int, list[int]] = {}
    numbers = channels.tolist()
    counts = Counter(numbers)
    for number in counts:
        turn = of_channel[number].expected.turn if number in of_channel else []
        if not turn or (bones.has_exponents and any(of_channel[number].forms[text.form].integers for text in turn)):
            return None
        turns[number] = list(range(len(kinds), len(kinds) + len(turn)))
        kinds += turn
    row_kinds = _in_turn(numbers, turns)
    if not _are_as_expected(bones, row_kinds, kinds):
        return None
    for number, count in counts.items():
        of_channel[number].expected.advance(count)
    return np.array([text.form for text in kinds], np.int32)[row_kinds]


def _in_turn(numbers: list[int], turns: Mapping[int, list[int]]) -> npt.NDArray[np.intp]:
    """Return the kind of each row, [N], if the kinds of each channel come in turn."""
    if len(turns) == 1:
        return np.arange(len(numbers)) % len(turns[numbers[0]])
    iterators = {number: cycle(turn) for number, turn in turns.items()}
    return np.array([next(iterators[number]) for number in numbers], np.intp)


def _are_as_expected(bones: Bones, row_kinds: npt.NDArray[np.intp], kinds: list[ExpectedText]) -> bool:
    """Whether the rows of a block are of these kinds.

    Args:
        bones: Of the block.
        row_kinds: The kind of each row, as a number in `kinds`, [N].
        kinds: The texts of rows.
    """
    # To look at the keys of each kind by itself takes longer than to spare the keys in the whole block.
    are_many = len(kinds) > _MOST_KINDS
    block, texts = (
        (bones.kept, [kind.skeleton for kind in kinds]) if are_many else (bones.bare, [kind.bare for kind in kinds])
    )
    lengths = np.array(list(map(len, texts)))[row_kinds]
    if int(lengths.sum()) != len(block):
        return False  # so that no more is joined than the block holds
    if b"".join([texts[kind] for kind in row_kinds.tolist()]) != block.tobytes():
        return False
    starts = np.cumsum(lengths) - lengths
    if are_many or len(kinds) == 1:
        return are_many or _have_keys(bones, starts, kinds[0])
    return all(_have_keys(bones, starts[row_kinds == number], kind) for number, kind in enumerate(kinds))


def _have_keys(bones: Bones, starts: Offsets, kind: ExpectedText) -> bool:
    """Whether rows that have the bare text of a kind have its keys, too.

    Args:
        bones: Of the block.
        starts: Where the rows start in `bones.bare`, [N].
        kind: Of these rows.
    """
    if not bones.are_whole(starts[:, None] + kind.whole_at, kind.whole_bytes):
        return False
    return all(bones.are_texts(starts + at, text) for at, text in kind.cut)
