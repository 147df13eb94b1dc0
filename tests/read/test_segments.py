"""A recording of many files opens soon, holds few of them open, and opens none twice."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.query.open_files import Segments
from ml_dash_mcap.query.places import LocalPlaces
from tests.support.files import draft, finished, save, unfinished

ROOT = Path(__file__).resolve().parents[2]
SEGMENTS = 1000

ROWS = [{"robot": [{"q": [i, 0.5], "_ts": float(i)} for i in range(3)]}]


@pytest.fixture(scope="module")
def long_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's folder of 1,000 segments, each with rows of its own."""
    folder = tmp_path_factory.mktemp("long") / "run"
    folder.mkdir()
    template = finished(draft([{"robot": [{"n": 100_000, "_ts": 1.0}]}]))
    for i in range(SEGMENTS):
        (folder / f"20260101T000000Z_{i + 1:06}.mcap").write_bytes(template)
    return folder


def test_a_folder_of_1000_segments_opens_within_a_second(long_run):
    with Recording(long_run):
        pass  # so that Python has compiled what is needed
    begun = time.process_time()
    with Recording(long_run) as rec:
        assert list(rec.topics) == ["robot"]
        assert len(rec.segments) == SEGMENTS
        took = time.process_time() - begun
    assert took < 1.0


UNDER_A_LIMIT = """
import json, resource, sys
from pathlib import Path

resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
from ml_dash_mcap import Recording

with Recording(sys.argv[1]) as rec:
    rows = sum(1 for _ in rec["robot"].rows())
    table = rec["robot"].to_arrow().num_rows
    most = len(list(Path("/proc/self/fd").iterdir())) if Path("/proc/self/fd").exists() else 0
    rec.refresh()
    print(json.dumps([len(rec.segments), rows, table, rec["robot"].info.count, most]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no such limit")
def test_a_folder_of_1000_segments_is_read_by_a_process_that_may_open_256_files(long_run):
    done = subprocess.run(
        [sys.executable, "-c", UNDER_A_LIMIT, str(long_run)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    segments, rows, table, count, most = json.loads(done.stdout)
    assert (segments, rows, table, count) == (SEGMENTS, 1, 1, 1)  # they all have the same time stamp, and merge
    assert most < 200


def test_segments_that_were_in_progress_when_they_were_opened_are_held_open_no_longer_than_that(tmp_path):
    path = tmp_path / "run" / "1.mcap.active"
    path.parent.mkdir()
    path.write_bytes(unfinished(draft(ROWS)))
    segments = Segments(LocalPlaces([path.parent]))
    [file] = segments.files
    path.write_bytes(finished(draft(ROWS)))
    path.rename(path.with_name("1.mcap"))
    assert segments.refresh()
    assert segments.files == [file]
    file.source.rest()  # type: ignore[attr-defined]  # as happens when many others are read
    assert len(file.source.read(0, 10)) == 10
    segments.close()


def test_a_reader_that_follows_a_recorder_sees_every_segment_however_many_there_are(tmp_path):
    options = RecorderOptions(chunk_bytes=256 * 1024, backlog_bytes=4 * 1024 * 1024, segment_bytes=1024 * 1024)
    with Recorder(tmp_path / "run", options) as recorder:
        topic = recorder.topic("robot")
        topic.append(blob="x" * 600_000, _ts=0.0)
        recorder.flush()
        with Recording(tmp_path / "run") as rec:
            for i in range(1, 6):
                topic.append(blob=os.urandom(400_000).hex(), _ts=float(i))
                recorder.flush()
                rec.refresh()
                assert len(rec["robot"]) == i + 1
            assert len(rec.segments) > 1


# -- several paths -----------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save(tmp_path / "run" / "1.mcap", ROWS, kinds={"robot": "log"})  # whose rows never merge
    save(tmp_path / "run" / "2.mcap", ROWS, kinds={"robot": "log"})
    return tmp_path / "run"


def count(*paths: Path) -> int:
    with Recording(paths) as rec:
        return len(list(rec["robot"].rows()))


def test_a_file_that_is_named_in_several_ways_is_opened_once(folder, monkeypatch):
    link = folder.parent / "link.mcap"
    link.symlink_to(folder / "1.mcap")
    monkeypatch.chdir(folder)
    assert count(folder) == 6
    assert count(folder, folder / "1.mcap") == 6
    assert count(Path("1.mcap"), folder / "1.mcap", link, folder / ".." / "run" / "1.mcap") == 3


def test_files_of_one_name_in_two_folders_are_two_files(folder):
    other = save(folder.parent / "other" / "1.mcap", ROWS, kinds={"robot": "log"})
    assert count(folder, other.parent) == 9


def test_files_are_in_the_order_in_which_they_were_given(folder):
    with Recording([folder / "2.mcap", folder]) as rec:
        assert [path.name for path in rec.segments] == ["2.mcap", "1.mcap"]


def test_a_file_that_is_gone_is_no_longer_part_of_it(folder):
    with Recording(folder) as rec:
        (folder / "1.mcap").unlink()
        assert rec.refresh()
        assert len(list(rec["robot"].rows())) == 3
        assert not rec.refresh()


def test_a_file_that_was_replaced_by_another_one_is_read_anew(folder):
    with Recording(folder) as rec:
        assert len(list(rec["robot"].rows())) == 6
        fresh = save(folder.parent / "fresh.mcap", [{"robot": [{"q": [7], "_ts": 7.0}]}], kinds={"robot": "log"})
        fresh.replace(folder / "2.mcap")
        assert rec.refresh()
        assert [row["_ts"] for row in rec["robot"].rows()] == [0.0, 1.0, 2.0, 7.0]
