"""The contents of a recording besides its rows: times, runs, parameters, logs, metrics, episodes, attachments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import clock
from .file_names import FILE_TOPIC, LOG_TOPIC, METRIC_TOPICS
from .inspect import episodes, run_metadata, runs
from .inspect.episodes import Episode
from .inspect.runs import RunInfo
from .mcap.losses import Loss
from .opening import Opened
from .query import attachments
from .query.attachments import Attachments
from .query.lazy_mapping import Lookup
from .query.topic_part import Row
from .recorded_topics import RecordedTopics


class RecordedRun(RecordedTopics):
    """The part of a `Recording` that is about its files and runs."""

    def __init__(self, files: Opened, run: str | int | None) -> None:
        """Take the open files.

        Args:
            files: Closed by whoever opened them.
            run: Of several runs, the one to read; None for all.
        """
        super().__init__(files)
        self._run: str | None = None
        """The id of the run that is read; None for all."""
        if run is not None:
            self._run = chosen = runs.choose(files.segments.all, run)
            files.segments.choose(lambda file: runs.id_of(file) == chosen)

    @property
    def segments(self) -> list[Path]:
        """The files, in the order of writing; in a store, their names as pure paths."""
        return [file.path for file in self._opened()]

    @property
    def finished(self) -> bool:
        """Whether every file has its end; one that is being recorded, or was cut, has none.

        A run that has just begun, without any file, is not finished either.
        """
        files = self._opened()
        return bool(files) and all(file.index.finished for file in files)

    @property
    def losses(self) -> list[Loss]:
        """The damage that was found and left out so far, each loss once, however often it was met.

        A chunk is verified when it is read, so read everything to know all of it. Counts and times of topics are those
        that the files announce, with what turned out to be lost.

        Example:
            >>> with Recording("damaged.mcap", on_damage="skip") as rec:
            ...     rows = list(rec["robot"].rows())
            ...     rec.losses
            [Loss(path=PosixPath('damaged.mcap'), offset=4711, what='a chunk whose checksum ...', messages=120)]
        """
        self._opened()
        return self._files.segments.losses

    @property
    def start(self) -> float | None:
        """Time of the first message on any topic, in s; None without messages."""
        times = [start_ns for start_ns, _ in run_metadata.spans(self._opened())]
        return clock.to_seconds(min(times)) if times else None

    @property
    def end(self) -> float | None:
        """Time of the last message on any topic, in s; None without messages."""
        times = [end_ns for _, end_ns in run_metadata.spans(self._opened())]
        return clock.to_seconds(max(times)) if times else None

    @property
    def duration(self) -> float:
        """From the first message to the last, in s."""
        start, end = self.start, self.end
        return 0.0 if start is None or end is None else max(end - start, 0.0)

    @property
    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """All metadata records, in the order of writing."""
        return run_metadata.metadata(self._opened())

    @property
    def run(self) -> dict[str, str]:
        """The description of the run, such as its `status`. The last value of each entry counts."""
        return run_metadata.run(self._opened())

    @property
    def runs(self) -> list[RunInfo]:
        """The runs in it, in the order in which they began: what each opening of a recorder on this folder wrote.

        `Recording(path, run=...)` reads one of them; its `runs` has only that.

        Example:
            >>> [(run.id, run.status, run.start, run.end) for run in rec.runs]
            >>> latest = Recording(rec.path, run=-1)
        """
        self._opened()
        every_run = runs.find(self._files.segments.all, self._files.is_recorded)
        return every_run if self._run is None else [run for run in every_run if run.id == self._run]

    @property
    def params(self) -> dict[str, Any]:
        """The parameters, by dotted name. The last value of each counts."""
        return run_metadata.parameters(self._opened())

    @property
    def logs(self) -> list[Row]:
        """The rows of the log, in time order."""
        return self._rows(LOG_TOPIC)

    @property
    def metrics(self) -> Mapping[str, list[Row]]:
        """Metric names, sorted, to their rows; each is read when it is asked for."""
        topics = [name for name in self._channel_names() if name.startswith(METRIC_TOPICS)]
        names = sorted(name.removeprefix(METRIC_TOPICS) for name in topics)
        return Lookup("metric", names, lambda name: self._rows(METRIC_TOPICS + name), str(self.path))

    @property
    def files(self) -> list[Row]:
        """The descriptions of the files that were saved with the run, in time order."""
        return self._rows(FILE_TOPIC)

    @property
    def episodes(self) -> list[Episode]:
        """The episodes, in the order of recording. `rec["robot"].read(episode.start, episode.end)` gives one's rows."""
        return episodes.read(self._opened())

    @property
    def attachments(self) -> Attachments:
        """The files inside it, by name: `rec.attachments["calibration.json"].read()`. The last one of a name counts."""
        return attachments.find(self._opened())
