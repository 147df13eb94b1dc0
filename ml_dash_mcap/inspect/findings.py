"""The results of a check of a recording, as values and as text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, get_args

from .plain_words import rows_text, seconds_text
from .row_spacing import Spacings

Kind = Literal["damage", "drops", "missing", "index", "clock", "gap", "late"]

KINDS: tuple[Kind, ...] = get_args(Kind)
"""In the order in which they are listed, among those of one severity."""

Severity = Literal["error", "warning", "note"]

SEVERITIES: tuple[Severity, ...] = get_args(Severity)
"""The worst first."""

_SEVERITY_OF: dict[Kind, Severity] = {
    "damage": "error",
    "drops": "error",
    "missing": "error",
    "index": "warning",
    "clock": "warning",
    "gap": "warning",
    "late": "note",
}

MOST_LISTED = 1000
"""So many occurrences of a finding are listed; all are counted."""


@dataclass(frozen=True, slots=True)
class Occurrence:
    """One place where something is wrong."""

    time: float | None
    """The time at which it begins, in s; None if it has no time."""
    what: str
    """In words."""
    rows: int = 0
    """How many rows it concerns: missing, late, merged or refused ones."""
    size: float = 0.0
    """How bad it is, among those of its kind: a duration in s, or a number of rows."""

    def __str__(self) -> str:
        return self.what if self.time is None else f"at {seconds_text(self.time)}: {self.what}"


@dataclass(frozen=True, slots=True)
class Finding:
    """Everything of one kind that is wrong on one topic."""

    topic: str | None
    """The topic; None for findings about the whole recording."""
    kind: Kind
    """- "damage": bytes that are broken, or a file without its end;
    - "index": an index, the statistics or the summary contradict the data, which are read instead;
    - "drops": rows that the recorder had to refuse;
    - "missing": sequence numbers that are not there;
    - "clock": times that step back or leap on, in the order of writing, or begin again in the next run, so that rows
      may be merged with others of the same time; or two kinds of clocks;
    - "gap": rows that are too far apart;
    - "late": rows that were written after one of a later time; reading sorts them."""
    time: float | None
    """The time of the worst occurrence, in s; None if it has no time."""
    what: str
    """In words: what it is, or how often it is there and what the worst is."""
    count: int = field(default=1, compare=False)
    """How many places there are."""
    rows: int = field(default=0, compare=False)
    """How many rows all of it concerns: missing, late, merged or refused ones."""
    occurrences: tuple[Occurrence, ...] = field(default=(), compare=False, repr=False)
    """The places, in time order; of very many the first 1000 and the worst."""

    @property
    def severity(self) -> Severity:
        """How bad it is.

        - "error": rows are lost, or are not what was recorded;
        - "warning": worth a look;
        - "note": nothing to act on.
        """
        return "error" if self.kind == "clock" and self.rows else _SEVERITY_OF[self.kind]

    def __str__(self) -> str:
        return self.what if self.count > 1 or self.time is None else f"at {seconds_text(self.time)}: {self.what}"


class Gathering:
    """Collects the findings of one topic, or of the whole recording."""

    def __init__(self, topic: str | None) -> None:
        """Begin with nothing.

        Args:
            topic: The topic; None for the whole recording.
        """
        self._topic = topic
        self._listed: dict[Kind, list[Occurrence]] = {}
        self._worst: dict[Kind, Occurrence] = {}
        self._counts: dict[Kind, int] = {}
        self._rows: dict[Kind, int] = {}

    def add(self, kind: Kind, occurrence: Occurrence) -> None:
        """Count and list one place."""
        self._counts[kind] = self._counts.get(kind, 0) + 1
        self._rows[kind] = self._rows.get(kind, 0) + occurrence.rows
        worst = self._worst.get(kind)
        if worst is None or occurrence.size > worst.size:
            self._worst[kind] = occurrence
        listed = self._listed.setdefault(kind, [])
        if len(listed) < MOST_LISTED:
            listed.append(occurrence)

    def all(self) -> list[Finding]:
        """Return a finding for each kind."""
        return [self._finding(kind, worst) for kind, worst in self._worst.items()]

    def _finding(self, kind: Kind, worst: Occurrence) -> Finding:
        count, rows, places = self._counts[kind], self._rows[kind], self._listed[kind]
        if worst not in places:
            places = [*places, worst]
        places = sorted(places, key=lambda place: (place.time is not None, place.time or 0.0))
        what = worst.what if count == 1 else _summed_up(kind, count, rows, worst)
        return Finding(self._topic, kind, worst.time, what, count, rows, tuple(places))


def _summed_up(kind: Kind, count: int, rows: int, worst: Occurrence) -> str:
    """Return one line of text about several places."""
    if kind == "gap":
        return f"{count} gaps, in which there are {rows_text(rows)} as a rule; the longest {worst}"
    if kind == "missing":
        return f"{rows_text(rows)} missing at {count} places; most of them {worst}"
    if kind == "late":
        return f"{rows_text(rows)} at {count} places written after one of a later time; the latest {worst}"
    if kind == "clock" and rows:
        return worst.what if worst.rows == rows else f"{rows_text(rows)} merged in all; most of them {worst}"
    return f"{count} times; {'the first: ' if worst.time is None else 'the largest '}{worst}"


@dataclass(frozen=True, slots=True)
class Report:
    """The result of a check: true if there is nothing to act on.

    Example:
        >>> report = rec.check()
        >>> if not report:
        ...     print(report)
        >>> [place.time for finding in report if finding.kind == "gap" for place in finding.occurrences]
    """

    findings: tuple[Finding, ...]
    """The worst first; one for each kind and topic."""
    topics: tuple[str, ...]
    """The topics that were checked."""
    spacings: tuple[Spacings, ...]
    """How far apart the rows of each topic are, by topic; measured, and nothing wrong by itself."""

    def __bool__(self) -> bool:
        return all(finding.severity == "note" for finding in self.findings)

    def __len__(self) -> int:
        return len(self.findings)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.findings)

    def __str__(self) -> str:
        """Return the findings in words, a line each, and the spacings of topics with long ones that are no gaps."""
        looked_at = f"{len(self.topics)} topic{'' if len(self.topics) == 1 else 's'}"
        lines = [f"{self._counted()} in {looked_at}"]
        lines += map(_line, self.findings)
        gaps = {finding.topic: finding.count for finding in self.findings if finding.kind == "gap"}
        lines += [
            f"spacing: {spacings.topic}: {spacings}"
            for spacings in self.spacings
            if spacings.long > gaps.get(spacings.topic, 0)
        ]
        return "\n".join(lines)

    def _counted(self) -> str:
        if not self.findings:
            return "nothing found"
        counts = {severity: sum(finding.severity == severity for finding in self.findings) for severity in SEVERITIES}
        parts = [f"{count} {severity}{'' if count == 1 else 's'}" for severity, count in counts.items() if count]
        return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _line(finding: Finding) -> str:
    topic = "" if finding.topic is None else f"{finding.topic}: "
    return f"{finding.severity}: {topic}{finding.kind}: {finding}"
