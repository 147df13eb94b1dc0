"""A recording at a glance: in a line where it is printed, as a table in a notebook."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest

from ml_dash_mcap import Recorder, Recording
from tests.support.files import save


@pytest.fixture
def run(tmp_path: Path) -> Path:
    with Recorder(tmp_path / "run") as recorder:
        for i in range(101):
            recorder.topic("robot").append(q=[0.5] * 7, cam={"name": "left"}, _ts=i / 10)
        recorder.topic('<script>alert("x")</script>').append(**{"<b>": 1}, _ts=0.0)
    return tmp_path / "run"


class Cells(HTMLParser):
    """The texts of a table's cells, by row."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.add(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self.rows:
            self.rows[-1][-1] += data


def test_a_recording_says_how_much_it_holds(run: Path) -> None:
    with Recording(run) as rec:
        said = """1 file, 10 s, 2 topics: <script>alert("x")</script> (1), robot (101)"""
        assert repr(rec) == f"<Recording {str(run)!r}: {said}>"
    assert repr(rec) == f"<Recording {str(run)!r}, closed>"


def test_of_many_topics_only_some_are_named(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", [{f"t{i:02}": [{"_ts": 0.0}] for i in range(20)}])
    with Recording(path) as rec:
        assert repr(rec).endswith(
            "20 topics: t00 (1), t01 (1), t02 (1), t03 (1), t04 (1), t05 (1), t06 (1), t07 (1), and 12 more>"
        )


def test_a_recording_that_has_just_begun_has_a_line_too(tmp_path: Path) -> None:
    with Recorder(tmp_path), Recording(tmp_path) as rec:
        assert repr(rec) == f"<Recording {str(tmp_path)!r}: 0 files, 0 s, 0 topics>"
        assert Cells(rec._repr_html_()).rows[1:] == []


def test_a_notebook_shows_the_topics_as_a_table_in_which_every_text_is_escaped(run: Path) -> None:
    with Recording(run) as rec:
        html = rec._repr_html_()
    table = Cells(html)
    assert table.tags == {"table", "caption", "thead", "tbody", "tr", "th", "td"}
    assert table.rows == [
        ["topic", "rows", "rate (Hz)", "start (s)", "end (s)", "fields"],
        ['<script>alert("x")</script>', "1", "", "0.0", "0.0", "<b> integer"],
        ["robot", "101", "10", "0.0", "10.0", "q number[7], cam.name string"],
    ]
    assert Recording(run)._repr_html_().count("<td>") == 12
    assert rec._repr_html_() == f"&lt;Recording {str(run)!r}, closed&gt;".replace("'", "&#x27;")


@pytest.mark.breaks_files
def test_a_damaged_file_has_a_line_and_a_table(run: Path) -> None:
    (path,) = run.glob("*.mcap")
    with Recording(run) as rec:
        chunk = rec._opened()[0].index.chunks[0]
    data = bytearray(path.read_bytes())
    data[chunk.offset + 60] ^= 1
    path.write_bytes(data)
    with Recording(run) as rec:
        assert "robot (101)" in repr(rec)
        (_, script, robot) = Cells(rec._repr_html_()).rows
        assert (script[0], robot[0]) == ('<script>alert("x")</script>', "robot")


def test_a_field_whose_values_differ_in_kind_is_said_to_be_anything(tmp_path):
    with Recorder(tmp_path) as recorder:
        for value in (1, "one", [1.0]):
            recorder.topic("odd").append(x=value, y=0.5, pose=[[1.0, 0.0], [0.0, 1.0]], _ts=1.0 + len(str(value)))
    with Recording(tmp_path) as rec:
        fields = {name: str(field) for name, field in rec.topics["odd"].fields.items()}
    assert fields == {"x": "any", "y": "number", "pose": "number[2,2]"}
