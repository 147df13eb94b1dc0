"""Writes a file whose layout must be known before its first row: in one pass over the rows, or in two.

The layout is guessed from the topic's schema and its first block. If a later block does not fit, the rest of the
rows is only looked at, and all are written again, by the layout that suits all of them. Memory holds a block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from ...rows.table import Block


class GrowingLayout(Protocol):
    """A layout that is made of the blocks that were added to it."""

    def holds(self, block: Block) -> bool:
        """Whether a block can be written as it is laid out now."""

    def add(self, block: Block) -> None:
        """Widen it, so that it holds a block too."""


def write(
    read: Callable[[], Iterator[Block]],
    layout: GrowingLayout,
    begin: Callable[[], AbstractContextManager[Callable[[Block], None]]],
    count: Callable[[int], None],
) -> None:
    """Write blocks.

    Args:
        read: Begins to read them, anew each time.
        layout: Of what is known before; it is widened.
        begin: Begins to write by the layout as it is then, over what was written before; gives what takes a block.
        count: Told how many rows more are done; rows that are written again do not count again.
    """
    most = 0
    blocks = read()
    block = next(blocks, None)
    if block is not None:
        layout.add(block)
    while True:
        done, fits = 0, True
        with begin() as put:
            while block is not None:
                # After the first block that does not fit, the rest is only looked at, so that a second pass always
                # fits.
                fits = fits and layout.holds(block)
                if fits:
                    put(block)
                    done += block.count
                    count(max(0, done - most))
                    most = max(most, done)
                else:
                    layout.add(block)
                block = next(blocks, None)
        if fits:
            return
        blocks = read()
        block = next(blocks, None)
