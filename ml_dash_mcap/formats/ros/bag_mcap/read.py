"""Reads MCAP files with ROS messages: those of a rosbag2 folder, or a single file."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from ....codecs.ros import distros
from ....errors import DamagedFileError
from ....file_names import BAG_RECORD
from ....mcap import stored_messages
from ....mcap.file_reader import McapFile
from ....mcap.limits import DEFAULT, Limits
from ....mcap.message import CHUNK_BYTES, Connection, MessageBlock
from ..bag_contents import unpacked


class McapBag:
    """An opened file."""

    def __init__(
        self,
        path: Path,
        *,
        is_packed: bool = False,
        salvages: bool = False,
        limits: Limits = DEFAULT,
        shown: Path | None = None,
    ) -> None:
        """Open a file.

        Args:
            path: Of the file.
            is_packed: Whether each message is compressed by zstd.
            salvages: Whether to leave out what is damaged, and note it in `losses`.
            limits: For what is read of it.
            shown: What to call the file in `losses` and `corrections`; None for `path`.

        Raises:
            DamagedFileError: It is no MCAP file, or cut, or broken.
        """
        self.name = path.name
        self.is_packed = is_packed
        self._salvages = salvages
        self._shown = shown or path
        self._lost: list[str] = []
        self.file = McapFile(path, limits, salvages=salvages)
        index = self.file.index
        if not index.finished and not salvages:
            self.file.close()
            what = "the file has no end: it was cut, or is still being written; on_damage='skip' takes what it has"
            raise DamagedFileError(path, index.end, what)
        self._channels = stored_messages.channels(self.file)

    @property
    def channels(self) -> Mapping[int, Connection]:
        """All channels by their ids."""
        return self._channels

    @property
    def count(self) -> int:
        """Messages in all."""
        return sum(self.file.index.message_counts.values())

    @property
    def losses(self) -> list[str]:
        """Descriptions of the damaged parts that were left out so far."""
        return [self._named(loss) for loss in self.file.losses if not loss.corrected] + self._lost

    @property
    def corrections(self) -> list[str]:
        """Wrong statements of the file about itself, in words; nothing is lost by them."""
        return [self._named(loss) for loss in self.file.losses if loss.corrected]

    @property
    def about(self) -> Mapping[str, str]:
        """The values of rosbag2's metadata record in the file; empty without such a record."""
        return next((record.values for record in self.file.metadata() if record.name == distros.RECORD), {})

    @property
    def is_carried(self) -> bool:
        """Whether a recording was made of a bag as this file: its messages are unpacked, whatever `about` says."""
        return any(record.name == BAG_RECORD for record in self.file.metadata())

    def blocks(self, wanted: Collection[int]) -> Iterator[MessageBlock]:
        """Yield the messages of some channels, in the order of the file.

        Raises:
            DamagedFileError: The file is damaged further on.
        """
        for block in stored_messages.joined(stored_messages.blocks(self.file, wanted), CHUNK_BYTES):
            yield unpacked(block, self._shown, self._lost if self._salvages else None) if self.is_packed else block

    def _named(self, loss: object) -> str:
        return str(loss).replace(str(self.file.path), str(self._shown))

    def close(self) -> None:
        """Close the file. May be called twice."""
        self.file.close()
