"""A local file gives its bytes by range, and counts what it gave."""

import pytest

from ml_dash_mcap.errors import MissingRecordingError, StorageError
from ml_dash_mcap.read.source import LocalFile


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
