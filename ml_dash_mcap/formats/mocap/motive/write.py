"""Writes OptiTrack Motive CSV, versions 1.23 and 1.25.

The header is that of Motive 2 and 3's own exports, with more pairs behind its first line: what the
recording was.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import hashlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from .... import clock as clocks
from ....meaning.mocap_objects import Body, Marker
from ....meaning.space import up_of
from ....meaning.units import DECIMALS
from ...destination import fresh_file, refuse_existing
from ...export_job import Job
from .. import take_clock as rates
from ..placement import NOTE_KEY, Note, Placing, to_text
from ..sto import write as sto
from ..table_text import TableText
from ..take import OutgoingTake, Thing
from ..take_contents import bodies_and_markers
from ..take_options import MocapWriteOptions
from ..wide import write as wide
from . import layout


@dataclass(frozen=True, slots=True)
class _Column:
    """One column of the file."""

    thing: Thing
    source: int
    """The column of the take that it shows."""
    group: str
    """"Rotation", "Position", "Mean Marker Error" or "Angle"."""
    axis: str
    is_length: bool


def export(job: Job, options: MocapWriteOptions) -> Path:
    """Write one file of a job's bodies and markers, and perhaps one beside it of its joints; or one wide table.

    Args:
        job: What to export; its destination is the file.
        options: How to write it.

    Raises:
        DestinationExistsError: Something is at the destination, or where the joints go.
        ConversionError: There is nothing to write, or no clock to write it on, or something is no rotation.
    """
    if options.layout == "wide":
        return wide.write(job, options)
    refuse_existing(job.dest)
    points, joints = bodies_and_markers(job, options.quat_order)
    things: list[Thing] = [*points, *(joints if options.joints == "columns" else ())]
    has_beside = options.joints == "sto" and bool(joints)
    beside = job.dest.with_name(f"{job.dest.stem}.joints.sto")
    with_origin = [thing.topic for thing in (*things, *(joints if has_beside else ()))]
    clock = rates.find(job, [thing.topic for thing in things], options.rate, with_origin=with_origin)
    with contextlib.ExitStack() as files:
        path = files.enter_context(fresh_file(job.dest))
        if has_beside:
            refuse_existing(beside)
            joints_file = files.enter_context(fresh_file(beside))
            sto.write(job, joints, options, joints_file, decimals=options.decimals, with_origin=with_origin)
        with path.open("wb") as file:
            _write(OutgoingTake(job, options, things, clock), options, file, beside.name if has_beside else None)
    return job.dest


def _write(take: OutgoingTake, options: MocapWriteOptions, file: BinaryIO, joints: str | None) -> None:
    columns = list(_columns(take))
    file.write(_header(take, options, columns, joints).encode())
    text = TableText(decimals=options.decimals, time_decimals=take.clock.time_decimals(options.decimals))
    order = [column.source for column in columns]
    is_in_order = order == list(range(sum(1 for _ in order)))
    units = {id(column.thing): take.unit_of(column.thing) for column in columns if column.is_length}
    shifts = [
        DECIMALS[options.length_units] - DECIMALS[units[id(column.thing)]] if column.is_length else 0
        for column in columns
    ]
    for window in take.windows():
        values = window.values if is_in_order and window.values.shape[1] == len(order) else window.values[:, order]
        file.write(text.rows(text.heads(window.frames, window.times), values, shifts))


def _columns(take: OutgoingTake) -> Iterator[_Column]:
    for thing, at in take.columns():
        if isinstance(thing, Body):
            yield from _axes(thing, at, layout.ROTATION, layout.ROTATION_AXES)
            yield from _axes(thing, at + 4, layout.POSITION, layout.POSITION_AXES)
            if thing.error is not None:
                yield _Column(thing, at + 7, layout.MARKER_ERROR, "", True)
        elif isinstance(thing, Marker):
            yield from _axes(thing, at, layout.POSITION, layout.POSITION_AXES)
        else:
            yield _Column(thing, at, layout.ANGLE, "", False)


def _axes(thing: Thing, first: int, group: str, axes: str) -> Iterator[_Column]:
    """Yield a column for each axis of an object's position or rotation."""
    for column, axis in enumerate(axes, first):
        yield _Column(thing, column, group, axis, group in layout.LENGTHS)


