"""Files that an earlier release wrote are read as they were then, and the same input is still written as the same bytes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from ml_dash_mcap import Recording
from tests.corpus.programs import EXPORTS, OLDER, PROGRAMS, rows_of
from tests.support.records import Opcode, Record
from tests.support.sections import cut

CORPUS = Path(__file__).resolve().parent / "corpus" / "files"

OF_THE_START = (Opcode.METADATA, Opcode.METADATA_INDEX)
"""Records that say when and by whom a recording was made."""


def records_of(folder: Path) -> list[tuple[int, bytes]]:
    """What a recording's files hold, chunks unpacked: the records of the data section, with all of their bytes."""
    return [
        (record.opcode, record.content)
        for path in sorted(folder.glob("*.mcap"))
        for record in contents(path)
        if record.opcode not in (*OF_THE_START, Opcode.CHUNK)
    ]


def contents(path: Path) -> list[Record]:
    return list(cut(path.read_bytes()).contents())


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    for name, program in PROGRAMS.items():
        program(folder / name)
    return folder


@pytest.mark.about_json
@pytest.mark.parametrize("name", [*PROGRAMS, *EXPORTS, *OLDER])
def test_a_file_of_an_earlier_release_gives_the_rows_that_it_gave_then(name: str, tmp_path: Path) -> None:
    place = tmp_path / name
    (shutil.copytree if (CORPUS / name).is_dir() else shutil.copy)(CORPUS / name, place)

    assert rows_of(place) == json.loads((CORPUS / f"{name}.rows.json").read_text())


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_same_input_is_recorded_as_the_same_records(name: str, recorded: Path) -> None:
    assert records_of(recorded / name) == records_of(CORPUS / name)


@pytest.mark.parametrize("name", [name for name in EXPORTS if not name.endswith(".parquet")])
@pytest.mark.filterwarnings("ignore:there are messages at time 0")
def test_the_same_recording_is_exported_as_the_same_bytes(name: str, tmp_path: Path) -> None:
    target, options = EXPORTS[name]
    shutil.copytree(CORPUS / "values-zstd", tmp_path / "values-zstd")
    with Recording(tmp_path / "values-zstd") as recording:
        recording.export(tmp_path / name, format=target, **options)

    files = [path.relative_to(CORPUS) for path in sorted((CORPUS / name).rglob("*")) if path.is_file()] or [Path(name)]
    for path in files:
        assert (tmp_path / path).read_bytes() == (CORPUS / path).read_bytes(), path


@pytest.mark.breaks_files
def test_a_recording_that_an_earlier_release_died_over_is_recovered(tmp_path: Path) -> None:
    folder = tmp_path / "dead"
    shutil.copytree(CORPUS / "dead", folder)
    for session in folder.glob(".ml_dash-*.json"):
        session.write_text(session.read_text().replace("/recordings/dead", str(folder)))

    with Recording(folder) as recording:
        rows = list(recording["robot"].rows())

    assert rows == [{"q": [0.1 * step, 1.0], "_ts": step * 0.01} for step in range(300)]
