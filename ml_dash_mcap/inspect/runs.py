"""The runs in a recording: each start of a program that recorded into its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .. import clock
from ..errors import DamagedFileError, NotFoundError, OptionError
from ..file_names import ACTIVE_SUFFIX, OWN_TOPICS
from ..query import counts
from ..query.file import File
from ..query.lazy_mapping import Lookup
from ..query.stored_topic import StoredTopic
from . import run_metadata, writing_order

ENDED = ("completed", "failed", "cancelled")
"""The ways to end that a run may state."""

_SHOWN = 5


@dataclass(frozen=True, slots=True)
class RunInfo:
    """One run in a recording: all that one recorder wrote, from its opening to its close.

    Example:
        >>> for run in rec.runs:
        ...     print(run.index, run.id, run.status, run.start, run.end, dict(run.counts))
        >>> with Recording(rec.path, run=-1) as latest:
        ...     latest["robot"].read()
    """

    index: int
    """Its number in the recording, from 0, in the order in which the runs began to write."""
    id: str
    """Names it: the same text in all its files. A file of another program is a run of its own, named as the file."""
    status: str
    """How it ended: "completed", "failed" or "cancelled"; "died" if it did not state any; "recording" while it goes on.
    A run without a status, as of a `Recorder` alone, is "finished", or "unfinished" if a file lacks its end."""
    start: float | None
    """Time of its first message on any topic, in s; None without messages."""
    end: float | None
    """Time of its last message, in s; None without messages."""
    segments: tuple[Path, ...]
    """Its files, in the order of writing."""
    counts: Mapping[str, int] = field(compare=False, repr=False)
    """Topic names, without the library's own ones, to its rows after merging; each is counted when it is asked for."""
    metadata: Mapping[str, str] = field(compare=False, repr=False)
    """From the run's first file: its prefix, host, library, `run_start` and so on."""

    @property
    def duration(self) -> float:
        """From the first message to the last, in s."""
        return 0.0 if self.start is None or self.end is None else max(self.end - self.start, 0.0)


def id_of(file: File) -> str:
    """Return which run wrote a file."""
    return writing_order.run_of(file) or file.path.name.removesuffix(ACTIVE_SUFFIX)


def status_of(stated: str | None, *, is_recorded: bool, is_finished: bool) -> str:
    """Return how a run stands.

    Args:
        stated: The status in its own records; None without one.
        is_recorded: Whether its recorder lives.
        is_finished: Whether all its files have their end.
    """
    if is_recorded:
        return "recording"
    if stated is not None:
        return stated if stated in ENDED else "died"
    return "finished" if is_finished else "unfinished"


def find(files: Sequence[File], is_recorded: Callable[[str], bool]) -> list[RunInfo]:
    """Return the runs that wrote some files, in the order in which they began.

    Args:
        files: In the order of writing.
        is_recorded: Tells of a run's id whether its recorder lives.
    """
    by_run: dict[str, list[File]] = {}
    for file in files:
        by_run.setdefault(id_of(file), []).append(file)
    return [_run(index, name, mine, is_recorded(name)) for index, (name, mine) in enumerate(by_run.items())]


def _run(index: int, name: str, files: Sequence[File], is_recorded: bool) -> RunInfo:
    spans = run_metadata.spans(files)
    topics = sorted({topic for file in files for topic in file.glance.channels_by_topic})
    users = [topic for topic in topics if not topic.startswith(OWN_TOPICS)]
    return RunInfo(
        index=index,
        id=name,
        status=status_of(
            run_metadata.run(files).get("status"),
            is_recorded=is_recorded,
            is_finished=all(file.index.finished for file in files),
        ),
        start=min((clock.to_seconds(start_ns) for start_ns, _ in spans), default=None),
        end=max((clock.to_seconds(end_ns) for _, end_ns in spans), default=None),
        segments=tuple(file.path for file in files),
        counts=Lookup("topic", users, lambda topic: counts.count(StoredTopic(files, topic))),
        metadata=_about(files[0]),
    )


def _about(file: File) -> dict[str, str]:
    try:
        return file.about()
    except DamagedFileError:  # reading the metadata raises this again
        return {}


def choose(files: Sequence[File], wanted: Any) -> str:
    """Return the id of a run that a caller asks for.

    Args:
        files: Of the recording, in the order of writing.
        wanted: A run's id, or the beginning of one that no other has; or its number, from 0, or from -1 for the last.

    Raises:
        NotFoundError: There is no such run, or several.
        OptionError: It is neither text nor a number.
    """
    ids = list(dict.fromkeys(map(id_of, files)))
    if isinstance(wanted, int) and not isinstance(wanted, bool):
        if -len(ids) <= wanted < len(ids):
            return ids[wanted]
        raise NotFoundError(f"run={wanted}: the recording has {len(ids)} run{'' if len(ids) == 1 else 's'}")
    if not isinstance(wanted, str) or not wanted:
        raise OptionError(f"run={wanted!r}: pass a run's id, or its number (0 for the first, -1 for the last)")
    alike = [wanted] if wanted in ids else [id_ for id_ in ids if id_.startswith(wanted)]
    if len(alike) == 1:
        return alike[0]
    shown = ", ".join(map(repr, (alike or ids)[:_SHOWN])) + (", ..." if len(alike or ids) > _SHOWN else "")
    what = "several runs begin so" if alike else "there is no such run"
    raise NotFoundError(f"run={wanted!r}: {what}; there are {shown}")
