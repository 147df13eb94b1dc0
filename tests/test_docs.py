"""What the pages say is so: options, public names, signatures, floors, and links between pages."""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

import ml_dash_mcap
from ml_dash_mcap import errors, options
from ml_dash_mcap.inspect.findings import Occurrence
from ml_dash_mcap.inspect.row_spacing import Spacings
from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.run.dreamlake_files import SessionFile, SessionFiles
from ml_dash_mcap.run.episode_marks import OpenEpisode
from ml_dash_mcap.run.files import Files
from ml_dash_mcap.run.lifecycle import Run
from ml_dash_mcap.run.logs import Logs
from ml_dash_mcap.run.metrics import Metric, Metrics
from ml_dash_mcap.run.parameters import Parameters
from ml_dash_mcap.run.tracks import Track, Tracks, TrackSlice
from ml_dash_mcap.topic import Topic

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]

WRITTEN_BY_TOOLS = {DOCS / "benchmarks.md"}
"""Pages that a make target writes; they may be missing."""

EXPORTED = [getattr(ml_dash_mcap, name) for name in ml_dash_mcap.__all__]
CLASSES = [
    *(found for found in EXPORTED if inspect.isclass(found) and not issubclass(found, (Exception, dict))),
    *(Run, Tracks, Metrics, Metric, Parameters, Logs, Files, SessionFiles, SessionFile),
    *(Occurrence, Spacings, OpenEpisode),
]
"""What is exported, and what that returns."""


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def without_blocks(markdown: str) -> str:
    return re.sub(r"^```.*?^```$", "", markdown, flags=re.MULTILINE | re.DOTALL)


def ids(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


# The options


def rows_of_options() -> dict[str, dict[str, str]]:
    """Return the table of options.md, by option."""
    lines = text_of(DOCS / "guides/options.md").splitlines()
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if re.match(r"\| `\w+` \|", line)]
    table = [cells for cells in table if len(cells) == 5]
    return {
        cells[0].strip("`"): dict(zip(("unit", "default", "variable", "says"), cells[1:], strict=True))
        for cells in table
    }


def test_the_table_of_options_has_every_option_in_order() -> None:
    assert list(rows_of_options()) == [field.name for field in fields(RecorderOptions)]


def test_the_table_of_options_has_their_defaults() -> None:
    defaults = {name: ast.literal_eval(row["default"].strip("`")) for name, row in rows_of_options().items()}
    assert defaults == {field.name: field.default for field in fields(RecorderOptions)}


def test_the_table_of_options_has_the_environment_variables() -> None:
    said = {row["variable"].strip("`"): name for name, row in rows_of_options().items() if row["variable"]}
    assert said == options._VARIABLES


def test_the_table_of_options_has_the_unit_that_a_name_ends_with() -> None:
    units = {"_s": "s", "_bytes": "bytes", "_rows": "rows"}
    for name, row in rows_of_options().items():
        for ending, unit in units.items():
            assert not name.endswith(ending) or row["unit"] == unit, name


# The reference

FORMAT_OPTIONS = ("ReadOptions", "WriteOptions")


def section(name: str) -> str:
    """Return the part of reference.md that is about a class; a TrackSlice is described with the Track."""
    heading = "Track" if name == "TrackSlice" else "Options of formats" if name.endswith(FORMAT_OPTIONS) else name
    found = re.search(rf"^### {heading}$(.*?)(?=^##|\Z)", text_of(DOCS / "reference.md"), re.MULTILINE | re.DOTALL)
    assert found, f"reference.md has no section {heading}"
    return found[1]


def first_column(markdown: str) -> list[str]:
    """Return the left cells of the tables of a section."""
    return [line.split("|")[1] for line in markdown.splitlines() if line.startswith("| ")]


def names_in(markdown: str) -> set[str]:
    """Return every name that stands in code, with what follows it cut off."""
    markdown = without_blocks(markdown)
    return {part for code in re.findall(r"`([^`]+)`", markdown) for part in re.match(r"[\w.]*", code)[0].split(".")}  # type: ignore[index]


def public(cls: type) -> list[str]:
    """Return the public methods, properties and attributes of a class."""
    return [name for name in dir(cls) if not name.startswith("_") and name not in {"with_traceback", "args"}]


def test_the_reference_has_every_exported_name() -> None:
    assert set(ml_dash_mcap.__all__) <= names_in(text_of(DOCS / "reference.md")) | set(
        re.findall(r"^### (\w+)$", text_of(DOCS / "reference.md"), re.MULTILINE)
    )


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_the_reference_has_every_public_name_of_a_class(cls: type) -> None:
    said = "\n".join(first_column(section(cls.__name__)))
    mentioned = names_in(said) | set(re.findall(r"\w+", " ".join(re.findall(rf"`{cls.__name__}\([^`]*`", said))))
    inherited = public(Topic) if cls is Track else []  # Track's section sends the reader to Topic for those
    assert set(public(cls)) - set(inherited) <= mentioned


HIDDEN = {"positional", "timestamp", "_exact", "unknown", "renamed"}
"""Parameters that are there to raise a helpful error, or for names of before."""


