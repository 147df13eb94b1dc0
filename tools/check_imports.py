"""Hold the floor plan: imports go down only, private names stay in their room, heavy libraries where they are needed.

Run by `make lint`; prints what is wrong and exits with 1. Imports for type checkers count like all others: a cycle
that only a type checker sees is a cycle for the reader too.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = "ml_dash_mcap"
ROOT = Path(__file__).resolve().parent.parent / PACKAGE

FLOORS: list[set[str]] = [
    {"version", "errors", "clock", "file_names", "time_hints"},
    {"suggestions"},
    {"options", "timestamps", "shipped_schemas", "store", "renamed_arguments"},
    {"rows"},
    {"meaning"},
    {"mcap"},
    {"codecs"},
    {"capture", "query"},
    {"inspect"},
    {"recovery", "compiled_append"},
    {"topic"},
    {"recorder"},
    {"formats"},
    {"selection"},
    {"topic_reader"},
    {"alignment", "opening"},
    {"recorded_topics"},
    {"recorded_run"},
    {"recording"},
    {"run", "conversion", "catalog"},
    {"experiment", "session"},
    {"cli"},
    {"__main__"},
]
"""Rooms by floor, the lowest first; a room imports from lower floors only."""

HEAVY = {
    "pyarrow": {"rows", "codecs", "query", "formats", "selection", "topic_reader", "alignment"},
    "cbor2": {"codecs.cbor"},
    "rosbags": {"codecs.ros.standard_types", "formats.ros.translate"},
    "ruamel": {"formats.ros.bag_metadata.yaml_text"},
    "google": {"codecs.protobuf_messages", "codecs.proto", "codecs.given"},
    "mcap_protobuf": {"codecs.protobuf_messages"},
    "foxglove_schemas_protobuf": {"codecs.given.foxglove_schemas"},
    "jsonschema_rs": {"codecs.given.given_json"},
    "ezc3d": {"formats.mocap.c3d.write"},
    "obstore": {"store.objects"},
    "PIL": {"run.images"},
    "rich": {"cli.output", "cli.progress"},
}
"""Which rooms or modules may import a heavy library."""


@dataclass(frozen=True)
class Import:
    """One import of a module."""

    line: int
    for_types: bool
    """Whether only type checkers make it (`if TYPE_CHECKING:`)."""

    module: str
    """Absolute; where a module is imported by its name (`from . import records`), that module."""

    name: str | None
    """What is imported of the module; None for the module itself."""


def main() -> int:
    """Check every module; return the exit code."""
    paths = sorted(ROOT.rglob("*.py"))
    modules = {module_name(path) for path in paths}
    graph: dict[str, set[str]] = {}
    faults = []
    for path in paths:
        module = module_name(path)
        imports = list(imports_of(path, modules))
        graph[module] = {each.module for each in imports if each.module in modules} - {module}
        faults += [f"{path.relative_to(ROOT.parent)}:{line}: {fault}" for line, fault in faults_of(module, imports)]
    faults += [f"modules import each other: {' -> '.join(cycle)}" for cycle in cycles(graph)]
    for fault in faults:
        print(fault)
    return 1 if faults else 0


def module_name(path: Path) -> str:
    """Return a module's absolute name, that of the package for `__init__`."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module: str) -> str:
    """Return the room that a module stands in: the first part of its name below the package."""
    return [*module.split("."), ""][1]


def faults_of(module: str, imports: list[Import]) -> Iterator[tuple[int, str]]:
    """Yield the line and the fault of each import that a module may not have."""
    for each in imports:
        if each.module.split(".")[0] == PACKAGE:
            if module != PACKAGE:
                yield from ((each.line, fault) for fault in direction_faults(module, each))
                yield from ((each.line, fault) for fault in privacy_faults(module, each))
        elif not each.for_types:
            yield from ((each.line, fault) for fault in weight_faults(module, each))


def weight_faults(module: str, imported: Import) -> Iterator[str]:
    """Yield a fault if a module imports a heavy library and is not meant to."""
    library = imported.module.split(".")[0]
    inside = module.removeprefix(PACKAGE + ".")
    allowed = HEAVY.get(library)
    if allowed is not None and not any(inside == name or inside.startswith(name + ".") for name in allowed):
        yield f"{inside} imports {library}; only {', '.join(sorted(allowed))} may"


def direction_faults(module: str, imported: Import) -> Iterator[str]:
    """Yield a fault if a room imports one that does not lie below it."""
    floors = {name: height for height, names in enumerate(FLOORS) for name in names}
    room, other = room_of(module), room_of(imported.module)
    if room == other:
        return
    for name in (room, other or "__init__"):
        if name not in floors:
            yield f"{name} stands on no floor; say in tools/check_imports.py where it belongs"
            return
    if floors[other] >= floors[room]:
        yield f"{room} imports {other}, which does not lie below it"


def privacy_faults(module: str, imported: Import) -> Iterator[str]:
    """Yield a fault if a private module or name of another room is imported."""
    if room_of(module) == room_of(imported.module):
        return
    private = [part for part in (*imported.module.split("."), imported.name or "") if is_private(part)]
    if private:
        yield f"{private[0]} of {imported.module} is private to its room"


def is_private(name: str) -> bool:
    """Whether a name begins with one underscore."""
    return name.startswith("_") and not name.startswith("__")


def imports_of(path: Path, modules: set[str]) -> Iterator[Import]:
    """Yield everything that a module imports, wherever in it."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    aliases: dict[str, str] = {}
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {inner for node in ast.walk(tree) if is_for_types(node) for inner in ast.walk(node)}
    for node in ast.walk(tree):
        is_typing = node in for_types
        if isinstance(node, ast.Import):
            yield from (Import(node.lineno, is_typing, alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = parts[: len(parts) - node.level] if node.level else ()
            module = ".".join([*base, *(node.module.split(".") if node.module else [])])
            for alias in node.names:
                inner = f"{module}.{alias.name}"
                if inner in modules:
                    aliases[alias.asname or alias.name] = inner
                    yield Import(node.lineno, is_typing, inner, None)
                else:
                    yield Import(node.lineno, is_typing, module, alias.name)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases:
            yield Import(node.lineno, False, aliases[node.value.id], node.attr)


def is_for_types(node: ast.AST) -> bool:
    """Whether a node is an `if TYPE_CHECKING:`, whose imports nobody makes."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def cycles(graph: dict[str, set[str]]) -> Iterator[list[str]]:
    """Yield each group of modules that import each other (strongly connected components, by Tarjan's algorithm)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        order[module] = low[module] = len(order)
        stack.append(module)
        for other in sorted(graph[module]):
            if other not in order:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], order[other])
        if low[module] == order[module]:
            at = stack.index(module)
            if len(stack) - at > 1:
                found.append(stack[at:])
            del stack[at:]

    sys.setrecursionlimit(10_000)
    for module in sorted(graph):
        if module not in order:
            visit(module)
    yield from found


if __name__ == "__main__":
    sys.exit(main())
