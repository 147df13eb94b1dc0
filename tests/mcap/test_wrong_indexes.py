"""What an index, the statistics or the summary say wrongly is corrected from the data and told, and costs nothing."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import NonSeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from ml_dash_mcap import Recording, recordings
from ml_dash_mcap.cli import main
from ml_dash_mcap.store import read_ahead
from tests.support.assemble import Draft, bundle
from tests.support.samples import swap

Lie = Callable[[Draft], None]
"""Changes a file whose summary is right."""

STEP = 10_000_000
"""Spacing of the messages, ns: far more than what two log times of one double may differ."""


def made() -> Draft:
    """Three chunks with messages of two topics at 0, 10, ... 80 ms, two attachments and two metadata records."""
    data: list[McapRecord] = []
    number = 0
    for chunk in range(3):
        head: list[McapRecord] = []
        if chunk == 0:
            head = [
                Schema(id=1, data=b"{}", encoding="jsonschema", name="row"),
                Channel(id=1, topic="a", message_encoding="json", metadata={}, schema_id=1),
                Schema(id=2, data=b"{}", encoding="jsonschema", name="other"),
                Channel(id=2, topic="b", message_encoding="json", metadata={}, schema_id=2),
            ]
        inside = []
        for _ in range(3):
            channel_id = 1 if number % 3 else 2
            inside.append(Message(channel_id, number * STEP, b'{"n":%d}' % number, number * STEP, number))
            number += 1
        data += bundle([*head, *inside])
        if chunk < 2:
            data.append(
                Attachment(create_time=1, log_time=5, name=f"{chunk}.txt", media_type="text/plain", data=b"abc")
            )
            data.append(Metadata(f"note{chunk}", {"chunk": str(chunk)}))
    return Draft(data).summarise()


def of(kind: type[Any], records: list[McapRecord], number: int = 0) -> Any:
    return [record for record in records if isinstance(record, kind)][number]


def changed(kind: type[Any], number: int = 0, **values: Any) -> Lie:
    """Say something else in a record of the summary; values may be functions of what is true."""

    def lie(draft: Draft) -> None:
        record = of(kind, draft.summary, number)
        given = {name: one(getattr(record, name)) if callable(one) else one for name, one in values.items()}
        swap(draft.summary, record, replace(record, **given))

    return lie


def left_out(kind: type[Any], number: int = 0) -> Lie:
    def lie(draft: Draft) -> None:
        draft.summary.remove(of(kind, draft.summary, number))

    return lie


def twice(kind: type[Any]) -> Lie:
    """Repeat a record of the summary behind itself."""

    def lie(draft: Draft) -> None:
        record = of(kind, draft.summary)
        swap(draft.summary, record, record, record)

    return lie


def all_of(*lies: Lie) -> Lie:
    def lie(draft: Draft) -> None:
        for one in lies:
            one(draft)

    return lie


def in_chunk(number: int, **values: Any) -> Lie:
    """Say something else in the head of a chunk."""

    def lie(draft: Draft) -> None:
        for name, value in values.items():
            setattr(of(Chunk, draft.data, number), name, value)

    return lie


def in_message_index(number: int, change: Callable[[list[tuple[int, int]]], list[tuple[int, int]]]) -> Lie:
    """Say something else in a message index; the summary says where everything lies all the same."""

    def lie(draft: Draft) -> None:
        index = of(MessageIndex, draft.data, number)
        index.records = change(list(index.records))
        draft.summarise()

    return lie


def without_message_index(number: int) -> Lie:
    """Leave out a message index, and do not mention it in the summary."""

    def lie(draft: Draft) -> None:
        draft.data.remove(of(MessageIndex, draft.data, number))
        draft.summarise()

    return lie


def skipping_0(draft: Draft) -> None:
    """What old writers did: they took a start of 0 for none, everywhere."""
    in_chunk(0, message_start_time=STEP)(draft)
    changed(ChunkIndex, 0, message_start_time=STEP)(draft)
    changed(Statistics, message_start_time=STEP)(draft)


SHIFTED = {"message_start_time": 50 * STEP, "message_end_time": 60 * STEP}

AT_ONCE: dict[str, Lie] = {
    "a chunk index starts late": changed(ChunkIndex, 1, message_start_time=4 * STEP),
    "a chunk index ends early": changed(ChunkIndex, 1, message_end_time=4 * STEP),
    "a chunk index is of another time": changed(ChunkIndex, 0, **SHIFTED),
    "a chunk and its index are of another time": all_of(in_chunk(0, **SHIFTED), changed(ChunkIndex, 0, **SHIFTED)),
    "all say the same wrong time": all_of(
        in_chunk(0, **SHIFTED), changed(ChunkIndex, 0, **SHIFTED), changed(Statistics, message_end_time=60 * STEP)
    ),
    "a start of 0 is skipped": skipping_0,
    "a start of 0 is skipped by the chunk and its index": all_of(
        in_chunk(0, message_start_time=STEP), changed(ChunkIndex, 0, message_start_time=STEP)
    ),
    "a chunk ends before it starts": changed(ChunkIndex, 2, message_start_time=8 * STEP, message_end_time=6 * STEP),
    "a chunk index leaves out a channel": changed(ChunkIndex, 1, message_index_offsets=lambda true: {1: true[1]}),
    "a chunk index has a channel too many": changed(
        ChunkIndex, 1, message_index_offsets=lambda true: {**true, 7: true[1]}
    ),
    "a chunk index confuses the message indexes": changed(
        ChunkIndex, 1, message_index_offsets=lambda true: {1: true[2], 2: true[1]}
    ),
    "a chunk index points into a message index": changed(
        ChunkIndex, 1, message_index_offsets=lambda true: {1: true[1] + 3, 2: true[2]}
    ),
    "the message indexes are said to be longer": changed(ChunkIndex, 2, message_index_length=lambda true: true + 9),
    "the message indexes are said to be shorter": changed(ChunkIndex, 2, message_index_length=lambda true: true - 9),
    "a chunk is said to be elsewhere": changed(ChunkIndex, 1, chunk_start_offset=lambda true: true - 1),
    "a chunk is said to be where another record is": changed(ChunkIndex, 2, chunk_start_offset=lambda true: true - 40),
    "a chunk is said to be longer": changed(ChunkIndex, 1, chunk_length=lambda true: true + 5),
    "a chunk is said to be shorter": changed(ChunkIndex, 1, chunk_length=lambda true: true - 5),
    "a chunk is said to be compressed": changed(ChunkIndex, 1, compression="zstd"),
    "a chunk is said to unpack to more": changed(ChunkIndex, 1, uncompressed_size=lambda true: true + 1),
    "a chunk is said to unpack to less": changed(ChunkIndex, 1, uncompressed_size=1),
    "a chunk is said to hold less": changed(ChunkIndex, 1, compressed_size=lambda true: true - 1),
    "a chunk has no index": left_out(ChunkIndex, 1),
    "a chunk has no index and is not counted": all_of(left_out(ChunkIndex, 1), changed(Statistics, chunk_count=2)),
    "a chunk has two indexes": twice(ChunkIndex),
    "a metadata record has two indexes": twice(MetadataIndex),
    "an attachment has two indexes": twice(AttachmentIndex),
    "a message index leaves out a message": in_message_index(0, lambda true: true[1:]),
    "a message index has an entry twice": in_message_index(0, lambda true: [true[0], *true]),
    "a message index has one entry instead of another": in_message_index(0, lambda true: [true[0], true[0]]),
    "a message index has another offset": in_message_index(0, lambda true: [(true[0][0], true[0][1] + 1), *true[1:]]),
    "a message index points behind its chunk": in_message_index(0, lambda true: [(true[0][0], 2**63), *true[1:]]),
    "a message index has another time": in_message_index(0, lambda true: [(true[0][0] + 1, true[0][1]), *true[1:]]),
    "a message index has a time outside of its chunk": in_message_index(
        1, lambda true: [(70 * STEP, true[0][1]), *true[1:]]
    ),
    "a message index is empty": in_message_index(2, lambda true: []),
    "a message index leaves out a message, and places are wrong": all_of(
        in_message_index(1, lambda true: true[1:]), changed(AttachmentIndex, offset=lambda true: true - 30)
    ),
    "a message index leaves out a message, and there are no other indexes": all_of(
        in_message_index(1, lambda true: true[1:]), *[left_out(ChunkIndex)] * 3
    ),
    "a message index is missing": without_message_index(2),
    "the statistics have more messages": changed(Statistics, message_count=100),
    "the statistics have fewer messages": changed(Statistics, message_count=1),
    "the statistics have more messages of a channel": changed(Statistics, channel_message_counts={1: 7, 2: 3}),
    "the statistics confuse the channels": changed(Statistics, channel_message_counts={1: 3, 2: 6}),
    "the statistics leave out a channel": changed(Statistics, channel_message_counts={1: 6}, message_count=6),
    "the statistics have another channel": changed(Statistics, channel_message_counts={1: 6, 2: 3, 9: 1}),
    "the statistics start early": changed(Statistics, message_start_time=2**62),
    "the statistics end late": changed(Statistics, message_end_time=2**62),
    "the statistics have no times": changed(Statistics, message_start_time=0, message_end_time=0),
    "the statistics have more chunks": changed(Statistics, chunk_count=4),
    "the statistics have no chunks": changed(Statistics, chunk_count=0),
    "the statistics have more attachments": changed(Statistics, attachment_count=3),
    "the statistics have fewer metadata": changed(Statistics, metadata_count=1),
    "an attachment index has another name": changed(AttachmentIndex, 1, name="x"),
    "an attachment index has another media type": changed(AttachmentIndex, 1, media_type="x"),
    "an attachment index has another size": changed(AttachmentIndex, 1, data_size=2),
    "an attachment index has another time": changed(AttachmentIndex, 1, log_time=6),
    "an attachment index points elsewhere": changed(AttachmentIndex, 1, offset=lambda true: true + 1),
    "an attachment index has another length": changed(AttachmentIndex, 1, length=lambda true: true - 1),
    "an attachment has no index": left_out(AttachmentIndex, 1),
    "a metadata index points elsewhere": changed(MetadataIndex, 1, offset=lambda true: true - 1),
    "a metadata index has another length": changed(MetadataIndex, 1, length=lambda true: true - 1),
    "a metadata record has no index": left_out(MetadataIndex, 0),
    "the summary leaves out a schema": left_out(Schema),
    "the summary leaves out a channel": left_out(Channel, 1),
}
"""What is corrected as soon as it matters, whoever asks."""

BY_CHECK: dict[str, Lie] = {
    "a metadata index has another name": changed(MetadataIndex, 0, name="x"),
    "the statistics have more schemas": changed(Statistics, schema_count=3),
    "the statistics have fewer channels": changed(Statistics, channel_count=1),
    "a message index leaves out a message, and the statistics too": all_of(
        in_message_index(0, lambda true: true[1:]),
        changed(Statistics, message_count=8, channel_message_counts={1: 5, 2: 3}),
    ),
    "a chunk has no index, and the statistics do not know it": all_of(
        left_out(ChunkIndex, 2),
        changed(
            Statistics,
            chunk_count=2,
            message_count=6,
            channel_message_counts={1: 4, 2: 2},
            message_end_time=5 * STEP,
        ),
    ),
    "an attachment has no index and is not counted": all_of(
        left_out(AttachmentIndex, 0), changed(Statistics, attachment_count=1)
    ),
    "a metadata record has no index and is not counted": all_of(
        left_out(MetadataIndex, 0), changed(Statistics, metadata_count=1)
    ),
    "the summary has another schema": changed(Schema, data=b'{"type":"object"}'),
    "the summary has another topic": changed(Channel, 1, topic="c"),
    "the summary has another message encoding": changed(Channel, 1, message_encoding="cbor"),
    "the summary has other channel metadata": changed(Channel, 0, metadata={"kind": "log"}),
}
"""What nothing tells but the data themselves: a check reads them all, and from then on everything is right."""


def save(path: Path, lie: Lie | None = None, library: str = "tests") -> Path:
    draft = made()
    if lie is not None:
        lie(draft)
    draft.header.library = library.ljust(len(draft.header.library))[: len(draft.header.library)]
    path.write_bytes(draft.finish())
    return path


def truth(path: Path) -> dict[str, list[dict[str, Any]]]:
    """The rows of each topic as the mcap package reads them from front to back, without any index."""
    rows: dict[str, list[dict[str, Any]]] = {}
    reader = NonSeekingReader(io.BytesIO(path.read_bytes()), validate_crcs=True)
    for _, channel, message in reader.iter_messages():
        number = int(message.data[5:-1])
        rows.setdefault(channel.topic, []).append({"n": number, "_ts": message.log_time / 1e9})
    return rows


def expected() -> dict[str, list[dict[str, Any]]]:
    rows = [{"n": n, "_ts": n * STEP / 1e9} for n in range(9)]
    return {"a": [row for row in rows if row["n"] % 3], "b": [row for row in rows if not row["n"] % 3]}


QUESTIONS: list[Callable[[Recording], object]] = [
    lambda rec: {topic: list(rec[topic].rows()) for topic in rec.topics},
    lambda rec: {topic: rec[topic].to_arrow().to_pylist() for topic in rec.topics},
    lambda rec: {topic: (info.count, info.start, info.end) for topic, info in rec.topics.items()},
    lambda rec: {one.name: (one.media_type, one.size, one.log_time, one.read()) for one in rec.attachments.list()},
    lambda rec: rec.metadata,
    lambda rec: {topic: rec[topic].last() for topic in rec.topics},
    lambda rec: {topic: len(rec[topic]) for topic in rec.topics},
    lambda rec: (rec.topics["a"].count, rec.start, rec.end),
]


def everything(rec: Recording) -> list[object]:
    return [ask(rec) for ask in QUESTIONS]


def answers() -> list[object]:
    rows = expected()
    return [
        rows,
        rows,
        {topic: (len(found), found[0]["_ts"], found[-1]["_ts"]) for topic, found in rows.items()},
        {f"{i}.txt": ("text/plain", 3, 5e-9, b"abc") for i in range(2)},
        [(f"note{i}", {"chunk": str(i)}) for i in range(2)],
        {topic: found[-1] for topic, found in rows.items()},
        {topic: len(found) for topic, found in rows.items()},
        (6, 0.0, 0.08),
    ]


@pytest.fixture(params=[1, 2], ids=["on one core", "on two"])
def cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(read_ahead, "_WORKERS", request.param)


def test_the_sample_is_right_and_nothing_is_found_in_it(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mcap")
    assert truth(path) == expected()
    with Recording(path) as rec:
        assert everything(rec) == answers()
        assert rec.losses == []
        assert not [finding for finding in rec.check() if finding.kind in ("index", "damage")]
        assert everything(rec) == answers()


@pytest.mark.usefixtures("cores")
@pytest.mark.parametrize("on_damage", ["raise", "skip"])
@pytest.mark.parametrize("name", AT_ONCE)
def test_a_lie_costs_nothing_whoever_asks_first(tmp_path: Path, name: str, on_damage: str) -> None:
    path = save(tmp_path / "a.mcap", AT_ONCE[name])
    for ask, answer in zip(QUESTIONS, answers(), strict=True):
        with Recording(path, on_damage=on_damage) as rec:
            assert ask(rec) == answer
            assert all(loss.corrected and loss.messages == 0 for loss in rec.losses)
    with Recording(path, on_damage=on_damage) as rec:
        assert everything(rec) == answers()


@pytest.mark.parametrize("library", ["tests", "ml_dash_mcap 0.0.0"])
@pytest.mark.parametrize("on_damage", ["raise", "skip"])
@pytest.mark.parametrize("name", [*AT_ONCE, *BY_CHECK])
def test_a_check_tells_of_every_lie_and_makes_it_true(tmp_path: Path, name: str, on_damage: str, library: str) -> None:
    path = save(tmp_path / "a.mcap", {**AT_ONCE, **BY_CHECK}[name], library)
    with Recording(path, on_damage=on_damage) as rec:
        kinds = [finding.kind for finding in rec.check() if finding.kind in ("index", "damage")]
        assert kinds
        assert set(kinds) == {"index"}
        assert everything(rec) == answers()
        assert all(loss.corrected and loss.messages == 0 for loss in rec.losses)


def test_a_file_that_says_something_wrong_is_neither_damaged_nor_a_failure_of_a_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run").mkdir()
    path = save(tmp_path / "run" / "a.mcap", AT_ONCE["a message index leaves out a message"])
    [entry] = recordings(tmp_path)
    assert (entry.status, entry.problem) == ("finished", None)
    assert main(["cat", str(path), "b"]) == 0
    output = capsys.readouterr()
    assert len(output.out.splitlines()) == 3
    assert output.err.startswith(f"corrected: {path}")


def test_a_window_sees_what_chunk_indexes_hid_once_everything_was_read(tmp_path: Path) -> None:
    lie = AT_ONCE["a chunk and its index are of another time"]
    path = save(tmp_path / "a.mcap", lie)
    for read_everything in (Recording.check, lambda rec: list(rec["a"].rows())):
        with Recording(path) as rec:
            assert [row["n"] for row in rec["b"].rows(0.03, 0.06)] == [3, 6]
            read_everything(rec)
            assert [row["n"] for row in rec["b"].rows(0.0, 0.03)] == [0, 3]
            assert [row["n"] for row in rec["a"].rows(0.0, 0.025)] == [1, 2]


def test_a_window_of_a_file_without_lies_reads_the_chunks_that_it_needs(tmp_path: Path) -> None:
    data: list[McapRecord] = [
        Schema(id=1, data=b"{}", encoding="jsonschema", name="row"),
        Channel(id=1, topic="a", message_encoding="json", metadata={}, schema_id=1),
    ]
    text = b'{"t":"' + b"x" * 100_000 + b'"}'
    for number in range(20):
        data += bundle([Message(1, number * STEP, text, number * STEP, number)])
    path = Draft(data).summarise().save(tmp_path / "a.mcap")
    with Recording(path) as rec:
        [file] = rec._opened()
        before = file.source.bytes_read
        assert len(list(rec["a"].rows(0.05, 0.055))) == 1
        assert file.source.bytes_read - before < 2 * len(text)


def test_a_check_tells_of_summary_offsets_that_point_elsewhere(tmp_path: Path) -> None:
    draft = made().locate()
    draft.offsets[0].group_start += 1
    path = tmp_path / "a.mcap"
    path.write_bytes(draft.close().bytes())
    with Recording(path) as rec:
        assert everything(rec) == answers()
        [finding] = [finding for finding in rec.check() if finding.kind in ("index", "damage")]
        assert (finding.kind, "a summary offset says" in finding.what) == ("index", True)
