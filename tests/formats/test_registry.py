"""What people read of formats is what the registry has: guides, docstrings, options."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import FormatError, OptionError, UsageError
from ml_dash_mcap.formats import registry
from ml_dash_mcap.formats.registry import NoOptions

GUIDES = Path(__file__).resolve().parents[2] / "docs" / "guides"
TEXT = "\n".join(path.read_text() for path in sorted(GUIDES.glob("*.md")))
CODE = {word for code in re.findall(r"`([^`\n]+)`", TEXT) for word in re.findall(r"[\w.]+", code)}
"""Every word that stands as code in a guide."""


def entries() -> list[registry.Format]:
    names = {*registry.names("read"), *registry.names("write"), *registry.names("render")}
    found = [registry.find(name, ability) for name in sorted(names) for ability in ("read", "write", "render")]
    return list({entry.name: entry for entry in found if entry is not None}.values())


@pytest.mark.parametrize("name", registry.names("write"))
def test_the_docstring_of_export_names_each_format(name: str) -> None:
    assert f'"{name}"' in (Recording.export.__doc__ or "")


@pytest.mark.parametrize("entry", entries(), ids=lambda entry: entry.name)
def test_the_guides_name_each_suffix_and_each_option(entry: registry.Format) -> None:
    assert {suffix for suffix in entry.suffixes if suffix not in CODE} == set()
    options = {*registry.option_names(entry.read_options), *registry.option_names(entry.write_options)}
    assert options - CODE == set()


@pytest.mark.parametrize("entry", entries(), ids=lambda entry: entry.name)
def test_options_are_frozen_have_defaults_and_say_what_they_are(entry: registry.Format) -> None:
    for reference in (entry.read_options, entry.write_options):
        kind = registry.load(reference)
        options = kind()
        assert registry.make_options(reference, {}, "x") == options
        assert kind is NoOptions or kind.__doc__
        for field in dataclasses.fields(kind):
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(options, field.name, None)


def test_an_option_that_is_none_is_named_with_those_that_there_are(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"^x has no option 'flaten'; it has flatten\. did you mean flatten=\?$"):
        registry.make_options("tables.table_options:ParquetWriteOptions", {"flaten": True}, "x")
    with pytest.raises(UsageError, match=r"^x has no option 'a'; it has none$"):
        registry.make_options(NoOptions, {"a": 1}, "x")
    with pytest.raises(OptionError, match="on_bad='no'"):
        registry.make_options("tables.table_options:TableReadOptions", {"on_bad": "no"}, "x")


def test_a_suffix_that_means_no_format_is_an_error_with_all_that_do(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as error:
        registry.format_of(tmp_path / "a.xyz")
    for entry in entries():
        assert all(f"{suffix} ({entry.name})" in str(error.value) for suffix in entry.suffixes)
        assert entry.write is None or entry.name in str(error.value)


def test_suffixes_mean_one_format_each() -> None:
    suffixes = [suffix for entry in entries() for suffix in entry.suffixes]
    assert len(suffixes) == len(set(suffixes))
