"""Work done a little ahead of who asks for it, on all cores."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_WORKERS = min(os.cpu_count() or 1, 8)
_AHEAD = 2
"""How many results wait for each worker: one it has finished and one it works on."""

_MOST_BYTES = 128 * 1024 * 1024
"""What is worked on, or waits for who asked for it, weighs no more than this, or is one item."""


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], *, weigh: Callable[[Item], int] | None = None
) -> Iterator[Result]:
    """Yield `work(item)` for each item, in their order, while threads work on the next few.

    What a call raises comes out in its place. One item alone is worked on by the caller.

    Args:
        work: Lets other threads run for most of its time; called on several threads, and calls nothing of this module.
        items: Taken on the caller's thread, a few ahead.
        weigh: Returns how much memory an item takes while it is worked on, in bytes; None if that is little.
    """
    items = iter(items)
    first = list(islice(items, 2))
    if len(first) < 2 or _WORKERS < 2:
        yield from map(work, chain(first, items))
        return
    pool = _pool()
    waiting: deque[tuple[Future[Result], int]] = deque()
    held = 0
    try:
        for item in chain(first, items):
            weight = 0 if weigh is None else weigh(item)
            while waiting and (len(waiting) >= _AHEAD * _WORKERS or held + weight > _MOST_BYTES):
                held -= waiting[0][1]
                yield waiting.popleft()[0].result()
            waiting.append((pool.submit(work, item), weight))
            held += weight
        while waiting:
            yield waiting.popleft()[0].result()
    finally:
        for future, _ in waiting:
            future.cancel()


_shared: ThreadPoolExecutor | None = None
"""Threads take longer to start than a window takes to read, so they stay."""


def _pool() -> ThreadPoolExecutor:
    global _shared
    if _shared is None:
        _shared = ThreadPoolExecutor(_WORKERS, "ml_dash_mcap reader")
    return _shared


def _forget() -> None:
    """A forked child has none of the threads."""
    global _shared
    _shared = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
