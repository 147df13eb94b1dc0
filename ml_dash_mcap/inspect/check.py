"""Checks whether a recording is whole, in order, on one clock, and without holes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ..errors import DamagedFileError
from ..file_names import DROPS_RECORD
from ..query.file import File
from . import clock_passes, topic_findings, writing_order
from .findings import KINDS, SEVERITIES, Finding, Gathering, Kind, Occurrence, Report
from .plain_words import rows_text
from .writing_order import Written

_NAMED = 3


def check(files: Sequence[File], topics: Iterable[str], *, has_all: bool) -> Report:
    """Check the time and sequence number of every message, and the files' own records about losses.

    Reads every chunk that holds one of the topics, so that its checksum is verified, and decodes no payload.

    Args:
        files: In the order of writing.
        topics: Their names.
        has_all: Whether these are all topics of the recording; then refused rows of other topics count too.
    """
    names = list(topics)
    damage: list[DamagedFileError] = []
    by_topic = writing_order.read(files, names, damage, has_all=has_all)
    counted = clock_passes.counted(files)
    findings = [*_damage(files, damage), *_drops(files, None if has_all else names), *_two_clocks(by_topic)]
    measured = []
    for topic in names:
        of_topic, spacings = topic_findings.topic(topic, by_topic[topic], counted)
        findings += of_topic
        measured += [] if spacings is None else [spacings]
    findings.sort(key=_rank)
    return Report(tuple(findings), tuple(names), tuple(measured))


def _rank(finding: Finding) -> tuple[int, int, str]:
    """Return the key by which findings are sorted: the worst first."""
    return SEVERITIES.index(finding.severity), KINDS.index(finding.kind), finding.topic or ""


def _damage(files: Sequence[File], errors: Sequence[DamagedFileError]) -> list[Finding]:
    """Return findings about damage, and about wrong indexes and statistics."""
    kinds: dict[str, Kind] = {str(error): "damage" for error in errors}
    for loss in (loss for file in files for loss in file.losses):
        # An error that was raised above is among the losses, too, and counts once.
        kinds.setdefault(str(loss), "index" if loss.corrected else "damage")
    gathered = Gathering(None)
    for text, kind in kinds.items():
        gathered.add(kind, Occurrence(None, text))
    return gathered.all()


def _drops(files: Sequence[File], topics: Sequence[str] | None) -> list[Finding]:
    """Return how many rows the recorders had to refuse; of each recorder, its last record counts."""
    last: dict[tuple[str, str], int] = {}
    for file in files:
        try:
            records = [record.values for record in file.metadata() if record.name == DROPS_RECORD]
        except DamagedFileError:  # it is among the findings of damage already
            continue
        run = writing_order.run_of(file) or file.source.name
        last.update({(run, topic): _count(text) for values in records for topic, text in values.items()})
    totals: dict[str, int] = {}
    for (_, topic), count in last.items():
        totals[topic] = totals.get(topic, 0) + count
    refused = {topic: count for topic, count in totals.items() if count and (topics is None or topic in topics)}
    return [finding for topic, count in refused.items() for finding in _refused(topic, count)]


def _refused(topic: str, count: int) -> list[Finding]:
    gathered = Gathering(topic)
    what = f"{rows_text(count)} refused, because the recorder's backlog was full"
    gathered.add("drops", Occurrence(None, what, count, count))
    return gathered.all()


def _count(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() else 0


def _two_clocks(by_topic: Mapping[str, Sequence[Written]]) -> list[Finding]:
    """Return a finding if some topics run on the wall clock, and others on a clock that starts near 0."""
    near_0, wall = [], []
    for topic, runs in by_topic.items():
        early, late = topic_findings.clocks(runs)
        if early and late:
            return []  # that topic has a finding of its own, which tells all
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
