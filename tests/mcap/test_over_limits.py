"""Where damage may be skipped, a message that is over the limits is left out alone: its chunk's other ones are read."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from ml_dash_mcap import Limits, Recording, convert
from ml_dash_mcap.errors import DamagedFileError

SMALL = Limits(chunk_bytes=10_000, any_ratio_bytes=10_000)


def save(path: Path, large: int, compression: CompressionType = CompressionType.ZSTD) -> Path:
    """A file of one chunk: three small messages, one of `large` zeros, three small ones."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=10**10, compression=compression)
        writer.start("ros2", "tests")
        small = writer.register_channel("/small", "json", writer.register_schema("s", "jsonschema", b"{}"))
        big = writer.register_channel("/big", "bytes", 0)
        for number in range(1, 7):
            writer.add_message(small, number * 10**9, b'{"n":%d}' % number, number * 10**9)
            if number == 3:
                writer.add_message(big, number * 10**9, bytes(large), number * 10**9)
        writer.finish()
    return path


def theirs(path: Path, topic: str = "/small") -> list[tuple[int, bytes]]:
    """A topic's messages as the mcap package reads them."""
    with path.open("rb") as file:
        return [(one.log_time, one.data) for _, _, one in make_reader(file).iter_messages(topics=[topic])]


CASES = [
    *[(100_000, SMALL, compression) for compression in CompressionType],
    (200_000_000, Limits(), CompressionType.ZSTD),
    (200_000_000, Limits(), CompressionType.LZ4),
]


@pytest.mark.parametrize("by_summary", [True, False], ids=["summary", "walked"])
@pytest.mark.parametrize(("large", "limits", "compression"), CASES, ids=str)
def test_only_what_does_not_fit_is_lost(
    tmp_path: Path, large: int, limits: Limits, compression: CompressionType, by_summary: bool
) -> None:
    path = save(tmp_path / "a.mcap", large, compression)
    expected = [int(data[5:-1]) for _, data in theirs(path)]
    if not by_summary:
        data = path.read_bytes()
        path.write_bytes(data[: data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")])
    with Recording(path, on_damage="skip", limits=limits) as rec:
        assert [row["n"] for row in rec["/small"].rows()] == expected == [1, 2, 3, 4, 5, 6]
        assert [row["n"] for row in rec["/small"].rows(2.0, 4.0)] == [2, 3, 4]
        assert [row["n"] for row in rec["/small"].rows(start_index=3, limit=2)] == [4, 5]
        assert rec["/small"].last()["n"] == 6
        rec.check()
        lost = [loss for loss in rec.losses if "limit" in loss.what]
        assert [(loss.messages, loss.corrected) for loss in lost] == [(1, False)]
        assert "1 of '/big'" in lost[0].what
        assert "limits=Limits(" in lost[0].what
        others = [loss for loss in rec.losses if loss not in lost]
        assert others == [] if by_summary else all("end" in loss.what for loss in others)


def test_where_damage_raises_the_chunk_is_refused_whole(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", 100_000)
    with Recording(path, limits=SMALL) as rec, pytest.raises(DamagedFileError, match="limits=Limits"):
        list(rec["/small"].rows())


@pytest.mark.parametrize("compression", CompressionType, ids=str)
def test_convert_carries_what_fits(tmp_path: Path, compression: CompressionType) -> None:
    path = save(tmp_path / "a.mcap", 100_000, compression)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        convert(path, tmp_path / "run", on_damage="skip", limits=SMALL)
    assert any("1 of '/big'" in str(one.message) for one in caught)
    with Recording(tmp_path / "run") as rec:
        [file] = rec.segments
    assert theirs(file) == theirs(path)
    assert theirs(file, "/big") == []


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD], ids=str)
def test_a_chunk_over_the_limits_that_is_damaged_besides_is_lost_whole(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = save(tmp_path / "a.mcap", 100_000, compression)
    data = bytearray(path.read_bytes())
    at = data.index(b'{"n":5}') + 5 if compression == CompressionType.NONE else data.index(b"zstd") + 60
    data[at] ^= 1
    path.write_bytes(data)
    with Recording(path, on_damage="skip", limits=SMALL) as rec:
        assert list(rec["/small"].rows()) == []
        assert [loss.messages for loss in rec.losses] == [7]


def test_a_bomb_loses_what_lies_behind_the_part_that_is_looked_at(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap", 400 * 1024 * 1024)
    with Recording(path, on_damage="skip") as rec:
        assert [row["n"] for row in rec["/small"].rows()] == [1, 2, 3]
        [loss] = rec.losses
        assert loss.messages == 4
        assert "all that lies behind" in loss.what
