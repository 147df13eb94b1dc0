"""An episode's times hold exactly the rows that were appended in it, whatever happened around them."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording, Session, shipped_schemas
from ml_dash_mcap.errors import FieldError, RangeError, StateError, TimestampError, TopicError
from ml_dash_mcap.inspect.episodes import Episode
from tests.support import disk, viewer_schema
from tests.support.examples import examples
from tests.support.files import save

EPOCH = 1_700_000_000.0
SMALL = RecorderOptions(chunk_bytes=65536, backlog_bytes=131_072, sync_interval_s=0)


@pytest.fixture
def exp(tmp_path: Path) -> Iterator[Experiment]:
    with Experiment("a/b", root=tmp_path).run as started:
        yield started


def episodes(exp: Experiment) -> list[Episode]:
    """End the run and read its episodes."""
    exp.run.complete()
    with Recording(exp.path) as rec:
        return rec.episodes


def rows_of(rec: Recording, episode: Episode, topic: str = "robot") -> list[Any]:
    read = rec[topic].read(start=episode.start, end=episode.end)
    return [entry["n"] for entry in read["entries"]]


def append(exp: Experiment, *numbers: int, start: float = 0.0) -> None:
    for n in numbers:
        exp.tracks("robot").append(n=n, _ts=start + n / 10)


# What belongs to an episode


@pytest.mark.parametrize("start", [0.0, EPOCH])
def test_an_episode_has_the_rows_between_its_marks(exp: Experiment, start: float) -> None:
    append(exp, 0, 1, start=start)
    with exp.episode(task="pick"):
        append(exp, 2, 3, 4, start=start)
    append(exp, 5, start=start)
    second = exp.episode(task="place")
    append(exp, 6, 7, start=start)
    second.end(success=True)
    append(exp, 8, start=start)
    exp.run.complete()
    with Recording(exp.path) as rec:
        assert [(one.index, one.task, one.success) for one in rec.episodes] == [(0, "pick", None), (1, "place", True)]
        assert [rows_of(rec, one) for one in rec.episodes] == [[2, 3, 4], [6, 7]]
        assert [one.end for one in rec.episodes] == [start + 4 / 10, start + 7 / 10]
        assert rec.episodes[0].duration == pytest.approx(0.3)


@pytest.mark.parametrize("start", [0.0, EPOCH])
@pytest.mark.parametrize("flushes", [False, True])
def test_the_first_episode_may_begin_before_the_first_row(exp: Experiment, start: float, flushes: bool) -> None:
    with exp.episode():
        if flushes:
            exp.flush()
        append(exp, 2, 3, start=start)
    append(exp, 4, start=start)
    exp.run.complete()
    with Recording(exp.path) as rec:
        (found,) = rec.episodes
        assert rows_of(rec, found) == [2, 3]
        assert (found.start, found.end) == (start + 2 / 10, start + 3 / 10)


def test_an_episode_holds_the_rows_of_all_topics(exp: Experiment) -> None:
    for n in range(9):
        if n % 3 == 0:
            exp.episode(task=str(n))
        exp.tracks("robot").append(n=n, _ts=n / 3)
        exp.tracks("camera").append(n=n, _ts=n / 3)
    exp.run.complete()
    with Recording(exp.path) as rec:
        for topic in ("robot", "camera"):
            assert [rows_of(rec, one, topic) for one in rec.episodes] == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]


@pytest.mark.parametrize("start", [0.0, EPOCH])
def test_an_episode_without_rows_holds_none(exp: Experiment, start: float) -> None:
    with exp.episode(task="before the first row"):
        pass
    append(exp, 0, 1, start=start)
    with exp.episode(task="between"):
        pass
    append(exp, 2, start=start)
    exp.run.complete()
    with Recording(exp.path) as rec:
        assert [rows_of(rec, one) for one in rec.episodes] == [[], []]
        assert [one.duration for one in rec.episodes] == [0.0, 0.0]


def test_the_caller_may_say_the_times(exp: Experiment) -> None:
    append(exp, *range(10))
    exp.episode(task="late", _ts=0.2).end(success=False, _ts=0.4)
    exp.episode(task="open end", _ts=0.7).end()
    exp.episode(task="point", _ts=5.0).end()
    exp.run.complete()
    with Recording(exp.path) as rec:
        assert [(one.start, one.end) for one in rec.episodes] == [(0.2, 0.4), (0.7, 0.9), (5.0, 5.0)]
        assert rows_of(rec, rec.episodes[0]) == [2, 3, 4]


def test_columns_and_inherited_times_count_as_rows(tmp_path: Path) -> None:
    with Session(name="s", workspace="w", local_path=tmp_path) as session:
        session.track("robot").append(n=0)
        with session.episode(task="pick") as episode:
            session.track("robot").append(n=1)
            session.track("camera").append(n=1, _ts=-1)
            last = session.track("robot").append(n=2)
            episode.success = True
        session.track("robot").append(n=3)
        assert last is session.track("robot")
        with session.episode():
            session.track("sim").append_columns(_ts=EPOCH * 1.1 + np.arange(5), n=np.arange(5))
    with Recording(session.path) as rec:
        first, second = rec.episodes
        assert (rows_of(rec, first), rows_of(rec, first, "camera")) == ([1, 2], [1])
        assert rows_of(rec, second, "sim") == [0, 1, 2, 3, 4]
        assert (first.task, first.success, second.task) == ("pick", True, None)


STEPS = st.lists(
    st.one_of(st.just("begin"), st.just("end"), st.integers(1, 3), st.just("flush"), st.just("run")), max_size=20
)


@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(STEPS, st.sampled_from([0.0, EPOCH]))
def test_whatever_comes_between_each_row_is_in_the_episode_in_which_it_was_appended(
    steps: list[Any], start: float
) -> None:
    expected: list[list[int]] = []
    is_open, n = False, 0
    with tempfile.TemporaryDirectory() as name:
        exp = Experiment("a/b", root=name, options=SMALL)
        exp.run.start()
        for step in steps:
            if step == "begin":
                exp.episode(task=str(len(expected)))
                expected.append([])
                is_open = True
            elif step == "end":
                exp.run.live.episodes.end_open()
                is_open = False
            elif step == "flush":
                exp.flush()
            elif step == "run":
                exp.run.complete()
                exp.run.start()
                is_open = False
            else:
                for _ in range(step):
                    append(exp, n, start=start)
                    expected[-1:] = [[*expected[-1], n]] if is_open else expected[-1:]
                    n += 1
        exp.run.complete()
        with Recording(exp.path) as rec:
            found = rec.episodes
            assert [one.index for one in found] == list(range(len(expected)))
            assert [one.task for one in found] == [str(index) for index in range(len(expected))]
            if "robot" in rec:
                assert [rows_of(rec, one) for one in found] == expected


# How it ends


def test_what_is_set_inside_counts(exp: Experiment) -> None:
    with exp.episode(task="pick", success=False, metadata={"seed": 7}) as episode:
        append(exp, 0)
        episode.success = np.bool_(True)
        episode.metadata["reward"] = 0.5
        episode.task = "pick again"
        assert episode.is_open
    assert not episode.is_open
    (found,) = episodes(exp)
    assert (found.task, found.success, found.metadata) == ("pick again", True, {"seed": 7, "reward": 0.5})


def test_an_exception_marks_it_as_failed_and_goes_on(exp: Experiment) -> None:
    def fail() -> None:
        with exp.episode(task="pick") as episode:
            append(exp, 0)
            episode.success = True
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    append(exp, 1)
    (found,) = episodes(exp)
    assert (found.success, found.end) == (False, 0.0)


def test_a_new_one_ends_the_one_before(exp: Experiment) -> None:
    first = exp.episode(task="first")
    append(exp, 0)
    with exp.episode(task="second"):
        append(exp, 1)
    assert not first.is_open
    assert [(one.task, one.start, one.end) for one in episodes(exp)] == [
        ("first", 0.0, 0.0),
        ("second", math.nextafter(0.0, 1.0), 0.1),
    ]


def test_the_inner_one_of_two_nested_ones_ends_the_outer_one(exp: Experiment) -> None:
    def fail() -> None:
        with exp.episode(task="outer"):
            append(exp, 0)
            with exp.episode(task="inner"):
                append(exp, 1)
                raise KeyError

    with pytest.raises(KeyError):
        fail()
    append(exp, 2)
    assert [(one.task, one.end, one.success) for one in episodes(exp)] == [("outer", 0.0, None), ("inner", 0.1, False)]


def test_the_end_of_the_run_ends_it(tmp_path: Path) -> None:
    exp = Experiment("a/b", root=tmp_path)

    def fail(n: int, task: str, success: bool | None) -> None:
        with exp.run:
            exp.episode(task=task, success=success)
            append(exp, n)
            raise OSError("unplugged")

    with exp.run:
        exp.episode(task="first")
        append(exp, 0)
    with pytest.raises(OSError, match="unplugged"):
        fail(1, "second", None)
    with pytest.raises(OSError, match="unplugged"):
        fail(2, "third", True)
    exp.run.start()
    exp.episode(task="fourth")
    append(exp, 3)
    exp.run.cancel()
    with Recording(exp.path) as rec:
        assert [(one.task, one.end, one.success) for one in rec.episodes] == [
            ("first", 0.0, None),
            ("second", 0.1, False),
            ("third", 0.2, True),
            ("fourth", 0.3, None),
        ]


def test_its_success_may_be_said_after_its_end(exp: Experiment) -> None:
    first = exp.episode(task="first")
    append(exp, 0)
    first.end()
    append(exp, 1)
    first.end()
    second = exp.episode(task="second")
    append(exp, 2)
    first.end(success=True)
    second.end(success=False)
    second.end(success=True)
    assert [(one.task, one.end, one.success) for one in episodes(exp)] == [("first", 0.0, True), ("second", 0.2, True)]
    first.end()
    with pytest.raises(StateError):
        first.end(success=False)


def test_one_that_is_being_recorded_has_no_end_yet(exp: Experiment) -> None:
    with exp.episode(task="pick"):
        append(exp, 0, 1)
        exp.flush()
        with Recording(exp.path) as rec:
            (found,) = rec.episodes
            assert (found.task, found.end, found.duration) == ("pick", None, None)
            assert rows_of(rec, found) == [0, 1]


def test_one_whose_recorder_died_has_no_end(tmp_path: Path) -> None:
    child = """
        import os, signal
        from ml_dash_mcap import Experiment

        exp = Experiment("a/b", root={root!r})
        exp.run.start()
        for episode in range(3):
            exp.episode(task=str(episode))
            for i in range(4):
                exp.tracks("robot").append(n=4 * episode + i, _ts=(4 * episode + i) / 10)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    code = textwrap.dedent(child.format(root=str(tmp_path)))
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    assert done.returncode == -signal.SIGKILL
    with Recording(tmp_path / "a/b") as rec:
        assert [(one.task, one.end) for one in rec.episodes] == [("0", 0.3), ("1", 0.7), ("2", None)]
        assert [rows_of(rec, one) for one in rec.episodes] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]]


