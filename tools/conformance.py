"""Read the MCAP project's conformance suite and print a table of how much of it reads as its descriptions say.

    python tools/conformance.py DIR

DIR is laid out as `tests/conformance/data` of https://github.com/foxglove/mcap: `<input>/<variant>.mcap`, and a
`<variant>.json` beside each that lists its records. Each file is read twice: record by record, and as a recording.
Exits with 1 if one does not hold what its description says.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ml_dash_mcap import Recording
from ml_dash_mcap.errors import RecorderError
from ml_dash_mcap.mcap import chunk_bytes, records, summary
from ml_dash_mcap.mcap.limits import DEFAULT
from ml_dash_mcap.mcap.message_records import MESSAGE_FIELDS, MESSAGE_HEAD_BYTES
from ml_dash_mcap.mcap.record_layout import Fields, split_records
from ml_dash_mcap.mcap.records import Opcode
from ml_dash_mcap.query import topic_messages
from ml_dash_mcap.query.file import File
from ml_dash_mcap.query.stored_topic import LAST_NS, StoredTopic

Described = dict[str, Any]
"""A record as a description has it: its `type`, and its `fields` by name; numbers as text, bytes as lists of them."""

_NAMES = {opcode: opcode.name.title().replace("_", "") for opcode in Opcode}
_MESSAGE_HEAD = MESSAGE_HEAD_BYTES


def plain(value: Any) -> Any:
    """Return a value as a description spells it."""
    if isinstance(value, (bytes, memoryview)):
        return [str(octet) for octet in bytes(value)]
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    return value if isinstance(value, str) else str(value)


def described(path: Path) -> list[Described]:
    """Return the records of a file in its order, those of chunks in their place, as our parser has them."""
    data = path.read_bytes()
    start, end = len(records.MAGIC), len(data) - len(records.MAGIC)
    assert data[:start] == data[end:] == records.MAGIC
    return list(_described(data[start:end], str(path), start))


def _described(data: bytes, path: str, base: int) -> Iterator[Described]:
    for opcode, at, fields in split_records(data, path, base):
        if opcode == Opcode.CHUNK:
            record = data[at - base : fields.end]
            head = records.CHUNK_HEAD.read(fields)
            chunk = records.Chunk(
                at,
                len(record),
                head.start_ns,
                head.end_ns,
                head.compression,
                head.records_length,
                head.uncompressed_size,
            )
            yield from _described(chunk_bytes.unpack(record, chunk, path, DEFAULT), path, 0)
        elif opcode != Opcode.MESSAGE_INDEX:
            values = _values(Opcode(opcode), fields, data[fields.start : fields.end])
            yield {"type": _NAMES[Opcode(opcode)], "fields": {name: plain(value) for name, value in values.items()}}


def _values(opcode: Opcode, fields: Fields, content: bytes) -> dict[str, Any]:
    """Return the fields of a record by the names of the specification."""
    if opcode == Opcode.HEADER:
        header = records.HEADER.read(fields)
        return {"profile": header.profile, "library": header.library}
    if opcode == Opcode.SCHEMA:
        schema = records.SCHEMA.read(fields)
        return {"id": schema.id, "name": schema.name, "encoding": schema.encoding, "data": schema.data}
    if opcode == Opcode.CHANNEL:
        channel = records.CHANNEL.read(fields)
        return {
            **{name: getattr(channel, name) for name in ("id", "schema_id", "topic", "message_encoding")},
            "metadata": dict(channel.metadata),
        }
    if opcode == Opcode.MESSAGE:
        names = ("channel_id", "sequence", "log_time", "publish_time")
        head = fields.numbers(MESSAGE_FIELDS)
        return {**dict(zip(names, head, strict=True)), "data": content[fields.at - fields.start :]}
    if opcode == Opcode.METADATA:
        metadata = records.METADATA.read(fields)
        return {"name": metadata.name, "metadata": dict(metadata.values)}
    if opcode == Opcode.ATTACHMENT:
        attachment = records.ATTACHMENT_HEAD.read(fields, offset=0, length=0)
        return {
            "name": attachment.name,
            "media_type": attachment.media_type,
            "log_time": attachment.log_time_ns,
            "create_time": attachment.create_time_ns,
            "data": fields.raw(attachment.data_size),
        }
    if opcode == Opcode.DATA_END:
        return {"data_section_crc": records.DATA_END.read(fields).data_section_crc}
    return _summary_values(opcode, fields)


def _summary_values(opcode: Opcode, fields: Fields) -> dict[str, Any]:
    if opcode == Opcode.STATISTICS:
        said = records.STATISTICS.read(fields)
        names = ("message_count", "schema_count", "channel_count", "attachment_count", "metadata_count", "chunk_count")
        return {
            **{name: getattr(said, name) for name in names},
            "message_start_time": said.start_ns,
            "message_end_time": said.end_ns,
            "channel_message_counts": dict(said.channel_message_counts),
        }
    if opcode == Opcode.CHUNK_INDEX:
        chunk = records.CHUNK_INDEX.read(fields)
        same = ("message_index_length", "compression", "compressed_size", "uncompressed_size")
        return {
            "message_start_time": chunk.start_ns,
            "message_end_time": chunk.end_ns,
            "chunk_start_offset": chunk.offset,
            "chunk_length": chunk.length,
            "message_index_offsets": dict(chunk.message_index_offsets),
            **{name: getattr(chunk, name) for name in same},
        }
    if opcode == Opcode.ATTACHMENT_INDEX:
        entry = records.ATTACHMENT_INDEX.read(fields)
        same = ("name", "media_type", "data_size", "offset", "length")
        times = {"log_time": entry.log_time_ns, "create_time": entry.create_time_ns}
        return {**times, **{name: getattr(entry, name) for name in same}}
    if opcode == Opcode.METADATA_INDEX:
        found = records.METADATA_INDEX.read(fields)
        return {name: getattr(found, name) for name in ("name", "offset", "length")}
    if opcode == Opcode.SUMMARY_OFFSET:
        group = records.SUMMARY_OFFSET.read(fields)
        return {"group_opcode": group.opcode, "group_start": group.start, "group_length": group.length}
    footer = records.FOOTER.read(fields)
    return {name: getattr(footer, name) for name in ("summary_start", "summary_offset_start", "summary_crc")}


def differences(path: Path) -> list[str]:
    """Return in which ways a file does not read as the description beside it says, in words."""
    said = json.loads(path.with_suffix(".json").read_text())["records"]
    expected = [{"type": one["type"], "fields": dict(one["fields"])} for one in said]
    found: list[str] = []
    try:
        if described(path) != expected:
            found.append("its records differ")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found += _of_recording(path, expected)
    except RecorderError as error:
        found.append(str(error))
    return found


def _of(expected: list[Described], kind: str) -> list[dict[str, Any]]:
    """Return the records of a kind that lie in the data section."""
    data = expected[: [one["type"] for one in expected].index("DataEnd")]
    return [one["fields"] for one in data if one["type"] == kind]


def _of_recording(path: Path, expected: list[Described]) -> Iterator[str]:
    """Yield what differs where the file is read as a recording: by topic, in the order of time, and checked."""
    with Recording(path) as recording:
        if recording.losses:
            yield f"losses: {recording.losses}"
        yield from _of_messages(path, expected)
        metadata = [(one["name"], one["metadata"]) for one in _of(expected, "Metadata")]
        if recording.metadata != metadata:
            yield "its metadata differ"
        attachments = [
            (one.name, one.media_type, one.log_time, [str(octet) for octet in one.read()])
            for one in recording.attachments.list()
        ]
        wanted = [
            (one["name"], one["media_type"], int(one["log_time"]) / 1e9, one["data"])
            for one in _of(expected, "Attachment")
        ]
        if attachments != wanted:
            yield "its attachments differ"
        times = [int(one["log_time"]) / 1e9 for one in _of(expected, "Message")]
        if (recording.start, recording.end) != (min(times, default=None), max(times, default=None)):
            yield "its times differ"
        for topic in recording.topics:
            rows = [row["_ts"] for row in recording[topic].rows()]
            if rows != sorted(times) or len(recording[topic]) != len(times):
                yield "its rows differ"
        damage = [finding.what for finding in recording.check() if finding.kind in ("damage", "index")]
        yield from (f"the check finds: {what}" for what in damage)


def _of_messages(path: Path, expected: list[Described]) -> Iterator[str]:
    file = File(path)
    try:
        topics = {one["id"]: one["topic"] for one in _of(expected, "Channel")}
        if {str(number): one.topic for number, one in file.index.channels.items()} != topics:
            yield "its channels differ"
        schemas = {one["id"]: (one["name"], one["encoding"], one["data"]) for one in _of(expected, "Schema")}
        known = {str(one.id): (one.name, one.encoding, plain(one.data)) for one in file.index.schemas.values()}
        if known != schemas:
            yield "its schemas differ"
        for number, topic in topics.items():
            found = [
                {"log_time": time, "publish_time": published, "sequence": sequence, "data": payload}
                for batch in topic_messages.read(StoredTopic([file], topic), 0, LAST_NS)
                for time, published, sequence, payload in zip(
                    batch.times_ns.tolist(),
                    batch.published_ns.tolist(),
                    batch.sequences.tolist(),
                    batch.payloads,
                    strict=True,
                )
            ]
            wanted = sorted(_of(expected, "Message"), key=lambda one: int(one["log_time"]))
            if [{"channel_id": number, **plain(one)} for one in found] != wanted:
                yield f"its messages on {topic!r} differ"
        footer = summary.read_footer(file.source, file.source.size())
        if footer is None or plain(footer.summary_crc) != expected[-1]["fields"]["summary_crc"]:
            yield "its footer differs"
    finally:
        file.close()


def features(path: Path) -> list[str]:
    """Return the features that a variant's name lists."""
    return path.stem.split("-")[1:]


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="DIR", help="a folder with a folder for each input")
    folder: Path = parser.parse_args().folder
    paths = sorted(path for path in folder.glob("*/*.mcap") if path.with_suffix(".json").exists())
    if not paths:
        print(f"{folder}: no <input>/<variant>.mcap with a .json beside it", file=sys.stderr)
        return 1
    wrong = {path: found for path in paths if (found := differences(path))}
    print(f"{'input':<24} {'files':>6} {'as described':>13}")
    for name, count in Counter(path.parent.name for path in paths).items():
        print(f"{name:<24} {count:>6} {count - sum(path.parent.name == name for path in wrong):>13}")
    print(f"{'with the feature':<24}")
    for feature, count in sorted(Counter(one for path in paths for one in features(path)).items()):
        print(f"  {feature:<22} {count:>6} {count - sum(feature in features(path) for path in wrong):>13}")
    print(f"{'all':<24} {len(paths):>6} {len(paths) - len(wrong):>13}")
    for path, found in wrong.items():
        print(f"{path.relative_to(folder)}: {'; '.join(found)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
