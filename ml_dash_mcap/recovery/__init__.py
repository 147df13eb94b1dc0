"""Recovers what a dead recorder left behind: finishes its segments, and writes the rows of its journal."""

from __future__ import annotations

import errno
import logging
import socket
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..capture.channels import ChannelInfo
from ..capture.prepare_block import BlockPreparer, SessionProgress
from ..capture.segment_names import STAMP
from ..capture.segment_sink import SegmentSink
from ..capture.session_record import SessionRecord
from ..capture.sink import SessionInfo
from ..errors import MissingRecordingError
from ..file_names import SESSION_GLOB
from ..mcap.row_arrays import SealedBuffer
from ..options import RecorderOptions
from ..store.run_folders import runs_below
from ..store.safe_paths import place
from ..store.session_lock import SessionLock
from ..version import LIBRARY
from . import dead_journals, session_progress, unfinished_segments
from .dead_journals import Leftover

_log = logging.getLogger("ml_dash_mcap")


@dataclass(frozen=True, slots=True)
class Recovered:
    """The result of a recovery."""

    finished: list[Path] = field(default_factory=list)
    """Segments that had lost their end, and the segment that was made of the journal."""
    rows: int = 0
    """Rows that were in the journal only."""
    lost_bytes: int = 0
    """Bytes of torn chunks whose rows are in no journal either, after a crash of the machine: these rows are lost."""
    left: list[Path] = field(default_factory=list)
    """Session files of dead recorders whose leftovers could not be recovered here; the log tells why."""

    def __add__(self, other: Recovered) -> Recovered:
        """Return the results of both recoveries together."""
        return Recovered(
            [*self.finished, *other.finished],
            self.rows + other.rows,
            self.lost_bytes + other.lost_bytes,
            [*self.left, *other.left],
        )


def recover(path: str | Path) -> Recovered:
    """Recover the leftovers of dead recorders in a run's folder and the folders below. Living recorders are left alone.

    `Recorder` and `Recording` do this to their own folder when they open it. Nothing is lost if it is interrupted.

    Args:
        path: The run's folder, or a folder of many, such as ".dash".

    Raises:
        MissingRecordingError: There is no such folder.
    """
    folder = place(path, "path")
    if not folder.is_dir():
        fault = "is a file; pass its folder" if folder.is_file() else "no recording here"
        raise MissingRecordingError(errno.ENOENT, fault, str(path))
    done = Recovered()
    for run_folder in runs_below(folder):
        done += recover_folder(run_folder)
    return done


def recover_folder(folder: Path) -> Recovered:
    """Recover the leftovers of dead recorders in one run's folder, without the folders below it; see `recover`."""
    done = Recovered()
    for session_file in sorted(folder.glob(SESSION_GLOB)):
        if session_file.is_symlink() or not session_file.is_file():
            continue  # a folder from outside may hold pipes, which would be waited for, and ways to others' sessions
        lock = SessionLock.seize(session_file)
        if lock is None:
            continue
        try:
            done += _recover_session(folder, lock)
        except Exception as error:  # a fault of one session must not stop the others, or opening the folder
            _log.warning("the leftovers of a crashed recorder in %s stay as they are: %r", folder, error)
            done += Recovered(left=[session_file])
        finally:
            lock.release()
    return done


def _recover_session(folder: Path, lock: SessionLock) -> Recovered:
    """Recover one session, whose lock is held."""
    record = SessionRecord.read(lock.path)
    original = record.original(lock)
    buffers = record.buffer_paths()
    if original is not None and SessionLock.is_held(original):
        buffers = []  # their recorder lives, and this folder is a copy of its folder
    elif not buffers and record.host not in (None, socket.gethostname()):
        _log.warning(
            "%s: the rows that a recorder on %s had not written yet are in its journal there (%s); open the recording"
            " there to get them",
            *(folder, record.host, record.journals),
        )
        return Recovered(left=[lock.path])
    done = _recover_rows(folder, record, dead_journals.read_all(buffers, record.session))
    # A copy of a folder names the journal of the original, which still needs it.
    if original is None:
        for buffer in buffers:
            buffer.unlink(missing_ok=True)
    # The session file goes last: as long as it is there, an interrupted recovery is done again.
    lock.remove()
    return done


def _recover_rows(folder: Path, record: SessionRecord, leftovers: list[Leftover]) -> Recovered:
    """Finish the segments of a session, and write the buffers that are in none of them into a further segment."""
    about = dict(record.about)
    unfinished = list(unfinished_segments.unfinished(folder, record.session, about.pop(STAMP, "")))
    torn_bytes = sum(map(unfinished_segments.torn_chunk_bytes, unfinished))
    journaled = {leftover.block for leftover in leftovers if leftover.starts}
    # Before the count below, which looks at finished segments only.
    finished = [unfinished_segments.finish(path, journaled) for path in unfinished]
    written, sequences = session_progress.written_so_far(folder, record.session)
    pending = [leftover for leftover in leftovers if leftover.block >= written]
    rows = sum(len(leftover.starts) for leftover in pending)
    if rows or any(leftover.extras for leftover in pending):
        about = {"prefix": folder.name, "run": record.session, **about, "library": LIBRARY, "recovered": "true"}
        last_ns = session_progress.last_times(folder, record.session, sequences)
        finished += _write_buffers(folder, about, pending, written, sequences, last_ns)
    # A torn chunk is lost only if the journal does not have its rows.
    return Recovered(finished, rows, lost_bytes=0 if pending else torn_bytes)


def _write_buffers(
    folder: Path,
    about: dict[str, str],
    pending: list[Leftover],
    written: int,
    sequences: dict[str, int],
    last_ns: dict[str, int],
) -> list[Path]:
    """Write buffers, in order, into a segment of their own."""
    channels: dict[int, ChannelInfo] = {}
    for leftover in pending:
        channels.update(leftover.channels)
    by_number = {number: sequences.get(info.topic, 0) for number, info in channels.items()}
    last_by_number = {number: last_ns[info.topic] for number, info in channels.items() if info.topic in last_ns}
    preparer = BlockPreparer(folder, about, channels, SessionProgress(written, by_number, last_by_number))
    segments = SegmentSink(RecorderOptions(), preparer.fallbacks, {}, written)
    segments.open(SessionInfo(folder, about))
    for leftover in pending:
        # A copy that can be changed: rows are numbered in place.
        data = np.frombuffer(bytearray(leftover.data), np.uint8)
        block = SealedBuffer(data, leftover.begin, leftover.end, leftover.starts, leftover.gaps, leftover.extras)
        segments.write(preparer.prepare(block))
    segments.close()
    return segments.finished
