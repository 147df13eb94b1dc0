"""A recorder for robots: a control loop logs to it, and it leaves MCAP files that open everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .version import __version__

if TYPE_CHECKING:
    from .catalog import recordings
    from .conversion import convert
    from .errors import (
        AlignmentError,
        BacklogFullError,
        ConversionError,
        ConversionWarning,
        DamagedFileError,
        DestinationExistsError,
        EncodingError,
        EntryNotFoundError,
        FieldError,
        ForeignFileError,
        FormatError,
        IntegerRangeError,
        MissingObjectError,
        MissingRecordingError,
        NotFoundError,
        OptionError,
        PrefixError,
        RangeError,
        RecorderError,
        StaleVersionError,
        StateError,
        StorageError,
        TimestampError,
        TopicError,
        UndecodedWarning,
        UsageError,
    )
    from .experiment import Experiment
    from .mcap.limits import Limits
    from .mcap.losses import Loss
    from .options import RecorderOptions
    from .recorder import Recorder
    from .recording import Recording
    from .recovery import recover
    from .session import Session
    from .store.local import LocalFolder
    from .store.objects import ObjectStore
    from .store.store import Store, StoredObject
    from .topic import Topic

__all__ = [
    "AlignmentError",
    "BacklogFullError",
    "ConversionError",
    "ConversionWarning",
    "DamagedFileError",
    "DestinationExistsError",
    "EncodingError",
    "EntryNotFoundError",
    "Experiment",
    "FieldError",
    "ForeignFileError",
    "FormatError",
    "IntegerRangeError",
    "Limits",
    "LocalFolder",
    "Loss",
    "MissingObjectError",
    "MissingRecordingError",
    "NotFoundError",
    "ObjectStore",
    "OptionError",
    "PrefixError",
    "RangeError",
    "Recorder",
    "RecorderError",
    "RecorderOptions",
    "Recording",
    "Session",
    "StaleVersionError",
    "StateError",
    "StorageError",
    "Store",
    "StoredObject",
    "TimestampError",
    "Topic",
    "TopicError",
    "UndecodedWarning",
    "UsageError",
    "__version__",
    "convert",
    "recordings",
    "recover",
]

_HOMES = {
    "Experiment": "experiment",
    "Limits": "mcap.limits",
    "LocalFolder": "store.local",
    "Loss": "mcap.losses",
    "ObjectStore": "store.objects",
    "Recorder": "recorder",
    "RecorderOptions": "options",
    "Recording": "recording",
    "Session": "session",
    "Store": "store.store",
    "StoredObject": "store.store",
    "Topic": "topic",
    "convert": "conversion",
    "recordings": "catalog",
    "recover": "recovery",
}


_ERRORS = frozenset(__all__) - _HOMES.keys() - {"__version__"}
"""What comes from `errors`."""


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that importing the package loads nothing heavy."""
    if name not in _HOMES and name not in _ERRORS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    home = import_module(f"{__name__}.{_HOMES.get(name, 'errors')}")
    found = getattr(home, name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
