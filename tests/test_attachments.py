"""Files inside a recording: named, in order, and with every bit that was written."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Attachment as Record
from mcap.records import AttachmentIndex
from mcap.writer import Writer

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import DamagedFileError, NotFoundError, StorageError
from tests.support.assemble import Draft
from tests.support.files import Row, draft, unfinished
from tests.support.samples import swap

ROWS: list[dict[str, list[Row]]] = [{"robot": [{"q": 1, "_ts": 1.0}]}]


def save(path: Path, *attachments: tuple[str, bytes], **options: Any) -> Path:
    """A file that mcap's own writer made."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        for second, (name, data) in enumerate(attachments):
            writer.add_attachment(create_time=0, log_time=second * 10**9, name=name, media_type="text/plain", data=data)
        writer.finish()
    return path


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"enable_crcs": False}])
def test_an_attachment_comes_back_as_it_was_written(tmp_path: Path, options: dict[str, Any]) -> None:
    path = save(
        tmp_path / "a.mcap", ("b.txt", b"hello"), ("a.bin", bytes(range(256)) * 1000), ("empty", b""), **options
    )
    with Recording(path) as rec:
        assert list(rec.attachments) == ["a.bin", "b.txt", "empty"]
        found = rec.attachments["a.bin"]
        assert (found.name, found.media_type, found.log_time, found.size) == ("a.bin", "text/plain", 1.0, 256_000)
        assert found.read() == bytes(range(256)) * 1000
        assert rec.attachments["b.txt"].read() == b"hello"
        assert rec.attachments["empty"].read() == b""
        assert repr(rec.attachments["b.txt"]) == (
            "Attachment(name='b.txt', media_type='text/plain', log_time=0.0, size=5)"
        )


def test_of_several_of_one_name_the_last_one_counts_and_all_are_listed(tmp_path: Path) -> None:
    first = save(tmp_path / "1.mcap", ("a", b"1"), ("b", b"2"), ("a", b"3"))
    second = save(tmp_path / "2.mcap", ("b", b"4"))
    with Recording([first, second]) as rec:
        assert {name: one.read() for name, one in rec.attachments.items()} == {"a": b"3", "b": b"4"}
        assert [one.read() for one in rec.attachments.list()] == [b"1", b"2", b"3", b"4"]


def test_a_recording_without_any_has_none(tmp_path: Path) -> None:
    with Recording(save(tmp_path / "a.mcap")) as rec:
        assert dict(rec.attachments) == {}
        with pytest.raises(NotFoundError, match="no attachment 'x' in the recording; there are none"):
            rec.attachments["x"]


def test_attachments_that_no_index_names_are_found(tmp_path: Path) -> None:
    from mcap.writer import IndexType

    path = save(tmp_path / "a.mcap", ("a", b"1"), ("b", b"2"), index_types=IndexType.ALL & ~IndexType.ATTACHMENT)
    with Recording(path) as rec:
        assert {name: one.read() for name, one in rec.attachments.items()} == {"a": b"1", "b": b"2"}


def with_attachment(data: bytes = b"hello") -> Draft:
    drafted = draft(ROWS)
    drafted.data.append(Record(create_time=1, log_time=2, name="a.txt", media_type="text/plain", data=data))
    return drafted


def test_an_attachment_of_a_file_without_an_end_is_read_too(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap.active"
    path.write_bytes(unfinished(with_attachment()))
    with Recording(path) as rec:
        assert rec.attachments["a.txt"].read() == b"hello"


@pytest.mark.breaks_files
@pytest.mark.parametrize("place", range(5))
def test_a_changed_byte_is_noticed(tmp_path: Path, place: int) -> None:
    whole = with_attachment().summarise().finish()
    at = whole.index(b"hello") + place
    path = tmp_path / "a.mcap"
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with (
        Recording(path) as rec,
        pytest.raises(DamagedFileError, match=r"a\.mcap, byte \d+: the checksum \(CRC-32\) of the attachment 'a\.txt'"),
    ):
        rec.attachments["a.txt"].read()


def with_lie(path: Path, change: dict[str, Any]) -> Path:
    """A file whose index says something else about its attachment."""
    drafted = with_attachment().summarise()
    entry = next(one for one in drafted.summary if isinstance(one, AttachmentIndex))
    swap(drafted.summary, entry, AttachmentIndex(**{**vars(entry), **change}))
    path.write_bytes(drafted.finish())
    return path


@pytest.mark.breaks_files
@pytest.mark.parametrize("change", [{"length": 2**63}, {"offset": 2**64 - 1}, {"length": 0}])
def test_an_index_that_points_out_of_the_file_does_not_count(tmp_path: Path, change: dict[str, Any]) -> None:
    with Recording(with_lie(tmp_path / "a.mcap", change)) as rec:
        assert rec.attachments["a.txt"].read() == b"hello"


@pytest.mark.breaks_files
@pytest.mark.parametrize(
    "change", [{"offset": 9}, {"length": 3}, {"name": "b"}, {"data_size": 4}, {"log_time": 4}, {"create_time": 7}]
)
@pytest.mark.parametrize("on_damage", ["raise", "skip"])
def test_what_an_index_says_wrongly_of_an_attachment_is_corrected_and_noted(
    tmp_path: Path, change: dict[str, Any], on_damage: str
) -> None:
    with Recording(with_lie(tmp_path / "a.mcap", change), on_damage=on_damage) as rec:
        (found,) = rec.attachments.values()
        assert (found.name, found.size, found.read()) == ("a.txt", 5, b"hello")
        assert [(loss.messages, loss.corrected) for loss in rec.losses] == [(0, True)]
        assert {finding.kind for finding in rec.check()} == {"index"}


@pytest.mark.breaks_files
def test_a_size_that_lies_is_damage_although_the_checksum_is_right(tmp_path: Path) -> None:
    drafted = with_attachment()
    whole = bytearray(drafted.summarise().finish())
    at = whole.index(b"hello")
    whole[at - 8 : at] = (2**40).to_bytes(8, "little")
    start = whole.index(b"\x09", 8 + 9)
    while whole[start + 9 : start + 17] != (2).to_bytes(8, "little"):
        start = whole.index(b"\x09", start + 1)
    whole[at + 5 : at + 9] = zlib.crc32(whole[start + 9 : at + 5]).to_bytes(4, "little")
    (tmp_path / "a.mcap").write_bytes(whole)
    with Recording(tmp_path / "a.mcap") as rec, pytest.raises(DamagedFileError, match="a field of 1099511627776 bytes"):
        rec.attachments["a.txt"].read()


def test_a_closed_recording_reads_no_attachment(tmp_path: Path) -> None:
    with Recording(save(tmp_path / "a.mcap", ("a", b"1"))) as rec:
        found = rec.attachments["a"]
    with pytest.raises(StorageError):
        found.read()
