"""Files of more than one chunk, which several threads parse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ml_dash_mcap.errors import ConversionWarning, ForeignFileError
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording
from tests.formats.mocap.support import read_back

FRAMES = 120_000


@pytest.fixture(scope="module")
def text() -> str:
    """Return a take of Motive's of 5 MB."""
    head = (
        "Format Version,1.23,Take Name,long,Capture Frame Rate,100.000000,Rotation Type,Quaternion,Length Units,Meters\n"
        "\n,Type,Marker,Marker,Marker\n,Name,tip,tip,tip\n,ID,A,A,A\n,,Position,Position,Position\n"
        "Frame,Time (Seconds),X,Y,Z\n"
    )
    return head + "".join(f"{frame},{frame / 100:.6f},{frame}.5,-1.25,0.000001\n" for frame in range(FRAMES))


def test_all_rows_come_in_their_order(text: str, tmp_path: Path) -> None:
    (tmp_path / "take.csv").write_text(text)
    with Recording(tmp_path / "take.csv") as recording:
        found = recording["markers"].to_numpy()
    assert np.array_equal(found["markers.tip"][:, 0], np.arange(FRAMES) + 0.5)
    assert np.array_equal(found["_ts"], np.round(np.arange(FRAMES) / 100, 6))


@pytest.mark.parametrize("frame", [0, 60_000, FRAMES - 1])
def test_a_bad_cell_anywhere_is_an_error_with_its_line_and_column(frame: int, text: str, tmp_path: Path) -> None:
    (tmp_path / "take.csv").write_text(text.replace(f",{frame}.5,", ",oops,", 1))
    with pytest.raises(ForeignFileError, match=rf"line {frame + 8}, column 3: 'oops' is not a number"):
        read_back(tmp_path / "take.csv", tmp_path / "run")


def test_bad_cells_are_counted_over_all_chunks(text: str, tmp_path: Path) -> None:
    for frame in (0, 60_000, 60_001, FRAMES - 1):
        text = text.replace(f",{frame}.5,", ",oops,", 1)
    (tmp_path / "take.csv").write_text(text)
    with pytest.warns(ConversionWarning, match="4 cells are no numbers"):
        rows = read_back(tmp_path / "take.csv", tmp_path / "run", on_bad="missing")
    assert len(rows["markers"]) == FRAMES


def test_a_take_with_gaps_in_all_of_its_windows_comes_back(tmp_path: Path) -> None:
    """Whole numbers, fractions and lists of both, each missing now and then."""
    with Recorder(tmp_path / "run") as recorder:
        hand = recorder.topic("hand")
        for frame in range(5_000):
            markers = {"whole": [frame, 1, 2], "fraction": [frame / 7, 0.5, 1.0], "mixed": [frame, 0.5, 2]}
            hand.append(markers={k: v for at, (k, v) in enumerate(markers.items()) if frame % (7 + at)}, _ts=frame / 50)
    with Recording(tmp_path / "run") as recording:
        recording.export(tmp_path / "take.csv", format="mocap")
        rows = [row for row in recording["hand"].rows() if row["markers"]]
    assert read_back(tmp_path / "take.csv", tmp_path / "again")["hand"] == rows
