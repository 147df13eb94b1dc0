"""Tests whose judge is not on this machine, which are left out rather than skipped one by one.

A judge is a module of this folder: recordings of other tools beside the repository, ROS's own code, Node.js. A test needs
one if it, or a function or fixture that it uses, names that module.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from types import CodeType, FunctionType, ModuleType
from typing import Any

import pytest

from . import node_program, rerun_reader, shared, system_python

JUDGES: Sequence[tuple[ModuleType, Callable[[], bool], str]] = (
    (shared, shared.is_here, "recordings of other tools in ../shared/data"),
    (system_python, system_python.is_here, "ROS's own code, Debian's python3-rosbag and python3-rosidl"),
    (node_program, node_program.is_here, "Node.js, in which viewers' readers run"),
    (rerun_reader, rerun_reader.is_here, "Rerun, which has wheels from Python 3.11 on"),
)
"""Modules that hold judges, whether the judge is here, and what it is."""


def judges() -> dict[str, str]:
    """Return the judges that are not here: the names of their modules, and what they are."""
    return {module.__name__: what for module, is_here, what in JUDGES if not is_here()}


def needs(item: pytest.Item) -> set[str]:
    """Return the names of the judges' modules that a test needs."""
    known = {module.__name__ for module, _, _ in JUDGES}
    fixtures = getattr(item, "_fixtureinfo", None)
    functions = [getattr(item, "function", None)]
    functions += [one.func for found in (fixtures.name2fixturedefs.values() if fixtures else ()) for one in found]
    seen: set[Any] = set()
    return {module for function in functions for module in _modules(function, seen)} & known


def _modules(function: Any, seen: set[Any]) -> Iterator[str]:
    """Yield the names of the modules that a function names, and those that the functions of the tests do that it calls."""
    inner = getattr(getattr(function, "hypothesis", None), "inner_test", function)
    plain = inspect.unwrap(inner) if callable(inner) else None
    if not isinstance(plain, FunctionType) or plain in seen:
        return
    seen.add(plain)
    for name in _names(plain.__code__):
        value = plain.__globals__.get(name)
        if isinstance(value, ModuleType):
            yield value.__name__
        elif isinstance(value, FunctionType):
            yield value.__module__
            if value.__module__.startswith("tests."):
                yield from _modules(value, seen)


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)
