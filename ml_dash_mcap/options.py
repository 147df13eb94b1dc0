"""The options of a recorder, each with its unit in its name."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal

from .errors import OptionError, UsageError
from .suggestions import checks_names, hint, similar

Compression = Literal["zstd", "lz4", "none"]
OnFull = Literal["block", "drop", "raise"]

KIB = 1024
MIB = 1024 * KIB


@checks_names(UsageError)
@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderOptions:
    """How a recorder buffers, compresses and splits what it is given.

    Raises:
        OptionError: A value is out of its range; the message names it.
        UsageError: There is no such option; the message names the one that was probably meant.
    """

    flush_interval_s: float = 1.0
    """Rows reach the file at the latest this many seconds after `append`. Their journal protects them before that."""

    chunk_bytes: int = 3 * MIB // 2
    """Size of a journal buffer, and so of an uncompressed chunk, in bytes (64 KiB to 4 MB: the viewers' limits)."""

    encoding: str = "json"
    """What the rows of tracks are encoded in, where `topic(encoding=...)` says nothing else: "json", which every viewer
    but Rerun reads; "protobuf", which Rerun reads too, and which is smaller and read several times as fast; or "cbor"
    (with the extra `cbor`), which only readers of CBOR do. Logs, metrics and episodes stay JSON."""

    compression: Compression = "zstd"
    """The compression of chunks."""

    compression_level: int | None = None
    """The compressor's own level. None takes the fastest that still compresses numbers well (zstd 1, lz4 0)."""

    backlog_bytes: int = 32 * MIB
    """Memory for rows that are not in the file yet, in bytes, reserved at start. A disk may stand still until it is
    full."""

    on_full: OnFull = "block"
    """What `append` does when the backlog is full: wait, refuse the row and count it, or raise `BacklogFullError`."""

    sync_interval_s: float = 1.0
    """At most this many seconds of rows are lost when the power goes. 0 leaves syncing to the operating system."""

    segment_bytes: int = 4 * 1024 * MIB
    """A new segment starts when a file has grown to this size, in bytes."""

    segment_duration_s: float = 3600.0
    """A new segment starts when a file has been written to for this many seconds."""

    batch_rows: int | None = None
    """Write as soon as this many rows are waiting. None leaves it to the size and the interval."""

    buffered: bool = True
    """False writes every row to the file before `append` returns. For debugging; it holds the loop up."""

    journal_dir: str | os.PathLike[str] | None = None
    """Where the journal's buffers live. None takes shared memory if there is room, else the run's own folder."""

    def __post_init__(self) -> None:
        for name in ("flush_interval_s", "sync_interval_s", "segment_duration_s"):
            _check_kind(name, getattr(self, name), (int, float), "a number")
        for name in ("chunk_bytes", "backlog_bytes", "segment_bytes"):
            _check_kind(name, getattr(self, name), (int,), "a whole number")
        for name in ("compression_level", "batch_rows"):
            _check_kind(name, getattr(self, name), (int, type(None)), "a whole number or None")
        _check_kind("encoding", self.encoding, (str,), "the name of an encoding")
        _check(isinstance(self.buffered, bool), "buffered", self.buffered, "True or False")
        _check_kind("journal_dir", self.journal_dir, (str, os.PathLike, type(None)), "a path or None")
        _check(self.flush_interval_s > 0, "flush_interval_s", self.flush_interval_s, "more than 0 s")
        _check(64 * KIB <= self.chunk_bytes <= 4_000_000, "chunk_bytes", self.chunk_bytes, "65,536 to 4,000,000 bytes")
        _check(self.compression in ("zstd", "lz4", "none"), "compression", self.compression, "'zstd', 'lz4' or 'none'")
        _check(
            self.backlog_bytes >= 2 * self.chunk_bytes,
            "backlog_bytes",
            self.backlog_bytes,
            f"at least two chunks, {2 * self.chunk_bytes} bytes",
        )
        _check(self.on_full in ("block", "drop", "raise"), "on_full", self.on_full, "'block', 'drop' or 'raise'")
        _check(self.sync_interval_s >= 0, "sync_interval_s", self.sync_interval_s, "0 s or more")
        _check(self.segment_bytes >= self.chunk_bytes, "segment_bytes", self.segment_bytes, "at least chunk_bytes")
        _check(self.segment_duration_s > 0, "segment_duration_s", self.segment_duration_s, "more than 0 s")
        _check(
            self.batch_rows is None or self.batch_rows > 0, "batch_rows", self.batch_rows, "None or more than 0 rows"
        )
        level = self.compression_level
        _check(level is None or -100 <= level <= 22, "compression_level", level, "-100 to 22, or None")

    @classmethod
    def from_environment(
        cls, environment: Mapping[str, str] | None = None, buffer_config: Any = None, **given: Any
    ) -> RecorderOptions:
        """Make options from what was given, ml-dash's `buffer_config`, and then the `ML_DASH_*` variables.

        The variables are `ML_DASH_FLUSH_INTERVAL` (s), `ML_DASH_TRACK_BATCH_SIZE` (rows), `ML_DASH_BUFFER_ENABLED`
        (true or false) and `ML_DASH_ENCODING`; each counts only where nothing else sets its option.

        Args:
            environment: Where to look the variables up; the process's own by default.
            buffer_config: A mapping or an object with any of ml-dash's `flush_interval` (s), `track_batch_size`
                (rows) and `buffer_enabled`, or of the names of this class. The entries of ml-dash for its server and
                for its other queues have no effect here.
            **given: Options by name; they win.

        Raises:
            OptionError: A variable or an entry has a value that its option cannot take, or an unknown name.
        """
        values = _from_variables(os.environ if environment is None else environment)
        values.update(_from_buffer_config(buffer_config))
        values.update(given)
        names = sorted(field.name for field in fields(cls))
        for name in values:
            if name not in names:
                raise OptionError(
                    f"unknown recorder option {name!r}; {hint(name, names, listing='the options are {}')}"
                )
        return cls(**values)

    def with_(self, **changes: Any) -> RecorderOptions:
        """Return these options with some of them changed."""
        return replace(self, **changes)


def misplaced(caller: str, unknown: Mapping[str, object], arguments: Iterable[str]) -> UsageError:
    """Return the error for arguments that a call does not take, some of which may be recorder options.

    Args:
        caller: Whose arguments they are, such as "Recorder".
        unknown: The arguments.
        arguments: The names that it takes.
    """
    name, value = next(iter(unknown.items()))
    options = [field.name for field in fields(RecorderOptions)]
    arguments = list(arguments)
    nearest = similar(name, [*arguments, *options])
    if nearest and nearest[0] in options:
        return UsageError(
            f"{caller}() takes no {name}=; it is one of the recorder's options: pass"
            f" options=RecorderOptions({nearest[0]}={value!r})"
        )
    advice = hint(name, arguments, spelling="{}=", listing="it takes {}")
    return UsageError(f"{caller}() got an unknown argument {name}=; {advice}")


def arguments_of(cls: type) -> list[str]:
    """Return the names of the arguments that a class takes, without `self` and those that stand for unknown ones."""
    parameters = list(inspect.signature(cls.__init__).parameters.values())[1:]  # type: ignore[misc]
    return [parameter.name for parameter in parameters if parameter.kind is not parameter.VAR_KEYWORD]


def check_options(options: object) -> None:
    """Raise UsageError if options are neither RecorderOptions nor None."""
    if options is None or isinstance(options, RecorderOptions):
        return
    instead = "RecorderOptions(**options)" if isinstance(options, Mapping) else "RecorderOptions(...)"
    raise UsageError(f"options={options!r} is of type {type(options).__name__}; pass {instead}")


_VARIABLES = {
    "ML_DASH_FLUSH_INTERVAL": "flush_interval_s",
    "ML_DASH_TRACK_BATCH_SIZE": "batch_rows",
    "ML_DASH_BUFFER_ENABLED": "buffered",
    "ML_DASH_ENCODING": "encoding",
}
_SWITCH = {"true": True, "1": True, "yes": True, "on": True, "false": False, "0": False, "no": False, "off": False}
_ML_DASH_NAMES = {"flush_interval": "flush_interval_s", "track_batch_size": "batch_rows", "buffer_enabled": "buffered"}
_ML_DASH_ELSEWHERE = (
    *("log_batch_size", "metric_batch_size", "file_upload_workers"),
    *("max_retries", "retry_base_delay", "retry_max_delay"),
)
"""The other entries of ml-dash 0.6.27 to 0.11: for queues that are not here, and for their server."""


def _check(holds: bool, name: str, value: object, wanted: str) -> None:
    if not holds:
        raise OptionError(f"{name}={value!r}: it must be {wanted}")


def _check_kind(name: str, value: object, kinds: tuple[type, ...], wanted: str) -> None:
    _check(isinstance(value, kinds) and not isinstance(value, bool), name, value, wanted)


def _from_variables(environment: Mapping[str, str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for variable, option in _VARIABLES.items():
        text = environment.get(variable, "").strip()
        if text:
            values[option] = _parse(variable, option, text)
    return values


def _parse(variable: str, option: str, text: str) -> float | int | bool | str:
    try:
        if option == "encoding":
            return text
        if option == "buffered":
            return _SWITCH[text.lower()]
        return int(text) if option == "batch_rows" else float(text)
    except (KeyError, ValueError) as error:
        raise OptionError(f"{variable}={text!r} in the environment does not say what {option} should be") from error


def _from_buffer_config(config: Any) -> dict[str, Any]:
    if config is None:
        return {}
    entries = {name: value for name, value in _entries(config).items() if name not in _ML_DASH_ELSEWHERE}
    if type(config).__module__.partition(".")[0] == "ml_dash":  # a later version may have more entries for its queues
        entries = {name: value for name, value in entries.items() if name in _ML_DASH_NAMES}
    return {_ML_DASH_NAMES.get(name, name): value for name, value in entries.items()}


def _entries(config: Any) -> dict[str, Any]:
    """Return what a mapping or an object holds by name."""
    if isinstance(config, Mapping):
        return dict(config)
    if is_dataclass(config) and not isinstance(config, type):  # perhaps one with slots
        return {field.name: getattr(config, field.name) for field in fields(config)}
    if hasattr(config, "_asdict"):  # a named tuple
        return dict(config._asdict())
    try:
        return {name: value for name, value in vars(config).items() if not name.startswith("_") and not callable(value)}
    except TypeError as error:
        raise OptionError(
            f"buffer_config={config!r}: pass a dict such as {{'flush_interval': 0.5}}, or an object with attributes"
        ) from error
