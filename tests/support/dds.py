"""Random structs of DDS: as Eclipse CycloneDDS has them, in IDL, and the rows that their values are."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any, Optional

import cyclonedds.idl.annotations as annotate
import cyclonedds.idl.types as types
from cyclonedds.idl import IdlEnum, IdlStruct
from hypothesis import strategies as st

BASIC: dict[str, tuple[Any, str, st.SearchStrategy[Any]]] = {
    "boolean": (bool, "boolean", st.booleans()),
    "octet": (types.uint8, "octet", st.integers(0, 255)),
    "int16": (types.int16, "short", st.integers(-(2**15), 2**15 - 1)),
    "uint32": (types.uint32, "unsigned long", st.integers(0, 2**32 - 1)),
    "int64": (types.int64, "long long", st.integers(-(2**63), 2**63 - 1)),
    "float32": (types.float32, "float", st.floats(width=32, allow_nan=False)),
    "float64": (types.float64, "double", st.floats(allow_nan=False)),
    "string": (str, "string", st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5)),
}


class Mode(IdlEnum, typename="pkg.Mode"):
    """An enumeration."""

    IDLE = 0
    RUN = 1


MODE_IDL = "enum Mode { IDLE, RUN };"


@dataclass
class Kind:
    """A type: its class in CycloneDDS, its name in IDL, and how to draw a value for both."""

    python: Any
    idl: str
    values: st.SearchStrategy[tuple[Any, Any]]
    """Pairs of what CycloneDDS takes, and what a row has."""
    declarator: str = ""
    """What stands behind a member's name in IDL."""


@dataclass
class Struct:
    """A struct, and those that it is made of."""

    name: str
    python: Any
    extensibility: str
    members: dict[str, Kind]
    base: Struct | None = None
    idl: list[str] = field(default_factory=list)

    def all_members(self) -> dict[str, Kind]:
        return {**(self.base.all_members() if self.base else {}), **self.members}

    def values(self) -> st.SearchStrategy[tuple[Any, dict[str, Any]]]:
        members = self.all_members()
        drawn = st.tuples(*(kind.values for kind in members.values()))
        return drawn.map(
            lambda pairs: (
                self.python(**{name: pair[0] for name, pair in zip(members, pairs, strict=True)}),
                {name: pair[1] for name, pair in zip(members, pairs, strict=True)},
            )
        )


NUMBER = itertools.count()
ANNOTATIONS = {"final": annotate.final, "appendable": annotate.appendable}


@st.composite
def structs(draw: st.DrawFn, *, version_2: bool, depth: int = 2) -> Struct:
    """A struct, perhaps with a base and with structs in it; only version 2 has members that may be absent."""
    base = draw(structs(version_2=version_2, depth=0)) if depth and draw(st.integers(0, 4)) == 0 else None
    extensibility = draw(st.sampled_from(sorted(ANNOTATIONS))) if base is None else base.extensibility
    name = f"S{next(NUMBER)}"
    idl = list(base.idl) if base else []
    members: dict[str, Kind] = {}
    for number in range(draw(st.integers(0 if depth < 2 else 1, 4))):
        kind, before = draw(_kinds(version_2, depth))
        members[f"{name.lower()}_{number}"] = kind
        idl += before
    python = _class(name, base.python if base else IdlStruct, extensibility, members)
    lines = "".join(
        f"{'@optional ' if kind.idl.startswith('@') else ''}{kind.idl.removeprefix('@')} {key}{kind.declarator};\n"
        for key, kind in members.items()
    )
    idl.append(f"@{extensibility} struct {name}{f' : {base.name}' if base else ''} {{\n{lines}}};")
    return Struct(name, python, extensibility, members, base, idl)


def _class(name: str, base: Any, extensibility: str, members: dict[str, Kind]) -> Any:
    """Make a class; from text, because CycloneDDS forgets the members of a base otherwise."""
    names = {f"type_{key}": kind.python for key, kind in members.items()}
    lines = [f"    {key}: type_{key}" for key in members] or ["    pass"]
    source = "\n".join(["@dataclass", "@annotation", f"class {name}(base, typename='pkg.{name}'):", *lines])
    names |= {"dataclass": dataclass, "annotation": ANNOTATIONS[extensibility], "base": base, "__name__": __name__}
    exec(compile(source, name, "exec", dont_inherit=True), names)
    return names[name]


@st.composite
def _kinds(draw: st.DrawFn, version_2: bool, depth: int) -> tuple[Kind, list[str]]:
    before: list[str] = []
    choice = draw(st.integers(0, 9))
    if choice < 2 and depth:
        inner = draw(structs(version_2=version_2, depth=depth - 1))
        kind, before = Kind(inner.python, inner.name, inner.values()), inner.idl
    elif choice == 2:
        kind = Kind(Mode, "Mode", st.sampled_from(list(Mode)).map(lambda one: (one, one.value)))
    else:
        python, idl, values = BASIC[draw(st.sampled_from(sorted(BASIC)))]
        kind = Kind(python, idl, values.map(lambda one: (one, one)))
    shape = draw(st.integers(0, 8))
    if shape == 6:
        row = Kind(types.array[kind.python, 2], kind.idl, _lists(kind, 2, 2), "[2]")
        kind = Kind(types.array[row.python, 3], kind.idl, _lists(row, 3, 3), "[3][2]")
    elif shape == 7:
        row = Kind(types.sequence[kind.python], f"sequence<{kind.idl}>", _lists(kind, 0, 2))
        kind = Kind(types.sequence[row.python], f"sequence<{row.idl}>", _lists(row, 0, 2))
    elif shape == 0:
        kind = Kind(types.sequence[kind.python], f"sequence<{kind.idl}>", _lists(kind, 0, 3))
    elif shape == 1:
        kind = Kind(types.array[kind.python, 2], kind.idl, _lists(kind, 2, 2), "[2]")
    elif shape == 2 and version_2:
        values = st.one_of(st.just((None, None)), kind.values)
        kind = Kind(Optional[kind.python], f"@{kind.idl}", values)  # noqa: UP045 - a class of CycloneDDS has no |
    return kind, before


def _lists(kind: Kind, least: int, most: int) -> st.SearchStrategy[tuple[Any, Any]]:
    is_bytes = kind.idl == "octet" and not kind.declarator
    pairs = st.lists(kind.values, min_size=least, max_size=most)
    return pairs.map(lambda some: ([one for one, _ in some], (bytes if is_bytes else list)(row for _, row in some)))


def idl(struct: Struct) -> str:
    """Its definition and those that it needs."""
    return f"module pkg {{\n{MODE_IDL}\n{chr(10).join(dict.fromkeys(struct.idl))}\n}};"
