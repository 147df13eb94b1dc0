"""QTM's files: bodies with all of their columns, events, names that are missing."""

from __future__ import annotations

from pathlib import Path

from ml_dash_mcap import Recording
from tests.formats.mocap.support import read_back

HEAD = "FILE_VERSION\t2.0.0\nNO_OF_FRAMES\t2\nNO_OF_BODIES\t1\nFREQUENCY\t100\nDESCRIPTION\tfirst try\nEVENT\tstart\t1\t0.0\nEVENT\tstop\t2\t0.01\nDATA_INCLUDED\t6D\nBODY_NAMES\tarm\n"
TURN = "0\t1\t0\t-1\t0\t0\t0\t0\t1"


def test_a_body_has_its_angles_and_its_residual_in_the_units_that_qtm_writes(tmp_path: Path) -> None:
    (tmp_path / "x.tsv").write_text(f"{HEAD}1000\t2000\t3000\t10\t20\t90\t0.5\t{TURN}\n" + "\t" * 15 + "\n")
    with Recording(tmp_path / "x.tsv") as recording:
        rows = list(recording["arm"].rows())
        metadata = recording.topics["arm"].metadata
    assert rows[0]["pos"] == [1.0, 2.0, 3.0]
    assert rows[0]["angles"] == [10.0, 20.0, 90.0]
    assert rows[0]["residual"] == 0.0005
    assert rows[1] == {"_ts": 0.01}
    assert metadata["units"] == {"pos": "m", "residual": "m", "angles": "deg"}
    assert metadata["converted"] == "lengths from mm to m"
    assert metadata["time_source"] == "rows at 100.0 Hz"
    assert metadata["qtm"]["EVENT"] == "start 1 0.0 stop 2 0.01"
    assert metadata["qtm"]["DESCRIPTION"] == "first try"


def test_bodies_without_their_matrices_are_kept_apart(tmp_path: Path) -> None:
    head = HEAD.replace("NO_OF_BODIES\t1", "NO_OF_BODIES\t2").replace("BODY_NAMES\tarm", "BODY_NAMES\tarm\tleg")
    (tmp_path / "x.tsv").write_text(head + "1000\t0\t0\t1\t2\t3\t0.5\t2000\t0\t0\t4\t5\t6\t0.25\n")
    back = read_back(tmp_path / "x.tsv", tmp_path / "back")
    assert back == {
        "arm": [{"pos": [1.0, 0.0, 0.0], "angles": [1.0, 2.0, 3.0], "residual": 0.0005, "_ts": 0.0}],
        "leg": [{"pos": [2.0, 0.0, 0.0], "angles": [4.0, 5.0, 6.0], "residual": 0.00025, "_ts": 0.0}],
    }


def test_a_marker_without_a_name_keeps_its_place(tmp_path: Path) -> None:
    (tmp_path / "x.tsv").write_text(
        "FILE_VERSION\t2.0.0\nFREQUENCY\t100\nMARKER_NAMES\ta\t\tc\n1000\t0\t0\t2000\t0\t0\t3000\t0\t0\n"
    )
    (row,) = read_back(tmp_path / "x.tsv", tmp_path / "back")["markers"]
    assert {name: value[0] for name, value in row["markers"].items()} == {"a": 1.0, "marker 2": 2.0, "c": 3.0}
