"""The options of reading and writing ROS bags."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ...codecs import codec_table
from ...errors import OptionError, UsageError
from ...mcap.limits import Limits
from . import ros_names

_MOST_OFFSET_S = 2**33
"""Nanoseconds that a signed 64-bit number holds are more."""


@dataclass(frozen=True, kw_only=True)
class RosbagReadOptions:
    """How bags of both generations are read."""

    encoding: Literal["ros", "json", "cbor", "protobuf"] | None = None
    """"ros" keeps all messages as they are, also of topics that this library exported; "json", "cbor" and "protobuf"
    make rows of all, in this library's own form; None keeps those of others, and makes rows of ours."""
    time: Literal["log", "header"] = "log"
    """What `_ts` is for rows that are made of messages of others: "log", when they were recorded, or "header", their
    header's stamp where they have one that is not 0; then all messages become rows."""
    topics: Iterable[str] | None = None
    """Names of the bag's topics, or those that they had in the recording that it was made of; None for all but the
    standard messages that this library derived."""
    definitions: Mapping[str, str | Path] | None = None
    """Type to its definition, or the `.msg` file with it, for bags that do not have them."""
    on_unknown: Literal["bytes", "skip", "raise"] = "bytes"
    """What happens to a topic with messages of a type that nobody knows: "bytes" keeps their bytes, with a warning,
    "skip" leaves it out with a warning, "raise" is an error."""
    on_damage: Literal["raise", "skip"] = "raise"
    """What happens if the bag is cut or damaged: "raise", or "skip" to take what can be read, with a warning."""
    limits: Limits | None = None
    """How much memory its MCAP files may ask for; None for the defaults."""

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("encoding", self.encoding, (None, "ros", *codec_table.recordable())),
            ("time", self.time, ("log", "header")),
            ("on_damage", self.on_damage, ("raise", "skip")),
        ):
            if value not in choices:
                raise OptionError(f"{name}={value!r}: it must be one of {', '.join(map(repr, choices))}")
        if self.time == "header" and self.encoding == "ros":
            raise OptionError(
                "time='header' makes rows with other times than their messages have, encoding='ros' makes none"
            )
        if isinstance(self.topics, str):
            raise UsageError(f"topics={self.topics!r}: pass a list of topics, such as topics=[{self.topics!r}]")


@dataclass(frozen=True, kw_only=True)
class RosbagWriteOptions:
    """How bags of both generations are written."""

    profile: Literal["std+lossless", "std", "lossless", "json"] = "std+lossless"
    """"std+lossless": a message of its own for each topic, and standard messages where they fit; "std" and "lossless":
    only these; "json": each row as JSON."""
    mapping: Mapping[str, Any] | None = None
    """Topic to what its standard messages are, see docs/guides/ros.md; None for the conventions."""
    time_offset: float = 0.0
    """Added to all times, in s; rows come back with their own."""
    package: str = "ml_dash_msgs"
    """The name of the package that defines our messages."""
    frame_id: str = ""
    """The frame of topics whose metadata states none."""
    tf: bool = False
    """Whether to send the first pose of each topic on `/tf` too."""
    on_bad: Literal["raise", "lossless"] = "raise"
    """What a row does that a standard message cannot say: "raise", or "lossless" to leave it out of that message with a
    warning."""
    embed_images: bool | str | Path = False
    """Whether a field that holds the path of a JPEG or PNG file becomes a message with the image, or the folder that
    its paths begin at; False leaves paths alone."""

    def __post_init__(self) -> None:
        ros_names.check_package(self.package)
        for name, value, choices in (
            ("profile", self.profile, ("std+lossless", "std", "lossless", "json")),
            ("on_bad", self.on_bad, ("raise", "lossless")),
        ):
            if value not in choices:
                raise OptionError(f"{name}={value!r}: it must be one of {', '.join(map(repr, choices))}")
        if self.mapping is not None and not isinstance(self.mapping, Mapping):
            raise OptionError(f"mapping={self.mapping!r}: pass a dict of topics")
        is_number = isinstance(self.time_offset, (int, float)) and not isinstance(self.time_offset, bool)
        if not is_number or not abs(self.time_offset) < _MOST_OFFSET_S:
            raise OptionError(f"time_offset={self.time_offset!r}: pass seconds, less than {_MOST_OFFSET_S}")
        if not isinstance(self.frame_id, str) or "\0" in self.frame_id:
            raise OptionError(f"frame_id={self.frame_id!r}: pass a name")
        if not isinstance(self.tf, bool):
            raise OptionError(f"tf={self.tf!r}: it must be True or False")


@dataclass(frozen=True, kw_only=True)
class Rosbag1WriteOptions(RosbagWriteOptions):
    """How ROS 1 bags are written."""

    compression: Literal["none", "bz2", "lz4"] = "none"
    """The compression of the bag's chunks."""

    def __post_init__(self) -> None:
        choices = ("none", "bz2", "lz4")
        if self.compression not in choices:
            raise OptionError(f"compression={self.compression!r}: it must be one of {', '.join(map(repr, choices))}")
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class Rosbag2WriteOptions(RosbagWriteOptions):
    """How rosbag2 folders are written."""

    storage: Literal["mcap", "sqlite3"] = "mcap"
    """The format of the bag's files."""
    distro: str | None = None
    """The ROS 2 distribution that will read it; "humble" needs metadata that is older than "jazzy"'s. None for the one
    that recorded the messages, if they came from a bag, or else "jazzy"."""
    split_bytes: int | None = None
    """A new file starts when one has grown to this size; None for one file."""
    compression: Literal["zstd", "lz4", "none"] | None = None
    """The compression of MCAP chunks; None for "zstd". SQLite files have only "none"."""

    def __post_init__(self) -> None:
        if self.storage not in ("mcap", "sqlite3"):
            raise OptionError(f"storage={self.storage!r}: it must be 'mcap' or 'sqlite3'")
        size = self.split_bytes
        if size is not None and (isinstance(size, bool) or not isinstance(size, int) or size < 1):
            raise OptionError(f"split_bytes={size!r}: it must be None or more than 0 bytes")
        compressions = ("zstd", "lz4", "none") if self.storage == "mcap" else ("none",)
        if self.compression is not None and self.compression not in compressions:
            choices = ", ".join(map(repr, compressions))
            raise OptionError(
                f"compression={self.compression!r}: it must be None or {choices} with storage={self.storage!r}"
            )
        super().__post_init__()
