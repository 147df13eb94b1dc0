"""Shows the progress of a command on the standard error, if that is a terminal."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from .output import is_rich

Report = Callable[[int, int], object]


@contextlib.contextmanager
def shown(what: str) -> Iterator[Report | None]:
    """Give a function that takes the rows done and the rows in all; None without a terminal.

    Args:
        what: The task, as it is shown.
    """
    if not sys.stderr.isatty():
        yield None
    elif is_rich(sys.stderr):
        yield from _bar(what)
    else:
        yield _Percent(what)
        print(file=sys.stderr)


class _Percent:
    def __init__(self, what: str) -> None:
        self._what = what
        self._said = -1

    def __call__(self, done: int, total: int) -> None:
        percent = 100 * done // total if total else 100
        if percent != self._said:
            self._said = percent
            print(f"\r{self._what}: {percent} %", end="", file=sys.stderr, flush=True)


def _bar(what: str) -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
