"""Converts foreign files to a recording, and a recording to the formats of others."""

from __future__ import annotations

import errno
import inspect
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import ConversionWarning, MissingRecordingError, UsageError
from .formats import readers, registry
from .formats.destination import fresh_folder, refuse_existing, replacing
from .formats.export_place import Reads, destination, located
from .formats.registry import Progress
from .formats.replacing import RECORDING, check_overwrite, keeper
from .formats.writers import options_of
from .recording import Recording
from .store.safe_paths import place
from .store.store import Store
from .suggestions import did_you_mean


def convert(
    src: str | Path,
    dest: str | Path,
    *,
    store: Store | None = None,
    format: str | None = None,
    encoding: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Path:
    """Turn a foreign file or folder into a recording, or a recording into another format or encoding.

    The result appears when it is whole; until then nothing is at `dest`.

    Args:
        src: A ROS bag, another foreign file, or a recording.
        dest: Where to. A recording becomes a folder.
        store: Where `dest` lies, which is a name in it then; None for this machine.
        format: What to write a recording as, such as "rosbag2"; None to tell by the suffix of `dest`.
        encoding: What the rows of the new recording are encoded in: "json", "cbor" or "protobuf". A recording, or any
            MCAP file with rows in one of these, becomes a recording with the same rows, times, metadata, attachments
            and saved files; its other messages (of ROS, protobuf of other people's types) stay as they are. The
            messages of a bag all become rows; without `encoding` they stay as they are. None for what the rows have,
            and for what the environment says (`ML_DASH_ENCODING`) where they come from a format without one. Of bags,
            "ros" is a choice too, and of CSV files any other is that of their text, such as "latin-1".
        overwrite: Whether to replace a file, or a folder of the same kind, that is at `dest` already. It stays until
            the new one is whole.
        progress: Called now and then with the rows done and the rows in all.
        options: Of what is read (a format's, or those of `Recording`, such as `on_damage`), and of the format that is
            written. Those that both have go to writing. An instance of a format's class of options, such as
            `ParquetWriteOptions(flatten=True)`, can be passed as `options` instead.

    Returns:
        `dest`; in a store, a PurePosixPath, which cannot be opened here.

    Raises:
        MissingRecordingError: Nothing is at `src`; also a FileNotFoundError.
        DestinationExistsError: Something is at `dest` that may not be replaced; also a FileExistsError.
        FormatError: There is no such format, or the one to write is not known; also a ValueError.
        UsageError: The format has no such option; also a TypeError.

    Example:
        >>> convert("field-test.bag", "runs/field-test")
        >>> convert("runs/field-test", "field-test-ros2", format="rosbag2")
        >>> convert("runs/alice/demo", "runs/alice/demo-typed", encoding="protobuf")
    """
    source = place(src, "src")
    target, put_into = located(dest, store)
    options |= {} if encoding is None else {"encoding": encoding}
    names_no_format = format is None and registry.suffix_format(target) is None
    if names_no_format and registry.detect(source) is not None:
        check_overwrite(overwrite)
        reading = readers.options_of(source)
        given = {name: value for name, value in options.items() if name in reading or name not in _OF_MCAP_ALONE}
        place_of_dest = destination(target, put_into, RECORDING, overwrite=overwrite, reads=Reads(None, [source]))
        with place_of_dest as path, fresh_folder(path) as folder:
            readers.into(source, folder, target.name, progress=progress, **given)
        return target
    if not source.exists():
        raise MissingRecordingError(errno.ENOENT, "there is nothing", str(src))
    chosen = format or ("mcap" if names_no_format and encoding is not None else registry.format_of(target))
    if overwrite is True and put_into is None:
        # The export below may know only a copy of the source.
        with replacing(keeper(RECORDING if chosen == "mcap" else chosen, [source])):
            refuse_existing(target)
    reads = _options_of_reading(source, chosen, options)
    writes = {name: value for name, value in options.items() if name not in reads}
    with _opened(source, reads) as recording:
        exported = recording.export(dest, store=store, format=chosen, overwrite=overwrite, progress=progress, **writes)
        for loss in recording.losses:
            then = "it was set right by the data" if loss.corrected else "it is left out"
            warnings.warn(f"{loss.path}, byte {loss.offset}: {loss.what}; {then}", ConversionWarning, stacklevel=2)
    return exported


@contextmanager
def _opened(source: Path, reads: Mapping[str, Any]) -> Iterator[Recording]:
    """Give what is at a path as a recording, read with options of its format, if there are any."""
    if not reads or registry.detect(source) is None:
        with Recording(source, **reads) as recording:
            yield recording
        return
    with readers.as_folder(source, **reads) as folder, Recording(folder, limits=reads.get("limits")) as recording:
        yield recording


_OF_RECORDINGS = [
    name
    # Taken from the signature, so that a new option of `Recording` needs no second list.
    for name, parameter in inspect.signature(Recording).parameters.items()
    if parameter.kind is parameter.KEYWORD_ONLY and name != "store"  # the store of `convert` is that of `dest`
]
"""The options of opening a recording, such as `on_damage`."""


_OF_MCAP_ALONE = {"on_damage", "limits"}
"""Options of `Recording` that have no meaning for formats without chunks, and are accepted for them all the same."""


def _options_of_reading(src: str | Path, format: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that only reading what is there has: those of its format, or those of a `Recording`.

    Raises:
        UsageError: One is neither of reading nor of writing.
    """
    if readers.takes(src, options.get("options")):
        return {"options": options["options"]}
    writing = {*inspect.signature(Recording.export).parameters, *options_of(format)}
    rest = {name: value for name, value in options.items() if name not in writing}
    reading = (readers.options_of(src) or _OF_RECORDINGS) if rest else []
    for name in rest:
        if name not in reading:
            names = [*reading, *options_of(format)]
            problem = f"they have {', '.join(names)}. {did_you_mean(name, names, spelling='{}=')}".rstrip(" .")
            raise UsageError(f"reading {src} and writing {format!r} have no option {name!r}; {problem}")
    return {name: value for name, value in rest.items() if name in reading}


__all__ = ["convert"]
