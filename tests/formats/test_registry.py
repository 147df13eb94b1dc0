"""What people read of formats is what the registry has: guides, docstrings, options."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from ml_dash_mcap import ParquetWriteOptions, Recorder, Recording, convert
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


def test_options_are_given_in_one_way(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("arm").append(q=[0.1, 0.2], _ts=0.5)
    with Recording(tmp_path / "run") as recording:
        path = recording.export(tmp_path / "a.parquet", options=None, flatten=True)
        assert pq.read_schema(path).names == ["_ts", "timestamp_ns", "q.0", "q.1"]
        path = recording.export(tmp_path / "b.parquet", options=None)
        assert pq.read_schema(path).names == ["_ts", "timestamp_ns", "q"]
        with pytest.raises(UsageError, match=r"got options= and flatten= too; put them into ParquetWriteOptions\("):
            recording.export(tmp_path / "c.parquet", options=ParquetWriteOptions(), flatten=True)
    convert(path, tmp_path / "back", options=None)
    with Recording(tmp_path / "back") as back:
        assert list(back.topics) == ["arm"]


def test_convert_offers_the_options_that_it_takes(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("arm").append(q=0.1, _ts=0.5)
    with pytest.raises(
        UsageError, match=r"have no option 'foo'; they have run, recover, on_damage.*flatten$"
    ) as caught:
        convert(tmp_path / "run", tmp_path / "x.parquet", foo=1)
    assert "store" not in str(caught.value).split("they have")[1]


def test_only_a_format_is_registered() -> None:
    with pytest.raises(UsageError, match=r"^register\(5\): pass a Format\(\.\.\.\), not int$"):
        registry.register(5)  # type: ignore[arg-type]


def test_a_suffix_that_means_no_format_is_an_error_with_all_that_do(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as error:
        registry.format_of(tmp_path / "a.xyz")
    for entry in entries():
        assert all(f"{suffix} ({entry.name})" in str(error.value) for suffix in entry.suffixes)
        assert entry.write is None or entry.name in str(error.value)


def test_suffixes_mean_one_format_each() -> None:
    suffixes = [suffix for entry in entries() for suffix in entry.suffixes]
    assert len(suffixes) == len(set(suffixes))