# Several runs and recorders


def test_their_numbers_go_on_when_the_run_goes_on(tmp_path: Path) -> None:
    for run in range(3):
        with Experiment("a/b", root=tmp_path).run as exp:
            for episode in range(2):
                with exp.episode(task=f"{run}.{episode}"):
                    append(exp, 2 * run + episode)
    with Recording(exp.path) as rec:
        assert [(one.index, one.task) for one in rec.episodes] == list(
            enumerate(["0.0", "0.1", "1.0", "1.1", "2.0", "2.1"])
        )
        assert [rows_of(rec, one) for one in rec.episodes] == [[n] for n in range(6)]


def test_two_recorders_at_one_time_keep_theirs_apart(tmp_path: Path) -> None:
    with Experiment("a/b", root=tmp_path).run as first, Experiment("a/b", root=tmp_path).run as second:
        for n in range(4):
            for number, exp in enumerate((first, second)):
                exp.episode(task=f"{number}.{n}")
                exp.tracks(f"robot{number}").append(n=n, _ts=EPOCH + n)
    with Recording(first.path) as rec:
        assert [one.index for one in rec.episodes] == list(range(8))
        assert sorted(one.task or "" for one in rec.episodes) == [
            f"{number}.{n}" for number in (0, 1) for n in range(4)
        ]
        for one in rec.episodes:
            number, n = (one.task or "").split(".")
            assert rows_of(rec, one, f"robot{number}") == [int(n)]


