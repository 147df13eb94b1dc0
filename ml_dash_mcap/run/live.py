"""Everything that a run in progress consists of."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Generic, Literal

from ..capture.topic_registry import TopicAbout
from ..codecs.own_rows import own_schema
from ..file_names import FILE, FILE_TOPIC, RUN_RECORD
from ..options import RecorderOptions
from ..recorder import Recorder, open_topic
from ..topic import EventTopic
from . import utc
from .endings import Status
from .episode_marks import Episodes
from .file_store import Details, FileStore
from .files import Files
from .logs import Logs
from .metrics import Metrics
from .parameters import Parameters
from .readback import Readback
from .tracks import Tracks, TrackT

Timestamps = Literal["strict", "auto"]


class Live(Generic[TrackT]):
    """An open recorder, with what users do with it: tracks, episodes, metrics, logs, parameters, files."""

    __slots__ = ("episodes", "files", "logs", "metrics", "parameters", "readback", "recorder", "tracks")

    def __init__(
        self,
        folder: Path,
        prefix: str,
        track_kind: type[TrackT],
        *,
        metadata: Mapping[str, str],
        timestamps: Timestamps,
        options: RecorderOptions,
    ) -> None:
        """Open a run's folder and record that it is running.

        Args:
            folder: The run's folder; made if it is not there.
            prefix: The run's name.
            track_kind: The class of its tracks.
            metadata: What the caller told about the run, for its metadata record.
            timestamps: Whether `append` needs a time stamp.
            options: The recorder's.

        Raises:
            StorageError: The folder cannot be made, written or locked.
        """
        # Asked first: the recorder that is opened next puts files of its own there.
        continued = _has_recordings(folder)
        self.recorder = Recorder(folder, options, prefix=prefix, metadata=metadata, timestamps=timestamps)
        try:
            self.readback = Readback(self.recorder)
            if continued:
                self.readback.remember_earlier()
            self.parameters = Parameters(self.recorder, self.readback)
            self.tracks = Tracks(self.recorder, self.readback, track_kind)
            self.metrics = Metrics(self.recorder, self.readback)
            self.logs = Logs(self.recorder, prefix)
            self.episodes = Episodes(self.recorder)
            rows = _FileRows(self.recorder, self.readback)
            self.files = Files(FileStore(folder / "files", rows, prefix), PurePosixPath(), Details())
            self._write_status("running")
        except BaseException:
            self.recorder.close()
            raise

    def end(self, status: Status, error: BaseException | None = None) -> None:
        """Record how the run ended, write everything and close; a second call does nothing.

        Args:
            status: How it ended.
            error: What made it fail.
        """
        if self.recorder.closed:
            return
        try:
            try:
                # Whatever fails here, the steps after it run: an open recorder would keep its lock and its journal.
                self.episodes.end_open(has_failed=status == "failed")
            finally:
                self._write_status(status, error)
        finally:
            self.readback.close()
            self.recorder.close()

    def _write_status(self, status: Status, error: BaseException | None = None) -> None:
        values = {"status": status, "time": utc.now_text()}
        if error is not None:
            values["error"] = f"{type(error).__name__}: {error}".encode(errors="backslashreplace").decode()
        self.recorder.write_metadata(RUN_RECORD, values)


class _FileRows:
    """Topic `ml_dash/files` of a run."""

    __slots__ = ("_readback", "_recorder")

    def __init__(self, recorder: Recorder, readback: Readback) -> None:
        self._recorder = recorder
        self._readback = readback

    def append(self, row: dict[str, Any]) -> None:
        about = TopicAbout(schema=own_schema("ml_dash.file"))
        open_topic(self._recorder, FILE_TOPIC, FILE, EventTopic, about).add(row)

    def rows(self) -> Iterable[dict[str, Any]]:
        return self._readback.rows(FILE_TOPIC)

    def check_open(self) -> None:
        self._readback.check_open()


def _has_recordings(folder: Path) -> bool:
    """Whether something was recorded in a folder before, be it only in the journals that a crash left behind."""
    try:
        names = os.listdir(folder)
    except OSError:  # no folder, or one that the recorder will report
        return False
    return any(".mcap" in name or name.startswith(".ml_dash-") for name in names)
