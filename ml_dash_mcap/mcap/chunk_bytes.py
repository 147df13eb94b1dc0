"""Unpacks a Chunk record into the records in it, within the limits on memory.

A chunk that is over the limits is refused by `unpack`; `read_fitting` streams it, and keeps the records that fit.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from zlib import crc32

from ..errors import DamagedFileError
from ..store.byte_source import ByteSource
from . import records
from .limits import MIB, Limits, of_file
from .message_records import MESSAGE_FIXED_BYTES
from .record_layout import PREFIX_BYTES, Bytes, Fields, read_prefix
from .records import Chunk, ChunkHead, Opcode

_PIECE = MIB
MOST_BYTES = 256 * MIB
"""The most uncompressed bytes that are looked at in a chunk that is compressed by more than `Limits.ratio`."""
MOST_RECORDS = 500_000
"""The most records that are looked at in such a chunk: small records cost the most time for their bytes."""
# A zstd frame says how large a window its reader must allocate. Larger windows are refused.
_MOST_WINDOW = 64 * MIB
_KEPT = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))


class LimitError(DamagedFileError):
    """A chunk would take more memory than the limits allow; the message says which to raise, and to what."""


class NoChunkError(DamagedFileError):
    """No chunk starts where an index says that one does."""


def check_size(chunk: Chunk, path: str, limits: Limits) -> None:
    """Refuse a chunk that would take too much memory, by the sizes that it announces, before any of it is read.

    Raises:
        DamagedFileError: It is beyond the limits.
    """
    size, packed = chunk.uncompressed_size, chunk.compressed_size
    if max(size, chunk.length - limits.record_bytes) > limits.chunk_bytes:
        largest = max(size, chunk.length)
        what = f"a chunk of {largest} bytes; the limit is {limits.chunk_bytes} (Limits.chunk_bytes)"
        raise LimitError(path, chunk.offset, f"{what}; limits=Limits(chunk_bytes={largest}) reads it")
    allowed = of_file(limits, 0).any_ratio_bytes or 0
    if size > allowed and size > limits.ratio * packed:
        what = f"a chunk that unpacks {packed} bytes to {size}; the limit is {limits.ratio} times (Limits.ratio)"
        what = f"{what} beyond {allowed} bytes (Limits.any_ratio_bytes)"
        raise LimitError(path, chunk.offset, f"{what}; limits=Limits(any_ratio_bytes={size}) reads it")


def unpack(
    record: Bytes, chunk: Chunk, path: str, limits: Limits, note: Callable[[str], None] = lambda what: None
) -> bytes:
    """Return a chunk's records, uncompressed and checked.

    Args:
        record: The whole Chunk record (or, for loose messages, just these).
        chunk: Its entry in the index.
        path: The file, for error messages.
        limits: Checked before memory is taken.
        note: Called with faults of the index entry, in words. The chunk itself counts.

    Raises:
        DamagedFileError: The record is no chunk, contradicts itself, is beyond the limits, or its CRC does not match.
    """
    check_size(chunk, path, limits)
    if chunk.compression == records.LOOSE:
        return bytes(record)
    opcode, length = read_prefix(record, 0) if len(record) >= PREFIX_BYTES else (0, 0)
    if opcode != Opcode.CHUNK or length != len(record) - PREFIX_BYTES:
        raise NoChunkError(path, chunk.offset, "the index says that a chunk starts here, but none does")
    fields = Fields(record, path, chunk.offset, PREFIX_BYTES)
    head = records.CHUNK_HEAD.read(fields)
    if head.records_length > len(record) - fields.at:  # a later version may add fields behind them
        raise DamagedFileError(path, chunk.offset, "a chunk whose content is longer than its record")
    stated = (chunk.compression, chunk.compressed_size, chunk.uncompressed_size)
    actual = (head.compression, head.records_length, head.uncompressed_size)
    if actual != stated:
        note(f"the chunk's index says (compression, compressed and uncompressed bytes) {stated}, the chunk {actual}")
        check_size(replace(chunk, compressed_size=actual[1], uncompressed_size=actual[2]), path, limits)
    packed = memoryview(record)[fields.at : fields.at + head.records_length]
    data = _decompress(packed, head, path, chunk.offset)
    if len(data) != head.uncompressed_size:
        raise DamagedFileError(
            path, chunk.offset, f"a chunk of {len(data)} bytes that announces {head.uncompressed_size} bytes"
        )
    if head.uncompressed_crc and crc32(data) != head.uncompressed_crc:
        raise DamagedFileError(path, chunk.offset, "a chunk whose checksum (CRC-32) does not match its content")
    return data


def _decompress(packed: memoryview, head: ChunkHead, path: str, offset: int) -> bytes:
    if head.compression == "":
        return bytes(packed)
    try:
        if head.compression == "zstd":
            return _unpack_zstd(packed, head.uncompressed_size)
        if head.compression == "lz4":
            return _unpack_lz4(packed, head.uncompressed_size)
    except Exception as error:  # each decompressor has its own error types, some of them plain RuntimeErrors
        raise DamagedFileError(path, offset, f"a chunk that cannot be uncompressed: {error}") from error
    raise DamagedFileError(path, offset, f"a chunk with the unknown compression {head.compression!r}")


_own = threading.local()
"""A decompressor for each thread: to make one takes 30 us, as long as it takes to unpack 30 kB."""


def _unpack_zstd(packed: memoryview, size: int) -> bytes:
    import zstandard

    announced = zstandard.frame_content_size(packed)
    if announced not in (-1, size):  # the decompressor believes the frame, whatever max_output_size says
        raise ValueError(f"its frame announces {announced} bytes, the chunk {size}")
    # max_output_size=0 stands for no limit.
    if size == 0:
        return b""
    decompressor = getattr(_own, "zstd", None)
    if decompressor is None:
        decompressor = _own.zstd = zstandard.ZstdDecompressor()
    data: bytes = decompressor.decompress(packed, max_output_size=size)
    return data


def _unpack_lz4(packed: memoryview, size: int) -> bytes:
    import lz4.frame

    decompressor = lz4.frame.LZ4FrameDecompressor()
    # One byte more than announced, to notice a frame that holds more.
    data: bytes = decompressor.decompress(packed, max_length=size + 1)
    return data


@dataclass(frozen=True, slots=True)
class FittingRecords:
    """The part of a chunk that fits the limits."""

    data: bytes
    """Its schemas, channels and messages that fit."""
    lost: Mapping[int, int]
    """Channel to how many messages do not fit."""
    is_whole: bool
    """Whether the chunk was read up to its end, so that its checksum is verified."""


def read_fitting(source: ByteSource, chunk: Chunk, limits: Limits) -> FittingRecords:
    """Read the part of a chunk over the limits that fits them.

    Args:
        source: The file.
        chunk: Which one.
        limits: Records fit that have, each and together, no more than `any_ratio_bytes` and `chunk_bytes`.

    Raises:
        DamagedFileError: It is damaged besides.
    """
    name = source.name
    front = source.read(chunk.offset, min(chunk.length, PREFIX_BYTES + records.CHUNK_HEAD_BYTES))
    opcode, length = read_prefix(front, 0) if len(front) >= PREFIX_BYTES else (0, 0)
    if opcode != Opcode.CHUNK or length != chunk.length - PREFIX_BYTES:
        raise DamagedFileError(name, chunk.offset, "the index says that a chunk starts here, but none does")
    fields = Fields(front, name, chunk.offset, PREFIX_BYTES)
    head = records.CHUNK_HEAD.read(fields)
    if fields.at + head.records_length > chunk.length:
        raise DamagedFileError(name, chunk.offset, "a chunk whose content is longer than its record")
    most = max(MOST_BYTES, limits.ratio * head.records_length)
    try:
        # One byte more than announced, to notice a chunk that holds more.
        stream = _UnpackedStream(_pieces(source, chunk.offset + fields.at, head), min(most, head.uncompressed_size + 1))
        rest = _keep_fitting(stream, min(of_file(limits, 0).any_ratio_bytes or 0, limits.chunk_bytes))
    except DamagedFileError as error:
        raise DamagedFileError(name, chunk.offset, error.what) from error
    except Exception as error:  # each decompressor has its own error types, some of them plain RuntimeErrors
        raise DamagedFileError(name, chunk.offset, f"a chunk that cannot be uncompressed: {error}") from error
    if rest.is_whole and stream.size != head.uncompressed_size:
        what = f"a chunk of {stream.size} bytes that announces {head.uncompressed_size} bytes"
        raise DamagedFileError(name, chunk.offset, what)
    if rest.is_whole and head.uncompressed_crc and stream.crc != head.uncompressed_crc:
        raise DamagedFileError(name, chunk.offset, "a chunk whose checksum (CRC-32) does not match its content")
    return rest


def _keep_fitting(stream: _UnpackedStream, room: int) -> FittingRecords:
    """Keep the records that fit into `room` bytes, in the order in which they lie."""
    kept = bytearray()
    lost: dict[int, int] = {}
    for _ in range(MOST_RECORDS):
        start = stream.take(PREFIX_BYTES)
        if len(start) < PREFIX_BYTES:
            return FittingRecords(bytes(kept), lost, stream.is_at_end and not start)
        opcode, length = read_prefix(start, 0)
        if opcode == 0:  # "0x00 is not a valid opcode"
            raise DamagedFileError("", 0, "a chunk with damaged records (one with the opcode 0)")
        if opcode in _KEPT and len(kept) + len(start) + length <= room:
            body = stream.take(length)
            if len(body) < length:
                return FittingRecords(bytes(kept), lost, is_whole=False)
            kept += start
            kept += body
            continue
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE_FIXED_BYTES:
                raise DamagedFileError("", 0, "a chunk with damaged records (a message that is shorter than any)")
            channel_id = int.from_bytes(stream.take(2), "little")
            lost[channel_id] = lost.get(channel_id, 0) + 1
            length -= 2
        if not stream.skip(length):
            return FittingRecords(bytes(kept), lost, is_whole=False)
    return FittingRecords(bytes(kept), lost, is_whole=False)


class _UnpackedStream:
    """Uncompressed bytes, of which little is in memory at a time."""

    def __init__(self, pieces: Iterator[bytes], most: int) -> None:
        """Begin at the start of the bytes that `pieces` yields, of which `most` are looked at."""
        self._pieces = pieces
        self._most = most
        self._piece = b""
        self._at = 0
        self.size = 0
        """How many bytes came out so far."""
        self.crc = 0
        """Their CRC-32."""
        self.is_at_end = False
        """Whether there are no more."""

    def _next(self) -> bool:
        piece = next(self._pieces, b"") if self.size < self._most else None
        self.is_at_end = piece == b""
        if not piece:
            return False
        self._piece, self._at = piece, 0
        self.size += len(piece)
        self.crc = crc32(piece, self.crc)
        return True

    def take(self, length: int) -> bytes:
        """Return the next bytes; fewer where they end."""
        if self._at + length <= len(self._piece):
            self._at += length
            return self._piece[self._at - length : self._at]
        parts = []
        while length:
            part = self._piece[self._at : self._at + length]
            self._at += len(part)
            length -= len(part)
            parts.append(part)
            if length and not self._next():
                break
        return b"".join(parts)

    def skip(self, length: int) -> bool:
        """Pass over bytes; returns whether there were so many."""
        while length > len(self._piece) - self._at:
            length -= len(self._piece) - self._at
            self._at = len(self._piece)
            if not self._next():
                return False
        self._at += length
        return True


class _PackedFile:
    """The compressed bytes of a chunk, as a file."""

    def __init__(self, source: ByteSource, at: int, length: int) -> None:
        self._source, self._at, self._end = source, at, at + length

    def read(self, size: int = _PIECE) -> bytes:
        """Return the next bytes, none at the end."""
        data = self._source.read(self._at, min(size, self._end - self._at))
        self._at += len(data)
        return data


def _pieces(source: ByteSource, at: int, head: ChunkHead) -> Iterator[bytes]:
    """Yield a chunk's records, uncompressed, in pieces of any lengths up to about 1 MiB."""
    packed = _PackedFile(source, at, head.records_length)
    if head.compression == "":
        return iter(packed.read, b"")
    if head.compression == "zstd":
        import zstandard

        reader = zstandard.ZstdDecompressor(max_window_size=_MOST_WINDOW).stream_reader(packed)  # type: ignore[arg-type]
        return iter(lambda: reader.read(_PIECE), b"")
    if head.compression == "lz4":
        return _lz4(packed)
    raise ValueError(f"it has the unknown compression {head.compression!r}")


def _lz4(packed: _PackedFile) -> Iterator[bytes]:
    import lz4.frame

    decompressor = lz4.frame.LZ4FrameDecompressor()
    while not decompressor.eof:
        more = packed.read(_PIECE // 8) if decompressor.needs_input else b""
        if decompressor.needs_input and not more:
            return
        piece: bytes = decompressor.decompress(more, max_length=_PIECE)
        if piece:
            yield piece
