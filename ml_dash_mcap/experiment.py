"""Experiment: ml-dash's interface to a recorder and a recording."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from .errors import StateError, UsageError
from .file_names import EXPERIMENT_ROOT as DEFAULT_ROOT
from .options import RecorderOptions, arguments_of, misplaced
from .run.files import Files
from .run.lifecycle import Run, choose_options, describe
from .run.live import Live, Timestamps
from .run.logs import Logs
from .run.metrics import Metrics
from .run.parameters import Parameters
from .run.shared_methods import RunMethods
from .run.tracks import Track, Tracks
from .store import safe_paths


class Experiment(RunMethods):
    """A run that is recorded into `<root>/<prefix>/`: tracks, metrics, logs, parameters and files.

    Starting the same prefix again adds to what is there. Any thread may call any method.

    Attributes:
        run: Starts and ends it; `with experiment.run as exp:` does both.
        prefix: Its name, owner/project/.../name.
        path: Its folder.

    Example:
        >>> with Experiment("alice/franka/demo", root="recordings").run as exp:
        ...     exp.params.set(control_freq=100)
        ...     for step in range(1000):
        ...         exp.tracks("robot").append(q=[0.1, 0.2], gripper=0.04, _ts=step / 100)
        ...     exp.tracks("robot").read(start_timestamp=1.0, end_timestamp=2.0)["count"]
        101
    """

    def __init__(
        self,
        prefix: str,
        *,
        root: str | os.PathLike[str] = DEFAULT_ROOT,
        dash_root: str | os.PathLike[str] | None = None,
        local_path: str | os.PathLike[str] | None = None,
        readme: str | None = None,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        bindrs: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        timestamps: Timestamps = "strict",
        buffer_config: Any = None,
        encoding: str | None = None,
        options: RecorderOptions | None = None,
        **unknown: NoReturn,
    ) -> None:
        """Describe an experiment; nothing is written before it is started.

        Args:
            prefix: Names joined by `/`: owner/project/.../name.
            root: The folder of all experiments; `dash_root` and `local_path` are other names of it.
            readme: Kept with the run, as are `description`, `tags`, `bindrs` and `metadata`.
            timestamps: "strict": every `append` to a track needs its `_ts`, in seconds. "auto": a missing one is the
                wall clock, and -1 is the last one used on any track.
            buffer_config: ml-dash's, a mapping or an object with any of `flush_interval` (s), `track_batch_size`
                (rows) and `buffer_enabled`.
            encoding: The encoding of the rows of its tracks, "json", "protobuf" or "cbor".
            options: Everything that can be said about buffering, compression and files, instead.

        Raises:
            PrefixError: The prefix is empty, absolute, or leaves the root.
            OptionError: An option has a value that it cannot take.
            UsageError: An argument is unknown, or two contradict each other.
        """
        if unknown:
            raise _unknown_argument(unknown)
        self.prefix = prefix
        self.path: Path = safe_paths.run_folder(_one_root(root, dash_root, local_path), prefix)
        self._timestamps: Timestamps = timestamps
        self._options = choose_options(options, buffer_config, encoding)
        self._said = describe(readme=readme, description=description, tags=tags, bindrs=bindrs, metadata=metadata)
        self.run: Run[Experiment, Track] = Run(self, self._begin)

    def __enter__(self) -> NoReturn:
        """Refuse: an experiment is started by its run.

        Raises:
            UsageError: Always; the message says what to write.
        """
        raise UsageError(f"an experiment is started by its run: write 'with Experiment({self.prefix!r}).run as exp:'")

    def __exit__(self, *exception: object) -> None:
        """Never called, as `__enter__` refuses."""

    def __repr__(self) -> str:
        return f"<Experiment {self.prefix!r}, {self.run.status or 'not started'}>"

    @property
    def owner(self) -> str:
        """First part of the prefix."""
        return self.prefix.split("/")[0]

    @property
    def project(self) -> str:
        """Second part of the prefix, or the first one if there is no other."""
        return self.prefix.split("/")[:2][-1]

    @property
    def name(self) -> str:
        """Last part of the prefix."""
        return self.prefix.split("/")[-1]

    @property
    def tracks(self) -> Tracks[Track]:
        """Timestamped rows: `exp.tracks("robot").append(q=[0.1, 0.2], _ts=0.0)`."""
        live = self.run.live
        if live is None:
            raise self._not_started()
        return live.tracks

    @property
    def metrics(self) -> Metrics:
        """Numbered points: `exp.metrics("train").log(loss=0.5)`."""
        return self._open_live("metrics").metrics

    @property
    def params(self) -> Parameters:
        """The run's parameters: `exp.params.set(lr=1e-3)`."""
        return self._open_live("params").parameters

    @property
    def logs(self) -> Logs:
        """Messages: `exp.logs.info("Training started", epoch=1)`."""
        return self._open_live("logs").logs

    @property
    def files(self) -> Files:
        """Files: `exp.files("frames").save_image(frame, to="frame_00001.jpg")`."""
        return self._open_live("files").files

    def flush(self) -> None:
        """Write everything taken so far to the file before returning."""
        self._open_live("flush").tracks.flush()

    def _begin(self) -> Live[Track]:
        return Live(
            self.path, self.prefix, Track, metadata=self._said, timestamps=self._timestamps, options=self._options
        )

    def _open_live(self, use: str) -> Live[Track]:
        live = self.run.live
        if live is None:
            raise self._not_started()
        return live

    def _not_started(self) -> StateError:
        if self.run.status is None:
            return StateError(
                "Experiment not started. Use 'with experiment.run:' or call experiment.run.start() first."
            )
        return StateError(
            f"Experiment {self.prefix!r} has ended ({self.run.status}). Recording({str(self.path)!r}) reads it;"
            " experiment.run.start() adds to it."
        )


def _one_root(
    root: str | os.PathLike[str], dash_root: str | os.PathLike[str] | None, local_path: str | os.PathLike[str] | None
) -> Path:
    given = [folder for folder in (dash_root, local_path) if folder is not None]
    if root != DEFAULT_ROOT:
        given.append(root)
    if len({os.fspath(folder) for folder in given}) > 1:
        raise UsageError(
            f"root={root!r}, dash_root={dash_root!r} and local_path={local_path!r} are names of one folder; pass one"
        )
    return Path(given[0] if given else root).expanduser().absolute()


def _unknown_argument(unknown: Mapping[str, object]) -> UsageError:
    for name in unknown:
        if name in ("dash_url", "remote"):
            return UsageError(f"Experiment() takes no {name}=: experiments are recorded to local files, in root=")
    return misplaced("Experiment", unknown, arguments_of(Experiment))
