"""The contenders of the appending benchmark: how each one's users open a file and log a row."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_rows import SCHEMA

KEYWORDS = "q=q, qd=qd, tau=tau, ee_pos=ee_pos, ee_quat=ee_quat, gripper=gripper"
DICT = '{"q": q, "qd": qd, "tau": tau, "ee_pos": ee_pos, "ee_quat": ee_quat, "gripper": gripper}'
DICT_TS = DICT.replace("}", ', "_ts": t}')
Names = dict[str, Any]
"""What a contender's statement may use; "topics" holds one value a topic."""


@contextmanager
def nothing(folder: Path, topics: list[str]) -> Iterator[Names]:
    yield {"topics": topics}


@contextmanager
def our_recorder(folder: Path, topics: list[str]) -> Iterator[Names]:
    from ml_dash_mcap import Recorder, RecorderOptions

    with Recorder(folder, RecorderOptions(compression="zstd")) as rec:
        yield {"topics": [rec.topic(name) for name in topics]}


@contextmanager
def our_typed_recorder(folder: Path, topics: list[str]) -> Iterator[Names]:
    from ml_dash_mcap import Recorder, RecorderOptions

    with Recorder(folder, RecorderOptions(compression="zstd", encoding="protobuf")) as rec:
        yield {"topics": [rec.topic(name) for name in topics]}


@contextmanager
def our_experiment(folder: Path, topics: list[str]) -> Iterator[Names]:
    from ml_dash_mcap import Experiment

    with Experiment(prefix="bench/append", root=folder).run as exp:
        yield {"topics": topics, "exp": exp}


@contextmanager
def foxglove_sdk(folder: Path, topics: list[str]) -> Iterator[Names]:
    import foxglove
    import orjson

    channels = [foxglove.Channel(name, schema=SCHEMA, message_encoding="json") for name in topics]
    with foxglove.open_mcap(folder / "foxglove.mcap"):  # as it comes: zstd, chunks of 1 MiB
        yield {"topics": channels, "dumps": orjson.dumps}


@contextmanager
def mcap_writer(folder: Path, topics: list[str]) -> Iterator[Names]:
    from mcap.writer import Writer

    writer = Writer(str(folder / "mcap.mcap"))  # as it comes: zstd, chunks of 1 MiB
    writer.start()
    schema = writer.register_schema("robot", "jsonschema", json.dumps(SCHEMA).encode())
    channels = [writer.register_channel(name, "json", schema) for name in topics]
    yield {"topics": channels, "writer": writer, "dumps": json.dumps}
    writer.finish()


@contextmanager
def ml_dash(folder: Path, topics: list[str]) -> Iterator[Names]:
    from ml_dash import Experiment

    with Experiment(prefix="bench/append/run", dash_root=str(folder)).run as exp:
        yield {"topics": topics, "exp": exp}


@contextmanager
def dreamlake(folder: Path, topics: list[str]) -> Iterator[Names]:
    from dreamlake import Episode

    with Episode(prefix="bench/append", root=str(folder)) as episode:
        yield {"topics": topics, "episode": episode}


def mcap_messages(folder: Path) -> int:
    """The messages that the statistics of all MCAP files in `folder` count, read by the `mcap` package."""
    from mcap.reader import make_reader

    count = 0
    for path in folder.rglob("*.mcap"):
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError(f"{path.name} has no statistics: it was not finished")
        count += summary.statistics.message_count
    return count


def jsonl_lines(folder: Path) -> int:
    return sum(path.read_bytes().count(b"\n") for path in folder.rglob("*.jsonl"))


def dreamlake_points(folder: Path) -> int:
    found = (json.loads(path.read_text()) for path in folder.rglob("metadata.json"))
    return sum(int(track.get("totalDataPoints", 0)) for track in found)


@dataclass(frozen=True, slots=True)
class Contender:
    """One way of logging a row."""

    title: str  # as the tables print it
    open: Callable[[Path, list[str]], AbstractContextManager[Names]]  # leaving it finishes the file
    call: str  # logs one row; `topic` is what open() gave for the topic
    count: Callable[[Path], int]  # the rows found in what it wrote
    ready: bool = False  # whether the JSON bytes are made before the clock starts


FOXGLOVE = "topic.log(%s, log_time=t_ns)"
CONTENDERS = {
    "ours": Contender("ml-dash-mcap, Recorder", our_recorder, f"topic.append({KEYWORDS}, _ts=t)", mcap_messages),
    "experiment": Contender(
        "ml-dash-mcap, Experiment", our_experiment, f"exp.tracks(topic).append({KEYWORDS}, _ts=t)", mcap_messages
    ),
    "typed": Contender(
        "ml-dash-mcap, Recorder, protobuf", our_typed_recorder, f"topic.append({KEYWORDS}, _ts=t)", mcap_messages
    ),
    "columns": Contender(
        "ml-dash-mcap, columns", our_recorder, f"topic.append_columns({KEYWORDS}, _ts=t)", mcap_messages
    ),
    "typed-columns": Contender(
        "ml-dash-mcap, columns, protobuf", our_typed_recorder, f"topic.append_columns({KEYWORDS}, _ts=t)", mcap_messages
    ),
    "foxglove-bytes": Contender(
        "foxglove-sdk, bytes made by orjson", foxglove_sdk, FOXGLOVE % f"dumps({DICT})", mcap_messages
    ),
    "foxglove-ts": Contender(
        "foxglove-sdk, the same with `_ts`", foxglove_sdk, FOXGLOVE % f"dumps({DICT_TS})", mcap_messages
    ),
    "foxglove-ready": Contender(
        "foxglove-sdk, bytes made beforehand", foxglove_sdk, FOXGLOVE % "ready", mcap_messages, ready=True
    ),
    "foxglove-dict": Contender("foxglove-sdk, dicts", foxglove_sdk, FOXGLOVE % DICT, mcap_messages),
    "mcap": Contender(
        "mcap, json",
        mcap_writer,
        f"writer.add_message(topic, log_time=t_ns, data=dumps({DICT}).encode(), publish_time=t_ns)",
        mcap_messages,
    ),
    "ml-dash": Contender("ml-dash", ml_dash, f"exp.tracks(topic).append({KEYWORDS}, _ts=t)", jsonl_lines),
    "dreamlake": Contender("dreamlake", dreamlake, f"episode.track(topic).append({KEYWORDS}, _ts=t)", dreamlake_points),
    "nothing": Contender("the clock alone", nothing, "pass", lambda folder: 0),
}
