"""Reads CSV files of Vicon Nexus and Tracker: sections, each with a rate, names, axes and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ....capture.topic_registry import TopicAbout
from ....errors import ForeignFileError
from ....file_names import MESSAGE
from ....meaning.units import DECIMALS
from ....recorder import Recorder, open_topic
from ....topic import Topic
from ...registry import Progress
from ...text.dialect import number
from ...text.headers import preview
from ...text.number_cells import Cells, Floats
from ...text.plain_text import opened
from .. import restored, row_times, stated_units
from ..joined_tables import joined
from ..placement import Note, Placement
from ..row_times import Timing
from ..take_options import ViconReadOptions
from ..track_rows import ReadingProgress, TopicRows, checked
from . import layout, sections, vicon_fields
from .layout import LEADING
from .sections import Section

_EVENTS_TOPIC = "events"


def record(src: Path, recorder: Recorder, options: ViconReadOptions, progress: Progress | None) -> None:
    """Append the sections of a file; lengths become metres, all else keeps its unit, which the metadata says.

    Trajectories are markers, those of a subject in a topic of its name. What has RX RY RZ RW TX TY TZ is a topic with
    `pos` and `quat`; three rotation angles stay as they are, in `rotation`. Everything else, such as devices, model
    outputs and the scales of segments, is a field an axis; events are the topic `events`.

    Args:
        src: The file.
        recorder: Where its rows go.
        options: How to read it.
        progress: Called now and then with the rows done and the rows in all.

    Raises:
        ForeignFileError: The file is not as Vicon writes it; says the line and the column.
    """
    report = ReadingProgress(src, progress)
    with opened(src) as file:
        contents = sections.read(src, file)
        note = contents.note
        origin = options.start if options.start is not None else note.origin if note else 0.0
        before, tables = 0, []
        for section in contents.sections:
            tables.append(_Table.of(src, file, section, note, before, options.topic, origin, options.on_bad))
            before += len(section.axes)
        moved = row_times.not_below_zero(
            src, Timing(origin), [table.first_stamp(file) for table in tables], is_asked=options.start is not None
        )
        for group in _connected(tables):
            _append(
                src,
                recorder,
                file,
                [replace(table, when=replace(table.when, shift=moved.shift)) for table in group],
                report,
            )
        bad = sum(table.cells.bad for table in tables)
        bad += _append_events(src, recorder, contents.events, replace(moved, origin=origin), options.on_bad)
    report.finish(bad)


@dataclass(frozen=True, slots=True)
class _Table:
    """One section, and where its numbers go."""

    section: Section
    cells: Cells
    placements: list[Placement]
    metadata: dict[str, dict[str, Any]]
    note: Note | None
    when: Timing
    sub_frames: int

    @classmethod
    def of(
        cls, path: Path, file: BinaryIO, section: Section, note: Note | None, before: int, topic: str, origin: float,
        on_bad: str,
    ) -> _Table:  # fmt: skip
        """Lay out a section whose columns stand behind `before` others of the file."""
        placements = vicon_fields.placed(section, topic)
        metadata = vicon_fields.about(section, placements)
        shifts = [stated_units.shift(unit) for unit in section.units]
        if note is not None:
            note = _part(note, before, len(section.axes))
            lengths = {at for at, unit in enumerate(section.units) if unit == layout.UNIT}
            shifts = restored.shifts(note, DECIMALS[layout.UNIT], len(section.axes), lengths)
            placements, metadata = list(note.placements), {name: dict(about) for name, about in note.metadata.items()}
        file.seek(section.start)
        head, tail = preview(file, section.stop)
        count = len(section.axes) + LEADING
        cells = Cells(path, count, section.dialect, [0, 0, *shifts], allow_short=True, on_bad=on_bad)
        cells.learn(head + tail)
        subs = cells.sample(head + tail)[:, 1]
        # The file does not state how many sub frames a frame has; the largest number in the first and last rows
        # tells.
        sub_frames = int(np.nanmax(subs, initial=0.0)) + 1 if not np.isnan(subs).all() else 1
        numbered = "frame" if sub_frames == 1 else "frame and sub frame"
        when = Timing(origin, section.rate, source=f"{numbered} numbers at {section.rate!r} Hz")
        return cls(section, cells, placements, metadata, note, when, sub_frames)

    def first_stamp(self, file: BinaryIO) -> float:
        """Return the time stamp of the first row that has one, in s; NaN if none has."""
        file.seek(self.section.start)
        head, _ = preview(file, self.section.stop)
        values = self.cells.sample(head)
        stamps = self._stamps(values)
        stamps_there = stamps[~np.isnan(stamps)]
        return float(stamps_there[0]) if len(stamps_there) else float("nan")

    def rows(self, file: BinaryIO, report: ReadingProgress) -> Iterator[tuple[Floats, Floats]]:
        """Yield time stamps, [N], s, and numbers, [N, C]; several sections can be read by turns."""
        points = [
            placement.columns
            for placement in vicon_fields.placed(self.section, "")
            if placement.path[0] in ("markers", "pos")
        ]
        turns = [
            placement.columns for placement in vicon_fields.placed(self.section, "") if placement.path[0] == "quat"
        ]
        file.seek(self.section.start)
        for part in self.cells.read(file, self.section.line, self.section.stop):
            numbers = part.values[:, LEADING:]
            if self.note:
                restored.turn_back(numbers, self.note, points, turns)
            times, keep = checked(self.cells, self._stamps(part.values), part.lines, 1)
            report.add(len(numbers), part.at)
            yield times, numbers if keep is None else numbers[keep]

    def _stamps(self, values: Floats) -> Floats:
        subs = np.nan_to_num(values[:, 1])
        # Vicon counts frames from 1 and sub frames from 0.
        frames = (values[:, 0] - 1) * self.sub_frames + subs
        return self.when.stamps(frames, frames)


def _connected(tables: Sequence[_Table]) -> list[list[_Table]]:
    """Return tables in groups: those of one rate that have rows of the same topics."""
    groups: list[list[_Table]] = []
    for table in tables:
        topics = {place.topic for place in table.placements}
        same = [
            group
            for group in groups
            if any(
                other.section.rate == table.section.rate and topics & {place.topic for place in other.placements}
                for other in group
            )
        ]
        groups = [group for group in groups if group not in same]
        groups.append([other_table for group in same for other_table in group] + [table])
    return groups


def _append(path: Path, recorder: Recorder, file: BinaryIO, tables: list[_Table], report: ReadingProgress) -> None:
    """Append several sections together: their numbers of one frame are one row."""
    placements: list[Placement] = []
    present: list[tuple[int]] = []
    metadata: dict[str, dict[str, Any]] = {}
    width = 0
    for table in tables:
        count = len(table.section.axes)
        placements += [replace(place, columns=tuple(width + at for at in place.columns)) for place in table.placements]
        present += [(width + count,)] * len(table.placements)
        for name, about in table.metadata.items():
            metadata[name] = vicon_fields.merged(metadata.get(name, {}), {**about, **table.when.metadata})
        width += count + 1
    if len(tables) == 1:
        tracks = TopicRows(path, recorder, placements, metadata, skip_empty=tables[0].note is not None)
        for times, values in tables[0].rows(file, report):
            tracks.append(times, values)
        return
    is_ours = tables[0].note is not None
    tracks = TopicRows(path, recorder, placements, metadata, skip_empty=is_ours, present=present)
    rows, width = _marked(path, tables[0], report), len(tables[0].section.axes) + 1
    for table in tables[1:]:
        more = len(table.section.axes) + 1
        # The column of ones tells afterwards which sections had a row at a time, also where all of its numbers are
        # missing.
        rows, width = joined(rows, _marked(path, table, report), (width, more)), width + more
    for times, values in rows:
        tracks.append(times, values)


def _marked(path: Path, table: _Table, report: ReadingProgress) -> Iterator[tuple[Floats, Floats]]:
    """Yield a section's rows with a column of ones behind them; the file is opened once for each section."""
    with opened(path) as file:
        for times, values in table.rows(file, report):
            yield times, np.concatenate((values, np.ones((len(values), 1))), axis=1)


