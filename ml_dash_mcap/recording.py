"""Recording: reads a finished, cut or growing recording, by topic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .codecs.decoding import decoding
from .errors import OptionError, UsageError
from .formats import registry
from .formats.export_job import Job
from .formats.export_place import Reads, destination, located
from .formats.registry import Progress
from .formats.replacing import RECORDING, check_overwrite
from .formats.writers import export
from .inspect import gaps, overview
from .inspect.check import check
from .inspect.findings import Report
from .inspect.gaps import Gap
from .mcap.limits import Limits
from .opening import OpeningOptions, open_recording
from .query import counts
from .query.lazy_mapping import Lookup
from .query.topic_rows import check_range
from .recorded_run import RecordedRun
from .store.store import Store
from .suggestions import not_found

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]


class Recording(RecordedRun):
    """A run's folder, or one MCAP file: finished, cut by a crash, or still being recorded.

    It is a mapping from the names of topics, sorted, to their readers. The library's own topics (`ml_dash/...`) are
    there when they are asked for by name; iteration leaves them out. Two recordings are equal if they are one object.

    Opening reads the indexes and no message. Any thread may read; `refresh` and `close` are for one at a time.

    Example:
        >>> with Recording("runs/alice/franka/demo-001") as rec:
        ...     rec.topics["robot"].count
        ...     rec["robot"].read(start=0.0, end=5.0, columns=["q"])
        ...     for row in rec["robot"].rows():
        ...         print(row["_ts"], row["q"])
        ...     tables = {name: topic.to_arrow() for name, topic in rec.items()}
    """

    def __init__(
        self,
        path: str | Path | Iterable[str | Path],
        *,
        store: Store | None = None,
        run: str | int | None = None,
        recover: bool = True,
        on_damage: str = "raise",
        limits: Limits | None = None,
        definitions: Mapping[str, str | Path] | None = None,
        on_unknown: str = "bytes",
    ) -> None:
        """Open a recording.

        Args:
            path: A run's folder or one file; or several of them, which are read as one recording. A ROS bag or another
                foreign file is converted into a temporary recording first; `convert` makes one that stays.
            store: Where `path` lies, which is a name in it then: a folder of MCAP files, or one. None for this machine.
            run: Of a folder with several runs (`runs` lists them), the one to read: its id, or the beginning of that,
                or its number, 0 for the first and -1 for the last. None reads all as one, in which rows of the same
                topic and time are one row.
            recover: Whether to make whole first what a dead recorder left in its folder, which writes there. False
                reads its files as they lie, without the rows that only its journal has. A store is only read.
            on_damage: "raise" a DamagedFileError where a file is damaged, or "skip" what cannot be read and note it in
                `losses`. A file that is no MCAP file can be skipped too, unless it is all that was asked for.
            limits: How much memory the files may ask for; None for the defaults, which suit files from outside.
            definitions: ROS types to their definitions, as text or the path of a `.msg` or `.idl` file: of types that
                the files do not define, or instead of what they say.
            on_unknown: What comes of messages that cannot be decoded: "bytes" for rows that have them as `data`, or as
                `_data` among messages that are decoded, and an UndecodedWarning; "skip" for no rows, and the warning;
                "raise" for an EncodingError where rows of that topic are asked for, and a DamagedFileError where one
                message is not what its schema says.

        Raises:
            MissingRecordingError: There is none; also a FileNotFoundError.
            DamagedFileError: A file is no MCAP file, or a finished one is broken.
            NotFoundError: There is no such run; the message names those that there are. Also a KeyError.
            OptionError: An option has a value that it cannot have; also a ValueError.
            UsageError: `store` is no store; also a TypeError.
            FormatError: A file in a store is of another format; also a ValueError.
        """
        how = decoding(definitions, on_unknown)
        bag_options: dict[str, Any] = {
            "definitions": definitions,
            "on_unknown": "skip" if on_unknown == "skip" else "bytes",
        }
        bag_options |= {} if limits is None else {"limits": limits}
        if on_damage not in ("raise", "skip"):
            raise OptionError(f'on_damage={on_damage!r} is neither "raise" nor "skip"')
        if limits is not None and not isinstance(limits, Limits):
            raise UsageError(f"limits={limits!r} is of type {type(limits).__name__}; pass Limits(...)")
        options = OpeningOptions(recover, on_damage == "skip", limits or Limits(), how, bag_options)
        files = open_recording(path, store, options)
        try:
            super().__init__(files, run)
        except BaseException:
            files.close()
            raise

    @property
    def store(self) -> Store | None:
        """Where the files lie; None on this machine."""
        return self._files.store

    def align(
        self,
        topics: Iterable[str] | Mapping[str, Iterable[str] | None],
        *,
        on: str | None = None,
        hz: float | None = None,
        how: str | Mapping[str, str] = "previous",
        tolerance_s: float | None = None,
        start: float | None = None,
        end: float | None = None,
    ) -> pa.Table:
        """Return several topics on one clock, as one Arrow table: `_ts`, and a column `topic.field` for each field.

        A topic's rows are its samples. What a row lacks is missing there, and so is what lies too far away: null.

        - "previous": the last row at or before a time, not older than `tolerance_s`;
        - "nearest": the nearest row, the earlier one of two, not farther than `tolerance_s`;
        - "linear": on the line between the rows on both sides, if these are no farther from each other than
          `tolerance_s`; numbers (as doubles), vectors and matrices. Text, booleans and whatever else is no number takes
          the previous value, unless its column is named;
        - "slerp": the same on the shortest arc, for quaternions, whichever of their elements comes first.

        Args:
            topics: Names; or a mapping from names to the columns wanted, None for all.
            on: The topic whose times to take. Its own rows come back as they are; it need not be one of `topics`.
            hz: Or so many times a second: the first time plus i / hz. From `start`, or else from where the last of the
                topics starts, to `end`, or else to where the first of them ends, both included.
            how: A method for all columns, or a mapping to methods from names: "topic.field", "topic" and "*" for all
                others. The most specific one counts; "previous" where there is none.
            tolerance_s: In s; None for any distance. Before a topic's first row "previous" has no value, and "linear"
                and "slerp" have none after its last one either.
            start: First time, in s; None for the beginning.
            end: Last time, included, in s; None for the end.

        Raises:
            NotFoundError: There is no such topic or column; also a KeyError.
            AlignmentError: There is no such method, a named column has no values for it, or slerp was to take others
                than 4-vectors; also a ValueError.
            UsageError: Both `on` and `hz` are given, or neither; also a TypeError.
            RangeError: The range's start lies after its end; also a ValueError.

        Example:
            >>> rec.align(["robot", "imu"], on="robot", how={"imu": "linear", "imu.quat": "slerp"}, tolerance_s=0.05)
            >>> rec.align({"robot": ["q"], "imu": ["accel"]}, hz=100, how="linear").to_pandas()
        """
        # Imported here, as it brings pyarrow; opening a recording does not need it.
        from .alignment import align

        self._opened()
        return align(self.__getitem__, topics, on=on, hz=hz, how=how, tolerance_s=tolerance_s, start=start, end=end)

    def gaps(self, topic: str, longer_than_s: float | None = None) -> list[Gap]:
        """Return where a topic's rows are too far apart, in time order; looks at indexes only.

        Args:
            topic: Its name.
            longer_than_s: What a gap is longer than, in s; 1.5 times the median spacing by default.

        Raises:
            NotFoundError: There is no such topic; also a KeyError.
            RangeError: `longer_than_s` is not a number above 0; also a ValueError.

        Example:
            >>> [(gap.start, gap.missing) for gap in rec.gaps("robot")]
        """
        if topic not in self:
            raise not_found("topic", topic, self._topic_names(), str(self.path))
        return gaps.find(self._stored(topic), longer_than_s)

    def check(self, topics: Iterable[str] | None = None) -> Report:
        """Look for damage, drops, missing sequence numbers, clocks that were set or began again, gaps and late rows.

        Reads every chunk that holds one of the topics, so that its checksum is verified, and decodes no row.

        Args:
            topics: Names; None for all that hold rows of a robot.

        Returns:
            What was found, the worst first; true if there is nothing to act on.

        Raises:
            NotFoundError: There is no such topic; also a KeyError.

        Example:
            >>> report = rec.check()
            >>> if not report:
            ...     print(report)
        """
        return check(self._opened(), self._chosen(topics), has_all=topics is None)

    def refresh(self) -> bool:
        """Take in what was written since; costs as much as there is new.

        Returns:
            Whether anything was.
        """
        self._opened()
        changed = self._files.segments.refresh()
        if changed:
            self._infos.clear()
        return changed

    def export(
        self,
        dest: str | Path,
        *,
        store: Store | None = None,
        format: str | None = None,
        topics: Iterable[str] | None = None,
        start: float | None = None,
        end: float | None = None,
        overwrite: bool = False,
        progress: Progress | None = None,
        **options: Any,
    ) -> Path:
        """Write topics in another format. The result appears when it is whole; until then nothing is at `dest`.

        Args:
            dest: Where to.
            store: Where `dest` lies, which is a name in it then; None for this machine. Files are written here first,
                and put there when all are whole.
            format: "parquet", "csv", "jsonl", "dreamlake", "rosbag2", "rosbag1", "mocap", "vicon", "qtm", "trc", "sto"
                "c3d" or "mcap"; the guides say what each writes. None to tell by the suffix of `dest`, such as
                ".parquet".
            topics: Names; None for all that hold rows of a robot.
            start: First time stamp, in s; None for the beginning.
            end: Last time stamp, included, in s; None for the end.
            overwrite: Whether to replace a file, or a folder of the same kind, that is at `dest`. It stays until the
                new one is whole.
            progress: Called now and then with the rows done and the rows in all.
            options: Of the format.

        Returns:
            `dest`; in a store, a PurePosixPath, which cannot be opened here.

        Raises:
            DestinationExistsError: Something is at `dest` that may not be replaced; also a FileExistsError.
            NotFoundError: There is no such topic; also a KeyError.
            FormatError: There is no such format, or the suffix says none; also a ValueError.
            UsageError: The format has no such option; also a TypeError.
            RangeError: The range's start lies after its end; also a ValueError.
        """
        path, put_into = located(dest, store)
        wanted = format if format is not None else registry.format_of(path)
        check_overwrite(overwrite)
        reads = Reads(self.store, [*self._files.paths, *self.segments])
        written = RECORDING if wanted == "mcap" else wanted
        with destination(path, put_into, written, overwrite=overwrite, reads=reads) as target:
            low, high = check_range(start, end)
            about = {**self.run, "params": self.params}
            chosen = Lookup("topic", self._chosen(topics), self._info)
            job = Job(target, self._opened(), chosen, low, high, about, progress, has_all_topics=topics is None)
            export(job, wanted, options)
        return path

    def close(self) -> None:
        """Close the files. May be called twice."""
        self._closed = True
        self._files.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        if self._closed:
            return f"<Recording {str(self.path)!r}, closed>"
        files = self._opened()
        counters = {name: partial(counts.count, self._stored(name)) for name in self._topic_names()}
        return overview.line(str(self.path), len(files), self.duration, counters)

    def _repr_html_(self) -> str:
        """Return the topics as a table, which notebooks show."""
        return escape(repr(self)) if self._closed else overview.table(repr(self), self.topics)
