"""What the reading benchmark reads: the same rows in each contender's own form, and recordings of odd shapes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from robot_rows import BLOCK_ROWS, SCHEMA, START_S, TOPICS, WIDTHS, Row, fresh_blocks, fresh_rows

TOPIC = TOPICS[3]  # the one that is read
ROS_TYPE = "bench_msgs/msg/Robot"
ROS_FIELDS = "\n".join(f"float64[{width}] {name}" if width > 1 else f"float64 {name}" for name, width in WIDTHS.items())
SMALL_CHUNK_BYTES = 64 * 1024


def rows_of_topic(count: int) -> Iterator[Row]:
    """Return the rows that `TOPIC` has among `count` rows of all topics."""
    return islice(fresh_rows(count, ready=False, per_tick=len(TOPICS)), TOPICS.index(TOPIC), None, len(TOPICS))


def ticks(count: int) -> Iterator[tuple[str, Row]]:
    """Yield `count` rows as a control loop logs them, tick by tick one of each topic."""
    rows = fresh_rows(count, ready=False, per_tick=len(TOPICS))
    return ((TOPICS[i % len(TOPICS)], row) for i, row in enumerate(rows))


# The forms of the same rows.


def truth(folder: Path, count: int) -> None:
    """What a reader of `TOPIC` has to find: `t` [N] and `q` [N, 7]."""
    import numpy

    rows = list(rows_of_topic(count))
    numpy.savez(folder / "truth.npz", t=[row[6] for row in rows], q=[row[0] for row in rows])


def ours(folder: Path, count: int, encoding: str = "json") -> None:
    from ml_dash_mcap import Recorder, RecorderOptions

    with Recorder(folder, RecorderOptions(compression="zstd", encoding=encoding)) as rec:
        topics = {name: rec.topic(name) for name in TOPICS}
        for name, (q, qd, tau, ee_pos, ee_quat, gripper, t, *_) in ticks(count):
            topics[name].append(q=q, qd=qd, tau=tau, ee_pos=ee_pos, ee_quat=ee_quat, gripper=gripper, _ts=t)


def typed(folder: Path, count: int) -> None:
    """The same in protobuf."""
    ours(folder, count, "protobuf")


def mcap(folder: Path, count: int) -> None:
    """The same payloads by mcap's own writer, as it comes: zstd, chunks of 1 MiB."""
    import orjson
    from mcap.writer import Writer

    writer = Writer(str(folder / "mcap.mcap"))
    writer.start()
    schema = writer.register_schema("robot", "jsonschema", json.dumps(SCHEMA).encode())
    channels = {name: writer.register_channel(name, "json", schema) for name in TOPICS}
    for name, (*fields, t, t_ns, _) in ticks(count):
        data = orjson.dumps({**dict(zip(WIDTHS, fields, strict=True)), "_ts": t})
        writer.add_message(channels[name], log_time=t_ns, data=data, publish_time=t_ns)
    writer.finish()


def rosbag2(folder: Path, count: int) -> None:
    """A message of its own with arrays of fixed size, in a bag with mcap storage and zstd chunks."""
    import numpy
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg(ROS_FIELDS, ROS_TYPE))
    robot = types.types[ROS_TYPE]
    writer = Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {name: writer.add_connection(f"/{name}", ROS_TYPE, typestore=types) for name in TOPICS}
        for name, (*lists, gripper, _, t_ns, _) in ticks(count):
            message = robot(*(numpy.array(one) for one in lists), gripper)
            writer.write(connections[name], t_ns, types.serialize_cdr(message, ROS_TYPE))


def ml_dash(folder: Path, count: int) -> None:
    """Only `TOPIC`, since each topic has a file of its own."""
    from ml_dash import Experiment

    with Experiment(prefix="bench/read/run", dash_root=str(folder)).run as exp:
        for *fields, t, _, _ in rows_of_topic(count):
            exp.tracks(TOPIC).append(**dict(zip(WIDTHS, fields, strict=True)), _ts=t)


