"""All files of the MCAP project's conformance suite read as they are described, however long their records are."""

from __future__ import annotations

import json
import subprocess
import sys
import zlib
from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from ml_dash_mcap import Recording
from tests.support import conformance, shared
from tests.support.conformance import OPCODES, PAD, Build, build, file_name, variants
from tools.conformance import differences

pytestmark = pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.UndecodedWarning")

ROOT = Path(__file__).resolve().parents[1]

EXTENDABLE = frozenset(OPCODES) - {"Footer", "Message"}
"""'The Footer and Message records will not be extended, since their formats do not allow for backward-compatible size
changes.' (https://mcap.dev/spec#records)"""

ALL_OF = {
    "OneMessage": frozenset(("ch", "mx", "st", "rsh", "rch", "chx", "sum", "pad")),
    "OneAttachment": frozenset(("ax", "st", "sum", "pad")),
    "OneMetadata": frozenset(("mdx", "st", "sum", "pad")),
    "TenMessages": frozenset(("ch", "mx", "st", "rsh", "rch", "chx", "sum", "pad")),
}


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite")
    assert conformance.save(folder) == 416
    return folder


@pytest.mark.parametrize("family", conformance.INPUTS)
def test_every_variant_reads_as_it_is_described(suite: Path, family: str) -> None:
    paths = sorted((suite / family).glob("*.mcap"))
    assert {path.name: differences(path) for path in paths} == {path.name: [] for path in paths}


@pytest.mark.parametrize(("family", "count"), [("OneMessage", 154), ("TenMessages", 154)])
def test_the_suites_own_files_read_as_they_are_described_and_are_those_that_are_built_here(
    family: str, count: int
) -> None:
    paths = {path.stem: path for path in shared.file(f"conformance/{family}").glob("*.mcap")}
    assert len(paths) == count
    assert {name: differences(path) for name, path in paths.items()} == {name: [] for name in paths}
    for name, features in variants():
        if name == family:
            path, made = paths[file_name(name, features)], build(name, features)
            assert made.data == path.read_bytes()
            assert json.loads(conformance.description(made)) == json.loads(path.with_suffix(".json").read_text())


def test_the_tool_prints_how_many_files_read_and_names_those_that_do_not(suite: Path, tmp_path: Path) -> None:
    for path in (suite / "NoData").iterdir():
        (tmp_path / "NoData").mkdir(exist_ok=True)
        (tmp_path / "NoData" / path.name).write_bytes(path.read_bytes())
    assert (code_of(suite), code_of(tmp_path), code_of(tmp_path / "NoData")) == (0, 0, 1)
    said = json.loads((tmp_path / "NoData/NoData-st.json").read_text())
    said["records"][-2]["fields"][0][1] = "1"
    (tmp_path / "NoData/NoData-st.json").write_text(json.dumps(said))
    done = run(tmp_path)
    assert done.returncode == 1
    assert "NoData/NoData-st.mcap: its records differ" in done.stdout
    assert done.stdout.splitlines()[-2].split() == ["all", "6", "5"]


def run(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tools.conformance", str(folder)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def code_of(folder: Path) -> int:
    return run(folder).returncode


# -- records that are longer than their fields -------------------------------------------------------------------------


def save(path: Path, made: Build) -> Path:
    path.write_bytes(made.data)
    path.with_suffix(".json").write_text(conformance.description(made))
    return path


@pytest.mark.parametrize("pad", [b"\0", PAD, bytes(range(1, 17)), b"\xff" * 100, bytes(5000)], ids=len)
@pytest.mark.parametrize("kind", [*sorted(EXTENDABLE), "all"])
@pytest.mark.parametrize("family", ALL_OF)
def test_any_record_may_be_longer_than_its_fields(tmp_path: Path, family: str, kind: str, pad: bytes) -> None:
    padded = EXTENDABLE if kind == "all" else frozenset({kind})
    for features in (ALL_OF[family], ALL_OF[family] - {"chx", "ax", "mdx", "sum"}, ALL_OF[family] & {"ch", "pad"}):
        path = save(tmp_path / f"{len(features)}.mcap", build(family, features, padded=padded, pad=pad))
        assert differences(path) == []


def test_schemas_and_channels_inside_chunks_may_be_longer_than_their_fields(tmp_path: Path) -> None:
    made = Build(frozenset({"pad"}))
    made.add("Header", {"profile": "", "library": ""})
    inside = [conformance.SCHEMA, conformance.CHANNEL, conformance.message(10, 2, 1)]
    made.add("Chunk", {"start": 2, "end": 2, "records": b"".join(made.packed(*one) for one in inside)})
    path = tmp_path / "a.mcap"
    path.write_bytes(made.data + made.packed("DataEnd", {"data_section_crc": 0}) + end())
    with Recording(path) as recording:
        assert [row["data"] for row in recording["example"].rows()] == [bytes([1, 2, 3])]
        assert recording.losses == []


def end() -> bytes:
    footer = Build(frozenset()).packed("Footer", {"summary_start": 0, "summary_offset_start": 0, "summary_crc": 0})
    return footer + conformance.MAGIC


@pytest.mark.parametrize("on_damage", ["raise", "skip"])
@pytest.mark.parametrize("cut", [0, 1, 40])
def test_a_padded_file_that_lost_its_end_keeps_its_chunk(tmp_path: Path, on_damage: str, cut: int) -> None:
    made = build("TenMessages", ALL_OF["TenMessages"], padded=EXTENDABLE)
    at = made.data.rindex(made.packed("Schema", conformance.SCHEMA[1]))  # in the summary
    path = tmp_path / "a.mcap"
    path.write_bytes(made.data[: at + cut])
    with Recording(path, on_damage=on_damage) as recording:
        assert recording.topics["example"].count == 10


def test_an_export_of_a_padded_file_is_read_by_the_package_of_others(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", build("TenMessages", ALL_OF["TenMessages"], padded=EXTENDABLE))
    with Recording(path) as recording:
        data = recording.read("example", format="mcap")
    found = [(one.log_time, one.data) for _, _, one in make_reader(BytesIO(data), validate_crcs=True).iter_messages()]
    times = sorted(one["log_time"] for kind, one in conformance.INPUTS["TenMessages"] if kind == "Message")
    assert found == [(time, bytes([1, 2, 3])) for time in times]


def test_an_attachments_checksum_is_that_of_its_fields_and_not_of_what_follows_them(tmp_path: Path) -> None:
    made = build("OneAttachment", frozenset({"pad"}), padded=frozenset({"Attachment"}), pad=b"later")
    path = save(tmp_path / "a.mcap", made)
    with Recording(path) as recording:
        assert recording.attachments["myFile"].read() == bytes([1, 2, 3])
    content = conformance.PACKED["Attachment"](conformance.ATTACHMENT[1])
    assert zlib.crc32(content[:-4]) == int.from_bytes(content[-4:], "little")
    at = made.data.index(bytes([1, 2, 3]))
    path.write_bytes(made.data[:at] + b"\7" + made.data[at + 1 :])
    with Recording(path) as recording, pytest.raises(ValueError, match="checksum"):
        recording.attachments["myFile"].read()
