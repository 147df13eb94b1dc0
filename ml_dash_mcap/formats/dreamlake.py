"""Writes a recording in the local layout of dreamlake sessions, as dreamlake before 0.4 reads it."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import orjson

from ..codecs.json import CODEC
from ..inspect.topics import TopicInfo
from ..query.topic_part import TopicPart
from .destination import fresh_folder, name_of, refuse_existing
from .export_job import Job, RowCounter
from .registry import NoOptions

DATA_NAME, ABOUT_NAME = "data.jsonl", "metadata.json"

_EMPTY_PART = "%2F"
"""Stands for a part of a topic without letters, as in `/robot`; no other part becomes this."""

_LONGEST_PART = 200
_COUNTED_ROWS = 1000


def export(job: Job, options: NoOptions) -> Path:
    """Write a session's folder: `tracks/<topic>/data.jsonl` with lines of `{"index", "data"}`, and what belongs to it.

    `data` is the row as it was given, nested, with its `_ts`. dreamlake finds the session if the destination is
    `<local_path>/<workspace>/<name>`. The parts of a topic between slashes are folders; a part that cannot be one, such
    as `..`, is spelt with `%2E` and the like.

    Args:
        job: What to export.
        options: None.
    """
    refuse_existing(job.dest)
    with fresh_folder(job.dest) as folder:
        _save(folder / "session.json", {"name": job.dest.name, "workspace": job.dest.absolute().parent.name})
        _save(folder / "parameters.json", {"version": 1, "data": job.about.get("params", {})})
        counter = job.counter()
        for topic, info in job.topics.items():
            track = folder / "tracks" / path_of(topic)
            track.mkdir(parents=True, exist_ok=True)
            count = _write(job.part(topic), track / DATA_NAME, counter)
            _save(track / ABOUT_NAME, _about(info, count))
        counter.finish()
    return job.dest


def path_of(topic: str) -> PurePosixPath:
    """Return a topic's folder; no two topics share one, and none leaves its parent."""
    return PurePosixPath(*map(_part, topic.split("/")))


def _part(part: str) -> str:
    if not part:
        return _EMPTY_PART
    # A topic `a/data.jsonl` would lie where the rows of topic `a` lie.
    if part in (DATA_NAME, ABOUT_NAME):
        return f"%{ord(part[0]):02X}{part[1:]}"
    # `~` and `%` are the marks of changed names, so a name that has them is spelt otherwise.
    is_plain = part.isprintable() and part[0] != "." and "%" not in part and "~" not in part
    return part if is_plain and len(part.encode()) <= _LONGEST_PART else name_of(part, "")


def _write(part: TopicPart, path: Path, counter: RowCounter) -> int:
    done = 0
    with path.open("xb") as file:
        for row in part.rows():
            file.write(b'{"index":%d,"data":%s}\n' % (done, CODEC.encode_read(row)))
            done += 1
            if done % _COUNTED_ROWS == 0:
                counter.add(_COUNTED_ROWS)
        counter.add(done % _COUNTED_ROWS)
    return done


def _about(info: TopicInfo, count: int) -> dict[str, object]:
    return {
        "trackId": f"local-track-{info.name}",
        "name": info.name,
        "description": info.description,
        "tags": info.tags,
        "metadata": info.metadata or None,
        "totalDataPoints": count,
        "nextIndex": count,
    }


def _save(path: Path, content: dict[str, object]) -> None:
    path.write_bytes(orjson.dumps(content, option=orjson.OPT_INDENT_2))
