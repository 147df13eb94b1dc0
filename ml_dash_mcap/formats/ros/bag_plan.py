"""Plans the topics and types of a ROS bag for the topics of a recording."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from ...codecs.ros import definitions, standard_types
from ...codecs.ros.message_types import Definitions
from ...errors import ConversionError, ConversionWarning, OptionError
from ...file_names import MESSAGE, TRACK
from ...mcap.message import Connection
from ...query import exact_blocks
from ...rows.plain_row import TIME_KEY
from ...rows.shape import Shape
from ..export_job import Job
from . import (
    ros_names as names,
)
from .bag_options import RosbagWriteOptions
from .messages import arrow_blocks, conventions, lossless, lossless_definitions, standard, underivable
from .messages.lossless import Message, MessageField
from .messages.standard import Derived


@dataclass(frozen=True, kw_only=True)
class Settings(RosbagWriteOptions):
    """The options of a bag that is written, and the needs of its storage."""

    is_ros1: bool
    room: int
    """Bytes to leave before each message."""
    is_in_order: bool
    """Whether messages of different topics must be nearly in order."""

    @classmethod
    def of(cls, options: RosbagWriteOptions, *, is_ros1: bool, room: int, is_in_order: bool) -> Settings:
        """Return the options of any bag with what its storage needs."""
        shared = {option.name: getattr(options, option.name) for option in fields(RosbagWriteOptions)}
        return cls(**shared, is_ros1=is_ros1, room=room, is_in_order=is_in_order)


@dataclass(frozen=True, slots=True)
class Outlet:
    """A topic of the bag."""

    number: int
    topic: str
    type: str
    """With its package, as in "sensor_msgs/msg/JointState"."""
    text: str
    """The type's definition, followed by those of the messages in it."""
    digest: str
    definitions: Definitions = field(default=Definitions("", {}), repr=False)
    """How its messages are serialised; empty for those that are carried."""
    carried: Connection | None = field(default=None, repr=False)
    """The channel of a topic whose messages are carried as they are."""


@dataclass(frozen=True, slots=True)
class TopicPlan:
    """How the rows of a topic become messages."""

    topic: str
    message: Message
    own: Outlet | None
    """The outlet of the message that holds the whole row; None if it is not wanted."""
    derived: tuple[tuple[Derived, Outlet], ...]

    @property
    def paths(self) -> list[tuple[MessageField, ...]]:
        """The ways to the fields whose texts are the paths of images to embed."""
        fields = [derived.fields["data"] for derived, _ in self.derived if derived.type == conventions.COMPRESSED]
        return [way for way in fields if way[-1].kind == "string"]


