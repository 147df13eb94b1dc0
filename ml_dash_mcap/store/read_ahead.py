"""Work that threads do a little ahead of the caller who asks for its results."""

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
"""How many items each worker holds: one that it has finished, and one that it works on."""

_MOST_BYTES = 128 * 1024 * 1024
"""All items that are worked on or wait for the caller take no more memory than this, unless it is a single item."""


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], *, weigh: Callable[[Item], int] | None = None
) -> Iterator[Result]:
    """Yield `work(item)` for each item, in their order, while threads work on the next few.

    An exception of a call is raised in the place of its result. A single item is worked on by the caller's thread.

    Args:
        work: Called on several threads. It should release the interpreter's lock for most of its time, and must not
            call this function, because all threads could then wait for each other.
        items: Iterated over on the caller's thread, a few items ahead.
        weigh: Returns how much memory an item takes while it is worked on, in bytes; None if that is little.
    """
    items = iter(items)
    first = list(islice(items, 2))
    # A single item gains nothing from a thread, and most windows of a recording are one.
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
"""The threads stay, because starting them takes longer than reading a window."""


def _pool() -> ThreadPoolExecutor:
    global _shared
    if _shared is None:
        _shared = ThreadPoolExecutor(_WORKERS, "ml_dash_mcap reader")
    return _shared


def _forget() -> None:
    """Start threads anew in a forked child, which has none of its parent's."""
    global _shared
    _shared = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
