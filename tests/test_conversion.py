"""A conversion takes the options of what it reads as opening that does, and says what it had to leave out."""

from __future__ import annotations

import csv
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap import (
    ConversionWarning,
    DamagedFileError,
    ForeignFileError,
    Limits,
    Recording,
    UsageError,
    convert,
)
from tests.support.files import draft, finished, save

CHUNKS = [{"arm": [{"n": at, "_ts": float(at)}]} for at in range(3)]


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """A recording of three chunks, in the second of which a digit of the row was changed."""
    data = bytearray(finished(draft(CHUNKS)))
    at = data.rindex(b'{"n":1')
    data[at + 5 : at + 6] = b"7"
    (tmp_path / "run").mkdir()
    (tmp_path / "run/a.mcap").write_bytes(data)
    return tmp_path / "run"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def message(error: type[Exception], call: Callable[[], object]) -> str:
    with pytest.raises(error) as caught:
        call()
    return str(caught.value)


@pytest.mark.breaks_files
def test_what_is_damaged_is_refused_or_left_out_with_a_word_as_when_it_is_opened(tmp_path: Path, damaged: Path) -> None:
    for src in (damaged, damaged / "a.mcap"):
        said = message(DamagedFileError, lambda src=src: convert(src, tmp_path / "arm.csv"))  # type: ignore[misc]
        assert str(damaged / "a.mcap") in said and "byte " in said
        assert sorted(os.listdir(tmp_path)) == ["run"], "nothing half-written stays"
        with pytest.warns(ConversionWarning, match=r"a\.mcap, byte \d+: .*; it is left out"):
            convert(src, tmp_path / "arm.csv", on_damage="skip")
        assert rows(tmp_path / "arm.csv") == [{"_ts": "0.0", "n": "0"}, {"_ts": "2.0", "n": "2"}]
        (tmp_path / "arm.csv").unlink()


def test_limits_are_those_of_opening(tmp_path: Path) -> None:
    src = save(tmp_path / "run/a.mcap", CHUNKS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        convert(src, tmp_path / "arm.csv", limits=Limits(chunk_bytes=1024 * 1024))
    assert len(rows(tmp_path / "arm.csv")) == 3
    for call in (
        lambda: Recording(src, limits=Limits(chunk_bytes=16))["arm"].read(),
        lambda: convert(src, tmp_path / "small.csv", limits=Limits(chunk_bytes=16)),
    ):
        assert "chunk" in message(DamagedFileError, call)
    assert not (tmp_path / "small.csv").exists()


@pytest.mark.parametrize("options", [{"on_damge": "skip"}, {"limit": None}, {"zzz": 1}], ids=str)
def test_an_option_that_neither_has_is_refused_with_those_there_are(tmp_path: Path, options: dict[str, Any]) -> None:
    src = save(tmp_path / "run/a.mcap", CHUNKS)
    said = message(UsageError, lambda: convert(src, tmp_path / "arm.parquet", **options))
    assert str(src) in said and "on_damage" in said and "flatten" in said
    assert not (tmp_path / "arm.parquet").exists()


def test_a_text_among_the_times_of_a_table_is_refused_with_its_line_or_left_out(tmp_path: Path) -> None:
    src = tmp_path / "arm.csv"
    src.write_text("_ts,x\n0.0,1\nabc,2\n2.0,3\n")
    said = message(ForeignFileError, lambda: convert(src, tmp_path / "run"))
    assert f"{src}: line 3: the time is" in said and "abc" in said and "on_bad" in said
    assert os.listdir(tmp_path) == ["arm.csv"]
    with pytest.warns(ConversionWarning, match="1 rows without a time were left out"):
        convert(src, tmp_path / "run", on_bad="missing")
    with Recording(tmp_path / "run") as recording:
        assert list(recording["arm"].rows()) == [{"x": 1, "_ts": 0.0}, {"x": 3, "_ts": 2.0}]
