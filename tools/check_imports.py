"""Hold the floor plan: imports go down only, and a heavy library is imported only in the file that needs it.

Run by `make lint`; prints what is wrong and exits with 1.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGE = "ml_dash_mcap"
ROOT = Path(__file__).resolve().parent.parent / PACKAGE

FLOORS: list[set[str]] = [
    {"version", "errors", "clock", "file_names", "time_hints"},
    {"suggestions"},
    {"options", "timestamps", "shipped_schemas", "store"},
    {"rows"},
    {"meaning"},
    {"mcap"},
    {"codecs"},
    {"capture", "query"},
    {"inspect"},
    {"recovery"},
    {"topic"},
    {"recorder"},
    {"formats"},
    {"topic_reader", "alignment", "opening"},
    {"recording"},
    {"run", "conversion", "catalog"},
    {"experiment", "session"},
    {"cli"},
    {"__main__"},
]
"""Rooms by floor, the lowest first; a room imports from lower floors only."""

HEAVY = {
    "pyarrow": {
        "alignment",
        "codecs.ros.arrow_columns",
        "formats.mocap.samples",
        "formats.ros.messages.arrow_blocks",
        "formats.tables.arrow_values",
        "formats.tables.csv.cells",
        "formats.tables.csv.layout",
        "formats.tables.csv.read",
        "formats.tables.csv.tokens",
        "formats.tables.csv.types",
        "formats.tables.jsonl.read",
        "formats.tables.nested_columns",
        "formats.tables.our_tables",
        "formats.tables.parquet.file_bytes",
        "formats.tables.parquet.layout",
        "formats.tables.parquet.read",
        "formats.tables.parquet.write",
        "formats.tables.table_intake",
        "formats.tables.table_times",
        "formats.text.number_cells",
        "query.exact_blocks",
        "query.topic_columns",
        "rows.align",
        "rows.array_lists",
        "rows.element_columns",
        "codecs.json_line_columns",
        "codecs.json_line_types",
        "codecs.json_lines",
        "rows.kinds",
        "rows.numpy_columns",
        "rows.table",
        "rows.to_data_frames",
        "rows.zero_copy",
        "topic_reader",
    },
    "rosbags": {"codecs.ros.standard_types", "formats.ros.translate"},
    "ruamel": {"formats.ros.bag_information"},
    "google": {"codecs.protobuf"},
    "mcap_protobuf": {"codecs.protobuf"},
    "ezc3d": {"formats.mocap.c3d.write"},
    "obstore": {"store.objects"},
    "PIL": {"run.images"},
    "rich": {"cli.output", "cli.progress"},
}
"""Which modules may import a heavy library."""


def main() -> int:
    """Check every module; return the exit code."""
    faults = [fault for path in sorted(ROOT.rglob("*.py")) for fault in check(path)]
    for fault in faults:
        print(fault)
    return 1 if faults else 0


def check(path: Path) -> Iterator[str]:
    """Yield what is wrong with one module's imports."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    name = ".".join(parts)
    if name == "__init__":
        return
    for line, target in imports(path, parts):
        top = target.split(".")[0]
        if top in HEAVY and name not in HEAVY[top]:
            yield f"{path.name}:{line}: {name} imports {top}; only {sorted(HEAVY[top]) or 'nobody'} may"
        if target == PACKAGE or target.startswith(f"{PACKAGE}."):
            yield from judge(path, line, parts[0], target.split(".")[1] if "." in target else "__init__")


def judge(path: Path, line: int, room: str, other: str) -> Iterator[str]:
    """Yield a fault if a room may not import another."""
    if room == other:
        return
    floors = {name: height for height, names in enumerate(FLOORS) for name in names}
    for name in (room, other):
        if name not in floors:
            yield f"{path.name}:{line}: {name} stands on no floor; say in tools/check_imports.py where it belongs"
            return
    if floors[other] >= floors[room]:
        yield f"{path.name}:{line}: {room} imports {other}, which does not lie below it"


def imports(path: Path, parts: tuple[str, ...]) -> Iterator[tuple[int, str]]:
    """Yield the line and the absolute name of everything that a module imports."""
    package = [PACKAGE, *parts[:-1]]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {inner for node in ast.walk(tree) if is_for_types(node) for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if node in for_types:
            continue
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = [*base, *(node.module.split(".") if node.module else [])]
            if node.module or not node.level:
                yield node.lineno, ".".join(module)
            else:
                yield from ((node.lineno, ".".join([*module, alias.name])) for alias in node.names)


def is_for_types(node: ast.AST) -> bool:
    """Whether a node is an `if TYPE_CHECKING:`, whose imports nobody makes."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


if __name__ == "__main__":
    sys.exit(main())
