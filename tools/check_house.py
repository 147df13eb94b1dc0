"""Hold the house in order: short files and functions, each class and file named once.

Run by `make lint`; prints what is wrong and exits with 1. `--figures` prints the figures as well.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parent.parent / "ml_dash_mcap"

FILE_LINES = 400
"""How long a file may be."""

MEDIAN_LINES = 10
"""How long the median function may be, from `def` to its last line, without its docstring."""

PARALLEL = {"__init__", "read", "write", "layout", "wire"}
"""Names of files that each room of a format may have."""

RIDDLES = {"said", "one", "found", "known", "ones"}
"""Names that say nothing of what they hold; a noun of the field says it."""


def main() -> int:
    """Check the package; return the exit code."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(ROOT.rglob("*.py"))}
    faults = [*long_files(trees), *names_given_twice(trees), *riddles(trees), *long_functions(trees)]
    for fault in faults:
        print(fault)
    if "--figures" in sys.argv:
        lines = [len(path.read_text(encoding="utf-8").splitlines()) for path in trees]
        lengths = [length(node) for tree in trees.values() for node in functions(tree)]
        print(f"{len(lines)} files, {sum(lines)} lines, {len(lengths)} functions, median {median(lengths):g} lines")
    return 1 if faults else 0


def long_files(trees: dict[Path, ast.Module]) -> Iterator[str]:
    """Yield the files that are too long."""
    for path in trees:
        count = len(path.read_text(encoding="utf-8").splitlines())
        if count > FILE_LINES:
            yield f"{shown(path)}: {count} lines; {FILE_LINES} at most: look for the seam"


def names_given_twice(trees: dict[Path, ast.Module]) -> Iterator[str]:
    """Yield classes of one name, and files of one name but for those that each room of a format may have."""
    files, classes = defaultdict(list), defaultdict(list)
    for path, tree in trees.items():
        if path.stem not in PARALLEL:
            files[path.stem].append(path)
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes[node.name].append(path)
    for name, paths in files.items():
        if len(paths) > 1:
            yield f"files of one name, {name}.py: {', '.join(map(shown, paths))}"
    for name, paths in classes.items():
        if len(paths) > 1:
            yield f"classes of one name, {name}: {', '.join(map(shown, paths))}"


def riddles(trees: dict[Path, ast.Module]) -> Iterator[str]:
    """Yield names of variables, arguments and attributes that do not say what they hold."""
    for path, tree in trees.items():
        for node in ast.walk(tree):
            name = (
                node.id
                if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
                else node.arg
                if isinstance(node, ast.arg)
                else None
            )
            if name in RIDDLES:
                yield f"{shown(path)}:{node.lineno}: {name!r} does not say what it holds"


def long_functions(trees: dict[Path, ast.Module]) -> Iterator[str]:
    """Yield a fault if the functions are too long in the median."""
    lengths = [length(node) for tree in trees.values() for node in functions(tree)]
    if median(lengths) > MEDIAN_LINES:
        yield f"the median function has {median(lengths):g} lines; {MEDIAN_LINES} at most"


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield the functions and methods of a module."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many lines a function has without its docstring."""
    lines = (function.end_lineno or function.lineno) - function.lineno + 1
    first = function.body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
        lines -= (first.end_lineno or first.lineno) - first.lineno + 1
    return lines


def shown(path: Path) -> str:
    """Return a path as messages show it."""
    return path.relative_to(ROOT.parent).as_posix()


if __name__ == "__main__":
    sys.exit(main())
