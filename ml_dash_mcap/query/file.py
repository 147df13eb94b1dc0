"""One file of a recording: an MCAP file, and how its messages become rows."""

from __future__ import annotations

from pathlib import Path

from ..codecs import decoding
from ..codecs.decoding import Decoding
from ..codecs.ros import distribution, distros
from ..codecs.ros.distros import Likely
from ..mcap import limits
from ..mcap.file_reader import McapFile
from ..mcap.records import Channel
from ..store.byte_source import ByteSource


class File(McapFile):
    """A file whose messages are decoded.

    Attributes:
        decoding: How.
    """

    def __init__(
        self,
        path: Path,
        limits_: limits.Limits = limits.DEFAULT,
        *,
        source: ByteSource | None = None,
        salvages: bool = False,
        decoding_: Decoding = decoding.DEFAULT,
    ) -> None:
        """Open a file and index it.

        Args:
            path: Where it is.
            limits_: Limits for reading it.
            source: Its bytes, which are closed with it; None for those of the local file at `path`.
            salvages: Whether to leave out damaged parts, and note them in `losses`, rather than to raise.
            decoding_: How its messages become rows.

        Raises:
            MissingRecordingError: There is no such file.
            DamagedFileError: It is no MCAP file, or a finished one that is broken.
        """
        super().__init__(path, limits_, source=source, salvages=salvages)
        self.decoding = decoding_

    def likely_distribution(self, channel: Channel) -> Likely:
        """Return the distributions of ROS 2 that a channel may come from."""
        return distribution.likely(channel, self.metadata_named(distros.RECORD), self.path)
