"""The stores that come with the package do what every store does; and a local folder does it between processes."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from obstore.store import MemoryStore, S3Store

from ml_dash_mcap import Recording, convert, recordings
from ml_dash_mcap.errors import MissingObjectError, PrefixError, StorageError, UsageError
from ml_dash_mcap.store.local import LocalFolder
from ml_dash_mcap.store.objects import ObjectStore
from ml_dash_mcap.store.store import Store
from tests.support.store_laws import StoreLaws, names, read
from tests.support.stored_recordings import Counting, RecordingLaws, local_run

__all__ = ["local_run"]

ROOT = Path(__file__).resolve().parents[2]


class TestLocalFolder(StoreLaws):
    @pytest.fixture
    def store(self, tmp_path: Path) -> Store:
        return LocalFolder(tmp_path / "store")


class TestRecordingsInALocalFolder(RecordingLaws):
    @pytest.fixture
    def store(self, tmp_path: Path) -> Store:
        return Counting(LocalFolder(tmp_path / "store"))  # which is read by its ranges, not as paths of this machine


def test_a_recording_in_a_local_folder_is_that_of_its_path(local_run: Path, tmp_path: Path) -> None:
    with Recording(local_run.name, store=LocalFolder(local_run.parent)) as rec:
        assert (rec.path, rec.store) == (local_run, None)
        dest = rec.export("out/event.csv", store=LocalFolder(tmp_path), topics=["event"])
    assert dest == tmp_path / "out" / "event.csv"
    assert dest.is_file()
    assert [entry.path for entry in recordings("", store=LocalFolder(local_run.parent))] == [local_run]


@pytest.mark.parametrize("name", ["/etc/passwd", "../../x", "a/../..", "a//b", "nul\0"])
def test_a_local_folder_has_no_path_for_a_name_that_leaves_it(tmp_path: Path, name: str) -> None:
    with pytest.raises(PrefixError):
        LocalFolder(tmp_path).path_of(name)


def test_a_local_folder_has_paths_for_names_and_for_itself(tmp_path: Path) -> None:
    assert LocalFolder(tmp_path).path_of("run/a.mcap") == tmp_path / "run" / "a.mcap"
    assert LocalFolder(tmp_path).path_of("") == tmp_path


def test_a_local_folder_goes_to_another_process_and_is_the_same_store_there(tmp_path: Path) -> None:
    folder = LocalFolder(tmp_path)
    folder.put("a", b"old")
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        pool.apply(LocalFolder.put, (folder, "a", b"new"))
    copy = pickle.loads(pickle.dumps(folder))
    assert (copy.root, read(copy, "a"), read(folder, "a")) == (tmp_path, b"new", b"new")


def test_an_object_store_is_pickled_if_its_store_of_obstore_is() -> None:
    store = ObjectStore(S3Store("bucket", region="eu-west-1"), url="s3://bucket")
    assert repr(pickle.loads(pickle.dumps(store))) == repr(store)
    with pytest.raises(TypeError, match="MemoryStore"):
        pickle.dumps(ObjectStore(MemoryStore()))


NO_STORES = {
    "a store of obstore": (MemoryStore(), r"of type MemoryStore.*; pass ObjectStore\(\.\.\.\) around it"),
    "a number": (5, r"store=5 is of type int.*; pass LocalFolder\(path\), ObjectStore\(\.\.\.\)"),
    "text": ("mcap", r"store='mcap' is of type str.*; pass LocalFolder\(path\), ObjectStore\(\.\.\.\)"),
    "a class": (LocalFolder, r"; pass an instance, as LocalFolder\(\.\.\.\) makes it"),
}


@pytest.mark.parametrize(("store", "advice"), NO_STORES.values(), ids=NO_STORES)
def test_what_is_no_store_is_refused_with_what_to_pass(
    local_run: Path, tmp_path: Path, store: Any, advice: str
) -> None:
    with Recording(local_run) as rec:
        for call in (
            lambda: Recording("demo", store=store),
            lambda: recordings("", store=store),
            lambda: rec.export("event.csv", store=store, topics=["event"]),
            lambda: convert(local_run, "event.csv", store=store, topics=["event"]),
        ):
            with pytest.raises(UsageError, match=advice):
                call()


class TestObjectStoreInMemory(StoreLaws, RecordingLaws):
    @pytest.fixture
    def store(self) -> Store:
        return ObjectStore(MemoryStore(), url="memory:")


def python(code: str, *arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


RACER = """
import sys
from ml_dash_mcap.errors import DestinationExistsError
from ml_dash_mcap.store.local import LocalFolder

store = LocalFolder(sys.argv[1])
won = []
for number in range(50):
    try:
        store.put_new(f"run/{number}", sys.argv[2].encode())
        won.append(number)
    except DestinationExistsError:
        pass
print(*won)
"""


def test_of_several_processes_that_put_the_same_new_object_one_does(tmp_path: Path) -> None:
    racers = [python(RACER, tmp_path, name) for name in "ab"]
    won = {name: done.communicate()[0].split() for name, done in zip("ab", racers, strict=True)}
    assert sorted(map(int, won["a"] + won["b"])) == list(range(50))
    store = LocalFolder(tmp_path)
    for name, numbers in won.items():
        assert all(read(store, f"run/{number}") == name.encode() for number in numbers)


WRITER = """
import sys
from pathlib import Path
from ml_dash_mcap.store.local import LocalFolder

LocalFolder(sys.argv[1]).put("run/a", Path(sys.argv[2]))
"""


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_a_process_that_is_killed_while_it_puts_an_object_leaves_nothing_that_can_be_seen(tmp_path: Path) -> None:
    content, store = tmp_path / "content", LocalFolder(tmp_path / "store")
    os.mkfifo(content)
    writer = python(WRITER, store.root, content)
    with content.open("wb") as pipe:  # opens when the writer reads
        pipe.write(b"x" * 10_000)
        pipe.flush()
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.communicate()
    assert [path.name for path in (store.root / "run").iterdir()] != []  # it was killed in the middle
    assert names(store) == []
    with pytest.raises(MissingObjectError):
        store.head("run/a")
    store.put_new("run/a", b"whole")
    assert names(store) == ["run/a"]


def test_files_that_others_put_into_a_local_folder_are_objects(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "a").write_bytes(b"1")
    (tmp_path / "run" / "link").symlink_to("a")
    (tmp_path / "run" / "nowhere").symlink_to("absent")
    assert names(LocalFolder(tmp_path)) == ["run/a", "run/link"]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the superuser may read everything")
def test_a_local_folder_that_may_not_be_read_is_a_storage_error(tmp_path: Path) -> None:
    (tmp_path / "closed").mkdir(mode=0)
    with pytest.raises(StorageError, match="cannot be listed"):
        LocalFolder(tmp_path / "closed").list()


def test_what_a_local_folder_cannot_do_is_a_storage_error_with_its_path(tmp_path: Path) -> None:
    store = LocalFolder(tmp_path)
    store.put("a", b"1")
    with pytest.raises(StorageError, match="a/b"):
        store.put("a/b", b"1")  # a file is no folder
    assert names(store) == ["a"]