def _header(take: OutgoingTake, options: MocapWriteOptions, columns: Sequence[_Column], joints: str | None) -> str:
    rows: list[list[str]] = [_pairs(take, options, columns, joints), []]
    rows.append(["", layout.TYPE, *(_type(column.thing) for column in columns)])
    rows.append(["", layout.NAME, *(column.thing.name for column in columns)])
    rows.append(["", layout.IDENTITY, *(_identity(column.thing) for column in columns)])
    if options.format_version == "1.25":
        bodies = {thing.topic: thing.name for thing in reversed(take.things) if isinstance(thing, Body)}
        parents = ["" if isinstance(column.thing, Body) else bodies.get(column.thing.topic, "") for column in columns]
        rows.append(["", layout.PARENT, *parents])
    rows.append(["", "", *(column.group for column in columns)])
    rows.append([layout.FRAME, layout.TIME, *(column.axis for column in columns)])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerows(rows)
    return text.getvalue()


def _pairs(take: OutgoingTake, options: MocapWriteOptions, columns: Sequence[_Column], joints: str | None) -> list[str]:
    clock, topics = take.clock, take.job.topics
    first = take.things[0].topic
    orders = {thing.order for thing in take.things if isinstance(thing, Body)}
    rate = f"{clock.stated_rate:.6f}"
    pairs = {
        layout.FORMAT_VERSION: options.format_version,
        layout.TAKE_NAME: take.job.dest.stem,
        layout.TAKE_NOTES: "",
        layout.CAPTURE_RATE: rate,
        layout.EXPORT_RATE: rate,
        layout.START_TIME: start_time(clock.origin),
        "Total Frames in Take": str(clock.count),
        "Total Exported Frames": str(clock.count),
        layout.ROTATION_TYPE: layout.QUATERNION,
        layout.LENGTH_UNITS: layout.UNIT_WORDS[options.length_units],
        layout.COORDINATE_SPACE: "Global",
        "ML Dash Topic": first,
        "ML Dash Start Timestamp": repr(clock.origin),
        "ML Dash Up Axis": (take.options.up or up_of(topics[first].metadata)).upper(),
        "ML Dash Quat Order": orders.pop() if len(orders) == 1 else "xyzw",
        NOTE_KEY: to_text(_note(take, columns, joints)),
    }
    return [text for pair in pairs.items() for text in pair]


def _note(take: OutgoingTake, columns: Sequence[_Column], joints: str | None) -> Note:
    placing = Placing()
    for thing in take.things:
        mine = [(at, column) for at, column in enumerate(columns) if column.thing is thing]
        groups = {
            layout.ROTATION: "rotation",
            layout.POSITION: "position",
            layout.MARKER_ERROR: "error",
            layout.ANGLE: "value",
        }
        where: dict[str, list[int]] = {}
        for at, column in mine:
            where.setdefault(groups[column.group], []).append(at)
        placing.add(thing, where)
    return take.note(placing, joints)


def _type(thing: Thing) -> str:
    return layout.RIGID_BODY if isinstance(thing, Body) else thing.kind if isinstance(thing, Marker) else layout.JOINT


def _identity(thing: Thing) -> str:
    # Motive's IDs are 32 hexadecimal digits. Ours come from the name, so that the same take gives the same file.
    return hashlib.sha256(f"{thing.topic}/{thing.name}".encode()).hexdigest()[:32].upper()


def start_time(origin_s: float) -> str:
    """Spell a wall-clock time as Motive does, in UTC; nothing for the time of a clock that starts near 0."""
    if not clocks.is_epoch_like(origin_s):
        return ""
    start = datetime.datetime.fromtimestamp(origin_s, datetime.timezone.utc)
    half = "AM" if start.hour < 12 else "PM"  # %p speaks the language of the machine
    return f"{start:%Y-%m-%d %I.%M.%S}.{start.microsecond // 1000:03d} {half}"
