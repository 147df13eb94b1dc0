"""The operating system's calls on a recording's files, counted, so that a test can make any one of them fail."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Plan = Callable[[int, str, Callable[[], Any]], Any]
"""Called in the place of a call with its number (from 1), its name and what does it; returns the call's result."""

BY_DESCRIPTOR = ("write", "writev", "pwrite", "fdatasync", "fsync", "ftruncate")
BY_PATH = ("open", "rename", "unlink")


class Calls:
    """The calls on the files in some folders so far."""

    def __init__(self, folder: Path) -> None:
        self.folder = os.path.realpath(folder)
        self.count = 0
        self.names: list[str] = []
        self.lock = threading.Lock()

    def concern(self, target: int | str | Path) -> bool:
        """Whether a descriptor or a path is a segment of the recording, or its folder."""
        if isinstance(target, int):
            try:
                target = os.readlink(f"/proc/self/fd/{target}")
            except OSError:
                return False
        path = os.fspath(target)
        return path.startswith(self.folder) and (".mcap" in path or path == self.folder)

    def next(self, name: str) -> int:
        """Number a call."""
        with self.lock:
            self.count += 1
            self.names.append(name)
            return self.count


@contextmanager
def calls_go_through(folder: Path, plan: Plan) -> Iterator[Calls]:
    """Let a plan decide what becomes of each call on a segment in a folder."""
    calls = Calls(folder)
    originals = {name: getattr(os, name) for name in (*BY_DESCRIPTOR, *BY_PATH) if hasattr(os, name)}

    def wrapped(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def call(target: Any, *args: Any, **kwargs: Any) -> Any:
            if not calls.concern(target):
                return original(target, *args, **kwargs)
            number = calls.next(name)
            call.half = lambda: half(originals, name, target, args)  # type: ignore[attr-defined]
            return plan(number, name, lambda: original(target, *args, **kwargs))

        return call

    for name, original in originals.items():
        setattr(os, name, wrapped(name, original))
    try:
        yield calls
    finally:
        for name, original in originals.items():
            setattr(os, name, original)


def half(originals: dict[str, Callable[..., Any]], name: str, target: Any, args: tuple[Any, ...]) -> None:
    """Do the first half of a write, as a disk does that fills up in the middle of it."""
    if name in ("write", "writev"):
        data = b"".join(bytes(piece) for piece in ([args[0]] if name == "write" else args[0]))
        originals["write"](target, data[: len(data) // 2])
    elif name == "pwrite":
        originals["pwrite"](target, bytes(args[0])[: len(args[0]) // 2], *args[1:])


def fails(which: Callable[[int, str], bool], errno: int, *, halfway: bool = False) -> Plan:
    """Make the calls that `which` picks fail with an error, a write after its first half if `halfway`."""

    def plan(number: int, name: str, call: Callable[[], Any]) -> Any:
        if not which(number, name):
            return call()
        if halfway:
            getattr(os, name).half()
        raise OSError(errno, os.strerror(errno))

    return plan


def dies_at(number: int, *, before: bool) -> Plan:
    """Kill this process with SIGKILL at a call: before it is done (a write: when half of it is), or right after it."""

    def plan(current: int, name: str, call: Callable[[], Any]) -> Any:
        if current != number:
            return call()
        if before:
            getattr(os, name).half()
        else:
            call()
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError("unreachable")

    return plan
