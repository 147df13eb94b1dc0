"""The options of writing a recording as MCAP files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...codecs import codec_table


@dataclass(frozen=True, kw_only=True)
class McapWriteOptions:
    """How recordings are written as MCAP files."""

    encoding: Literal["json", "cbor", "protobuf"] | None = None
    """The encoding of the rows; None leaves all messages as they are. Messages that are no rows stay as they are in any
    case: those of ROS, protobuf messages of other people's types, the library's own topics (`ml_dash/...`), and topics
    of the types that viewers draw (`foxglove.*`)."""

    def __post_init__(self) -> None:
        if self.encoding is not None:
            codec_table.to_record(self.encoding)
