"""The metadata of a rosbag2: the fields of its `metadata.yaml`, a part of which each file of the bag repeats.

The source is rosbag2_storage's `metadata_io.cpp` and `yaml.hpp`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....codecs.ros.distros import METADATA_KEY
from ..bag_plan import Outlet
from . import qos_profiles, yaml_text

_VERSION = "version"
_DISTRO = "ros_distro"
_CUSTOM = "custom_data"
_FILES = "relative_file_paths"
_MODE, _FORMAT = "compression_mode", "compression_format"
_COUNT = "message_count"
_TOPICS, _TOPIC = "topics_with_message_count", "topic_metadata"
_NAME, _PROFILES, _DIGEST = "name", "offered_qos_profiles", "type_description_hash"


class BagInformation:
    """The contents of a bag's metadata. Values of the wrong type count as missing."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = values

    @classmethod
    def parse(cls, text: str) -> BagInformation:
        """Read the metadata of a bag.

        Raises:
            ValueError: It is no metadata of a bag.
        """
        parsed = yaml_text.load(text)
        values = parsed.get(METADATA_KEY, parsed) if isinstance(parsed, dict) else None
        if not isinstance(values, dict):
            raise ValueError("there is no mapping in it")
        return cls(values)

    @classmethod
    def lenient(cls, text: str) -> BagInformation:
        """Read the metadata of a bag; returns `NOTHING` for a text that is none."""
        try:
            return cls.parse(text) if text else NOTHING
        except ValueError:
            return NOTHING

    def __bool__(self) -> bool:
        """Whether there are any metadata."""
        return bool(self._values)

    @property
    def version(self) -> int:
        """Of the metadata; 0 without metadata."""
        version = self._values.get(_VERSION)
        return version if isinstance(version, int) else 0

    @property
    def distro(self) -> str:
        """Name of the distribution that recorded the bag; empty if it is not stated."""
        return self._text(_DISTRO)

    @property
    def custom(self) -> Mapping[str, str]:
        """The custom data of the bag, by key."""
        custom = self._values.get(_CUSTOM)
        return custom if isinstance(custom, dict) else {}

    @property
    def compression_mode(self) -> str:
        """The unit of compression, "file" or "message"; empty without compression."""
        return self._text(_MODE).lower()

    @property
    def compression_format(self) -> str:
        """How it is compressed, such as "zstd"; empty for not at all."""
        return self._text(_FORMAT).lower()

    @property
    def file_names(self) -> list[str]:
        """The files of the bag, in the order of recording.

        Raises:
            ValueError: There is no list of names.
        """
        names = self._values.get(_FILES)
        if names is None:
            return []
        if not isinstance(names, list) or not all(isinstance(name, str) and "\0" not in name for name in names):
            raise ValueError(f"{_FILES} is no list of names of files: {names!r}")
        return names

    @property
    def digests(self) -> dict[str, str]:
        """Hashes of types, by topic."""
        return {name: str(topic[_DIGEST]) for name, topic in self._topics().items() if topic.get(_DIGEST)}

    @property
    def profiles(self) -> dict[str, str]:
        """QoS profiles by topic, as YAML."""
        profiles = {}
        for name, topic in self._topics().items():
            offered = topic.get(_PROFILES)
            if isinstance(offered, str):
                profiles[name] = offered
            elif isinstance(offered, list):  # since version 9 of the metadata; JSON is YAML
                profiles[name] = "\n".join(f"- {json.dumps(profile, default=str)}" for profile in offered)
        return profiles

    def _text(self, key: str) -> str:
        return str(self._values.get(key) or "")

    def _topics(self) -> dict[str, Mapping[str, Any]]:
        listed = self._values.get(_TOPICS)
        entries = [entry.get(_TOPIC) for entry in listed if isinstance(entry, dict)] if isinstance(listed, list) else []
        return {str(topic[_NAME]): topic for topic in entries if isinstance(topic, dict) and topic.get(_NAME)}


NOTHING = BagInformation({})
"""The metadata of a bag without any."""


@dataclass(frozen=True, slots=True)
class FileContents:
    """How many messages a file of the bag holds, and of which times."""

    name: str
    counts: Mapping[int, int]
    """Messages, by the number of their outlet."""
    start_ns: int
    """Time of the first message; 0 without messages."""
    end_ns: int

    @property
    def count(self) -> int:
        """Messages in all."""
        return sum(self.counts.values())


@dataclass(frozen=True, slots=True)
class Description:
    """The metadata of a bag that is written, as far as all of its files have the same."""

    version: int
    """Of the metadata."""
    storage: str
    distro: str
    custom: Mapping[str, str]

    def text(self, outlets: Sequence[Outlet], files: Sequence[FileContents]) -> str:
        """Return the `metadata.yaml` of a bag."""
        return yaml_text.text({METADATA_KEY: self._values(outlets, files)})

    def text_of_file(self, outlets: Sequence[Outlet], file: FileContents) -> str:
        """Return the metadata that a file of the bag has of itself."""
        return yaml_text.text(self._values(outlets, [file]))

    def _values(self, outlets: Sequence[Outlet], files: Sequence[FileContents]) -> dict[str, Any]:
        filled = [file for file in files if file.count]
        start = min((file.start_ns for file in filled), default=0)
        end = max((file.end_ns for file in filled), default=0)
        return {
            _VERSION: self.version,
            "storage_identifier": self.storage,
            "duration": _duration(start, end),
            "starting_time": _starting_time(start),
            _COUNT: sum(file.count for file in files),
            _TOPICS: [self._topic(outlet, files) for outlet in outlets],
            _FORMAT: "",
            _MODE: "",
            _FILES: [file.name for file in files],
            "files": [_file(file) for file in files],
            _CUSTOM: dict(self.custom) or None,
            _DISTRO: self.distro,
        }

    def _topic(self, outlet: Outlet, files: Sequence[FileContents]) -> dict[str, Any]:
        offered = qos_profiles.offered(outlet, self.version)
        metadata = {
            _NAME: outlet.topic,
            "type": outlet.type,
            "serialization_format": "cdr",
            _PROFILES: offered if self.version < qos_profiles.NAMES_VERSION else qos_profiles.parse(offered),
            _DIGEST: outlet.digest,
        }
        return {_TOPIC: metadata, _COUNT: sum(file.counts.get(outlet.number, 0) for file in files)}


def _file(file: FileContents) -> dict[str, Any]:
    return {
        "path": file.name,
        "starting_time": _starting_time(file.start_ns),
        "duration": _duration(file.start_ns, file.end_ns),
        _COUNT: file.count,
    }


def _duration(start_ns: int, end_ns: int) -> dict[str, int]:
    return {"nanoseconds": end_ns - start_ns}


def _starting_time(start_ns: int) -> dict[str, int]:
    return {"nanoseconds_since_epoch": start_ns}