class Planner:
    """Plans a bag."""

    def __init__(self, job: Job, settings: Settings, others: Sequence[Outlet] = ()) -> None:
        """Prepare to plan.

        Args:
            job: What is exported.
            settings: What the caller wants.
            others: Topics that the bag has besides.

        Raises:
            ConversionError: The mapping has a topic that is not exported.
        """
        self._job = job
        self._settings = settings
        self._others = others
        self._warned: set[str] = set()
        self.outlets: list[Outlet] = []
        """All topics of the bag."""
        self.metadata = {name: dict(info.metadata) for name, info in job.topics.items()}
        """The metadata of the topics of the recording, by topic."""
        for topic in settings.mapping or ():
            if topic not in job.topics:
                there = ", ".join(map(repr, job.topics)) or "none"
                raise ConversionError(f"mapping has the topic {topic!r}, which is not exported; there are {there}")

    def plan(self, shapes: Mapping[str, Shape]) -> list[TopicPlan]:
        """Return how the rows of each topic become messages.

        Args:
            shapes: Topics, to the shapes of their rows.

        Raises:
            ConversionError: The mapping or the metadata do not fit the rows.
        """
        self.outlets = []
        called: dict[str, str] = {}
        others = {outlet.topic for outlet in self._others}
        for topic in shapes:  # first of all, so that no standard message takes a name of ours
            called[topic] = names.topic(topic, {*called.values(), *others})
        taken_types: set[str] = set()
        taken_topics = {*called.values(), *others}
        plans = [self._planned(topic, rows, called[topic], taken_types, taken_topics) for topic, rows in shapes.items()]
        if self._settings.embed_images is not False and not any(plan.paths for plan in plans):
            self.warn("embed_images: no field holds paths of .jpg or .png files")
        return plans

    def warn(self, what: str, first: str = "") -> None:
        """Warn, once for each text, of something that the bag cannot express."""
        if what not in self._warned:
            self._warned.add(what)
            warnings.warn(f"{what}; the first: {first}" if first else what, ConversionWarning, stacklevel=2)

    def _planned(
        self, topic: str, rows: Shape, called: str, taken_types: set[str], taken_topics: set[str]
    ) -> TopicPlan:
        settings = self._settings
        is_json = settings.profile == "json"
        message = lossless.design(rows, topic, set() if is_json else taken_types, is_json=is_json)
        wanted = self._wanted(topic, message, called, taken_topics) if "std" in settings.profile else []
        about = {} if is_json else self._about(topic, wanted)  # one type of JSON for all topics
        message = Message(message.name, message.fields, message.is_stated, True, about)
        own = None
        if settings.profile != "std":
            type_ = f"{settings.package}/msg/{message.name}"
            text = lossless_definitions.embedded(message, settings.package, is_ros1=settings.is_ros1)
            digest = standard_types.digest(type_, text, is_ros1=settings.is_ros1)
            own = self._outlet(called, type_, text, digest)
        derived = [(message, self._standard(message)) for message in wanted]
        if own is None and not derived and rows.kinds:
            self.warn(f"topic {topic!r}: no standard message says what its fields hold; profile='std' leaves it out")
        return TopicPlan(topic, message, own, tuple(derived))

    def _about(self, topic: str, wanted: list[Derived]) -> dict[str, Any]:
        """Return what a message's definition says besides its fields, in bags that have no other place for it too."""
        info = self._job.topics[topic]
        about: dict[str, Any] = {"topic": topic}
        kind = self._job.stored(topic).kind
        if kind != TRACK:
            about["kind"] = kind or MESSAGE
        if info.description is not None:
            about["description"] = info.description
        if info.tags:
            about["tags"] = list(info.tags)
        if info.metadata:
            about["metadata"] = dict(info.metadata)
        if wanted:
            about["derived"] = [derived.topic for derived in wanted]
        return about

    def _wanted(self, topic: str, message: Message, called: str, taken: set[str]) -> list[Derived]:
        settings = self._settings
        mapping = (settings.mapping or {}).get(topic, {})
        if mapping is None or mapping is False:
            return []
        if not isinstance(mapping, Mapping):
            raise OptionError(
                f"mapping of the topic {topic!r} is {mapping!r}: pass a dict of standard messages, or None"
            )
        metadata = self.metadata[topic]
        try:
            wanted = standard.derive(
                message, called, metadata, mapping, tf=settings.tf, embeds=settings.embed_images is not False
            )
        except ConversionError as error:
            raise ConversionError(f"topic {topic!r}: {error}") from error
        self._check_units(topic)
        return [derived for derived in wanted if self._is_writable(derived, topic, called, taken)]

    def _is_writable(self, derived: Derived, topic: str, called: str, taken: set[str]) -> bool:
        """Whether a standard message can be made of a topic's rows and its name is free; takes the name then.

        Raises:
            ConversionError: It cannot, and that is to be an error.
        """
        why = underivable.check(derived)
        ragged = underivable.ragged_role(derived)
        where = f"topic {topic!r}"
        if ragged is not None:
            where += self._uneven(topic, derived.fields[ragged])
        raises = self._settings.on_bad == "raise"
        if why is not None and raises:
            suffix = derived.topic.removeprefix(f"{called}/")
            raise ConversionError(
                f"{where}: {why}, so {derived.topic} cannot be written; pass mapping={{{topic!r}: {{{suffix!r}:"
                " None}} to leave it out, or on_bad='lossless' to leave out all such with a warning"
            )
        is_taken = derived.topic in taken and not (derived.type == conventions.TF and derived.topic == "/tf")
        if is_taken and derived.is_asked and raises:
            raise ConversionError(f"topic {topic!r}: mapping of {derived.topic!r}: another topic has that name")
        if why is not None or is_taken:
            self.warn(f"{where}: {derived.topic} is left out: {why or 'another topic has that name'}")
            return False
        taken.add(derived.topic)
        return True

    def _check_units(self, topic: str) -> None:
        """Warn of units of fields that a topic does not have, perhaps because they are nested."""
        units = self.metadata[topic].get("units")
        there = self._job.topics[topic].fields
        for key in units if isinstance(units, Mapping) else ():
            if there and not any(name == key or name.startswith(f"{key}.") for name in there):
                self.warn(
                    f"topic {topic!r}: its units have {key!r}, and there is no such field; there are {_list(there)}"
                )

    def _uneven(self, topic: str, way: tuple[MessageField, ...]) -> str:
        """Return words that name the first row where the length of a field differs from that of the row before."""
        number, length = 0, None
        for part in exact_blocks.read(self._job.stored(topic), self._job.low, self._job.high):
            for row in part if isinstance(part, list) else arrow_blocks.to_rows(part):
                value: Any = row
                for step in way:
                    value = value.get(step.key) if isinstance(value, dict) else None
                if isinstance(value, list):
                    if length is not None and len(value) != length:
                        return f", row {number} (_ts={row[TIME_KEY]!r})"
                    length = len(value)
                number += 1
        return ""

    def _standard(self, derived: Derived) -> Outlet:
        """Return the outlet of a standard message; `/tf` is everybody's."""
        for outlet in self.outlets:
            if outlet.topic == derived.topic:
                return outlet
        text, digest = standard_types.definition(derived.type, is_ros1=self._settings.is_ros1)
        return self._outlet(derived.topic, derived.type, text, digest)

    def _outlet(self, topic: str, type_: str, text: str, digest: str) -> Outlet:
        described = definitions.parse(type_, text, is_ros1=self._settings.is_ros1)
        outlet = Outlet(len(self._others) + len(self.outlets) + 1, topic, type_, text, digest, described)
        self.outlets.append(outlet)
        return outlet


def _list(names: Iterable[str]) -> str:
    shown = [*itertools.islice(names, 21)]
    return ", ".join([*shown[:20], "..."] if len(shown) > 20 else shown)
