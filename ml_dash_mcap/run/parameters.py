"""Parameters of a run: nested values under dotted names, merged call by call."""

from __future__ import annotations

import reprlib
import threading
from argparse import Namespace
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import fields, is_dataclass
from itertools import islice
from types import SimpleNamespace
from typing import Any

import orjson

from ..errors import FieldError, UsageError
from ..file_names import PARAMETERS_RECORD
from ..recorder import Recorder
from ..rows import json_text
from .readback import Readback

_SHOWN = 10
"""So many parameters are shown at a glance."""


class Parameters:
    """Sets and gets the parameters of a run; any thread may call it.

    Example:
        >>> exp.params.set(model={"lr": 1e-3, "layers": 4}, optimizer="adam")
        >>> exp.params.get()
        {'model.lr': 0.001, 'model.layers': 4, 'optimizer': 'adam'}
    """

    __slots__ = ("_earlier", "_merge_lock", "_readback", "_recorder", "_values")

    def __init__(self, recorder: Recorder, readback: Readback) -> None:
        """Make the parameters of a run.

        Args:
            recorder: Where they are kept.
            readback: Where those of earlier runs are read.
        """
        self._recorder = recorder
        self._readback = readback
        self._merge_lock = threading.Lock()
        """Guards the values, and keeps them in the order of the records in the file."""
        self._values: dict[str, Any] = {}
        self._earlier: dict[str, Any] | None = None
        """Those of earlier runs, once they were asked for."""

    def __repr__(self) -> str:
        """Show those that were set in this run; `get` has those of earlier runs, too."""
        values = dict(self._values)
        shown = [f"{name}={reprlib.repr(value)}" for name, value in islice(values.items(), _SHOWN)]
        more = [f"and {len(values) - _SHOWN} more"] if len(values) > _SHOWN else []
        return f"<Parameters: {', '.join([*shown, *more]) or 'none yet'}>"

    def set(self, values: Any = None, /, **more: Any) -> Parameters:
        """Set parameters, and leave those that are not named as they are.

        Nested dicts, dataclasses, namespaces and classes (their public attributes) are flattened to dotted names; numpy
        values, tuples and the like become plain ones.

        Args:
            values: A dict of them, or a dataclass or `argparse.Namespace` that holds them.
            **more: Parameters by name; they win over those of `values`.

        Raises:
            FieldError: A value cannot be stored, or two have one name.
            UsageError: `values` is nothing that holds parameters.
            StateError: The recording is closed.

        Example:
            >>> exp.params.set({"lr": 1e-3, "model": {"layers": 4}}, seed=7)
        """
        held = {} if values is None else _fields(values)
        if held is None:
            raise UsageError(f"params.set({values!r}): pass a dict, or values by name as in params.set(lr=1e-3)")
        flat = {**flatten(held), **flatten(more)}
        with self._merge_lock:
            # The recorder comes first: it refuses a value that cannot be stored, and then no value is changed.
            self._recorder.set_parameters(flat)
            self._values.update({name: _as_stored(name, value) for name, value in flat.items()})
        return self

    def log(self, values: Any = None, /, **more: Any) -> Parameters:
        """Set parameters: another name of `set`."""
        return self.set(values, **more)

    def get(self, flatten: bool = True) -> dict[str, Any]:
        """Return all parameters, those of earlier runs under the same prefix included.

        Args:
            flatten: Whether to leave them under their dotted names; False gives nested dicts.

        Raises:
            DamagedFileError: A file of an earlier run is damaged.
            StateError: The recording is closed.
        """
        self._readback.check_open()
        with self._merge_lock:
            if self._earlier is None:
                self._earlier = self._readback.earlier_parameters()
            # A caller may change what it gets; the stored values must stay.
            values = deepcopy({**self._earlier, **self._values})
        return values if flatten else nest(values)


def flatten(values: Mapping[Any, Any], parent: str = "") -> dict[str, Any]:
    """Return nested values under dotted names; an empty dict stays a value.

    Raises:
        FieldError: Two of them have one name, as in `{1: "a", "1": "b"}`.
    """
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{parent}{key}"
        inner = _fields(value)
        below = flatten(inner, f"{name}.") if inner else {name: value if inner is None else {}}
        for shared in below.keys() & flat.keys():
            raise FieldError(f"two parameters are called {shared!r}; rename one of them")
        flat.update(below)
    return flat


def nest(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Undo `flatten`; a name that lies inside another one's plain value stays dotted."""
    nested: dict[str, Any] = {}
    # Short names first, so that a plain value is in place before names inside it are met.
    for name in sorted(flat, key=lambda name: name.count(".")):
        *parents, last = name.split(".")
        place: Any = nested
        for parent in parents:
            place = place.setdefault(parent, {}) if isinstance(place, dict) else None
        if isinstance(place, dict):
            place[last] = flat[name]
        else:
            nested[name] = flat[name]
    return nested


def _as_stored(name: str, value: Any) -> Any:
    """Return a value as it comes back from the file: a copy, made of plain types."""
    return json_text.restore(orjson.loads(json_text.exact({name: value}, PARAMETERS_RECORD, packs=False)))[name]


def _fields(value: Any) -> dict[str, Any] | None:
    """Return what a value consists of that has dotted names of its own, or None if it is a plain one."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, type):
        return {k: v for k, v in vars(value).items() if not k.startswith("_") and not callable(v)}
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, (SimpleNamespace, Namespace)):
        return dict(vars(value))
    return None
