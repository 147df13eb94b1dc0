"""Checks the names of users' topics."""

from __future__ import annotations

from ..errors import TopicError, UsageError
from ..file_names import OWN_TOPICS

_MAX_TOPIC_BYTES = 1024


def check_topic(name: object) -> None:
    """Check the name of a user's topic.

    Raises:
        UsageError: It is no text.
        TopicError: It is empty, too long, has a NUL, cannot be encoded, or is reserved.
    """
    if not isinstance(name, str):
        raise UsageError(f"a topic's name is text, not {type(name).__name__}: {name!r}")
    try:
        size = len(name.encode())
    except UnicodeEncodeError as error:
        raise TopicError(f"topic {name!r} is not valid Unicode: {error}") from error
    if not name or name.isspace():
        raise TopicError(f"a topic needs a name; got {name!r}")
    if size > _MAX_TOPIC_BYTES:
        raise TopicError(f"topic {name[:40]!r}...: its name has {size} bytes; at most {_MAX_TOPIC_BYTES} are allowed")
    if "\0" in name:
        raise TopicError(f"topic {name!r} has a NUL in its name")
    if name.startswith(OWN_TOPICS):
        raise TopicError(f"topic {name!r}: names that begin with {OWN_TOPICS!r} are the library's own")
