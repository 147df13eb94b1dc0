"""Accepts the names of other people's files as names of topics and fields, or changes them with a warning."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..capture.topic_names import check_topic
from ..errors import ConversionWarning, TopicError
from ..file_names import OWN_TOPICS
from ..rows.plain_row import EXACT_KEY, TIME_KEY
from .mocap.placement import Placement

# A topic's name has 1024 bytes at most; the rest is room for the digest.
_KEPT_BYTES = 900
_RESERVED = (TIME_KEY, EXACT_KEY)


def distinct(names: Sequence[str]) -> list[str]:
    """Return names, those that are there several times with `#2`, `#3` behind all but the first.

    Example:
        >>> distinct(["a", "a", "a#2"])
        ['a', 'a#3', 'a#2']
    """
    taken = set(names)
    seen: set[str] = set()
    distinct_names = []
    for name in names:
        new, number = name, 2
        # A number must not make a name that the file itself has further on.
        while new in seen or (new != name and new in taken):
            new, number = f"{name}#{number}", number + 1
        seen.add(new)
        distinct_names.append(new)
    return distinct_names


def accepted(path: Path, placements: Sequence[Placement]) -> list[Placement]:
    """Return placements whose topics and fields have names that the library takes and that differ.

    A name that it does not take (empty, too long, its own) is changed, and a warning says so.

    Args:
        path: The file, for the warning.
        placements: As the file names them.
    """
    topics = {name: _topic(name) for name in dict.fromkeys(placement.topic for placement in placements)}
    changed = [f"{name[:40]!r} is {new[:40]!r}" for name, new in topics.items() if name != new]
    accepted_placements: list[Placement] = []
    taken: set[tuple[str, tuple[str, ...]]] = set()
    all_paths = {(topics[placement.topic], placement.path) for placement in placements}
    for placement in placements:
        topic, field = topics[placement.topic], placement.path
        if any((topic, field[:length]) in all_paths for length in range(1, len(field))):
            field = (".".join(field),)  # a field cannot be a dict too
        changed += [f"{name!r} is {name + '_'!r}" for name in _RESERVED if name in field]
        field = tuple(f"{name}_" if name in _RESERVED else name for name in field)
        number, last = 2, field[-1]
        while (topic, field) in taken or (number > 2 and (topic, field) in all_paths):
            field, number = (*field[:-1], f"{last}#{number}"), number + 1
        taken.add((topic, field))
        accepted_placements.append(replace(placement, topic=topic, path=field))
    if changed:
        warnings.warn(
            f"{path}: names that no topic or field can have were changed: {', '.join(changed[:5])}",
            ConversionWarning,
            stacklevel=2,
        )
    return accepted_placements


def _topic(name: str) -> str:
    try:
        check_topic(name)
    except TopicError:
        text = name.encode("utf-8", "replace").decode().replace("\0", "\ufffd")
        text = f"file/{text}" if text.startswith(OWN_TOPICS) else text
        if not text.strip():
            return "unnamed"
        if len(text.encode()) > _KEPT_BYTES:
            digest = hashlib.sha256(text.encode()).hexdigest()[:8]
            return f"{text.encode()[:_KEPT_BYTES].decode('utf-8', 'ignore')}-{digest}"
        return text
    return name
