"""The .proto files of a topic of a recording, with what its annotations say."""

from __future__ import annotations

from ..errors import EncodingError
from ..mcap.records import Schema
from ..query.stored_topic import StoredTopic
from .topics import TopicInfo


def files(topic: StoredTopic, info: TopicInfo) -> dict[str, str]:
    """Return the text of each .proto file by its name, that of the topic's own message first.

    Args:
        topic: The topic.
        info: What is known about it.

    Raises:
        EncodingError: Its messages are not protobuf, or their descriptors are broken or contradict each other.
    """
    # Imported here, as they bring protobuf.
    from ..codecs.proto import topic_files
    from ..codecs.proto.row_comments import RowsAbout

    about = RowsAbout(
        topic.name,
        info.description,
        units=_units(info),
        shapes={name: field.shape for name, field in info.fields.items()},
        notes=_notes(info),
    )
    return topic_files.texts(_schemas(topic), about)


def _schemas(topic: StoredTopic) -> list[Schema]:
    schemas: list[Schema] = []
    for file, channel in topic.channels:
        schema = file.index.schema_of(channel)
        if schema is None or schema.encoding != "protobuf" or channel.message_encoding != "protobuf":
            raise EncodingError(
                f"topic {topic.name!r} has no .proto file: its messages are encoded as {channel.message_encoding!r}; "
                'record it with encoding="protobuf", or see its JSON Schema in '
                f"recording.topics[{topic.name!r}].schema"
            )
        schemas.append(schema)
    return schemas


def _units(info: TopicInfo) -> dict[str, str]:
    units = info.metadata.get("units")
    return {str(name): str(unit) for name, unit in units.items()} if isinstance(units, dict) else {}


def _notes(info: TopicInfo) -> list[str]:
    """Return sentences for the other annotations."""
    notes = []
    joints = info.metadata.get("joint_names")
    if isinstance(joints, list):
        notes.append(f"Joints: {', '.join(map(str, joints))}.")
    if "frame_id" in info.metadata:
        notes.append(f"Frame: {info.metadata['frame_id']}.")
    if "quat_order" in info.metadata:
        notes.append(f"Quaternions: {info.metadata['quat_order']}.")
    return notes
