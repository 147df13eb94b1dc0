"""Measures taken in rounds: the contenders in turn, each time in a process of its own, so that moods hit all alike."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from report import Figures, Results

TIMEOUT_S = 600  # of one process

Order = dict[str, Any]  # what a process is to do, as JSON can say it


def play(
    turns: Mapping[str, Sequence[str]],
    rounds: int,
    run: Callable[[str, str], Figures],
    once: Container[str] = (),
) -> Results:
    """Take all measures of all contenders, round by round, and say how it goes.

    Args:
        turns: Measure to its contenders.
        rounds: How many.
        run: Takes one measure of one contender.
        once: The measures that are taken in the first round only.
    """
    results: Results = {}
    for turn in range(rounds):
        for measure, contenders in turns.items():
            if turn and measure in once:
                continue
            first = turn % max(1, len(contenders))  # nobody always runs after the same one
            for name in (*contenders[first:], *contenders[:first]):
                figures = run(measure, name)
                results.setdefault((measure, name), []).append(figures)
                print(f"round {turn + 1}/{rounds} {measure:9} {name:14} {_brief(figures)}", file=sys.stderr)
    return results


def in_a_process(program: str, order: Order, timeout_s: float = TIMEOUT_S) -> Figures:
    """Have a program carry out an order (it calls `answer`); returns its figures, or why there are none."""
    command = [sys.executable, program, "--child", json.dumps(order)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)
    except subprocess.TimeoutExpired:
        return {"absent": "failed", "why": f"not done after {timeout_s} s"}
    if done.returncode == 0:
        return json.loads(done.stdout)  # type: ignore[no-any-return]
    print(done.stderr, file=sys.stderr)
    return {"absent": "failed", "why": f"exit code {done.returncode}"}


def answer(order: str, run: Callable[[Order], Figures]) -> None:
    """Carry out an order; the figures are the only thing on the real standard output."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the contenders print goes elsewhere
    try:
        figures = run(json.loads(order))
    except ModuleNotFoundError as error:
        if "." in (error.name or "."):  # a part of a package is missing, not the package
            raise
        figures = {"absent": "missing", "why": str(error)}
    print(json.dumps(figures), file=out, flush=True)


def parser(about: str | None, names: Iterable[str], space: str) -> argparse.ArgumentParser:
    """Return the options that every benchmark has.

    Args:
        about: The program's docstring.
        names: Of its measures and contenders.
        space: How much room it needs for its files, in words.
    """
    names = list(dict.fromkeys(names))
    made = argparse.ArgumentParser(description=(about or "").partition("\n")[0])
    made.add_argument("--quick", action="store_true", help="a smoke run: one round of few rows")
    only = "a measure or a contender, may be repeated: " + ", ".join(names)
    made.add_argument("--only", action="append", default=[], choices=names, metavar="NAME", help=only)
    made.add_argument("--rounds", type=int, help="default 5, with --quick 1")
    made.add_argument("--out", type=Path, help="the Markdown file whose section is replaced; default: print it")
    scratch = f"where to record, with {space} free; default: the system's temporary folder"
    made.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help=scratch)
    made.add_argument("--child", help=argparse.SUPPRESS)
    return made


def options(
    about: str | None, names: Iterable[str], space: str, carry_out: Callable[[Order], Figures]
) -> argparse.Namespace | None:
    """Return what a benchmark was asked for, `rounds` among it; None in a process that had an order to carry out.

    The arguments are those of `parser` and `answer`.
    """
    made = parser(about, names, space)
    given = made.parse_args()
    if given.child:
        answer(given.child, carry_out)
        return None
    if given.out and given.only:
        made.error("--out writes the whole section: leave out --only")
    given.rounds = given.rounds or (1 if given.quick else 5)
    return given


def chosen(turns: Mapping[str, Sequence[str]], only: Sequence[str]) -> dict[str, list[str]]:
    """Return the measures and contenders that `--only` names; all measures, or all contenders, if it names none."""
    measures = [name for name in turns if name in only] or list(turns)
    everybody = {name for contenders in turns.values() for name in contenders}
    wanted = everybody.intersection(only) or everybody
    return {measure: [name for name in turns[measure] if name in wanted] for measure in measures}


def _brief(figures: Figures) -> str:
    """The figures in a line, for who waits; in the report they are medians."""
    shown = {key: f"{value:.5g}" if isinstance(value, float) else value for key, value in figures.items()}
    return ", ".join(f"{key} {value}" for key, value in shown.items())
