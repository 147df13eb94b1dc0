"""What a check of a recording found, in values and in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Literal, get_args

Kind = Literal["damage", "drops", "missing", "clock", "late", "gap", "irregular"]

KINDS: tuple[Kind, ...] = get_args(Kind)
"""In the order in which they are listed."""

_SHOWN = 3


@dataclass(frozen=True, slots=True)
class Finding:
    """One problem."""

    topic: str | None
    """Whose; None if it is the recording's."""
    kind: Kind
    """- "damage": bytes that are broken, or a file without its end;
    - "drops": rows that the recorder had to refuse;
    - "missing": sequence numbers that are not there;
    - "clock": times that step back or leap on, in the order of writing, or two kinds of clocks;
    - "late": rows that were written after one of a later time;
    - "gap": rows that are too far apart;
    - "irregular": spacings that vary."""
    time: float | None
    """Where it begins, in s; None where no time tells."""
    what: str
    """In words."""

    def __str__(self) -> str:
        return self.what if self.time is None else f"at {said(self.time)}: {self.what}"


@dataclass(frozen=True, slots=True)
class Report:
    """What a check found: true if that is nothing.

    Example:
        >>> report = rec.check()
        >>> if not report:
        ...     print(report)
        >>> [finding for finding in report if finding.kind == "gap"]
    """

    findings: tuple[Finding, ...]
    """By topic, those of one topic and kind in time order."""
    topics: tuple[str, ...]
    """Those that were looked at."""

    def __bool__(self) -> bool:
        return not self.findings

    def __len__(self) -> int:
        return len(self.findings)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.findings)

    def __str__(self) -> str:
        """Return all findings in words, of many alike the first few."""
        looked_at = f"{len(self.topics)} topic{'' if len(self.topics) == 1 else 's'}"
        if not self.findings:
            return f"nothing found in {looked_at}"
        lines = [f"{len(self.findings)} finding{'' if len(self.findings) == 1 else 's'} in {looked_at}"]
        for (topic, kind), group in groupby(self.findings, lambda one: (one.topic, one.kind)):
            alike = list(group)
            lines.append(f"{'the recording' if topic is None else topic}: {kind}, {len(alike)}")
            lines += [f"    {one}" for one in alike[:_SHOWN]]
            lines += [f"    and {len(alike) - _SHOWN} more"] if len(alike) > _SHOWN else []
        return "\n".join(lines)


def rows_said(count: int) -> str:
    """Return a number of rows in words."""
    return f"{count} row{'' if count == 1 else 's'}"


def said(seconds: float) -> str:
    """Return a time or a duration in words, to the microsecond."""
    return f"{seconds:.6f}".rstrip("0").rstrip(".") + " s"
