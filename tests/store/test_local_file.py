"""A local file gives its bytes by range, counts what it gave, and is open only while it is needed."""

import os
import threading

import pytest

from ml_dash_mcap.errors import DamagedFileError, MissingRecordingError, StorageError
from ml_dash_mcap.store import local_file as sources
from ml_dash_mcap.store.local_file import LocalFile


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(bytes(range(100)))
    return path


def test_a_range_is_what_lies_between_its_ends(path):
    source = LocalFile(path)
    assert source.read(10, 5) == bytes(range(10, 15))
    assert (source.bytes_read, source.reads) == (5, 1)


def test_a_range_that_leaves_the_file_ends_with_it(path):
    source = LocalFile(path)
    assert source.read(98, 5) == bytes([98, 99])
    assert source.read(200, 5) == b""


def test_the_size_is_that_of_now(path):
    source = LocalFile(path)
    path.write_bytes(bytes(200))
    assert source.size() == 200


def test_a_renamed_file_is_still_the_same_file(path):
    source = LocalFile(path)
    renamed = path.rename(path.with_name("renamed"))
    path.write_bytes(b"another")
    assert source.is_at(renamed)
    assert not source.is_at(path)
    assert not source.is_at(path.with_name("absent"))


def test_a_missing_file_is_a_file_not_found_error(tmp_path):
    with pytest.raises(MissingRecordingError, match="no such file") as caught:
        LocalFile(tmp_path / "absent")
    assert isinstance(caught.value, FileNotFoundError)


def test_a_file_may_be_closed_twice_and_is_not_read_afterwards(path):
    source = LocalFile(path)
    source.close()
    source.close()
    with pytest.raises(StorageError):
        source.read(0, 1)
    with pytest.raises(StorageError):
        source.size()


@pytest.mark.parametrize("offset", [100, 2**31, 2**63 - 1, 2**63, 2**64 - 1])
@pytest.mark.parametrize("length", [0, 1, 2**63, 2**64 - 1])
def test_a_range_that_no_file_can_have_is_empty(path, offset, length):
    assert LocalFile(path).read(offset, length) == b""


def test_a_length_that_no_memory_holds_gives_what_there_is(path):
    assert LocalFile(path).read(90, 2**63) == bytes(range(90, 100))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.timeout(10)
def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(DamagedFileError, match="a pipe"):
        LocalFile(tmp_path / "pipe.mcap")


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(DamagedFileError, match="a folder"):
        LocalFile(tmp_path)


def open_files(files):
    return sum(file._handle is not None for file in files)


def test_of_many_files_only_those_that_were_read_last_are_open(tmp_path):
    files = []
    for i in range(sources._MOST_OPEN + 50):
        (tmp_path / str(i)).write_bytes(b"%d" % i)
        files.append(LocalFile(tmp_path / str(i)))
    assert open_files(files) == sources._MOST_OPEN
    assert [file.read(0, 10) for file in files] == [b"%d" % i for i in range(len(files))]
    assert open_files(files) == sources._MOST_OPEN
    assert all(file._handle is not None for file in files[-sources._MOST_OPEN :])


def test_a_file_that_rests_and_is_gone_is_a_file_not_found_error(path):
    source = LocalFile(path)
    source.rest()
    path.unlink()
    with pytest.raises(MissingRecordingError):
        source.read(0, 1)


def test_a_file_that_rests_and_was_replaced_is_not_taken_for_itself(path, tmp_path):
    source = LocalFile(path)
    source.rest()
    (tmp_path / "other").write_bytes(b"other")
    (tmp_path / "other").replace(path)
    with pytest.raises(StorageError, match="another file"):
        source.read(0, 1)


def test_a_file_that_may_be_renamed_stays_open_until_it_has_its_name(path):
    source = LocalFile(path, stays_open=True)
    renamed = path.rename(path.with_name("renamed"))
    for i in range(sources._MOST_OPEN + 10):
        (path.parent / str(i)).write_bytes(b"")
    others = [LocalFile(path.parent / str(i)) for i in range(sources._MOST_OPEN + 10)]
    assert source.read(0, 1) == b"\0"
    source.settle(renamed)
    assert [other.size() for other in others] == [0] * len(others)
    assert source._handle is None
    assert source.read(1, 1) == b"\1"


def test_threads_may_read_files_that_are_closed_and_opened_under_them(tmp_path):
    for i in range(sources._MOST_OPEN + 100):
        (tmp_path / str(i)).write_bytes(b"%d" % i)
    files = [LocalFile(tmp_path / str(i)) for i in range(sources._MOST_OPEN + 100)]
    wrong = []

    def read_all(step):
        for i in range(0, len(files) * 3, step):
            at = i % len(files)
            if files[at].read(0, 10) != b"%d" % at:
                wrong.append(at)

    threads = [threading.Thread(target=read_all, args=(step,)) for step in (1, 3, 5, 7)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
