"""The start times of Motive and QTM: in the languages of Windows, with 12 and with 24 hours, or a warning."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import ConversionWarning
from tests.formats.mocap.support import read_back
from tests.formats.mocap.test_motive import BODY, HEADER
from tests.formats.mocap.test_points import QTM

STAMP = "2019-09-18 04.30.02.695 PM"
AFTERNOON = 1568824202.695
"""2019-09-18 16:30:02.695 UTC."""
NIGHT = AFTERNOON - 12 * 3600


def start_of(tmp_path: Path, stamp: str, encoding: str = "utf-8", **options: Any) -> float:
    (tmp_path / "demo.csv").write_bytes((HEADER + BODY).replace(STAMP, stamp).encode(encoding))
    return float(read_back(tmp_path / "demo.csv", tmp_path / "back", **options)["robot"][0]["_ts"])


HALVES = {
    "English": ("AM", "PM"),
    "English, small": ("am", "pm"),
    "English of Australia": ("a.m.", "p.m."),
    "English, large with points": ("A.M.", "P.M."),
    "Spanish": ("a. m.", "p. m."),
    "Spanish with no-break spaces": ("a.\u00a0m.", "p.\u00a0m."),
    "Spanish with narrow no-break spaces": ("a.\u202fm.", "p.\u202fm."),
    "Chinese": ("\u4e0a\u5348", "\u4e0b\u5348"),
    "Japanese": ("\u5348\u524d", "\u5348\u5f8c"),
    "Korean": ("\uc624\uc804", "\uc624\ud6c4"),
    "Portuguese": ("da manh\u00e3", "da tarde"),
    "Swedish": ("fm", "em"),
    "Finnish": ("ap.", "ip."),
    "Czech": ("dop.", "odp."),
    "Slovene": ("dop.", "pop."),
    "Hungarian": ("de.", "du."),
    "Greek": ("\u03c0.\u03bc.", "\u03bc.\u03bc."),
    "Turkish": ("\u00d6\u00d6", "\u00d6S"),
    "Russian": ("\u0414\u041f", "\u041f\u041f"),
    "Bulgarian": ("\u043f\u0440.\u043e\u0431.", "\u0441\u043b.\u043e\u0431."),
    "Arabic": ("\u0635", "\u0645"),
    "Hebrew": ("\u05dc\u05e4\u05e0\u05d4\u05f4\u05e6", "\u05d0\u05d7\u05d4\u05f4\u05e6"),
    "Vietnamese": ("SA", "CH"),
    "Thai": ("\u0e01\u0e48\u0e2d\u0e19\u0e40\u0e17\u0e35\u0e48\u0e22\u0e07", "\u0e2b\u0e25\u0e31\u0e07\u0e40\u0e17\u0e35\u0e48\u0e22\u0e07"),
    "Italian, older": ("m.", "p."),
    "German": ("vorm.", "nachm."),
    "Dutch": ("a.m.", "p.m."),
    "Afrikaans": ("vm.", "nm."),
    "Persian": ("\u0642.\u0638.", "\u0628.\u0638."),
}  # fmt: skip
"""What stands for the halves of a day, in the spelling of CLDR."""


@pytest.mark.parametrize("language", HALVES)
def test_the_halves_of_a_day_are_known_in_the_languages_of_windows(language: str, tmp_path: Path) -> None:
    before, after = HALVES[language]
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    assert start_of(tmp_path / "a", f"2019-09-18 04.30.02.695 {after}") == AFTERNOON
    assert start_of(tmp_path / "b", f"2019-09-18 04.30.02.695 {before}") == NIGHT


@pytest.mark.parametrize(
    ("stamp", "seconds"),
    [
        ("2021-05-12 10.27.58.765 p. m.", 1620858478.765),
        ("2019-09-18 12.30.02.695 AM", NIGHT - 4 * 3600),
        ("2019-09-18 12.30.02.695 PM", AFTERNOON - 4 * 3600),
        ("2019-09-18 16.30.02.695", AFTERNOON),
        ("2019-09-18 16.30.02.695 ", AFTERNOON),
        ("2019-09-18 16:30:02.695", AFTERNOON),
        ("2019/09/18 16:30:02.695", AFTERNOON),
        ("18.09.2019 16:30:02.695", AFTERNOON),
        ("2019-09-18 \u4e0b\u5348 04.30.02.695", AFTERNOON),
        ("\u4e0b\u5348 04:30:02.695 2019-09-18", AFTERNOON),
        ("2019\u5e749\u670818\u65e5 \u5348\u5f8c 4:30:02.695", AFTERNOON),
        ("2019-09-18 04.30.02.695PM", AFTERNOON),
        ("2019-09-18  04.30.02.695\u00a0PM", AFTERNOON),
    ],
)
def test_every_layout_of_a_moment_is_read(stamp: str, seconds: float, tmp_path: Path) -> None:
    assert start_of(tmp_path, stamp) == seconds


def test_a_no_break_space_of_windows_own_encoding_is_read(tmp_path: Path) -> None:
    assert start_of(tmp_path, "2019-09-18 04.30.02.695 p.\u00a0m.", "latin-1") == AFTERNOON


@pytest.mark.parametrize(
    "stamp", ["soon", "2019-13-18 04.30.02.695 PM", "2019-09-18 04.30.02.695 XX", "9/18/2019 04.30 PM", "2019-09-18"]
)
def test_a_moment_that_is_not_understood_draws_a_warning_and_is_kept_as_text(stamp: str, tmp_path: Path) -> None:
    with pytest.warns(ConversionWarning, match=r"demo\.csv: Capture Start Time .* is not understood.*pass start="):
        assert start_of(tmp_path, stamp) == 0.0
    with Recording(tmp_path / "back") as recording:
        assert recording.topics["robot"].metadata["motive"]["Capture Start Time"] == stamp


def test_no_moment_draws_no_warning_and_neither_does_one_beside_start(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    assert start_of(tmp_path, "") == 0.0
    assert start_of(tmp_path / "a", "soon", start=3.0) == 3.0


def test_a_qtm_file_whose_time_stamp_is_not_understood_draws_a_warning(tmp_path: Path) -> None:
    (tmp_path / "x.tsv").write_text(QTM.replace("2014-06-17, 08:53:44", "gestern"))
    with pytest.warns(ConversionWarning, match="TIME_STAMP 'gestern.*is not understood"):
        back = read_back(tmp_path / "x.tsv", tmp_path / "back")
    assert back["markers"][0]["_ts"] == 0.0
