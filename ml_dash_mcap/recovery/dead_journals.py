"""Finds and parses the journal buffers that a dead recorder left behind."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from ..capture.channels import ChannelInfo
from ..codecs.codec import Codec
from ..codecs.decode import codec_of
from ..errors import DamagedFileError
from ..file_names import JOURNAL_RECORD, KIND_KEY, TRACK
from ..mcap.record_layout import PREFIX_BYTES, Fields, read_prefix
from ..mcap.records import CHANNEL, MAGIC, METADATA, SCHEMA, Channel, Opcode, Schema


@dataclass(slots=True)
class Leftover:
    """A journal buffer of a dead recorder."""

    path: Path
    data: bytes
    begin: int
    """Where in it the first record starts."""
    end: int
    """The place where the last sound record ends."""
    session: str | None = None
    block: int = -1
    """Its number among the session's blocks with rows."""
    starts: list[int] = field(default_factory=list)
    gaps: list[tuple[int, int]] = field(default_factory=list)
    extras: list[tuple[int, int]] = field(default_factory=list)
    channels: dict[int, ChannelInfo] = field(default_factory=dict)

    def take(self, opcode: int, at: int, end: int, schemas: dict[int, Schema]) -> None:
        """Take in one record.

        Raises:
            DamagedFileError: It contradicts itself.
        """
        if opcode == Opcode.MESSAGE:
            self.starts.append(at)
            return
        fields = Fields(self.data, str(self.path), 0, at + PREFIX_BYTES, end)
        if opcode == Opcode.SCHEMA:
            schema = SCHEMA.read(fields)
            schemas[schema.id] = schema
            info = self.channels.get(schema.id)
            if info is not None:  # the schema grew
                self.channels[info.number] = _with_schema(info, schema)
        elif opcode == Opcode.CHANNEL:
            info = _channel_info(CHANNEL.read(fields), schemas)
            self.channels[info.number] = info
        elif opcode == Opcode.METADATA:
            metadata = METADATA.read(fields)
            if metadata.name == JOURNAL_RECORD:
                self.session, self.block = metadata.values["session"], int(metadata.values["block"])
            else:
                self.extras.append((at, end))
        self.gaps.append((at, end))


def read_all(paths: list[Path], session: str) -> list[Leftover]:
    """Read the buffers that hold something, in the order in which they were filled."""
    leftovers = [_read(path, session) for path in paths]
    return sorted(
        (leftover for leftover in leftovers if leftover is not None),
        # A buffer of metadata only has the number of the next block with rows, and was filled before it.
        key=lambda leftover: (leftover.block, bool(leftover.starts)),
    )


def _read(path: Path, session: str) -> Leftover | None:
    """Read a buffer's records up to the first byte that begins none; None if nothing was recorded in it."""
    data = path.read_bytes()
    if not data.startswith(MAGIC):
        return None
    leftover = Leftover(path, data, begin=len(MAGIC), end=len(MAGIC))
    schemas: dict[int, Schema] = {}
    while leftover.end + PREFIX_BYTES <= len(data):
        at = leftover.end
        opcode, length = read_prefix(data, at)
        end = at + PREFIX_BYTES + length
        if opcode == 0 or end > len(data):
            break
        try:
            leftover.take(opcode, at, end, schemas)
        except DamagedFileError:  # the machine did this, not the recorder; what came before is whole
            break
        leftover.end = end
    return leftover if leftover.session == session and (leftover.starts or leftover.extras) else None


def _channel_info(channel: Channel, schemas: dict[int, Schema]) -> ChannelInfo:
    """Return a topic as its recorder had it, without a codec if its encoding is not known or not installed here."""
    metadata = dict(channel.metadata)
    kind = metadata.pop(KIND_KEY, TRACK)
    schema = schemas[channel.schema_id]
    codec = codec_of(channel)
    info = ChannelInfo(
        channel.id,
        channel.topic,
        kind,
        metadata,
        schema_name=schema.name,
        message_encoding=channel.message_encoding,
        schema_encoding=schema.encoding,
        codec=codec if isinstance(codec, Codec) else None,
    )
    return _with_schema(info, schema)


def _with_schema(info: ChannelInfo, schema: Schema) -> ChannelInfo:
    """Return a topic with a schema, and with a codec that goes on with it if the schema is inferred."""
    data = bytes(schema.data)
    codec = None if info.codec is None else info.codec.for_channel(info.topic, data)
    info = replace(info, codec=codec, schema=None)
    is_inferred = codec is not None and data == info.first_schema()
    return info if is_inferred else replace(info, schema=data)
