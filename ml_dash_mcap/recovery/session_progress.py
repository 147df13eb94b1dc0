"""Tells how many blocks and rows of a session are in finished segments, where a recovery goes on."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from ..errors import DamagedFileError
from ..file_names import BLOCK_OPCODE, SEGMENT_SUFFIX, STEPS_RECORD
from ..mcap.file_reader import McapFile
from ..mcap.record_layout import PREFIX_BYTES, Fields, read_prefix
from ..mcap.records import BLOCK_END
from ..query.stored_topic import LAST_NS


def written_so_far(folder: Path, session: str) -> tuple[int, dict[str, int]]:
    """Return how many blocks with rows a session has in finished segments, and how many rows each topic has there.

    The session's segments are its newest ones, so that older runs in the folder are not opened.
    """
    blocks, rows = 0, dict[str, int]()
    for file in _newest_first(folder):
        if file.about().get("run") != session:
            if blocks:
                break
            continue
        blocks = max(blocks, whole_blocks(file)[0])
        for number, count in file.index.message_counts.items():
            topic = file.index.channels[number].topic
            rows[topic] = rows.get(topic, 0) + count
    return blocks, rows


def last_times(folder: Path, session: str, rows: Mapping[str, int]) -> dict[str, int]:
    """Return the time of the last row that was appended to each topic and is in finished segments, in ns.

    Args:
        folder: The run's folder.
        session: Whose segments, its newest ones.
        rows: How many rows each topic has in them.
    """
    last_ns: dict[str, int] = {}
    wanted = {topic for topic, count in rows.items() if count}
    for file in _newest_first(folder):
        if wanted <= last_ns.keys():
            break
        try:
            if file.about().get("run") == session:
                last_ns = {**_last_times_of(file, wanted - last_ns.keys(), rows), **last_ns}
        except DamagedFileError:  # a step back between the two blocks is not counted, and nothing else is lost
            continue
    return last_ns


def whole_blocks(file: McapFile) -> tuple[int, int]:
    """Return the number of blocks up to the last whole block in a file, and the number of chunks up to there."""
    chunks = file.index.chunks
    for number in range(len(chunks), 0, -1):
        chunk = chunks[number - 1]
        at = chunk.indexes_end
        # Padded, because the crash may have ended the file here; opcode 0 is no record.
        opcode, length = read_prefix(file.source.read(at, PREFIX_BYTES).ljust(PREFIX_BYTES, b"\0"), 0)
        if chunk.indexed and (opcode, length) == (BLOCK_OPCODE, 8):
            content = file.source.read(at + PREFIX_BYTES, length)
            if len(content) == length:
                return BLOCK_END.read(Fields(content, file.source.name)).number + 1, number
    return int(file.about().get("first_block", 0)), 0


def _newest_first(folder: Path) -> Iterator[McapFile]:
    """Yield the finished segments of a folder that can be opened, each closed behind it."""
    for path in sorted(folder.glob(f"*{SEGMENT_SUFFIX}"), reverse=True):
        try:
            file = McapFile(path)
        except DamagedFileError:
            continue
        try:
            yield file
        finally:
            file.close()


def _last_times_of(file: McapFile, wanted: Collection[str], rows: Mapping[str, int]) -> dict[str, int]:
    """Return the last times of some topics in one file; unpacks the last chunk of each.

    Where rows merged, the last row in the file may not be the last row that was appended. Then the block has a record
    that tells, which counts as long as no row of the topic came after that block.
    """
    last_ns: dict[str, int] = {}
    for record in file.metadata():
        if record.name == STEPS_RECORD:
            for topic, counts in json.loads(record.values["topics"]).items():
                if counts["rows"] == rows.get(topic):
                    last_ns[topic] = int(counts["last_ns"])
    numbers = {number: channel.topic for number, channel in file.index.channels.items()}
    for chunk in reversed(file.index.chunks):  # finished files have an index for each
        missing = {number for number, topic in numbers.items() if topic in wanted and topic not in last_ns}
        if not missing:
            break
        for messages in file.cut(chunk, sorted(missing & chunk.message_index_offsets.keys()), 0, LAST_NS):
            if len(messages.offsets):
                # The row that lies last, which need not be the row with the latest time.
                last_ns[numbers[messages.channel_id]] = int(messages.times_ns[messages.offsets.argmax()])
    return last_ns
