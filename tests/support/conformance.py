"""The files of the MCAP project's conformance suite, built byte by byte, each with the records that it holds.

The rules are those of the suite (https://github.com/foxglove/mcap, tests/conformance: inputs, variants of ten features,
and which of them make sense together). `rsh` repeats schemas, `rch` channels; `ax`, `mdx`, `chx` and `mx` are indexes of
attachments, metadata, chunks and messages; `ch` puts messages into a chunk, `st` adds statistics, `sum` summary offsets,
and `pad` three bytes behind the last field of every record that may be extended.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

from tests.support.raw import MAGIC, numbers, record, text

Fields = dict[str, Any]
Described = tuple[str, Fields]
"""The name of a record's kind, and its fields."""

FEATURES = ("ch", "mx", "st", "rsh", "rch", "ax", "mdx", "chx", "sum", "pad")
PAD = b"\x01\xff\xff"

SCHEMA: Described = ("Schema", {"id": 1, "name": "Example", "encoding": "c", "data": bytes([4, 5, 6])})
CHANNEL: Described = (
    "Channel",
    {"id": 1, "schema_id": 1, "topic": "example", "message_encoding": "a", "metadata": {"foo": "bar"}},
)
SCHEMALESS: Described = (
    "Channel",
    {"id": 1, "schema_id": 0, "topic": "example", "message_encoding": "text", "metadata": {}},
)
ATTACHMENT: Described = (
    "Attachment",
    {
        "name": "myFile",
        "media_type": "application/octet-stream",
        "log_time": 2,
        "create_time": 1,
        "data": bytes([1, 2, 3]),
    },
)
METADATA: Described = ("Metadata", {"name": "myMetadata", "metadata": {"foo": "bar"}})


def message(sequence: int, log_time: int, publish_time: int) -> Described:
    data = bytes([1, 2, 3])
    return "Message", {
        "channel_id": 1, "sequence": sequence, "log_time": log_time, "publish_time": publish_time, "data": data
    }  # fmt: skip


INPUTS: dict[str, list[Described]] = {
    "NoData": [],
    "OneSchemalessMessage": [SCHEMALESS, message(10, 2, 1)],
    "OneMessage": [SCHEMA, CHANNEL, message(10, 2, 1)],
    "OneAttachment": [ATTACHMENT],
    "OneMetadata": [METADATA],
    "TenMessages": [
        SCHEMA,
        CHANNEL,
        *(message(sequence, time, time) for sequence, time in enumerate((0, 2, 1, 3, 3, 5, 4, 7, 8, 9))),
    ],
}


def variants() -> Iterator[tuple[str, frozenset[str]]]:
    """Every input with every set of features that makes sense for it."""
    for name, records in INPUTS.items():
        kinds = {kind for kind, _ in records}
        for count in range(len(FEATURES) + 1):
            for chosen in combinations(FEATURES, count):
                if _makes_sense(frozenset(chosen), kinds):
                    yield name, frozenset(chosen)


def _makes_sense(features: frozenset[str], kinds: set[str]) -> bool:
    needs = {"ax": "Attachment", "mdx": "Metadata", "rsh": "Schema", "rch": "Channel"}
    if any(feature in features and kind not in kinds for feature, kind in needs.items()):
        return False
    if features & {"ch", "chx", "mx"} and not kinds & {"Message", "Channel", "Schema"}:
        return False
    if "sum" in features and not features & {"chx", "rsh", "rch", "mdx", "ax", "st"}:
        return False
    return "ch" in features or not features & {"chx", "mx"}


def file_name(name: str, features: frozenset[str]) -> str:
    return "-".join([name, *sorted(features)])


