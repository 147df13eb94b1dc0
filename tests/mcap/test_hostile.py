"""Files made to do harm are refused with one error, or read for what they are, soon and in little memory."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.errors import MissingRecordingError
from ml_dash_mcap.file_names import LARGE_BYTES
from tests.support import every_read, raw
from tests.support.examples import examples

ROOT = Path(__file__).resolve().parents[2]

Build = Callable[[], bytes]

LAST = 2**64 - 1
FRONT = raw.header() + raw.schema() + raw.channel()

REFUSED: dict[str, Build] = {}
"""Files that are refused, and of which nothing is read where damage may be skipped, unless noted otherwise."""
READ: dict[str, Build] = {}
"""Files that are read, although they are odd."""
NO_MCAP: dict[str, Build] = {}
"""Files of which there is nothing to read."""


def case(cases: dict[str, Build]) -> Callable[[Build], Build]:
    """Note a case under the name of its function."""

    def note(build: Build) -> Build:
        cases[build.__name__] = build
        return build

    return note


def with_chunk(
    packed: bytes, compression: str = "", *, size: int | None = None, indexes: bytes = b"", front: bytes = FRONT
) -> bytes:
    """A file of one chunk with everything that belongs to one; `size` is what the chunk and its index announce."""
    chunk = raw.chunk(packed, compression, size=size)
    offsets = {1: len(front) + len(chunk)} if indexes else {}
    index = raw.chunk_index(
        len(front),
        len(chunk),
        indexes=offsets,
        index_length=len(indexes),
        compression=compression,
        sizes=(len(packed), len(packed) if size is None else size),
    )
    return raw.file(front + chunk + indexes, raw.schema() + raw.channel() + raw.statistics({1: 1}) + index)


def with_indexes(*indexes: bytes, statistics: bytes | None = None, data: bytes = b"") -> bytes:
    """A file whose summary says what `indexes` do about its data section."""
    said = raw.statistics({1: 1}, chunks=len(indexes)) if statistics is None else statistics
    return raw.file(FRONT + data, raw.schema() + raw.channel() + said + b"".join(indexes))


def zeros(compressor: object, size: int) -> bytes:
    """Zeros, compressed a little at a time."""
    block = bytes(1024 * 1024)
    parts = [compressor.begin()] if hasattr(compressor, "begin") else []
    parts += [compressor.compress(block) for _ in range(size // len(block))]  # type: ignore[attr-defined]
    return b"".join([*parts, compressor.flush()])  # type: ignore[attr-defined]


# -- what unpacks to much more than it is -----------------------------------------------------------------------------

BOMB_BYTES = 512 * 1024 * 1024


@case(REFUSED)
def zstd_bomb_that_says_its_size() -> bytes:
    packed = zeros(zstandard.ZstdCompressor().compressobj(size=BOMB_BYTES), BOMB_BYTES)
    return with_chunk(packed, "zstd", size=BOMB_BYTES)


@case(REFUSED)
def zstd_bomb_that_says_it_is_small() -> bytes:
    return with_chunk(zeros(zstandard.ZstdCompressor().compressobj(size=BOMB_BYTES), BOMB_BYTES), "zstd", size=100)


@case(REFUSED)
def zstd_bomb_in_a_frame_without_a_size() -> bytes:
    return with_chunk(zeros(zstandard.ZstdCompressor().compressobj(), BOMB_BYTES), "zstd", size=1000)


@case(REFUSED)
def zstd_frame_with_a_window_of_2_gb() -> bytes:
    parameters = zstandard.ZstdCompressionParameters(window_log=31, enable_ldm=True)
    packed = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    return with_chunk(packed.compress(bytes(1000)) + packed.flush(), "zstd", size=1000)


@case(REFUSED)
def lz4_bomb_that_says_its_size() -> bytes:
    return with_chunk(zeros(lz4.frame.LZ4FrameCompressor(), 256 * 1024 * 1024), "lz4", size=256 * 1024 * 1024)


@case(REFUSED)
def lz4_bomb_that_says_it_is_small() -> bytes:
    return with_chunk(zeros(lz4.frame.LZ4FrameCompressor(), 256 * 1024 * 1024), "lz4", size=1000)


@case(REFUSED)
def bomb_without_a_summary() -> bytes:
    packed = zeros(zstandard.ZstdCompressor().compressobj(size=BOMB_BYTES), BOMB_BYTES)
    return raw.file(FRONT + raw.chunk(packed, "zstd", size=BOMB_BYTES))


@case(READ)
def as_much_as_any_ratio_gives() -> bytes:
    row = raw.message(1, 1, b'{"a":1' + b" " * (LARGE_BYTES - 100) + b"}")
    return with_chunk(zstandard.compress(row), "zstd", size=len(row), indexes=raw.message_index(1, [(1, 0)]))


# -- lengths and counts that lie ---------------------------------------------------------------------------------------


def lying(size: int) -> bytes:
    return with_chunk(b"", size=size)


REFUSED |= {f"chunk_of_{size}_bytes": lambda size=size: lying(size) for size in (1, 2**31, 2**40, 2**63, LAST)}  # type: ignore[misc]


@case(REFUSED)
def chunk_whose_data_is_longer_than_it() -> bytes:
    return raw.file(FRONT + raw.chunk(b"", length=LAST))


@case(REFUSED)
def message_longer_than_its_chunk() -> bytes:
    return with_chunk(raw.message(1, 1, b"{}", length=LAST))


@case(REFUSED)
def message_shorter_than_any() -> bytes:
    return with_chunk(raw.record(5, b"12345"))


@case(REFUSED)
def channel_with_a_map_of_4_gb() -> bytes:
    return raw.file(raw.header() + raw.schema() + raw.channel(metadata=struct.pack("<I", 2**32 - 1)))


@case(REFUSED)
def schema_with_a_name_of_4_gb() -> bytes:
    return raw.file(raw.header() + raw.record(3, b"\1\0" + raw.text("x", 2**32 - 1)))


@case(REFUSED)
def record_of_18_exabytes() -> bytes:
    return raw.file(FRONT + raw.metadata(length=LAST))


@case(REFUSED)
def compression_that_nobody_knows() -> bytes:
    return with_chunk(raw.message(1, 1, b"{}"), "brotli" * 3)


@case(REFUSED)
def compression_that_means_messages_outside_of_chunks() -> bytes:
    return with_chunk(raw.message(1, 1, b"{}"), "\0loose")


@case(READ)
def statistics_of_18_quintillion_messages() -> bytes:
    chunk = raw.chunk(raw.message(1, 1, b"{}"))
    index = raw.chunk_index(len(FRONT), len(chunk), sizes=(33, 33))
    return with_indexes(index, statistics=raw.statistics({1: LAST}), data=chunk)


# -- places that lie ---------------------------------------------------------------------------------------------------

PLACES = (0, 8, 40, 2**31, 2**63, LAST - 8, LAST)
LENGTHS = (0, 60, LAST)
INDEXED = with_chunk(raw.message(1, 1, b"{}"), indexes=raw.message_index(1, [(1, 0)]))

READ |= {
    f"chunk_index_to_{offset}_of_{length}": lambda offset=offset, length=length: with_indexes(  # type: ignore[misc]
        raw.chunk_index(offset, length)
    )
    for offset in PLACES
    for length in LENGTHS
}
READ |= {
    f"message_index_at_{offset}_of_{length}": lambda offset=offset, length=length: with_indexes(  # type: ignore[misc]
        raw.chunk_index(len(FRONT), 60, indexes={1: offset}, index_length=length), data=raw.chunk(b"")
    )
    for offset in PLACES
    for length in LENGTHS
}
READ |= {
    f"metadata_index_to_{offset}_of_{length}": lambda offset=offset, length=length: with_indexes(  # type: ignore[misc]
        raw.metadata_index(offset, length), statistics=raw.statistics({}, chunks=0, records=1)
    )
    for offset in PLACES
    for length in LENGTHS
}
READ |= {
    f"attachment_index_to_{offset}_of_{length}": lambda offset=offset, length=length: with_indexes(  # type: ignore[misc]
        raw.attachment_index(offset, length, length), statistics=raw.statistics({}, chunks=0, attachments=1)
    )
    for offset in PLACES
    for length in LENGTHS
}
READ |= {
    f"footer_to_{start}_and_{offsets_at}": lambda start=start, offsets_at=offsets_at: (
        INDEXED[:-37]  # type: ignore[misc]
        + raw.footer(start, offsets_at)
    )
    for start in (*PLACES, len(INDEXED), len(INDEXED) - 37)
    for offsets_at in (0, 8, LAST)
}
READ |= {
    f"message_index_entry_to_{offset}": lambda offset=offset: with_chunk(  # type: ignore[misc]
        raw.message(1, 1, b"{}"), indexes=raw.message_index(1, [(1, offset)])
    )
    for offset in PLACES[1:]
}


# -- the same again and again ------------------------------------------------------------------------------------------


@case(READ)
def chunk_that_is_indexed_20_000_times() -> bytes:
    chunk = raw.chunk(raw.message(1, 1, b"{}"))
    index = raw.chunk_index(len(FRONT), len(chunk), sizes=(33, 33))
    return with_indexes(*[index] * 20_000, data=chunk)


@case(READ)
def chunk_indexes_of_ever_other_forms() -> bytes:
    return with_indexes(*[raw.chunk_index(i, 1, compression="x" * (i % 2)) for i in range(20_000)])


@case(READ)
def chunk_indexes_that_are_alike_and_wrong_by_turns() -> bytes:
    return with_indexes(*[raw.chunk_index(LAST if i % 8 == 7 else 8, 0) for i in range(20_000)])


@case(READ)
def message_that_is_indexed_100_000_times() -> bytes:
    row = raw.message(1, 1, b'{"a":"' + b" " * 1_000_000 + b'"}')
    packed = zstandard.compress(row)
    return with_chunk(packed, "zstd", size=len(row), indexes=raw.message_index(1, [(1, 0)] * 100_000))


@case(REFUSED)
def messages_in_messages_in_messages() -> bytes:
    channels = range(1, 10_001)
    size = 2_000_000
    heads = b"".join(raw.message(i, 1, b"", length=size - 31 * (i - 1) - 9) for i in channels)
    front = raw.header() + raw.schema() + b"".join(map(raw.channel, channels))
    data = heads.ljust(size)
    chunk = raw.chunk(zstandard.compress(data), "zstd", size=size)
    indexes = [raw.message_index(i, [(1, 31 * (i - 1))]) for i in channels]
    return raw.file(front + chunk + b"".join(indexes))


@case(READ)
def message_indexes_in_message_indexes() -> bytes:
    front = raw.header() + raw.schema() + b"".join(map(raw.channel, range(1, 2001)))
    chunk = raw.chunk(raw.message(1, 1, b"{}"))
    inner, offsets = b"", {}
    room = 2000 * 15 + 16 * 20_000
    for i in range(1, 2001):
        offsets[i] = len(front) + len(chunk) + len(inner)
        length = (room - len(inner) - 15) // 16 * 16
        inner += struct.pack("<BQHI", 7, length + 6, i, length)
    inner = inner.ljust(room, b"\0")
    index = raw.chunk_index(len(front), len(chunk), indexes=offsets, index_length=room, sizes=(33, 33))
    channels = b"".join(map(raw.channel, range(1, 2001)))
    return raw.file(front + chunk + inner, raw.schema() + channels + raw.statistics({1: 1}) + index)


@case(READ)
def chunk_with_message_indexes_of_10_000_channels() -> bytes:
    front = raw.header() + raw.schema() + b"".join(map(raw.channel, range(10_000)))
    indexes = b"".join(raw.message_index(i, []) for i in range(10_000))
    return front + raw.chunk(raw.message(1, 1, b"{}")) + indexes


@case(READ)
def messages_outside_chunks_on_10_000_channels() -> bytes:
    front = raw.header() + raw.schema() + raw.channel()
    return front + b"".join(raw.message(i, 1, b"") for i in range(10_000))


@case(READ)
def records_of_nothing() -> bytes:
    return FRONT + raw.record(0x80, b"") * 100_000


@case(READ)
def summary_of_records_of_nothing() -> bytes:
    return with_indexes(raw.record(0x80, b"") * 100_000)


@case(READ)
def metadata_in_metadata() -> bytes:
    inner, entries, total = b"", [], 2_000_000
    for _ in range(10_000):
        entries.append((len(FRONT) + len(inner), total - len(inner)))
        inner += struct.pack("<BQ", 12, total - len(inner) - 9) + raw.text("n") + struct.pack("<I", 0)
    indexes = b"".join(raw.metadata_index(*entry) for entry in entries)
    return with_indexes(indexes, statistics=raw.statistics({}, chunks=0, records=10_000), data=inner.ljust(total))


@case(READ)
def groups_of_one_summary_region_again_and_again() -> bytes:
    summary = raw.schema() + raw.channel() + raw.statistics({}, chunks=0) + raw.record(0x80, bytes(70_000))
    start = len(FRONT) + 13
    group = raw.summary_offset(4, start, len(raw.schema() + raw.channel()))
    return raw.file(FRONT, summary, group * 2000)


@case(READ)
def groups_that_lie_in_each_other_and_in_themselves() -> bytes:
    summary = raw.schema() + raw.channel() + raw.statistics({}, chunks=0) + raw.record(0x80, bytes(70_000))
    start = len(FRONT) + 13
    groups = [raw.summary_offset(opcode, start, len(summary)) for opcode in range(1, 16)]
    return raw.file(FRONT, summary, b"".join(groups))


# -- times and values ---------------------------------------------------------------------------------------------------


def of_rows(*rows: tuple[int, bytes], times: tuple[int, int] = (0, LAST)) -> bytes:
    """A file with some rows, each in a chunk of its own that says it is of `times`."""
    chunks = [raw.chunk(raw.message(1, *row), times=times) for row in rows]
    return raw.file(FRONT + b"".join(chunks))


@case(READ)
def last_time_there_is() -> bytes:
    return of_rows((LAST, b"{}"), (2**63, b"{}"), (0, b"{}"), (LAST - 1, b'{"_ts":18446744073.709553}'))


@case(READ)
def a_thousand_times_behind_the_last_that_our_recorder_takes() -> bytes:
    return of_rows(*[(2**63 + i * 10**9, b'{"_ts":0.5}') for i in range(100)])


@case(READ)
def time_stamps_that_are_no_times() -> bytes:
    stamps = [b"NaN", b"Infinity", b"-Infinity", b"1e400", b"-1", b"null", b'"x"', b"[1]", b"{}", b"true", b"9" * 400]
    return of_rows(*[(i, b'{"_ts":' + stamp + b"}") for i, stamp in enumerate(stamps)])


@case(READ)
def chunk_that_ends_before_it_starts() -> bytes:
    return of_rows((5, b"{}"), times=(9, 1))


@case(READ)
def chunk_that_says_it_is_of_another_time() -> bytes:
    return of_rows((5, b"{}"), times=(100, 200))


@case(READ)
def number_of_a_million_digits() -> bytes:
    return of_rows((1, b'{"a":' + b"9" * 1_000_000 + b"}"))


@case(REFUSED)
def lists_in_lists_in_lists() -> bytes:
    return of_rows((1, b'{"a":' + b"[" * 1_000_000 + b"]" * 1_000_000 + b"}"), (2, b"[" * 1_000_000))


@case(REFUSED)
def dicts_in_dicts_in_dicts() -> bytes:
    return of_rows((1, b'{"a":' * 300_000 + b"1" + b"}" * 300_000))


@case(REFUSED)
def text_that_is_no_text() -> bytes:
    return of_rows((1, b'{"a":"\xff\xfe"}'))


@case(READ)
def schema_in_schema_in_schema() -> bytes:
    deep = b'{"type":"object","properties":{"a":' * 10_000 + b"{}" + b"}}" * 10_000
    front = raw.header() + raw.schema(1, deep) + raw.channel() + raw.channel(2)
    return front + raw.chunk(raw.message(1, 1, b'{"a":1}') + raw.message(2, 2, b"{}"))


@case(READ)
def parameters_in_parameters_in_parameters() -> bytes:
    pair = raw.text("a") + raw.text("[" * 100_000)
    return FRONT + raw.metadata("ml_dash.parameters", struct.pack("<I", len(pair)) + pair)


# -- anything at all ----------------------------------------------------------------------------------------------------

VALUES = st.sampled_from((0, 1, 2, 8, 9, 31, 255, 2**16 - 1, 2**31, 2**32 - 1, 2**62, 2**63, LAST - 8, LAST))
CHANGES = st.lists(st.tuples(st.integers(0, 10_000), st.sampled_from("BHIQ"), VALUES), max_size=3)


def changed(data: bytes, changes: list[tuple[int, str, int]]) -> bytes:
    """Bytes with numbers written over them."""
    changing = bytearray(data)
    for place, kind, value in changes:
        size = struct.calcsize(kind)
        struct.pack_into(f"<{kind}", changing, place % (len(data) - size), value % 256**size)
    return bytes(changing)


@pytest.mark.filterwarnings("ignore::ml_dash_mcap.errors.UndecodedWarning")
@given(of_data=CHANGES, of_summary=CHANGES, of_offsets=CHANGES)
@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_numbers_stand_in_a_file_whose_checksums_are_right_nothing_but_our_error_comes_of_it(
    tmp_path, of_data, of_summary, of_offsets
):
    data = FRONT + raw.channel(2, "u")
    indexes = []
    for start in (1, 3):
        inside = [raw.message(1 + i, start + i, b'{"a":%d}' % i) for i in range(2)]
        chunk = raw.chunk(b"".join(inside), times=(start, start + 1))
        behind = [raw.message_index(1 + i, [(start + i, i * len(inside[0]))]) for i in range(2)]
        place = len(data) + len(chunk)
        offsets = {1: place, 2: place + len(behind[0])}
        size = len(b"".join(inside))
        indexes.append(
            raw.chunk_index(
                len(data), len(chunk), indexes=offsets, index_length=len(b"".join(behind)), sizes=(size, size)
            )
        )
        data += chunk + b"".join(behind)
    data += raw.metadata()
    indexes.append(raw.metadata_index(len(data) - len(raw.metadata()), len(raw.metadata())))
    groups = [raw.schema(), raw.channel() + raw.channel(2, "u"), raw.statistics({1: 2, 2: 2}, chunks=2, records=1)]
    summary = b"".join([*groups, *indexes])
    offsets_group = raw.summary_offset(3, len(data) + 13, len(groups[0]))
    path = tmp_path / "file.mcap"
    front = len(raw.header())
    path.write_bytes(
        raw.file(
            data[:front] + changed(data[front:], of_data),
            changed(summary, of_summary),
            changed(offsets_group, of_offsets),
        )
    )
    assert every_read.outcome(path, "raise") in ("read", "refused")
    assert every_read.outcome(path, "skip") == "read"


# -- hardly a file ------------------------------------------------------------------------------------------------------

NO_MCAP |= {
    "nothing": lambda: b"",
    "one_byte": lambda: b"\x89",
    "magic": lambda: raw.MAGIC,
    "magic_twice": lambda: raw.MAGIC * 2,
    "footer_and_no_header": lambda: raw.MAGIC + raw.footer(0),
    "footer_to_the_start": lambda: raw.MAGIC + raw.footer(8, 8),
    "header_of_18_exabytes": lambda: raw.MAGIC + raw.record(1, bytes(8), LAST),
    "header_and_no_more_than_its_length": lambda: raw.MAGIC + raw.record(1, b"", 8),
    "another_format": lambda: b"#ROSBAG V2.0\n" + bytes(5000),
    "another_version": lambda: raw.MAGIC.replace(b"0", b"1") + raw.header()[8:],
    "zeros": lambda: bytes(100_000),
}
READ |= {
    "header": lambda: raw.header(),
    "header_of_half_a_megabyte": lambda: raw.header("x" * 500_000),
    "header_and_end": lambda: raw.file(raw.header()),
}


@pytest.mark.parametrize("session", ["x", "*", ""])
def test_a_folder_from_outside_cannot_have_the_journal_of_a_living_recorder_deleted(tmp_path, session):
    options = RecorderOptions(backlog_bytes=4 * 1024 * 1024, journal_dir=tmp_path)
    with Recorder(tmp_path / "alive", options) as recorder:
        recorder.topic("robot").append(q=1, _ts=1.0)
        journals = sorted(tmp_path.glob(".ml_dash-*.journal"))
        hostile = tmp_path / "hostile"
        hostile.mkdir()
        said = {"session": session, "journals": f"{tmp_path}/.ml_dash-*.journal"}
        (hostile / ".ml_dash-x.json").write_text(json.dumps(said))
        with suppress(MissingRecordingError), Recording(hostile):
            pass
        assert journals
        assert sorted(tmp_path.glob(".ml_dash-*.journal")) == journals


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.timeout(20)
def test_pipes_in_a_folder_from_outside_are_not_waited_for(tmp_path):
    (tmp_path / "1.mcap").write_bytes(INDEXED)
    for name in ("2.mcap", "3.mcap.active", ".ml_dash-x.json", ".ml_dash-y-0.journal"):
        os.mkfifo(tmp_path / name)
    (tmp_path / ".ml_dash-y.json").write_text(json.dumps({"journals": f"{tmp_path}/.ml_dash-y-*.journal"}))
    with Recording(tmp_path, on_damage="skip") as rec:
        assert list(rec["t"].rows()) == [{"_ts": 1e-9}]
        assert [loss.path.name for loss in rec.losses] == ["2.mcap", "3.mcap.active"]


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, object]]:
    """What came of each file, read by one process in every way there is."""
    folder = tmp_path_factory.mktemp("hostile")
    paths = []
    for name, build in [*NO_MCAP.items(), *REFUSED.items(), *READ.items()]:
        paths.append(folder / f"{name}.mcap")
        paths[-1].write_bytes(build())
    for name, start in (("sparse", raw.header()), ("sparse_chunk", raw.header() + struct.pack("<BQ", 6, 2**39))):
        paths.append(folder / f"{name}.mcap")
        paths[-1].write_bytes(start)
        os.truncate(paths[-1], 2**40)
    names = [str(path) for path in paths]
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.every_read", *names],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=110,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return {said["name"]: said for said in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_lies_is_refused_and_nothing_else_goes_wrong(outcomes, name):
    assert outcomes[name]["raise"] == "refused"


@pytest.mark.parametrize("name", NO_MCAP)
def test_what_is_no_mcap_file_is_refused_whatever_may_be_skipped(outcomes, name):
    assert (outcomes[name]["raise"], outcomes[name]["skip"]) == ("refused", "refused")


@pytest.mark.parametrize("name", [*READ, "sparse", "sparse_chunk"])
def test_an_odd_file_is_read_or_refused_and_nothing_else_goes_wrong(outcomes, name):
    assert outcomes[name]["raise"] in ("read", "refused")


@pytest.mark.parametrize("name", [*REFUSED, *READ, "sparse", "sparse_chunk"])
def test_where_damage_may_be_skipped_no_file_with_a_header_is_refused(outcomes, name):
    assert outcomes[name]["skip"] == "read"


def test_no_file_takes_longer_than_a_second(outcomes):
    slow = {name: said for name, said in outcomes.items() if max(said["raise_s"], said["skip_s"]) > 1.0}
    assert not slow


def test_no_file_takes_more_than_300_mb(outcomes):
    assert max(said["peak_mb"] for said in outcomes.values()) < 300
