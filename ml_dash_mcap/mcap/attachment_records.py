"""Finds the attachments of one MCAP file, by its index or by a scan, and reads their bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from zlib import crc32

from ..errors import DamagedFileError
from .indexed_file import IndexedFile
from .record_layout import PREFIX_BYTES, Fields, read_prefix
from .records import ATTACHMENT_HEAD, MAGIC, AttachmentEntry, Opcode

_HEAD_BYTES = 4096
"""So much of an attachment is read to compare it with the index."""

_NAMES_BYTES = 64 * 1024
"""Enough of an attachment to hold everything before its data."""


def entries(file: IndexedFile) -> Sequence[AttachmentEntry]:
    """Return where a file's attachments lie, in its order: by its index, or by a scan where that is wrong."""
    glance = file.glance
    statistics = glance.statistics
    if statistics is not None and statistics.attachment_count != len(glance.attachments):
        return list(_scan(file))
    wrong = next((entry for entry in glance.attachments if not _is_there(file, entry)), None)
    if wrong is not None:
        what = f"the attachment index says that {wrong.name!r} is here, with its size and times, which is not so"
        scanned = list(_scan(file))
        if len(scanned) >= len(glance.attachments):
            file.note(wrong.offset, what, "attachment")
            return scanned
    return glance.attachments


def _is_there(file: IndexedFile, entry: AttachmentEntry) -> bool:
    """Whether an attachment starts where an index says, and says the same of itself."""
    try:
        data = file.source.read(entry.offset, min(entry.length, _HEAD_BYTES))
        if len(data) < PREFIX_BYTES or read_prefix(data, 0)[0] != Opcode.ATTACHMENT:
            return False
        length = PREFIX_BYTES + read_prefix(data, 0)[1]
        fields = Fields(data, file.source.name, entry.offset, PREFIX_BYTES)
        return entry == ATTACHMENT_HEAD.read(fields, offset=entry.offset, length=length)
    except DamagedFileError:
        return entry.length > _HEAD_BYTES  # its names are too long to be looked at here


def _scan(file: IndexedFile) -> Iterator[AttachmentEntry]:
    source, at = file.source, len(MAGIC)
    size = source.size()
    while at + PREFIX_BYTES <= size:
        opcode, length = read_prefix(source.read(at, PREFIX_BYTES), 0)
        content, end = at + PREFIX_BYTES, at + PREFIX_BYTES + length
        if opcode in (0, Opcode.DATA_END, Opcode.FOOTER) or end > size:
            return
        if opcode == Opcode.ATTACHMENT:
            start = Fields(source.read(content, min(length, _NAMES_BYTES)), source.name, content)
            yield ATTACHMENT_HEAD.read(start, offset=at, length=end - at)
        at = end


def data(file: IndexedFile, entry: AttachmentEntry) -> bytes:
    """Return an attachment's bytes, checked against the checksum (CRC-32) that they were written with.

    Raises:
        DamagedFileError: They do not match it, or lie elsewhere than the index says.
        StorageError: The file is closed.
    """
    source, at, length = file.source, entry.offset, entry.length
    if at + length > source.size():
        raise DamagedFileError(source.name, at, f"the attachment {entry.name!r} ends behind the end of the file")
    record = source.read(at, length)
    opcode, content = read_prefix(record, 0) if length >= PREFIX_BYTES else (0, 0)
    if opcode != Opcode.ATTACHMENT or content != length - PREFIX_BYTES:
        raise DamagedFileError(source.name, at, "the index says that an attachment starts here, but none does")
    fields = Fields(record, source.name, at, PREFIX_BYTES)
    head = ATTACHMENT_HEAD.read(fields, offset=at, length=length)
    data = fields.raw(head.data_size)
    checked = memoryview(record)[PREFIX_BYTES : fields.at]  # later versions may add fields behind it
    # 0 stands for no checksum.
    expected = fields.u32()
    if expected and crc32(checked) != expected:
        raise DamagedFileError(
            source.name, at, f"the checksum (CRC-32) of the attachment {entry.name!r} does not match its content"
        )
    return data
