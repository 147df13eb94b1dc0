"""What can be imported from the package: everything public, once, and nothing heavy with it."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path

import pytest

import ml_dash_mcap
from ml_dash_mcap import Recording, Selection, TopicReader, errors, options
from ml_dash_mcap.formats import registry
from ml_dash_mcap.formats.registry import NoOptions
from ml_dash_mcap.recorded_run import RecordedRun
from ml_dash_mcap.recorded_topics import RecordedTopics

PUBLIC = ml_dash_mcap.__all__


def test_the_names_are_sorted_and_each_is_there_once() -> None:
    assert sorted(set(PUBLIC)) == PUBLIC


def test_dir_shows_the_public_names_and_nothing_else() -> None:
    assert dir(ml_dash_mcap) == PUBLIC
    ml_dash_mcap.Recording  # noqa: B018 - what was loaded is not listed twice
    assert dir(ml_dash_mcap) == PUBLIC


@pytest.mark.parametrize("name", PUBLIC)
def test_each_name_is_the_one_that_its_module_defines(name: str) -> None:
    value = getattr(ml_dash_mcap, name)
    if name != "__version__":
        assert value.__name__ == name
        assert value.__doc__


def test_a_name_that_there_is_not_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Recordng'"):
        ml_dash_mcap.Recordng  # noqa: B018
    with pytest.raises(ImportError):
        from ml_dash_mcap import nothing  # type: ignore[attr-defined]  # noqa: F401


def test_type_checkers_find_each_name_where_it_is_loaded_from() -> None:
    tree = ast.parse(Path(ml_dash_mcap.__file__).read_text())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    imported = {
        alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    homes = {name: ml_dash_mcap._HOMES.get(name, "errors") for name in PUBLIC if name != "__version__"}
    assert imported == homes


def test_every_error_and_warning_is_public() -> None:
    raised = [name for name, one in vars(errors).items() if inspect.isclass(one) and issubclass(one, Exception)]
    assert set(raised) <= set(PUBLIC)


def test_the_options_of_every_format_are_public() -> None:
    entries = registry._BUILT_IN
    kinds = {registry.load(kind) for entry in entries for kind in (entry.read_options, entry.write_options)}
    assert {kind.__name__ for kind in kinds - {NoOptions}} <= set(PUBLIC)
    assert options.RecorderOptions.__name__ in PUBLIC


def test_everything_that_a_recording_and_its_topics_return_is_public() -> None:
    members = [
        getattr(member, "fget", member)
        for kind in (Recording, RecordedRun, RecordedTopics, TopicReader, Selection)
        for name, member in vars(kind).items()
        if not name.startswith("_")
    ]
    returned = {
        word
        for member in members
        if inspect.isfunction(member)
        for word in re.findall(r"(?<![\w.])[A-Z]\w+", member.__annotations__["return"])
    }
    assert {"Entries", "Selection", "Report", "Gap"} & returned
    assert returned - {"Any", "Iterator", "Mapping", "None", "Path", "Row", "Sequence", "DataFrame"} <= set(PUBLIC)