def test_any_thread_may_begin_them(exp: Experiment) -> None:
    def work(number: int) -> None:
        for n in range(50):
            exp.episode(task=f"{number}.{n}")

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = episodes(exp)
    assert sorted(one.task or "" for one in found) == sorted(f"{number}.{n}" for number in range(4) for n in range(50))
    assert all(one.end is not None for one in found)


# What is refused


@pytest.mark.parametrize("how", ["experiment", "session"])
def test_there_are_none_before_the_start_and_after_the_end(tmp_path: Path, how: str) -> None:
    opened: dict[str, Callable[[], Any]] = {
        "experiment": lambda: Experiment("a/b", root=tmp_path),
        "session": lambda: Session(name="s", workspace="w", local_path=tmp_path),
    }
    with pytest.raises(StateError):
        opened[how]().episode()


@pytest.mark.parametrize(
    "said",
    [
        {"task": 5},
        {"success": "yes"},
        {"success": 1},
        {"metadata": [1]},
        {"metadata": {"bad": object()}},
        {"task": "\ud800"},
    ],
)
def test_what_cannot_be_stored_is_refused_at_the_call(exp: Experiment, said: dict[str, Any]) -> None:
    with pytest.raises(FieldError):
        exp.episode(**said)
    exp.episode(task="good").end()
    assert [one.task for one in episodes(exp)] == ["good"]


