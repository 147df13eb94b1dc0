"""The life of a run: started, then completed, failed or cancelled, and perhaps started again."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from types import TracebackType
from typing import Any, Generic, TypeVar

from ..codecs import codec_table
from ..errors import FieldError, StateError, UsageError
from ..options import RecorderOptions, check_options
from ..rows import json_text
from .endings import Status, status_by
from .live import Live
from .tracks import TrackT

OwnerT = TypeVar("OwnerT")

_log = logging.getLogger("ml_dash_mcap")


class Run(Generic[OwnerT, TrackT]):
    """Starts and ends a run; also a context manager, which yields the experiment.

    An exception in the body marks the run as failed, and Ctrl-C as cancelled, like everything else that ends a program
    without an error in it (the cancelling of a task, the closing of a generator). `sys.exit()` completes it, unless its
    code says otherwise. Everything appended is written, and the exception goes on (with a note, if closing fails too).

    Example:
        >>> with Experiment("alice/franka/demo").run as exp:
        ...     exp.tracks("robot").append(q=[0.1, 0.2], _ts=0.0)
    """

    __slots__ = ("_begin", "_owner", "live", "status")

    def __init__(self, owner: OwnerT, begin: Callable[[], Live[TrackT]]) -> None:
        """Make a run that has not started.

        Args:
            owner: What `start` returns: the experiment.
            begin: Opens the recorder.
        """
        self._owner = owner
        self._begin = begin
        self.live: Live[TrackT] | None = None
        """The parts of the run while it is recorded, else None."""
        self.status: Status | None = None
        """How the run stands; None before its first start."""

    def __repr__(self) -> str:
        return f"<Run of {self._owner!r}>"

    def start(self) -> OwnerT:
        """Start recording; does nothing while it is started. After its end, a run starts again and is added to.

        Raises:
            StorageError: The run's folder cannot be made, written or locked.
        """
        if self.live is None:
            self.live = self._begin()
            self.status = "running"
        return self._owner

    def complete(self) -> None:
        """End the run as completed: write everything and close. Does nothing after its end.

        Raises:
            StateError: It was never started.
        """
        self._end("completed")

    def fail(self, error: BaseException | None = None) -> None:
        """End the run as failed: write everything and close. Does nothing after its end.

        Args:
            error: Why; its type and text are kept.

        Raises:
            StateError: It was never started.
        """
        self._end("failed", error)

    def cancel(self) -> None:
        """End the run as cancelled: write everything and close. Does nothing after its end.

        Raises:
            StateError: It was never started.
        """
        self._end("cancelled")

    def __enter__(self) -> OwnerT:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        status = status_by(error)
        if error is None:
            self.complete()
            return
        try:
            self._end(status, error if status == "failed" else None)
        except Exception as trouble:  # the body's exception goes on; what came of closing must not replace it
            note = f"closing the run after this also failed: {type(trouble).__name__}: {trouble}"
            _log.error("%s: %s", type(error).__name__, note)
            if hasattr(error, "add_note"):
                error.add_note(note)

    def _end(self, status: Status, error: BaseException | None = None) -> None:
        if self.status is None:
            raise StateError("the run was never started; use 'with experiment.run:' or call experiment.run.start()")
        # Taken away first: whatever fails below, the run has ended and is not ended a second time.
        live, self.live = self.live, None
        if live is None:
            return
        self.status = status
        live.end(status, error)


def describe(
    *,
    readme: str | None = None,
    description: str | None = None,
    tags: Iterable[str] | None = None,
    bindrs: Iterable[str] | None = None,
    metadata: Mapping[str, Any] | None = None,
) -> dict[str, str]:
    """Return what a caller says about a run as the text values of a metadata record.

    Raises:
        FieldError: The metadata hold a value that cannot be stored.
    """
    texts = {name: text for name, text in (("readme", readme), ("description", description)) if text is not None}
    for name, listed in (("tags", tags), ("bindrs", bindrs)):
        if listed is not None:
            texts[name] = _json_text(name, [listed] if isinstance(listed, str) else list(listed))
    if metadata is not None:
        texts["metadata"] = _json_text("metadata", dict(metadata))
    return texts


def _json_text(name: str, value: Any) -> str:
    try:
        return json.dumps(value, default=json_text.plain_list, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise FieldError(f"{name}={value!r} has no JSON: {error}") from error


def choose_options(options: RecorderOptions | None, buffer_config: Any, encoding: str | None = None) -> RecorderOptions:
    """Return a recorder's options from those given, ml-dash's `buffer_config`, or the environment.

    Args:
        options: What was given as `options=`.
        buffer_config: What was given as `buffer_config=`.
        encoding: What was given as `encoding=`; it counts more than the environment.

    Raises:
        UsageError: Two of them say the same thing.
        OptionError: A value is out of its range, or a name unknown.
    """
    if encoding is not None:
        codec_table.to_record(encoding)
    if options is None:
        chosen = RecorderOptions.from_environment(buffer_config=buffer_config)
        return chosen if encoding is None else replace(chosen, encoding=encoding)
    if buffer_config is not None:
        raise UsageError("options= and buffer_config= both say how to buffer; pass one")
    check_options(options)
    if encoding not in (None, options.encoding):
        raise UsageError(
            f"encoding={encoding!r} and options= with encoding={options.encoding!r} contradict each other; pass"
            f" options=RecorderOptions(encoding={encoding!r}, ...)"
        )
    return options
