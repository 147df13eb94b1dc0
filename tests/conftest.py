"""What holds for every test: each file that our recorder finished in the test's folder suits all its readers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.rules import problems

OUR_LIBRARY = b"ml_dash_mcap "
_LIBRARY_AT = 8 + 9 + 4 + 0 + 4
"""Magic, prefix of the Header, an empty profile, the length of the library's name."""


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers", "breaks_files: the test damages files of the recorder on purpose; they are not judged"
    )


def _is_ours(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(_LIBRARY_AT + len(OUR_LIBRARY))[_LIBRARY_AT:] == OUR_LIBRARY


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
        for problem in problems(path)
    ]
    assert not found, "a finished file breaks the rules of its readers:\n" + "\n".join(found[:20])
