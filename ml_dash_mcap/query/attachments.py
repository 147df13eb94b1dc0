"""The files that were attached to a recording, by their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from .. import clock
from ..mcap import attachment_records
from ..mcap.file_reader import McapFile
from ..mcap.records import AttachmentEntry
from .lazy_mapping import Lookup


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside a recording, such as a calibration; its bytes are read when they are asked for."""

    name: str
    media_type: str
    """The type that its writer gave, such as "application/json"."""
    log_time: float
    """When it was put there, in s."""
    size: int
    """In bytes."""
    _file: McapFile = field(repr=False, compare=False)
    _entry: AttachmentEntry = field(repr=False, compare=False)

    def read(self) -> bytes:
        """Return its bytes, checked against the checksum (CRC-32) that they were written with.

        Raises:
            DamagedFileError: They do not match it, or lie elsewhere than the index says.
            StorageError: The recording is closed.

        Example:
            >>> json.loads(rec.attachments["calibration.json"].read())
        """
        return attachment_records.data(self._file, self._entry)


class Attachments(Lookup[Attachment]):
    """Attachments by name, sorted. If several have one name, the last one that was written counts."""

    def __init__(self, attachments: Sequence[Attachment]) -> None:
        """Give attachments, which are in the order of writing, by their names."""
        by_name = {attachment.name: attachment for attachment in attachments}
        super().__init__("attachment", sorted(by_name), by_name.__getitem__)
        self._attachments = tuple(attachments)

    def list(self) -> list[Attachment]:
        """Return all attachments in the order of writing, also several of one name."""
        return list(self._attachments)


def find(files: Sequence[McapFile]) -> Attachments:
    """Return the attachments of some files, without reading their bytes: only where each starts, to see that it does.

    Args:
        files: In the order of writing.
    """
    return Attachments(
        [
            Attachment(entry.name, entry.media_type, clock.to_seconds(entry.log_time_ns), entry.data_size, file, entry)
            for file in files
            for entry in sorted(attachment_records.entries(file), key=lambda entry: entry.offset)
        ]
    )
