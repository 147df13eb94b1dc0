"""Files that were put inside a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from zlib import crc32

from .. import clock
from ..errors import DamagedFileError
from ..mcap import records
from ..mcap.record_layout import PREFIX_BYTES, Fields, read_prefix
from ..mcap.records import AttachmentEntry, Opcode
from .file import File
from .lazy_mapping import Lookup

_HEAD_BYTES = 4096
"""So much is read to see whether an attachment is what the index says."""

_NAMES_BYTES = 64 * 1024
"""Enough of an attachment to hold everything before its data."""


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside a recording, such as a calibration; its bytes are read when they are asked for."""

    name: str
    media_type: str
    """Such as "application/json"; what its writer said."""
    log_time: float
    """When it was put there, in s."""
    size: int
    """In bytes."""
    _file: File = field(repr=False, compare=False)
    _entry: AttachmentEntry = field(repr=False, compare=False)

    def read(self) -> bytes:
        """Return its bytes, checked against the checksum (CRC-32) that they were written with.

        Raises:
            DamagedFileError: They do not match it, or lie elsewhere than the index says.
            StorageError: The recording is closed.

        Example:
            >>> json.loads(rec.attachments["calibration.json"].read())
        """
        source, at, length = self._file.source, self._entry.offset, self._entry.length
        if at + length > source.size():
            raise DamagedFileError(source.name, at, f"the attachment {self.name!r} ends behind the end of the file")
        record = source.read(at, length)
        opcode, content = read_prefix(record, 0) if length >= PREFIX_BYTES else (0, 0)
        if opcode != Opcode.ATTACHMENT or content != length - PREFIX_BYTES:
            raise DamagedFileError(source.name, at, "the index says that an attachment starts here, but none does")
        fields = Fields(record, source.name, at, PREFIX_BYTES)
        found = records.ATTACHMENT_HEAD.read(fields, offset=at, length=length)
        data = fields.raw(found.data_size)
        checked = memoryview(record)[PREFIX_BYTES : fields.at]  # later versions may add fields behind it
        expected = fields.u32()
        if expected and crc32(checked) != expected:
            raise DamagedFileError(
                source.name, at, f"the checksum (CRC-32) of the attachment {self.name!r} does not match its content"
            )
        return data


class Attachments(Lookup[Attachment]):
    """Names, sorted, to attachments; of several of one name, the one that was written last."""

    def __init__(self, found: Sequence[Attachment]) -> None:
        """Name what was found, in the order of writing."""
        by_name = {one.name: one for one in found}
        super().__init__("attachment", sorted(by_name), by_name.__getitem__)
        self._found = tuple(found)

    def list(self) -> list[Attachment]:
        """Return all of them, in the order of writing, those of one name too."""
        return list(self._found)


def find(files: Sequence[File]) -> Attachments:
    """Return the attachments of some files, without reading their bytes: only where each starts, to see that it does.

    Args:
        files: In the order of writing.
    """
    return Attachments(
        [
            Attachment(one.name, one.media_type, clock.to_seconds(one.log_time_ns), one.data_size, file, one)
            for file in files
            for one in sorted(entries(file), key=lambda one: one.offset)
        ]
    )


def entries(file: File) -> Sequence[AttachmentEntry]:
    """Return where a file's attachments lie, in its order: by its index, or by a walk where that is wrong."""
    glance = file.glance
    said = glance.statistics
    if said is not None and said.attachment_count != len(glance.attachments):
        return list(_walk(file))
    wrong = next((entry for entry in glance.attachments if not _is_there(file, entry)), None)
    if wrong is not None:
        what = f"the attachment index says that {wrong.name!r} is here, with its size and times, which is not so"
        walked = list(_walk(file))
        if len(walked) >= len(glance.attachments):
            file.note(wrong.offset, what, "attachment")
            return walked
    return glance.attachments


def _is_there(file: File, entry: AttachmentEntry) -> bool:
    """Whether an attachment starts where an index says, and says the same of itself."""
    try:
        data = file.source.read(entry.offset, min(entry.length, _HEAD_BYTES))
        if len(data) < PREFIX_BYTES or read_prefix(data, 0)[0] != Opcode.ATTACHMENT:
            return False
        length = PREFIX_BYTES + read_prefix(data, 0)[1]
        fields = Fields(data, file.source.name, entry.offset, PREFIX_BYTES)
        return entry == records.ATTACHMENT_HEAD.read(fields, offset=entry.offset, length=length)
    except DamagedFileError:
        return entry.length > _HEAD_BYTES  # its names are too long to be looked at here


def _walk(file: File) -> Iterator[AttachmentEntry]:
    source, at = file.source, len(records.MAGIC)
    size = source.size()
    while at + PREFIX_BYTES <= size:
        opcode, length = read_prefix(source.read(at, PREFIX_BYTES), 0)
        content, end = at + PREFIX_BYTES, at + PREFIX_BYTES + length
        if opcode in (0, Opcode.DATA_END, Opcode.FOOTER) or end > size:
            return
        if opcode == Opcode.ATTACHMENT:
            start = Fields(source.read(content, min(length, _NAMES_BYTES)), source.name, content)
            yield records.ATTACHMENT_HEAD.read(start, offset=at, length=end - at)
        at = end
