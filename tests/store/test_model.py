"""Any sequence of calls does to a store what it does to a dictionary."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from obstore.store import MemoryStore

from ml_dash_mcap.errors import DestinationExistsError, MissingObjectError, StaleVersionError
from ml_dash_mcap.store.local import LocalFolder
from ml_dash_mcap.store.objects import ObjectStore
from ml_dash_mcap.store.store import Store
from tests.extensions.test_toy_store import ToyStore
from tests.support.examples import examples

STORES: dict[str, Callable[[Path], Store]] = {
    "local folder": LocalFolder,
    "obstore in memory": lambda path: ObjectStore(MemoryStore()),
    "toy": lambda path: ToyStore(),
}

NAMES = st.sampled_from(["a", "b/a", "b/c/a", "b/c/d", "b-1/a", "ü/50%"])
FOLDERS = st.sampled_from(["", "b", "b/c", "b-1", "absent", "a"])
CONTENTS = st.binary(max_size=20)
RANGES = st.lists(st.tuples(st.integers(0, 25), st.integers(0, 25)), max_size=4)


class Model(RuleBasedStateMachine):
    """A store beside a dictionary."""

    make: Callable[[Path], Store]

    @initialize()
    def begin(self) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.store = type(self).make(Path(self.folder.name) / "store")
        self.content: dict[str, bytes] = {}
        self.versions: dict[str, str] = {}
        self.stale: dict[str, str] = {}
        """A version that each name had before, whatever it has now."""

    def teardown(self) -> None:
        if hasattr(self, "folder"):
            self.folder.cleanup()

    def note(self, name: str, content: bytes, version: str) -> None:
        if name in self.versions:
            self.stale[name] = self.versions[name]
        self.content[name], self.versions[name] = content, version

    @rule(name=NAMES, content=CONTENTS)
    def put(self, name: str, content: bytes) -> None:
        self.note(name, content, self.store.put(name, content))

    @rule(name=NAMES, content=CONTENTS)
    def put_new(self, name: str, content: bytes) -> None:
        if name in self.content:
            with pytest.raises(DestinationExistsError):
                self.store.put_new(name, content)
        else:
            self.note(name, content, self.store.put_new(name, content))

    @rule(name=NAMES, content=CONTENTS)
    def replace(self, name: str, content: bytes) -> None:
        if name in self.versions:
            self.note(name, content, self.store.replace(name, content, self.versions[name]))

    @rule(name=NAMES, content=CONTENTS)
    def replace_what_is_not_there_any_more(self, name: str, content: bytes) -> None:
        if name in self.stale:
            with pytest.raises(StaleVersionError):
                self.store.replace(name, content, self.stale[name])

    @rule(name=NAMES)
    def delete(self, name: str) -> None:
        self.store.delete(name)
        self.content.pop(name, None)
        if name in self.versions:
            self.stale[name] = self.versions.pop(name)

    @rule(name=NAMES, ranges=RANGES)
    def read(self, name: str, ranges: list[tuple[int, int]]) -> None:
        if name not in self.content:
            with pytest.raises(MissingObjectError):
                self.store.head(name)
            return
        content = self.content[name]
        assert list(self.store.read_ranges(self.store.head(name), ranges)) == [content[a:b] for a, b in ranges]

    @rule(folder=FOLDERS, recursive=st.booleans())
    def list(self, folder: str, recursive: bool) -> None:
        start = f"{folder}/" if folder else ""
        below = sorted(name for name in self.content if name.startswith(start))
        wanted = [name for name in below if recursive or "/" not in name[len(start) :]]
        assert [stored.name for stored in self.store.list(folder, recursive=recursive)] == wanted

    @invariant()
    def it_has_what_the_dictionary_has(self) -> None:
        if hasattr(self, "store"):
            stored: list[Any] = [(entry.name, entry.size, entry.version) for entry in self.store.list()]
            assert stored == [(name, len(self.content[name]), self.versions[name]) for name in sorted(self.content)]


@pytest.mark.parametrize("kind", STORES)
def test_a_store_is_a_dictionary_of_whole_objects(kind: str) -> None:
    machine = type("Machine", (Model,), {"make": staticmethod(STORES[kind])})
    run_state_machine_as_test(
        machine, settings=settings(max_examples=examples(30), stateful_step_count=20, deadline=None)
    )
