"""What holds for every test: each file that our recorder finished in the test's folder suits all its readers."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import absent, examples
from tests.support.rules import problems

OUR_LIBRARY = b"ml_dash_mcap "
_LIBRARY_AT = 8 + 9 + 4 + 0 + 4
"""Magic, prefix of the Header, an empty profile, the length of the library's name."""


SEED_PAGES = Path(__file__).resolve().parents[2] / "shared" / "seeds"

collect_ignore = [] if SEED_PAGES.is_dir() else ["test_seed_pages.py"]
"""The pages that specify the two APIs lie beside the repository on some machines."""


def pytest_report_header() -> list[str]:
    """Say which tests are left out because what they ask is not on this machine."""
    return [f"left out: the tests that ask {what}" for what in absent.judges().values()]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave those tests out."""
    missing = absent.judges().keys()
    items[:] = [item for item in items if not absent.needs(item) & missing]


def pytest_configure(config: pytest.Config) -> None:
    examples.load_profile()
    config.addinivalue_line(
        "markers", "about_json: the test looks into payloads of JSON, which it records whatever the environment says"
    )
    config.addinivalue_line(
        "markers", "breaks_files: the test damages files of the recorder on purpose; they are not judged"
    )


def _is_ours(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(_LIBRARY_AT + len(OUR_LIBRARY))[_LIBRARY_AT:] == OUR_LIBRARY


@pytest.fixture(autouse=True)
def _json_for_what_is_about_it(request: pytest.FixtureRequest) -> Iterator[None]:
    """All other tests can be run with another `ML_DASH_ENCODING`, too."""
    with pytest.MonkeyPatch.context() as environment:
        if request.node.get_closest_marker("about_json"):
            environment.delenv("ML_DASH_ENCODING", raising=False)
        yield


@pytest.fixture(autouse=True)
def _every_finished_file_is_clean(request: pytest.FixtureRequest) -> Iterator[None]:
    yield
    folder = getattr(request.node, "funcargs", {}).get("tmp_path")
    if folder is None or request.node.get_closest_marker("breaks_files"):
        return
    found = [
        f"{path.relative_to(folder)}: {problem}"
        for path in sorted(folder.rglob("*.mcap"))
        if path.is_file() and _is_ours(path)
        for problem in _judged(path)
    ]
    assert not found, "a finished file breaks the rules of its readers:\n" + "\n".join(found[:20])


_CLEAN: set[bytes] = set()
"""Digests of the contents that the judge found clean: copies of a file are judged once."""


def _judged(path: Path) -> list[str]:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha1").digest() if sys.version_info >= (3, 11) else None
    if digest in _CLEAN:
        return []
    faults = problems(path)
    if not faults and digest is not None:
        _CLEAN.add(digest)
    return faults