def dreamlake(folder: Path, count: int) -> None:
    """Only `TOPIC`, since each track has a file of its own."""
    from dreamlake import Episode

    with Episode(prefix="bench/read", root=str(folder)) as episode:
        for *fields, t, _, _ in rows_of_topic(count):
            episode.track(TOPIC).append(**dict(zip(WIDTHS, fields, strict=True)), _ts=t)


def rerun(folder: Path, count: int) -> None:
    """An entity for each field, sent in columns of 10,000 rows, topic by topic."""
    import numpy
    import rerun as rr

    stream = rr.RecordingStream("bench")
    stream.save(folder / "bench.rrd")
    rows = ticks(count)
    while block := list(islice(rows, BLOCK_ROWS * len(TOPICS))):
        for topic in TOPICS:
            *fields, t, _, _ = zip(*(row for name, row in block if name == topic), strict=True)
            times = rr.TimeColumn("time", timestamp=numpy.array(t))
            for (name, width), values in zip(WIDTHS.items(), fields, strict=True):
                scalars = rr.Scalars.columns(scalars=numpy.array(values).reshape(-1))
                entity = f"/{topic}/{name}"
                stream.send_columns(entity, [times], scalars if width == 1 else scalars.partition([width] * len(t)))
    stream.flush()


# Recordings of odd shapes, made by this library.


def chunks(folder: Path, count: int) -> None:
    """One file of about `count` small chunks, each with all topics."""
    from ml_dash_mcap import Recorder, RecorderOptions

    options = RecorderOptions(chunk_bytes=SMALL_CHUNK_BYTES, batch_rows=len(TOPICS), sync_interval_s=0)
    with Recorder(folder, options) as rec:
        topics = [rec.topic(name) for name in TOPICS]
        for number in range(count):
            for topic in topics:
                topic.append(x=number, _ts=START_S + number)
            rec.flush()


def segments(folder: Path, count: int) -> None:
    """`count` segments with a row of each topic in them, each from a recorder of its own."""
    from ml_dash_mcap import Recorder, RecorderOptions

    options = RecorderOptions(chunk_bytes=SMALL_CHUNK_BYTES, backlog_bytes=2 * SMALL_CHUNK_BYTES, sync_interval_s=0)
    for number in range(count):
        with Recorder(folder, options) as rec:
            for name in TOPICS:
                rec.topic(name).append(x=number, _ts=START_S + number)


def topics(folder: Path, count: int) -> None:
    """`count` topics of 200 rows each in one file."""
    from ml_dash_mcap import Recorder

    with Recorder(folder) as rec:
        every = [rec.topic(name) for name in (TOPIC, *(f"sensor/{number:04d}" for number in range(count - 1)))]
        for step in range(200):
            for topic in every:
                topic.append(q=[0.1 * step] * 7, temp=20.5, n=step, _ts=START_S + step / 100)


def gigabytes(folder: Path, size: int) -> None:
    """One topic, recorded until its files have `size` bytes."""
    from ml_dash_mcap import Recorder, RecorderOptions

    with Recorder(folder, RecorderOptions(compression="zstd")) as rec:
        topic = rec.topic(TOPIC)
        for number, (q, qd, tau, ee_pos, ee_quat, gripper, t, *_) in enumerate(fresh_blocks(1 << 40)):
            topic.append_columns(q=q, qd=qd, tau=tau, ee_pos=ee_pos, ee_quat=ee_quat, gripper=gripper, _ts=t)
            if number % 10 == 0 and bytes_on_disk(folder) >= size:
                return


def bytes_on_disk(folder: Path) -> int:
    """Return the size of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


FORMS: dict[str, Callable[[Path, int], None]] = {
    "truth": truth,
    "ours": ours,
    "typed": typed,
    "mcap": mcap,
    "rosbag2": rosbag2,
    "ml-dash": ml_dash,
    "dreamlake": dreamlake,
    "rerun": rerun,
    "minute": chunks,
    "longer": chunks,
    "segments": segments,
    "topics": topics,
    "gigabytes": gigabytes,
}
"""What makes a form in a folder, and how many rows, chunks, segments or bytes it is given."""
