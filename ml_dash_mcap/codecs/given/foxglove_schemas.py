"""Finds Foxglove's protobuf schemas by name, in the package foxglove-schemas-protobuf."""

from __future__ import annotations

import functools
import importlib
import pkgutil
from typing import Any

from ...errors import OptionError
from ...suggestions import hint

_PACKAGE = "foxglove_schemas_protobuf"
_PREFIX = "foxglove."
_SUFFIX = "_pb2"


def descriptor(name: str) -> Any:
    """Return the descriptor of a message.

    Args:
        name: Such as "foxglove.PoseInFrame".

    Raises:
        OptionError: There is no such message, or the package is not installed.
    """
    existing = names()
    if name not in existing:
        raise OptionError(
            f"schema={name!r}: no schema has that name; {hint(name, existing)} A schema of your own is passed as its"
            " protobuf class, or as a JSON Schema in a dict"
        )
    message = name.removeprefix(_PREFIX)
    module = importlib.import_module(f"{_PACKAGE}.{message}{_SUFFIX}")
    return module.DESCRIPTOR.message_types_by_name[message]


@functools.cache
def names() -> list[str]:
    """Return the names of all messages, sorted: each has a module of its own."""
    try:
        package = importlib.import_module(_PACKAGE)
    except ModuleNotFoundError as error:
        raise OptionError(
            'schema="foxglove...." needs the package foxglove-schemas-protobuf, which is not installed: pip install'
            " 'ml-dash-mcap[foxglove]'"
        ) from error
    modules = [module.name for module in pkgutil.iter_modules(package.__path__) if module.name.endswith(_SUFFIX)]
    return [_PREFIX + module.removesuffix(_SUFFIX) for module in modules]