def _append_events(
    path: Path, recorder: Recorder, events: Sequence[tuple[int, dict[str, str]]], when: Timing, on_bad: str
) -> int:
    """Append events as rows of text; returns how many have no time and were left out."""
    rows: list[dict[str, Any]] = []
    for line, event in events:
        word = next((word for word in event if word.lower().startswith("time")), "Time (s)")
        time = number(event.get(word, ""))
        if time is None or when.origin + time + when.shift < 0:
            if on_bad == "raise":
                problem = f"the event has the time {event.get(word, '')!r}, which is none"
                raise ForeignFileError(path, f"{problem}; pass on_bad='missing' to leave it out", line)
            continue
        event_fields = {key.lower().replace(" ", "_"): value for key, value in event.items() if key and key != word}
        rows.append({**event_fields, "_ts": when.origin + time + when.shift})
    if rows:
        about = {"vicon": {"section": layout.EVENTS}, **when.metadata}
        open_topic(recorder, _EVENTS_TOPIC, MESSAGE, Topic, TopicAbout(metadata=about)).append_batch(rows)
    return len(events) - len(rows)


def _part(note: Note, first: int, count: int) -> Note:
    """Return the part of a note that is about one section's columns."""
    mine = [placement for placement in note.placements if all(first <= at < first + count for at in placement.columns)]
    moved = tuple(
        Placement(placement.topic, placement.path, placement.shape, tuple(at - first for at in placement.columns))
        for placement in mine
    )
    return replace(note, placements=moved)