def octets(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def texts(values: Mapping[str, str]) -> bytes:
    return octets(b"".join(text(key) + text(value) for key, value in values.items()))


PACKED: dict[str, Callable[[Fields], bytes]] = {
    "Header": lambda of: text(of["profile"]) + text(of["library"]),
    "Schema": lambda of: struct.pack("<H", of["id"]) + text(of["name"]) + text(of["encoding"]) + octets(of["data"]),
    "Channel": lambda of: (
        struct.pack("<HH", of["id"], of["schema_id"])
        + text(of["topic"])
        + text(of["message_encoding"])
        + texts(of["metadata"])
    ),
    "Message": lambda of: (
        struct.pack("<HIQQ", *(of[name] for name in ("channel_id", "sequence", "log_time", "publish_time"))) + of["data"]
    ),
    "Chunk": lambda of: (
        struct.pack("<QQQI", of["start"], of["end"], len(of["records"]), zlib.crc32(of["records"]))
        + text("")
        + struct.pack("<Q", len(of["records"]))
        + of["records"]
    ),
    "MessageIndex": lambda of: (
        struct.pack("<H", of["channel_id"]) + octets(b"".join(struct.pack("<QQ", *one) for one in of["records"]))
    ),
    "Attachment": lambda of: _with_crc(
        struct.pack("<QQ", of["log_time"], of["create_time"])
        + text(of["name"])
        + text(of["media_type"])
        + struct.pack("<Q", len(of["data"]))
        + of["data"]
    ),
    "Metadata": lambda of: text(of["name"]) + texts(of["metadata"]),
    "DataEnd": lambda of: struct.pack("<I", of["data_section_crc"]),
    "Statistics": lambda of: (
        struct.pack(
            "<QHIIIIQQ",
            *(of[name] for name in ("message_count", "schema_count", "channel_count", "attachment_count")),
            *(of[name] for name in ("metadata_count", "chunk_count", "message_start_time", "message_end_time")),
        )
        + numbers(of["channel_message_counts"])
    ),
    "MetadataIndex": lambda of: struct.pack("<QQ", of["offset"], of["length"]) + text(of["name"]),
    "AttachmentIndex": lambda of: (
        struct.pack("<QQQQQ", *(of[name] for name in ("offset", "length", "log_time", "create_time", "data_size")))
        + text(of["name"])
        + text(of["media_type"])
    ),
    "ChunkIndex": lambda of: (
        struct.pack("<QQQQ", *(of[f"{name}"] for name in
                    ("message_start_time", "message_end_time", "chunk_start_offset", "chunk_length")))
        + numbers(of["message_index_offsets"])
        + struct.pack("<Q", of["message_index_length"])
        + text(of["compression"])
        + struct.pack("<QQ", of["compressed_size"], of["uncompressed_size"])
    ),
    "SummaryOffset": lambda of: struct.pack("<BQQ", of["group_opcode"], of["group_start"], of["group_length"]),
    "Footer": lambda of: struct.pack("<QQI", of["summary_start"], of["summary_offset_start"], of["summary_crc"]),
}  # fmt: skip
"""The layouts of https://mcap.dev/spec#records."""

OPCODES = {
    name: opcode
    for opcode, name in enumerate(
        (
            *("Header", "Footer", "Schema", "Channel", "Message", "Chunk", "MessageIndex", "ChunkIndex", "Attachment"),
            *("AttachmentIndex", "Statistics", "Metadata", "MetadataIndex", "SummaryOffset", "DataEnd"),
        ),
        1,
    )
}
NEVER_PADDED = {"Message", "Chunk", "DataEnd", "Footer"}
"""What the suite's own writer never extends; the specification lets a Chunk and a DataEnd grow too."""
NOT_LISTED = {"Chunk", "MessageIndex"}
"""What a description leaves out: it lists the records of a chunk instead."""


def _with_crc(data: bytes) -> bytes:
    return data + struct.pack("<I", zlib.crc32(data))


@dataclass
class Build:
    """A file in the making, and the description of it."""

    features: frozenset[str]
    padded: frozenset[str] = frozenset(OPCODES) - NEVER_PADDED
    """The kinds of records that get a pad, if the file has them."""
    pad: bytes = PAD
    data: bytes = MAGIC
    records: list[Described] = field(default_factory=list)

    def packed(self, kind: str, fields: Fields, *, is_inside: bool = False) -> bytes:
        behind = self.pad if "pad" in self.features and kind in self.padded and not is_inside else b""
        return record(OPCODES[kind], PACKED[kind](fields) + behind)

    def add(self, kind: str, fields: Fields) -> tuple[int, int]:
        """Add a record; returns where it starts, and its length."""
        packed = self.packed(kind, fields)
        self.data += packed
        if kind not in NOT_LISTED:
            self.records.append((kind, fields))
        return len(self.data) - len(packed), len(packed)


def build(name: str, features: frozenset[str], **how: Any) -> Build:
    """Build one variant of one input. Other arguments are those of `Build`."""
    made = Build(features, **how)
    made.add("Header", {"profile": "", "library": ""})
    indexes: dict[str, list[Fields]] = {"MetadataIndex": [], "AttachmentIndex": [], "ChunkIndex": []}
    inside = b""
    entries: dict[int, list[tuple[int, int]]] = {}
    times: list[int] = []
    for kind, fields in INPUTS[name]:
        if "ch" in features and kind in ("Schema", "Channel", "Message"):
            if kind == "Channel":
                entries.setdefault(fields["id"], [])
            if kind == "Message":
                entries[fields["channel_id"]].append((fields["log_time"], len(inside)))
            inside += made.packed(kind, fields, is_inside=True)
            made.records.append((kind, fields))
        else:
            _add_alone(made, kind, fields, indexes)
        times += [fields["log_time"]] if kind == "Message" else []
    if "ch" in features:
        _add_chunk(made, inside, entries, times, indexes)
    made.add("DataEnd", {"data_section_crc": zlib.crc32(made.data)})
    _add_summary(made, INPUTS[name], indexes, times)
    return made


def _add_alone(made: Build, kind: str, fields: Fields, indexes: dict[str, list[Fields]]) -> None:
    offset, length = made.add(kind, fields)
    if kind == "Attachment" and "ax" in made.features:
        said = {key: fields[key] for key in ("log_time", "create_time", "name", "media_type")}
        indexes["AttachmentIndex"].append(
            {"offset": offset, "length": length, "data_size": len(fields["data"]), **said}
        )
    if kind == "Metadata" and "mdx" in made.features:
        indexes["MetadataIndex"].append({"offset": offset, "length": length, "name": fields["name"]})


def _add_chunk(
    made: Build,
    inside: bytes,
    entries: dict[int, list[tuple[int, int]]],
    times: list[int],
    indexes: dict[str, list[Fields]],
) -> None:
    start, end = min(times), max(times)
    offset, length = made.add("Chunk", {"start": start, "end": end, "records": inside})
    offsets: dict[int, int] = {}
    index_length = 0
    for channel_id, found in entries.items() if "mx" in made.features else ():
        offsets[channel_id], size = made.add("MessageIndex", {"channel_id": channel_id, "records": found})
        index_length += size
    if "chx" in made.features:
        indexes["ChunkIndex"].append(
            {
                "message_start_time": start,
                "message_end_time": end,
                "chunk_start_offset": offset,
                "chunk_length": length,
                "message_index_offsets": offsets,
                "message_index_length": index_length,
                "compression": "",
                "compressed_size": len(inside),
                "uncompressed_size": len(inside),
            }
        )


def _add_summary(made: Build, records: list[Described], indexes: dict[str, list[Fields]], times: list[int]) -> None:
    kinds = [kind for kind, _ in records]
    statistics = {
        "message_count": len(times),
        "schema_count": kinds.count("Schema"),
        "channel_count": kinds.count("Channel"),
        "attachment_count": kinds.count("Attachment"),
        "metadata_count": kinds.count("Metadata"),
        "chunk_count": int("ch" in made.features),
        "message_start_time": min(times, default=0),
        "message_end_time": max(times, default=0),
        "channel_message_counts": {1: len(times)} if times else {},
    }
    repeated = {"Schema": "rsh", "Channel": "rch"}
    groups: dict[str, list[Fields]] = {
        **{
            kind: [fields for one, fields in records if one == kind and feature in made.features]
            for kind, feature in repeated.items()
        },
        "Statistics": [statistics] if "st" in made.features else [],
        **indexes,
    }
    start = len(made.data)
    places = []
    for kind, group in groups.items():
        begin = len(made.data)
        for fields in group:
            made.add(kind, fields)
        places += [(kind, begin, len(made.data) - begin)] if group else []
    footer = {"summary_start": start if places else 0, "summary_offset_start": 0, "summary_crc": 0}
    if "sum" in made.features:
        footer["summary_offset_start"] = len(made.data)
        for kind, begin, length in places:
            made.add("SummaryOffset", {"group_opcode": OPCODES[kind], "group_start": begin, "group_length": length})
    footer["summary_crc"] = zlib.crc32(made.data[start:] + made.packed("Footer", footer)[:-4])
    made.add("Footer", footer)
    made.data += MAGIC


def description(made: Build) -> str:
    """The JSON that lies beside a file of the suite."""
    records = [
        {"type": kind, "fields": [[name, _plain(fields[name])] for name in sorted(fields)]}
        for kind, fields in made.records
    ]
    features = [feature for feature in FEATURES if feature in made.features]
    return json.dumps({"records": records, "meta": {"variant": {"features": features}}})


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return [str(octet) for octet in value]
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    return value if isinstance(value, str) else str(value)


def save(folder: Path) -> int:
    """Write the whole suite into a folder; returns how many files it has."""
    count = 0
    for name, features in variants():
        made = build(name, features)
        place = folder / name
        place.mkdir(exist_ok=True)
        path = place / f"{file_name(name, features)}.mcap"
        path.write_bytes(made.data)
        path.with_suffix(".json").write_text(description(made))
        count += 1
    return count
