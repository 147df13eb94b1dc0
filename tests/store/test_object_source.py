"""An object is read by range as a file is: exactly, with few requests, and with bounded memory."""

from __future__ import annotations

import random
import threading

import pytest

from ml_dash_mcap.errors import StaleVersionError, StorageError
from ml_dash_mcap.store import object_source
from ml_dash_mcap.store.block_cache import BLOCK_BYTES, BlockCache
from ml_dash_mcap.store.object_source import ObjectSource
from ml_dash_mcap.store.ranges import coalesced
from tests.extensions.test_toy_store import ToyStore
from tests.support.stored_recordings import Counting

SIZE = 10 * BLOCK_BYTES + 123
CONTENT = random.Random(0).randbytes(SIZE)


@pytest.fixture
def store() -> Counting:
    store = Counting(ToyStore())
    store.put("a", CONTENT)
    return store


@pytest.fixture
def source(store: Counting) -> ObjectSource:
    return ObjectSource(store, store.head("a"))


def test_any_range_is_that_of_the_content(source: ObjectSource) -> None:
    numbers = random.Random(1)
    edges = [0, 1, BLOCK_BYTES - 1, BLOCK_BYTES, BLOCK_BYTES + 1, SIZE - 1, SIZE, SIZE + 5, 2**63]
    for _ in range(500):
        offset = numbers.choice([*edges, numbers.randrange(SIZE)])
        length = numbers.choice([*edges, numbers.randrange(3 * BLOCK_BYTES)])
        if numbers.random() < 0.2:
            source.expect([(offset, offset + length), (0, 10), (5, SIZE), (SIZE - 10, SIZE)])
        assert source.read(offset, length) == CONTENT[offset : offset + length]


def test_what_is_expected_is_fetched_with_the_first_of_it(source: ObjectSource, store: Counting) -> None:
    ranges = [(number * BLOCK_BYTES, number * BLOCK_BYTES + 100) for number in range(1, 9, 2)]
    source.expect(ranges)
    assert [source.read(start, end - start) for start, end in ranges] == [CONTENT[start:end] for start, end in ranges]
    assert store.asked == [ranges]


def test_no_more_is_fetched_ahead_than_a_bound(store: Counting, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(object_source, "_AHEAD_BYTES", 3 * BLOCK_BYTES)
    source = ObjectSource(store, store.head("a"))
    ranges = [(number * BLOCK_BYTES, (number + 1) * BLOCK_BYTES) for number in range(8)]
    source.expect(ranges)
    for start, end in ranges:
        assert source.read(start, end - start) == CONTENT[start:end]
    assert store.asked == [ranges[:3], ranges[3:6], ranges[6:]]


def test_a_source_knows_its_size_and_reads_no_more_when_it_was_closed(source: ObjectSource) -> None:
    assert (source.name, source.size(), source.stored_bytes()) == ("a", SIZE, SIZE)
    source.close()
    source.close()
    with pytest.raises(StorageError, match="closed"):
        source.read(0, 1)


def test_a_source_is_one_version(source: ObjectSource, store: Counting) -> None:
    assert source.is_version(store.head("a"))
    assert source.read(0, 10) == CONTENT[:10]
    store.put("a", b"another")
    assert not source.is_version(store.head("a"))
    with pytest.raises(StaleVersionError):
        source.read(5 * BLOCK_BYTES, 10)


def test_threads_read_one_source(source: ObjectSource) -> None:
    wrong = []

    def read(seed: int) -> None:
        numbers = random.Random(seed)
        for _ in range(300):
            offset, length = numbers.randrange(SIZE), numbers.randrange(2 * BLOCK_BYTES)
            if source.read(offset, length) != CONTENT[offset : offset + length]:
                wrong.append((offset, length))

    threads = [threading.Thread(target=read, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_cache_keeps_what_was_used_last_and_no_more_bytes_than_it_may() -> None:
    cache = BlockCache(300)
    cache.put(1, {0: b"a" * 100, 1: b"b" * 100})
    cache.put(2, {0: b"c" * 100})
    assert set(cache.get(1, [0, 1])) == {0, 1}
    cache.put(2, {1: b"d" * 100})
    assert cache.get(2, [0, 1, 2]) == {1: b"d" * 100}
    assert set(cache.get(1, [0, 1])) == {0, 1}
    cache.put(3, {0: b"e" * 301})
    assert [cache.get(owner, [0, 1]) for owner in (1, 2, 3)] == [{}, {}, {}]
    cache.put(1, {0: b"a" * 100})
    cache.forget(1)
    assert cache.get(1, [0]) == {}


@pytest.mark.parametrize(
    ("ranges", "gap", "joined"),
    [
        ([], 10, []),
        ([(5, 5), (7, 3)], 10, []),
        ([(0, 5), (5, 7)], 0, [(0, 7)]),
        ([(20, 30), (0, 5), (3, 8)], 11, [(0, 8), (20, 30)]),
        ([(20, 30), (0, 5), (3, 8)], 12, [(0, 30)]),
        ([(0, 30), (5, 10)], 0, [(0, 30)]),
    ],
)
def test_neighbours_are_read_together(ranges: list[tuple[int, int]], gap: int, joined: list[tuple[int, int]]) -> None:
    assert coalesced(ranges, gap) == joined
