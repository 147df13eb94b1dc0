"""The names of the files in a run's folder and of our metadata records, shared by writing and reading."""

from __future__ import annotations

EXPERIMENT_ROOT = ".dash"
SESSION_ROOT = ".dreamlake"
DEFAULT_ROOTS = (EXPERIMENT_ROOT, SESSION_ROOT)
"""The default folders of all runs: ml-dash's and dreamlake's."""

SEGMENT_SUFFIX = ".mcap"

ACTIVE_SUFFIX = ".active"
"""Follows `SEGMENT_SUFFIX` while a segment is in progress; no viewer takes such a file for a finished one."""

SESSION_FILE = ".ml_dash-{session}.json"
"""Locked while its recorder lives; says where the journal is."""

SESSION_GLOB = SESSION_FILE.format(session="*")

JOURNAL_FILE = ".ml_dash-{session}-{number}.journal"

ABOUT_RECORD = "ml_dash"
"""The first metadata record of each segment."""

PARAMETERS_RECORD = "ml_dash.parameters"
TOPIC_RECORD = "ml_dash.topic"
RUN_RECORD = "ml_dash.run"
DROPS_RECORD = "ml_dash.drops"
BAG_RECORD = "ml_dash.bag"
"""In files that were copied from a bag: what bag it was."""
STEPS_RECORD = "ml_dash.steps_back"
JOURNAL_RECORD = "ml_dash.journal"
"""In journal buffers only."""

OWN_TOPICS = "ml_dash/"
"""Topics that begin so are the library's own."""

LOG_TOPIC = OWN_TOPICS + "log"
METRIC_TOPICS = OWN_TOPICS + "metrics/"
FILE_TOPIC = OWN_TOPICS + "files"
EPISODE_TOPIC = OWN_TOPICS + "episodes"

KIND_KEY = "kind"
"""In a channel's metadata: one of the kinds below."""

TRACK, LOG, METRIC, FILE, EPISODE, MESSAGE = "track", "log", "metric", "file", "episode", "message"
"""Only the rows of tracks merge. Messages are other people's: those of a bag, the rows of a table, the frames of a
take."""

BLOCK_OPCODE = 0x8B
"""A private record (https://mcap.dev/spec#opcodes: other readers pass over it) behind the chunks of each block, with
the block's number in 8 bytes. A recovery tells by it which blocks of a journal are in the file, and whole."""

WIDER_SCHEMA_OPCODE = 0x8C
"""A private record with the content of a Schema record: the schema of its id from here on. It is written before the
Schema record is widened in place, where rows cannot be decoded without their schema: a crash may tear that one."""


LARGE_BYTES = 48 * 1024 * 1024
LARGE_RATIO = 200
"""A chunk of more than `LARGE_BYTES` that compresses by more than `LARGE_RATIO` is stored as it is: a reader on guard
against bombs could not tell it from one. Maps and pictures of most robots are smaller."""


def is_like_a_bomb(size: int, packed: int) -> bool:
    """Whether a chunk unpacks to so much, and from so little, that a reader with our own limits would refuse it."""
    return size > LARGE_BYTES and size > LARGE_RATIO * packed