def test_what_cannot_be_stored_at_its_end_is_an_error_and_it_has_ended(exp: Experiment) -> None:
    def end_badly(n: int, error: type[Exception] | None) -> None:
        with exp.episode(task="pick") as episode:
            append(exp, n)
            episode.success = "perhaps"  # type: ignore[assignment]
            episode.metadata["bad"] = object()
            if error is not None:
                raise error

    append(exp, 0)
    with pytest.raises(FieldError):
        end_badly(1, None)
    with pytest.raises(ZeroDivisionError):
        end_badly(2, ZeroDivisionError)
    append(exp, 3)
    assert [one.end for one in episodes(exp)] == [0.1, 0.2]


def test_times_that_cannot_be_are_refused(exp: Experiment) -> None:
    for bad in (math.nan, -1.0, "soon"):
        with pytest.raises(TimestampError):
            exp.episode(_ts=bad)  # type: ignore[arg-type]
    episode = exp.episode(_ts=2.0)
    with pytest.raises(RangeError, match=r"starts at 2\.0 cannot end at _ts=1\.0") as caught:
        episode.end(_ts=1.0)
    assert isinstance(caught.value, ValueError)
    assert episode.is_open
    episode.end(_ts=2.0)
    assert [(one.start, one.end) for one in episodes(exp)] == [(2.0, 2.0)]


def test_their_topic_is_the_library_s_own(exp: Experiment) -> None:
    with pytest.raises(TopicError):
        exp.tracks("ml_dash/episodes")
    with exp.episode():
        append(exp, 0)
    exp.run.complete()
    with Recording(exp.path) as rec:
        assert list(rec.topics) == ["robot"]
        assert rec["ml_dash/episodes"].info.kind == "episode"
        assert rec.check()


# The marks


def test_each_mark_is_what_its_schema_says(exp: Experiment) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    append(exp, 0)
    exp.episode(task="pick", success=True, metadata={"seed": 7, "limits": [0.5, math.nan]})
    append(exp, 1)
    exp.episode()
    exp.run.complete()
    rows = disk.rows(exp.path)["ml_dash/episodes"]
    assert [(row["number"], row["revision"]) for row in rows] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    for row in rows:
        jsonschema.validate(row, shipped_schemas.load("ml_dash.episode"))
    assert rows[1]["task"] == "pick" and rows[1]["end"] == 0.1 and rows[1]["metadata"]["seed"] == 7
    channel, schema = disk.channel(exp.path, "ml_dash/episodes")
    assert (channel.metadata["kind"], schema.name) == ("episode", "ml_dash.episode")
    assert json.loads(schema.data) == shipped_schemas.load("ml_dash.episode")
    assert viewer_schema.violations(json.loads(schema.data)) == []


def test_marks_lie_on_the_tracks_clock(exp: Experiment) -> None:
    append(exp, 0)
    with exp.episode():
        append(exp, 5)
    exp.run.complete()
    assert [row["_ts"] for row in disk.rows(exp.path)["ml_dash/episodes"]] == [0.0, 0.5]


def test_a_recording_without_marks_has_no_episodes_and_what_is_no_mark_is_none(tmp_path: Path) -> None:
    with Recorder(tmp_path / "begun"), Recording(tmp_path / "begun") as rec:
        assert rec.episodes == []
    mark = {"run": "x", "number": 0, "revision": 0, "_ts": 3.0}
    rows: list[dict[str, Any]] = [
        {"task": "no run", "_ts": 0.0},
        {**mark, "number": "0"},
        {**mark, "task": 5, "success": "yes", "metadata": [1], "start": "a", "end": True},
    ]
    save(tmp_path / "a.mcap", [{"ml_dash/episodes": rows}], kinds={"ml_dash/episodes": "episode"})
    with Recording(tmp_path) as rec:
        assert rec.episodes == [Episode(0, None, 3.0, None, None, {})]
