"""The tables of rosbag2's SQLite files, shared by reader and writer.

The source is rosbag2_storage_sqlite3's `sqlite_storage.cpp`. Version 1 of the schema has topics and messages, 2 has the
QoS profiles of topics, 3 the distribution, and 4 the definitions of types, their hashes and the metadata.
"""

from __future__ import annotations

SUFFIX = ".db3"

SCHEMA_VERSION = 4
"""The version of the schema in the files that we write."""

CREATE_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
    encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
    data BLOB NOT NULL);
"""
CREATE_INDEX = "CREATE INDEX timestamp_idx ON messages (timestamp ASC)"

SCHEMA, METADATA, TOPICS, DEFINITIONS, MESSAGES = "schema", "metadata", "topics", "message_definitions", "messages"
"""Names of the tables."""

LEAST_TABLES = frozenset({TOPICS, MESSAGES})
"""Those that files of every version have."""

INSERT_SCHEMA = "INSERT INTO schema VALUES (?, ?)"
INSERT_METADATA = "INSERT INTO metadata(metadata_version, metadata) VALUES (?, ?)"
INSERT_TOPIC = "INSERT INTO topics VALUES (?, ?, ?, 'cdr', ?, ?)"
INSERT_DEFINITION = (
    "INSERT INTO message_definitions(topic_type, encoding, encoded_message_definition, type_description_hash)"
    " VALUES (?, ?, ?, ?)"
)
INSERT_MESSAGE = "INSERT INTO messages(timestamp, topic_id, data) VALUES (?, ?, ?)"

SELECT_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table'"
SELECT_DISTRO = "SELECT ros_distro FROM schema"
SELECT_METADATA = "SELECT metadata FROM metadata"
SELECT_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
SELECT_TOPIC_COLUMNS = "PRAGMA table_info(topics)"
SELECT_MESSAGES = "SELECT topic_id, timestamp, data"
"""Followed by where from."""
COUNT_MESSAGES = "SELECT COUNT(*) FROM messages"

_LATER_COLUMNS = ("offered_qos_profiles", "type_description_hash")
"""Columns of the topics that only later versions have."""


def select_topics(columns: set[str]) -> str:
    """Return the question for the topics: id, name, type, format, QoS profiles and hash; empty what there is not.

    Args:
        columns: Those that the table has.
    """
    later = ", ".join(name if name in columns else "''" for name in _LATER_COLUMNS)
    return f"SELECT id, name, type, serialization_format, {later} FROM topics ORDER BY id"
