"""Turns columns with dotted names into structs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

_MOST_STRUCTS = 50
"""Structs in structs; columns that lie deeper keep their dotted names, because pyarrow reads no Parquet file with more
than 100 levels."""


@dataclass(frozen=True, slots=True)
class Tree:
    """A struct's keys: each a column, by its dotted name, or a struct of its own."""

    children: dict[str, str | Tree] = field(default_factory=dict)

    def renamed(self, names: Mapping[str, str]) -> Tree:
        """Return the same tree with other names for some of its own keys."""
        return Tree({names.get(key, key): inner for key, inner in self.children.items()})

    def put(self, path: Sequence[str], column: str) -> None:
        """Give a column a place."""
        if len(path) == 1:
            self.children[path[0]] = column
            return
        inner = self.children.setdefault(path[0], Tree())
        assert isinstance(inner, Tree)
        inner.put(path[1:], column)


def tree(names: Iterable[str], literal: Collection[str] = ()) -> Tree:
    """Return the nested places of dotted columns.

    A key in which a dot is literal stays a column of its own, and so does everything under a top-level name of which
    another column is a parent: `cam` beside `cam.pos`.

    Args:
        names: Of the columns.
        literal: Those whose dots are part of a key.
    """
    columns = list(names)
    paths = {name: _path(name, literal) for name in columns}
    mixed = {path[0] for name, path in paths.items() if any(parent in paths for parent in _parents(name))}
    tree = Tree()
    for name, path in paths.items():
        tree.put((name,) if path[0] in mixed else path, name)
    return tree


def fields(tree: Tree, leaf: Callable[[str], pa.Field]) -> list[pa.Field]:
    """Return the fields of a tree.

    Args:
        tree: The tree.
        leaf: Returns the field of a column, under whatever name.
    """
    return [
        pa.field(key, pa.struct(fields(inner, leaf))) if isinstance(inner, Tree) else leaf(inner).with_name(key)
        for key, inner in tree.children.items()
    ]


def arrays(wanted: Sequence[pa.Field], tree: Tree, columns: Mapping[str, pa.Array]) -> list[pa.Array]:
    """Return the arrays of a tree's fields; a struct whose keys are all null is null.

    Args:
        wanted: What `fields` returned.
        tree: The tree.
        columns: By dotted name.
    """
    return [
        _struct(field.type, inner, columns) if isinstance(inner, Tree) else columns[inner]
        for field, inner in zip(wanted, tree.children.values(), strict=True)
    ]


def _struct(type_: pa.DataType, tree: Tree, columns: Mapping[str, pa.Array]) -> pa.Array:
    wanted = [type_.field(at) for at in range(type_.num_fields)]
    children: list[Any] = arrays(wanted, tree, columns)
    mask = functools.reduce(pc.and_, map(pc.is_null, children)) if all(child.null_count for child in children) else None
    return pa.StructArray.from_arrays(children, fields=wanted, mask=mask)


def _path(name: str, literal: Collection[str]) -> tuple[str, ...]:
    parts = tuple(name.split("."))
    return (name,) if name in literal or not all(parts) or len(parts) > _MOST_STRUCTS else parts


def _parents(name: str) -> Iterable[str]:
    return (name[:at] for at, letter in enumerate(name) if letter == ".")
