"""Every error this library raises.

    RecorderError
    ├── TimestampError       (ValueError)                a time stamp missing, not a number, out of range
    ├── FieldError           (TypeError, ValueError)     a field that cannot be stored, or a reserved name
    │   └── IntegerRangeError  (OverflowError)           an integer that 64 bits cannot hold
    ├── TopicError           (ValueError)                a topic that is empty, too long or not text
    ├── PrefixError          (ValueError)                a prefix or file name that is malformed or leaves its root
    ├── OptionError          (ValueError)                an option that makes no sense
    ├── UsageError           (TypeError)                 a call with arguments that it does not take
    ├── StateError           (RuntimeError)              used before its start, after its end, or in a forked child
    ├── BacklogFullError     (BufferError)               the writer fell behind and on_full="raise"
    ├── RangeError           (ValueError)                a range that ends before it starts, or of no numbers
    ├── StorageError         (OSError)                   a folder or file that cannot be made, written or locked
    │   ├── MissingRecordingError  (FileNotFoundError)   a path where no recording is
    │   ├── MissingObjectError     (FileNotFoundError)   a name under which a store has nothing
    │   ├── StaleVersionError                            an object that was replaced since it was looked at
    │   └── DestinationExistsError (FileExistsError)     an export's destination that is there already
    ├── NotFoundError        (KeyError)                  a topic, column or entry that is not there
    ├── AlignmentError       (ValueError)                a method or rate that topics cannot be aligned with
    ├── FormatError          (ValueError)                a format that is not known, or not read in a store
    ├── ConversionError      (ValueError)                a topic, row or name that another format cannot say
    ├── ForeignFileError     (ValueError)                another tool's file that breaks its format's rules
    ├── EncodingError        (ValueError)                a schema that is broken, or has what cannot be decoded
    └── DamagedFileError     (ValueError)                a file that is no MCAP, or whose bytes contradict themselves

Each is also the builtin that a caller would expect, so `except ValueError` keeps working. `UndecodedWarning` (a
UserWarning) is no error: the messages that it is about are read, as bytes.
"""

from __future__ import annotations

from pathlib import Path


class RecorderError(Exception):
    """The root of the tree: `except RecorderError` catches everything this library raises on purpose."""


class TimestampError(RecorderError, ValueError):
    """A `_ts` that is missing, not a number, not finite, negative or beyond what MCAP holds."""


class FieldError(RecorderError, TypeError, ValueError):
    """A field of a row that cannot be stored; the message names the topic and the field."""


class IntegerRangeError(FieldError, OverflowError):
    """An integer below -2**63 or above 2**64 - 1."""


class TopicError(RecorderError, ValueError):
    """A topic name that is empty, too long, reserved, not text, or has a NUL in it."""


class PrefixError(RecorderError, ValueError):
    """A prefix or a file name that is malformed or would leave its root folder."""


class OptionError(RecorderError, ValueError):
    """An option that makes no sense."""


class UsageError(RecorderError, TypeError):
    """A call with arguments that it does not take, such as positional ones to `append`."""


class StateError(RecorderError, RuntimeError):
    """A recorder, experiment or session used before its start, after its end, or in a forked child."""


class BacklogFullError(RecorderError, BufferError):
    """The backlog is full and `on_full="raise"`: the row was not taken."""


class RangeError(RecorderError, ValueError):
    """A time or index range whose end lies before its start, or whose ends are not numbers."""


class StorageError(RecorderError, OSError):
    """A folder or file that cannot be made, read, written or locked."""


class MissingRecordingError(StorageError, FileNotFoundError):
    """A path where no recording is."""


class MissingObjectError(StorageError, FileNotFoundError):
    """A name under which a store has nothing."""


class StaleVersionError(StorageError):
    """An object of a store that is not the version any more that the caller has seen; nothing was written."""


class DestinationExistsError(StorageError, FileExistsError):
    """The destination of an export, or a new object's name, is there already; nothing was written."""


class NotFoundError(RecorderError, KeyError):
    """A topic, column or entry that is not there."""

    def __str__(self) -> str:
        """Return the message as written (a plain KeyError would show it in quotes)."""
        return str(self.args[0]) if self.args else ""


class AlignmentError(RecorderError, ValueError):
    """A method or a rate that topics cannot be brought onto one clock with."""


class FormatError(RecorderError, ValueError):
    """A format that is not known, or that is not read in a store."""


class ConversionError(RecorderError, ValueError):
    """A topic, row or name that another format cannot say; the message names it, and what to pass."""


class ForeignFileError(RecorderError, ValueError):
    """Another tool's file that breaks the rules of its format; the message says where.

    Attributes:
        path: The file.
        line: Where in it the trouble was found, from 1; None where a file has no lines.
        column: Which cell of the line, from 1; None for the whole line.
        what: What is wrong, in words.
    """

    def __init__(self, path: str | Path, what: str, line: int | None = None, column: int | None = None) -> None:
        place = "" if line is None else f", line {line}" + ("" if column is None else f", column {column}")
        super().__init__(f"{path}{place}: {what}")
        self.path = Path(path)
        self.line = line
        self.column = column
        self.what = what

    def __reduce__(self) -> tuple[type[ForeignFileError], tuple[Path, str, int | None, int | None]]:
        """Let it pass between processes."""
        return type(self), (self.path, self.what, self.line, self.column)


class EncodingError(RecorderError, ValueError):
    """A schema that is broken, or that has what this library cannot decode."""


class EntryNotFoundError(NotFoundError, StorageError):
    """No entry at or before a time: a KeyError, as ml-dash promises, and a StorageError, as it does."""


class DamagedFileError(RecorderError, ValueError):
    """A file that is no MCAP, or whose bytes contradict themselves.

    Attributes:
        path: The file.
        offset: Where in it the trouble was found, in bytes from its start.
        what: What is wrong, in words.
    """

    def __init__(self, path: str | Path, offset: int, what: str) -> None:
        super().__init__(f"{path}, byte {offset}: {what}")
        self.path = Path(path)
        self.offset = offset
        self.what = what

    def __reduce__(self) -> tuple[type[DamagedFileError], tuple[Path, int, str]]:
        """Let it pass between processes."""
        return type(self), (self.path, self.offset, self.what)


class ConversionWarning(UserWarning):
    """Something that another format does not say, or says in a way that should be looked at."""


class UndecodedWarning(UserWarning):
    """Messages that this library does not decode: their rows have the bytes. Or texts in them that are no UTF-8."""
