"""What every store does, as tests: inherit from `StoreLaws`, and give it a fixture `store`, an empty one for each test."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ml_dash_mcap.errors import (
    DestinationExistsError,
    MissingObjectError,
    PrefixError,
    StaleVersionError,
    StorageError,
)
from ml_dash_mcap.store.store import Content, Store

THREADS = 8
ODD_NAMES = [
    "blank in it",
    "a%2Fb",
    "50%",
    "ü/日本.mcap",
    "e\u0301",
    "ab:c",
    "x#y?z&w=1",
    "~tilde",
    ".hidden",
    "(1)'\"*",
    "x" * 255,
]
NAMES_THAT_LEAVE = [
    "",
    "/etc/passwd",
    "..",
    "../x",
    "a/../../x",
    "a/..",
    "./a",
    "a/./b",
    "a//b",
    "a/",
    "C:\\x",
    "C:/x",
    "a\\b",
]
OTHER_BAD_NAMES = ["nul\0", "new\nline", "x" * 256, "\ud800"]


def names(store: Store, prefix: str = "", *, recursive: bool = True) -> list[str]:
    return [stored.name for stored in store.list(prefix, recursive=recursive)]


def read(store: Store, name: str) -> bytes:
    stored = store.head(name)
    return store.read_ranges(stored, [(0, stored.size)])[0]


def at_once(call: Callable[[int], Any]) -> list[Any]:
    """Call a function on several threads at once; returns what it returned or raised."""
    barrier = threading.Barrier(THREADS)
    results: list[Any] = [None] * THREADS

    def run(number: int) -> None:
        barrier.wait()
        try:
            results[number] = call(number)
        except Exception as error:
            results[number] = error

    threads = [threading.Thread(target=run, args=(number,)) for number in range(THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return results


class StoreLaws:
    # -- what is there -------------------------------------------------------------------------------------------------

    def test_an_object_is_what_was_put_and_its_size_time_and_version_are_known(self, store: Store) -> None:
        version = store.put("run/a.bin", b"hello")
        stored = store.head("run/a.bin")
        assert (stored.name, stored.size, stored.version) == ("run/a.bin", 5, version)
        assert abs(stored.modified - time.time()) < 3600
        assert store.list() == [stored]
        assert store.read_ranges(stored, [(0, 5)]) == [b"hello"]

    def test_an_object_is_made_of_a_local_file(self, store: Store, tmp_path: Path) -> None:
        content = bytes(range(256)) * 40_000  # 10 MB: more than one part of an upload
        (tmp_path / "content").write_bytes(content)
        store.put("large", tmp_path / "content")
        assert read(store, "large") == content

    def test_an_empty_object_is_an_object(self, store: Store) -> None:
        store.put("empty", b"")
        stored = store.head("empty")
        assert stored.size == 0
        assert store.read_ranges(stored, [(0, 0), (0, 10), (5, 10)]) == [b"", b"", b""]
        assert names(store) == ["empty"]

    def test_what_is_not_there_is_a_file_not_found_error(self, store: Store) -> None:
        with pytest.raises(MissingObjectError) as caught:
            store.head("run/absent")
        assert isinstance(caught.value, FileNotFoundError)
        assert isinstance(caught.value, StorageError)
        store.put("run/a", b"")
        with pytest.raises(MissingObjectError):
            store.head("run")  # a folder is no object

    def test_a_deleted_object_is_gone_and_deleting_it_again_does_nothing(self, store: Store) -> None:
        store.put("run/a", b"1")
        stored = store.head("run/a")
        store.delete("run/a")
        store.delete("run/a")
        store.delete("never/there")
        assert names(store) == []
        with pytest.raises(MissingObjectError):
            store.read_ranges(stored, [(0, 1)])

    def test_the_url_names_the_store_in_errors(self, store: Store) -> None:
        with pytest.raises(MissingObjectError, match="absent") as caught:
            store.head("absent")
        assert store.url
        assert store.url in str(caught.value)

    # -- lists ---------------------------------------------------------------------------------------------------------

    def test_a_list_is_sorted_by_name(self, store: Store) -> None:
        wanted = ["a", "b-1", "b/1", "b/10", "b/9", "b0", "ü"]
        for name in reversed(wanted):
            store.put(name, b"")
        assert names(store) == wanted

    def test_a_prefix_is_a_folder_and_not_the_beginning_of_a_name(self, store: Store) -> None:
        for name in ("run/a", "run/b/c", "run-2/a", "ru", "other/run/a"):
            store.put(name, b"")
        assert names(store, "run") == ["run/a", "run/b/c"]
        assert names(store, "run/b") == ["run/b/c"]
        assert names(store, "ru") == []
        assert names(store, "absent") == []

    def test_a_list_that_is_not_recursive_has_only_what_lies_in_the_folder_itself(self, store: Store) -> None:
        for name in ("top", "run/a", "run/b/c", "run/z"):
            store.put(name, b"")
        assert names(store, recursive=False) == ["top"]
        assert names(store, "run", recursive=False) == ["run/a", "run/z"]
        assert names(store, "absent", recursive=False) == []

    def test_many_objects_are_all_listed(self, store: Store) -> None:
        wanted = [f"run/{number:04}" for number in range(220)]  # several pages of 50
        for name in wanted:
            store.put(name, b"x")
        assert names(store) == wanted
        assert names(store, "run", recursive=False) == wanted

    # -- names ---------------------------------------------------------------------------------------------------------

    def test_names_with_odd_characters_are_names(self, store: Store) -> None:
        for name in ODD_NAMES:
            store.put(name, name.encode())
        assert names(store) == sorted(ODD_NAMES)
        for name in ODD_NAMES:
            assert read(store, name) == name.encode()
            store.delete(name)
        assert names(store) == []

    @pytest.mark.parametrize("name", [*NAMES_THAT_LEAVE, *OTHER_BAD_NAMES], ids=ascii)
    def test_a_name_that_leaves_the_store_or_that_some_store_refuses_is_refused(self, store: Store, name: str) -> None:
        store.put("a/x", b"kept")
        stored = store.head("a/x")
        calls: list[Callable[[], object]] = [
            lambda: store.head(name),
            lambda: store.put(name, b"1"),
            lambda: store.put_new(name, b"1"),
            lambda: store.replace(name, b"1", stored.version),
            lambda: store.delete(name),
            lambda: store.read_ranges(type(stored)(name, 1, 0.0, ""), [(0, 1)]),
        ]
        calls += [lambda: store.list(name)] if name else []
        for call in calls:
            with pytest.raises(PrefixError):
                call()
        assert names(store) == ["a/x"]

    # -- ranges --------------------------------------------------------------------------------------------------------

    def test_a_range_does_not_include_its_end(self, store: Store) -> None:
        store.put("a", b"0123456789")
        assert store.read_ranges(store.head("a"), [(2, 5), (0, 1), (9, 10)]) == [b"234", b"0", b"9"]

    def test_ranges_may_overlap_repeat_and_come_in_any_order(self, store: Store) -> None:
        content = bytes(range(256)) * 20_000  # 5 MB, so that ranges far apart are requests of their own
        store.put("a", content)
        ranges = [(5_000_000, 5_000_010), (0, 10), (5, 20), (0, 10), (2_500_000, 2_500_001), (7, 7)]
        assert store.read_ranges(store.head("a"), ranges) == [content[start:end] for start, end in ranges]

    def test_a_range_ends_with_its_object(self, store: Store) -> None:
        store.put("a", b"0123456789")
        ranges = [(8, 100), (10, 20), (11, 12), (2**40, 2**41), (5, 3)]
        assert store.read_ranges(store.head("a"), ranges) == [b"89", b"", b"", b"", b""]

    def test_no_ranges_are_no_bytes(self, store: Store) -> None:
        store.put("a", b"0123456789")
        assert list(store.read_ranges(store.head("a"), [])) == []

    def test_an_object_that_was_replaced_is_not_read_as_what_it_was(self, store: Store) -> None:
        store.put("a", b"0123456789")
        stored = store.head("a")
        store.put("a", b"9876543210")
        with pytest.raises(StaleVersionError):
            store.read_ranges(stored, [(0, 5)])

    # -- conditions ----------------------------------------------------------------------------------------------------

    def test_put_replaces_and_the_version_of_another_content_is_another(self, store: Store) -> None:
        versions = [store.put("a", content) for content in (b"1", b"2", b"3")]  # S3 makes versions of the content
        assert len(set(versions)) == 3
        assert read(store, "a") == b"3"
        assert store.head("a").version == versions[-1]

    def test_put_new_leaves_what_is_there(self, store: Store) -> None:
        version = store.put_new("run/a", b"first")
        with pytest.raises(DestinationExistsError) as caught:
            store.put_new("run/a", b"second")
        assert isinstance(caught.value, FileExistsError)
        assert read(store, "run/a") == b"first"
        assert store.head("run/a").version == version

    def test_of_several_that_put_the_same_new_object_one_does(self, store: Store) -> None:
        for attempt in range(20):
            name = f"run/{attempt}"
            results = at_once(lambda number, name=name: store.put_new(name, b"%d" % number))  # type: ignore[misc]
            [winner] = [number for number, result in enumerate(results) if isinstance(result, str)]
            assert sum(isinstance(result, DestinationExistsError) for result in results) == THREADS - 1
            assert read(store, name) == b"%d" % winner

    def test_replace_replaces_the_version_that_was_seen(self, store: Store) -> None:
        first = store.put("a", b"1")
        second = store.replace("a", b"2", first)
        assert second != first
        assert (read(store, "a"), store.head("a").version) == (b"2", second)

    def test_replace_refuses_a_stale_version_and_leaves_what_is_there(self, store: Store) -> None:
        stale = store.put("a", b"1")
        store.put("a", b"2")
        with pytest.raises(StaleVersionError):
            store.replace("a", b"3", stale)
        assert read(store, "a") == b"2"

    def test_replace_refuses_a_version_of_what_is_gone(self, store: Store) -> None:
        version = store.put("a", b"1")
        store.delete("a")
        with pytest.raises(StaleVersionError):
            store.replace("a", b"2", version)
        assert names(store) == []

    def test_a_counter_that_is_replaced_by_several_at_once_counts_them_all(self, store: Store) -> None:
        store.put("counter", b"0")

        def count(number: int) -> None:
            while True:
                stored = store.head("counter")
                try:
                    value = int(store.read_ranges(stored, [(0, stored.size)])[0])
                    store.replace("counter", b"%d" % (value + 1), stored.version)
                    return
                except StaleVersionError:
                    continue

        assert at_once(count) == [None] * THREADS
        assert read(store, "counter") == b"%d" % THREADS

    # -- whole or not at all -------------------------------------------------------------------------------------------

    def test_a_reader_never_sees_a_part_of_an_object_nor_of_two(self, store: Store) -> None:
        size = 1_000_000
        store.put("a", b"0" * size)
        stop = threading.Event()

        def write() -> None:
            number = 0
            while not stop.is_set():
                number = (number + 1) % 10
                store.put("a", b"%d" % number * size)

        writer = threading.Thread(target=write)
        writer.start()
        whole = 0
        try:
            while whole < 30:
                stored = store.head("a")
                assert stored.size == size
                assert names(store) == ["a"]
                try:
                    first, last = store.read_ranges(stored, [(0, 1), (0, size)])
                except StaleVersionError:
                    continue
                assert last == first * size
                whole += 1
        finally:
            stop.set()
            writer.join()

    @pytest.mark.parametrize("verb", ["put", "put_new", "replace"])
    def test_content_that_cannot_be_read_leaves_nothing(self, store: Store, tmp_path: Path, verb: str) -> None:
        version = store.put("other", b"1")
        absent: Content = tmp_path / "absent"
        arguments = ("other", absent, version) if verb == "replace" else ("run/a", absent)
        with pytest.raises(StorageError, match=r"cannot be copied.*absent"):
            getattr(store, verb)(*arguments)
        assert names(store) == ["other"]
        assert read(store, "other") == b"1"
