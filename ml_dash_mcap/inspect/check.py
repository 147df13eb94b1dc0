"""Whether a recording is what it should be: whole, in order, on one clock, and without holes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ..errors import DamagedFileError
from ..file_names import DROPS_RECORD
from ..query.file import File
from . import clock_passes, topic_findings, writing_order
from .findings import KINDS, SEVERITIES, Finding, Gathering, Kind, Occurrence, Report
from .plain_words import rows_said
from .writing_order import Written

_NAMED = 3


def check(files: Sequence[File], topics: Iterable[str], *, has_all: bool) -> Report:
    """Look at every message's time and sequence number, and at what the files say about themselves.

    Reads every chunk that holds one of the topics, so that its checksum is verified, and decodes no payload.

    Args:
        files: In the order of writing.
        topics: Their names.
        has_all: Whether these are all topics, so that the drops of any other one are told too.
    """
    names = list(topics)
    met: list[DamagedFileError] = []
    by_topic = writing_order.read(files, names, met, has_all=has_all)
    counted = clock_passes.counted(files)
    found = [*_damage(files, met), *_drops(files, None if has_all else names), *_two_clocks(by_topic)]
    measured = []
    for topic in names:
        findings, spacings = topic_findings.topic(topic, by_topic[topic], counted)
        found += findings
        measured += [] if spacings is None else [spacings]
    found.sort(key=lambda one: (SEVERITIES.index(one.severity), KINDS.index(one.kind), one.topic or ""))
    return Report(tuple(found), tuple(names), tuple(measured))


def _damage(files: Sequence[File], met: Sequence[DamagedFileError]) -> list[Finding]:
    """Return what is broken, and what indexes and statistics say wrongly."""
    kinds: dict[str, Kind] = {str(error): "damage" for error in met}
    for loss in (loss for file in files for loss in file.losses):
        kinds.setdefault(str(loss), "index" if loss.corrected else "damage")
    gathered = Gathering(None)
    for text, kind in kinds.items():
        gathered.add(kind, Occurrence(None, text))
    return gathered.all()


def _drops(files: Sequence[File], topics: Sequence[str] | None) -> list[Finding]:
    """Return what the recorders had to refuse; of each one, the last thing that it said counts."""
    last: dict[tuple[str, str], int] = {}
    for file in files:
        try:
            said = [one.values for one in file.metadata() if one.name == DROPS_RECORD]
        except DamagedFileError:  # the damage is told
            continue
        run = writing_order.run_of(file) or file.source.name
        last.update({(run, topic): _count(text) for values in said for topic, text in values.items()})
    totals: dict[str, int] = {}
    for (_, topic), count in last.items():
        totals[topic] = totals.get(topic, 0) + count
    refused = {topic: count for topic, count in totals.items() if count and (topics is None or topic in topics)}
    return [finding for topic, count in refused.items() for finding in _refused(topic, count)]


def _refused(topic: str, count: int) -> list[Finding]:
    gathered = Gathering(topic)
    what = f"{rows_said(count)} refused, because the recorder's backlog was full"
    gathered.add("drops", Occurrence(None, what, count, count))
    return gathered.all()


def _count(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() else 0


def _two_clocks(by_topic: Mapping[str, Sequence[Written]]) -> list[Finding]:
    """Tell if some topics run on the wall clock, and others on one that starts near 0."""
    near_0, wall = [], []
    for topic, runs in by_topic.items():
        early, late = topic_findings.clocks(runs)
        if early and late:
            return []  # what is said about that topic says it all
        near_0 += [topic] if early else []
        wall += [topic] if late else []
    if not near_0 or not wall:
        return []
    what = f"two kinds of clocks: near 0 on {_listed(near_0)}, wall-clock time on {_listed(wall)}"
    gathered = Gathering(None)
    gathered.add("clock", Occurrence(None, what))
    return gathered.all()


def _listed(topics: Sequence[str]) -> str:
    shown = ", ".join(map(repr, topics[:_NAMED]))
    return shown if len(topics) <= _NAMED else f"{shown} and {len(topics) - _NAMED} more"
