"""A benchmark as a value: measures, contenders, aims; and the program that takes them and writes its section."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import report
import rounds
from report import Aim, Figures, Results


@dataclass(frozen=True)
class Comparison:
    """Measures of several contenders, and how they are shown."""

    about: str | None
    """The docstring of its program."""

    section: str
    """Key of its section in the report."""

    heading: str
    measures: Mapping[str, str]
    """Key of a measure to its title."""

    turns: Mapping[str, Sequence[str]]
    """Key of a measure to the keys of its contenders."""

    titles: Mapping[str, str]
    """Key of a contender to its title."""

    shown: Mapping[str, str]
    """Key of a figure to the head of its column."""

    aims: Sequence[Aim]
    packages: Sequence[str]
    """Those whose versions the report names."""

    sizes: tuple[int, int]
    """How much is measured, and how much in a quick run."""

    space: str
    """How much room it needs for its files, in words."""

    notes: str
    """What was measured, with `{size}` and `{rounds}` to fill in."""

    def main(self, measure: Callable[[rounds.Order], Figures], run: Callable[[str, str, Path, int], Figures]) -> None:
        """Take the measures that the command line asks for, and write or print the section.

        Args:
            measure: Carries out an order, in a process of its own.
            run: Takes a measure of a contender, given the folder for files and the size.
        """
        given = rounds.options(self.about, [*self.measures, *self.titles], self.space, measure)
        if given is None:
            return
        size = self.sizes[1 if given.quick else 0]
        turns = rounds.chosen(self.turns, given.only)
        with tempfile.TemporaryDirectory(dir=given.folder) as scratch:
            results = rounds.play(turns, given.rounds, lambda what, name: run(what, name, Path(scratch), size))
        report.deliver(given.out, self.section, self.text(results, given.rounds, size, given.folder))

    def text(self, results: Results, count: int, size: int, folder: Path) -> str:
        """Return the section as Markdown."""
        aims = [report.judge(aim, results) for aim in self.aims if aim.figure[:2] in results]
        parts = [f"## {self.heading}"]
        if size == self.sizes[1]:
            parts.append("**A quick run: it shows that the benchmark works, and no more.**")
        parts += [
            self.notes.format(size=f"{size:,}", rounds=count),
            report.environment(self.packages, folder),
            "### Aims\n\n" + report.table(["", "measured", "aim", ""], aims),
        ]
        return "\n\n".join([*parts, *self._tables(results)])

    def _tables(self, results: Results) -> list[str]:
        tables = []
        for what, title in self.measures.items():
            taken = {name: results[what, name] for name in self.turns[what] if (what, name) in results}
            body = [
                [self.titles[name], *(report.cell(figures, figure) for figure in self.shown)]
                for name, figures in taken.items()
            ]
            if body:
                tables.append(f"### {title}\n\n{report.table(['', *self.shown.values()], body)}")
        return tables
