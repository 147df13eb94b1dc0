"""A selection: a part of a topic that is read when it is asked for, and planned once."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.errors import NotFoundError, RangeError, StateError, UsageError
from ml_dash_mcap.query import plan
from ml_dash_mcap.store.local import LocalFolder

ROWS = 400


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Ten topics of 400 rows in several chunks."""
    with Recorder(tmp_path / "run", RecorderOptions(chunk_bytes=65536)) as recorder:
        for step in range(ROWS):
            for number in range(10):
                recorder.topic(f"t{number}").append(
                    q=[step / 3, step / 7], n=step, cam={"name": "x" * 30}, _ts=step / 100
                )
    return tmp_path / "run"


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Gets an entry with every plan that is made."""
    made: list[int] = []
    make = plan.chunks

    def counted(*arguments: object) -> plan.ChunkPlan:
        made.append(1)
        return make(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(plan, "chunks", counted)
    return made


def test_every_form_has_the_same_rows(run: Path) -> None:
    with Recording(run) as rec:
        part = rec["t3"].select(1.0, 1.5, ["n", "q"])
        expected = [{"n": step, "q": [step / 3, step / 7], "_ts": step / 100} for step in range(100, 151)]
        assert list(part.rows()) == list(part) == expected
        assert len(part) == 51
        assert part.arrow().to_pylist() == [{"_ts": r["_ts"], "n": r["n"], "q": r["q"]} for r in expected]
        assert part.numpy()["q"].shape == (51, 2)
        assert part.pandas(flatten=True)["q.1"].tolist() == [r["q"][1] for r in expected]
        assert part.polars()["n"].to_list() == [r["n"] for r in expected]
        assert sum(table.num_rows for table in part.batches(20)) == 51
        assert part.read() == rec["t3"].read(1.0, 1.5, ["n", "q"])
        out = io.BytesIO()
        part.write(out, format="csv")
        assert len(out.getvalue().splitlines()) == 52


def test_the_methods_of_a_topic_are_those_of_its_selections(run: Path) -> None:
    with Recording(run) as rec:
        topic = rec["t0"]
        part = topic.select(start=2.0, columns=["n"], start_index=3, limit=5)
        window = {"start": 2.0, "columns": ["n"], "start_index": 3, "limit": 5}
        assert list(topic.rows(**window)) == list(part.rows())
        assert topic.to_arrow(**window).equals(part.arrow())
        assert np.array_equal(topic.to_numpy(**window)["n"], part.numpy()["n"])
        assert topic.to_pandas(**window).equals(part.pandas())
        assert topic.to_polars(**window).equals(part.polars())
        assert [one.num_rows for one in topic.batches(rows=2, **window)] == [2, 2, 1]
        assert len(part) == 5


@pytest.mark.parametrize("format", ["json", "jsonl", "mocap", "parquet", "mcap"])
def test_rows_chosen_by_their_number_are_chosen_in_every_format(run: Path, tmp_path: Path, format: str) -> None:
    with Recording(run) as rec:
        data = rec["t0"].select(start_index=10, limit=3).read(format)
    if format == "json":
        assert [entry["n"] for entry in data["entries"]] == [10, 11, 12]
    elif format == "mocap":
        assert [frame["n"] for frame in data["frames"]] == [10, 11, 12]
    elif format == "jsonl":
        assert len(data.splitlines()) == 3
    elif format == "parquet":
        assert pq.read_table(io.BytesIO(data)).column("n").to_pylist() == [10, 11, 12]
    else:
        (tmp_path / "some.mcap").write_bytes(data)
        assert [row["n"] for row in Recording(tmp_path / "some.mcap")["t0"].rows()] == [10, 11, 12]


def test_nothing_is_read_before_it_is_asked_for(run: Path, plans: list[int]) -> None:
    with Recording(run) as rec:
        part = rec["t0"].select(1.0, 2.0, ["absent"])
        assert repr(part) == "<Selection of 't0', start=1.0, end=2.0, columns=('absent',)>"
        assert (part.topic, part.start, part.end, part.columns) == ("t0", 1.0, 2.0, ("absent",))
        assert plans == []
        with pytest.raises(NotFoundError, match="no column 'absent'"):
            part.rows()


def test_a_selection_plans_once_however_often_it_is_read(run: Path, plans: list[int]) -> None:
    with Recording(run) as rec:
        part = rec["t0"].select(1.0, 2.0)
        for _ in range(3):
            part.arrow()
            list(part.rows())
            assert len(part) == 101
    assert len(plans) == 1


def test_listing_ten_topics_plans_each_once(run: Path, plans: list[int]) -> None:
    with Recording(run) as rec:
        assert [info.count for info in rec.topics.values()] == [ROWS] * 10
        assert len(plans) == 10


def test_a_selection_of_a_recording_that_grows_has_the_new_rows_after_a_refresh(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        topic = recorder.topic("a")
        topic.append(n=0, _ts=0.0)
        recorder.flush()
        with Recording(tmp_path / "run") as rec:
            part = rec["a"].select()
            assert len(part) == 1
            topic.append(n=1, _ts=1.0)
            recorder.flush()
            rec.refresh()
            assert [row["n"] for row in part] == [0, 1]
            assert len(part) == 2


def test_a_selection_of_a_closed_recording_says_so(run: Path) -> None:
    with Recording(run) as rec:
        part = rec["t0"].select()
    for read in (part.rows, part.arrow, lambda: len(part), part.read):
        with pytest.raises(StateError, match="is closed"):
            read()


def test_a_range_that_makes_no_sense_is_refused_at_once(run: Path) -> None:
    with Recording(run) as rec:
        with pytest.raises(RangeError, match=r"start=2\.0 lies after end=1\.0"):
            rec["t0"].select(2.0, 1.0)
        with pytest.raises(RangeError, match="limit=-1"):
            rec["t0"].select(limit=-1)
        with pytest.raises(RangeError, match="start is NaN"):
            rec["t0"].select(math.nan)


def test_the_nearest_rows_on_both_sides_are_added(run: Path) -> None:
    with Recording(run) as rec:
        part = rec["t0"].select(1.002, 1.018, ["n"])
        assert [row["n"] for row in part] == [101]
        assert [row["n"] for row in part.with_neighbours()] == [100, 101, 102]
        assert [row["n"] for row in part.with_neighbours(0.001)] == [101]


def test_a_part_of_the_rows_keeps_them_beside_its_neighbours(run: Path) -> None:
    def numbers(**arguments: Any) -> tuple[list[int], list[int], list[int]]:
        part = rec["t0"].select(columns=["n"], **arguments)
        return tuple([row["n"] for row in rows] for rows in (part, part.with_neighbours(), part.with_neighbours(0.001)))

    with Recording(run) as rec:
        middle = {"start": 1.0, "end": 2.0, "start_index": 5, "limit": 3}
        assert numbers(**middle) == ([105, 106, 107], [104, 105, 106, 107, 108], [105, 106, 107])
        assert numbers(limit=2) == ([0, 1], [0, 1, 2], [0, 1])
        assert numbers(start=3.97, start_index=1) == ([398, 399], [397, 398, 399], [398, 399])
        assert numbers(start=1.0, end=2.0, start_index=200) == ([], [], [])


@pytest.mark.parametrize("most_s", [-1.0, math.nan, "1", [1]])
def test_a_distance_of_neighbours_that_is_none_is_named(run: Path, most_s: Any) -> None:
    with (
        Recording(run) as rec,
        pytest.raises(RangeError, match=r"with_neighbours\(most_s=.*: pass a number of seconds"),
    ):
        rec["t0"].select(1.0, 2.0).with_neighbours(most_s)


def test_the_time_stamps_alone_can_be_read(run: Path) -> None:
    with Recording(run) as rec:
        assert rec["t0"].select(end=0.02, columns=["_ts"]).arrow().to_pydict() == {"_ts": [0.0, 0.01, 0.02]}


@pytest.mark.parametrize(
    "call", ["read", "rows", "to_arrow", "to_numpy", "to_pandas", "to_polars", "batches", "select"]
)
def test_what_ranges_were_called_before_works_and_says_what_to_use(run: Path, call: str) -> None:
    with Recording(run) as rec:
        with pytest.warns(
            DeprecationWarning, match=rf"TopicReader\.{call}\(\): start_timestamp= is called start= now"
        ) as caught:
            old = getattr(rec["t0"], call)(start_timestamp=3.99)
        assert [warning.filename for warning in caught] == [__file__]
        assert repr(old) == repr(getattr(rec["t0"], call)(start=3.99)) or call in ("rows", "batches")
        with pytest.raises(TypeError, match=rf"TopicReader\.{call}\(\) got an unexpected keyword argument 'since'"):
            getattr(rec["t0"], call)(since=3.99)
        with pytest.raises(UsageError, match=rf"TopicReader\.{call}\(\) got both start= and start_timestamp="):
            getattr(rec["t0"], call)(1.0, start_timestamp=3.99)


def test_read_of_a_recording_names_itself(run: Path) -> None:
    with Recording(run) as rec:
        with pytest.warns(DeprecationWarning, match=r"Recording\.read\(\): end_timestamp= is called end= now"):
            assert rec.read("t0", end_timestamp=0.0, columns=["n"]) == rec.read("t0", end=0.0, columns=["n"])  # type: ignore[call-overload]
        with pytest.raises(TypeError, match=r"Recording\.read\(\) got an unexpected keyword argument 'since'"):
            rec.read("t0", since=1.0)  # type: ignore[call-overload]
        with pytest.raises(UsageError, match=r"Recording\.read\(\) got both end= and end_timestamp="):
            rec.read("t0", end=1.0, end_timestamp=1.0)  # type: ignore[call-overload]


def test_a_store_gives_the_same_selections(run: Path) -> None:
    with Recording("run", store=LocalFolder(run.parent)) as stored, Recording(run) as rec:
        assert stored["t1"].select(1.0, 2.0).arrow().equals(rec["t1"].select(1.0, 2.0).arrow())