def documented_calls() -> list[Any]:
    """Return every call in reference.md whose signature can be looked up: class, method, what is in the brackets."""
    calls = []
    for cls in CLASSES:
        cells = " ".join(first_column(section(cls.__name__)))
        for owner, name, inside in re.findall(r"`(TrackSlice\.)?(\w+)\(([^`]*)\)`", cells):
            is_another = name.endswith(FORMAT_OPTIONS) and name != cls.__name__
            if (cls is TrackSlice) == bool(owner) and not is_another:
                function = cls if name == cls.__name__ else getattr(cls, name)
                calls.append(pytest.param(function, inside, id=f"{cls.__name__}.{name}"))
    return calls


@pytest.mark.parametrize(("function", "inside"), documented_calls())
def test_a_signature_in_the_reference_is_that_of_the_code(function: Any, inside: str) -> None:
    said = ast.parse(f"def f({re.sub(r', _ts(?=[,)])', ', _ts=None', inside)}): ...").body[0].args  # type: ignore[attr-defined]
    hidden = {*HIDDEN, "self"} - set(re.findall(r"\w+", inside))
    parameters = [one for name, one in inspect.signature(function).parameters.items() if name not in hidden]
    kinds = {kind: [one for one in parameters if one.kind is kind] for kind in inspect._ParameterKind}
    plain = kinds[inspect.Parameter.POSITIONAL_ONLY] + kinds[inspect.Parameter.POSITIONAL_OR_KEYWORD]
    assert [arg.arg for arg in said.args] == [one.name for one in plain]
    assert [arg.arg for arg in said.kwonlyargs] == [one.name for one in kinds[inspect.Parameter.KEYWORD_ONLY]]
    assert ([said.kwarg.arg] if said.kwarg else []) == [one.name for one in kinds[inspect.Parameter.VAR_KEYWORD]]
    has_default = dict(zip([arg.arg for arg in said.args][::-1], said.defaults[::-1], strict=False))
    has_default |= {arg.arg: value for arg, value in zip(said.kwonlyargs, said.kw_defaults, strict=True) if value}
    for one in parameters:
        if one.name in has_default and one.name != "_ts":
            assert ast.literal_eval(has_default[one.name]) == one.default, one.name


def public_functions() -> list[Any]:
    """Return every public function and method, special ones included."""
    functions = [one for one in EXPORTED if inspect.isfunction(one)]
    methods = [(cls.__name__, name, one) for cls in CLASSES for name, one in inspect.getmembers(cls, callable)]
    return [
        *(pytest.param(one, id=one.__name__) for one in functions),
        *(
            pytest.param(one, id=f"{cls}.{name}")
            for cls, name, one in methods
            if inspect.isfunction(inspect.unwrap(one)) and "ml_dash_mcap" in one.__module__
        ),
    ]


@pytest.mark.parametrize("function", public_functions())
def test_help_shows_defaults_that_a_reader_understands(function: Any) -> None:
    said = str(inspect.signature(function))
    assert " at 0x" not in said
    assert "<object" not in said
    assert "<function" not in said


def test_the_reference_has_every_error() -> None:
    tree = [found for found in vars(errors).values() if inspect.isclass(found) and found.__module__ == errors.__name__]
    mentioned = names_in(text_of(DOCS / "reference.md"))
    assert {error.__name__ for error in tree} <= mentioned


# The pages


@pytest.mark.parametrize("page", [ROOT / "README.md", DOCS / "tutorial.md"], ids=ids)
def test_the_line_that_installs_the_package_is_that_of_its_build(page: Path) -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    name = re.search(r'^name = "(.+)"$', project, re.MULTILINE)[1]  # type: ignore[index]
    pythons = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', project)
    line = f"pip install {name}    # or `pip install .` in a clone"
    assert line in text_of(page)
    assert f"Python {pythons[0]} to {pythons[-1]}" in text_of(page)
    extras = re.search(r"^\[project.optional-dependencies\]$(.*?)^\[", project, re.MULTILINE | re.DOTALL)[1]  # type: ignore[index]
    for extra in re.findall(rf"{name}\[(\w+)\]", text_of(page)):
        assert re.search(rf"^{extra} = ", extras, re.MULTILINE), extra


def anchors(page: Path) -> set[str]:
    """Return what links can lead to in a page, by GitHub's rule."""
    text = without_blocks(text_of(page))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_the_links_of_a_page_lead_somewhere(page: Path) -> None:
    text = without_blocks(text_of(page))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith("https://"):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if target in WRITTEN_BY_TOOLS:
            continue
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_can_be_reached_from_the_index() -> None:
    reached, new = set[Path](), {DOCS / "README.md"}
    while new:
        page = new.pop()
        reached.add(page)
        links = {(page.parent / link).resolve() for link in re.findall(r"\]\(([^)\s#]+\.md)", text_of(page))}
        new |= {link for link in links if link.is_file()} - reached
    assert set(DOCS.rglob("*.md")) <= reached


def test_the_decisions_are_numbered_and_say_what_why_and_what_it_costs() -> None:
    pages = sorted((DOCS / "decisions").glob("2*.md"))
    assert [page.name[11:15] for page in pages] == [f"{number:04d}" for number in range(1, len(pages) + 1)]
    for page in pages:
        text = text_of(page)
        assert text.startswith(f"# {page.name[11:15]} "), page.name
        assert page.name[:10] in text, page.name
        assert re.findall(r"^## (.+)$", text, re.MULTILINE) == ["What", "Why", "What it costs"], page.name
