"""Signal handlers and finalizers, at every point where Python can run one, one after the other instead of by luck.

CPython runs signal handlers when a function begins and when a call of a C function has returned. A profile function is
called at the same points, so it can stand for the handler: at the first such point, then at the second, and so on.
"""

from __future__ import annotations

import ctypes
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any


def _is_interesting(file: str) -> bool:
    """Whether code is the library's, some of which is compiled for rows, or that of the locks and events that it uses."""
    return "ml_dash_mcap" in file or file in (threading.__file__, "<compiled row>")


class Interruption:
    """Runs a handler at one of the points inside the library that a call of it passes."""

    def __init__(self, number: int, handler: Callable[[], object]) -> None:
        self.number = number
        self.passed = 0
        self.where = "nowhere"
        self._handler = handler

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        if event not in ("call", "c_return") or not _is_interesting(frame.f_code.co_filename):
            return
        if frame.f_code.co_name == "<genexpr>":  # closing one calls it too, and what is raised there goes nowhere
            return
        self.passed += 1
        if self.passed == self.number:
            name = getattr(argument, "__name__", "") if event == "c_return" else "its beginning"
            self.where = f"{frame.f_code.co_name}:{frame.f_lineno} after {name}"
            sys.setprofile(None)
            try:
                self._handler()
            finally:
                sys.setprofile(self)


def at_every_point(
    action: Callable[[], object], handler: Callable[[], object], *, first: int = 1
) -> Iterator[Interruption]:
    """Run an action again and again, a handler interrupting it one point later each time, until it ends before that.

    Args:
        action: Called on this thread; other threads go on undisturbed.
        handler: Called inside it, once.
        first: Number of the first point.
    """
    number = first
    while True:
        interruption = Interruption(number, handler)
        sys.setprofile(interruption)
        try:
            action()
        finally:
            sys.setprofile(None)
        if interruption.where == "nowhere":
            return
        yield interruption
        number += 1


def within(seconds: float, action: Callable[[], object], on_hang: Callable[[], object]) -> None:
    """Run an action on a thread of its own; one that hangs is an error with its traceback, and is left behind.

    Args:
        seconds: How long it may take.
        action: What to run.
        on_hang: Called if it hangs, so that the end of the process does not wait for it.
    """
    errors: list[BaseException] = []

    def run() -> None:
        try:
            action()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    if thread.is_alive():
        on_hang()
        frame = sys._current_frames().get(thread.ident or 0)
        hanging = "".join(traceback.format_stack(frame))
        ident = ctypes.c_ulong(thread.ident or 0)  # one that waits in a loop would slow down all the tests after this
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ident, ctypes.py_object(SystemExit))
        raise AssertionError(f"it hangs:\n{hanging}")
    if errors:
        raise errors[0]
