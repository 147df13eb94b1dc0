"""Session: dreamlake's interface to a recorder and a recording."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from .codecs.given.schema_source import SchemaSource
from .errors import OptionError, StateError
from .file_names import SESSION_ROOT as DEFAULT_ROOT
from .options import RecorderOptions, arguments_of, misplaced
from .run.dreamlake_files import SessionFile, SessionFiles
from .run.dreamlake_tracks import SessionTrack
from .run.lifecycle import Run, choose_options, describe
from .run.live import Live
from .run.parameters import Parameters
from .run.shared_methods import RunMethods
from .run.tracks import Tracks
from .store import safe_paths


class Session(RunMethods):
    """A session that is recorded into `<local_path>/<workspace>/<name>/`: tracks, logs, parameters and files.

    It is a context manager, or is opened and closed by `open` and `close`; opening the same session again adds to
    what is there. Any thread may call any method.

    Attributes:
        name: Its name.
        workspace: What it belongs to.
        path: Its folder.

    Example:
        >>> with Session(name="my-experiment", workspace="project", local_path=".dreamlake") as session:
        ...     session.track("train_loss").append(value=0.5, epoch=1)
        ...     session.track("train_loss").read()["total"]
        1
    """

    def __init__(
        self,
        name: str,
        workspace: str,
        *,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        local_path: str | os.PathLike[str] | None = None,
        remote: None = None,
        buffer_config: Any = None,
        encoding: str | None = None,
        options: RecorderOptions | None = None,
        **unknown: NoReturn,
    ) -> None:
        """Describe a session; nothing is written before it is opened.

        Args:
            name: Its name; `/` in it makes folders.
            workspace: What it belongs to.
            description: Kept with the session, as are `tags` and `metadata`.
            local_path: The folder of all sessions; `.dreamlake` by default.
            remote: Must be None: sessions are recorded to local files.
            buffer_config: See `Experiment`, as for `options`.
            encoding: The encoding of the points of its tracks, "json", "protobuf" or "cbor".

        Raises:
            PrefixError: The name or the workspace is empty, absolute, or leaves the folder.
            OptionError: `remote` is set, or an option has a value that it cannot take.
            UsageError: An argument is unknown, or two contradict each other.
        """
        if unknown:
            raise misplaced("Session", unknown, arguments_of(Session))
        if remote is not None:
            raise OptionError(
                f"remote={remote!r}: sessions are recorded to local files; leave remote= out, and set local_path= to"
                " choose their folder"
            )
        self.name = name
        self.workspace = workspace
        parts = [*safe_paths.components(workspace, "workspace"), *safe_paths.components(name, "name")]
        root = Path(DEFAULT_ROOT if local_path is None else local_path).expanduser().absolute()
        self._prefix = "/".join(parts)
        self.path: Path = safe_paths.run_folder(root, self._prefix)
        self._options = choose_options(options, buffer_config, encoding)
        self._said = describe(description=description, tags=tags, metadata=metadata)
        self._run: Run[Session, SessionTrack] = Run(self, self._begin)

    def __repr__(self) -> str:
        return f"<Session {self._prefix!r}, {'open' if self._run.live else 'closed'}>"

    def open(self) -> Session:
        """Open the session; does nothing while it is open.

        Raises:
            StorageError: Its folder cannot be made, written or locked.
        """
        return self._run.start()

    def close(self) -> None:
        """Write everything and close; does nothing while it is closed."""
        if self._run.live is not None:
            self._run.complete()

    def __enter__(self) -> Session:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._run.__exit__(kind, error, trace)

    def track(
        self,
        name: str,
        description: str | None = None,
        tags: Sequence[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        *,
        units: Mapping[str, str] | None = None,
        joint_names: Sequence[str] | None = None,
        frame_id: str | None = None,
        quat_order: str | None = None,
        encoding: str | None = None,
        schema: SchemaSource = None,
    ) -> SessionTrack:
        """Return the track of that name, the same object each time.

        Args:
            name: Such as "robot/position/left-camera".
            description: Kept with the track, as are `tags` and `metadata`; they may come at any call.
            units: Dotted field name to its unit, such as `{"q": "rad"}`. Exports to ROS and mocap formats go by these
                and by the following; all are kept in the metadata.
            joint_names: Of the elements of joint angles, velocities and torques.
            frame_id: What positions, orientations and vectors are relative to.
            quat_order: "xyzw" or "wxyz", of all quaternions of the topic.
            encoding: The encoding of its points; that of the session by default.
            schema: The schema of its points, as `Recorder.topic` takes it.

        Raises:
            TopicError: The name is empty, too long, or one of the library's own, or the track is open in another
                encoding, with another schema, or has points without one.
            OptionError: Points cannot be recorded in that encoding, or the schema is not known.
            EncodingError: The schema is broken.
            StateError: The session is closed.
        """
        live = self._run.live
        if live is None:
            raise _closed("track")
        return live.tracks(
            name,
            description,
            tags,
            metadata,
            units=units,
            joint_names=joint_names,
            frame_id=frame_id,
            quat_order=quat_order,
            encoding=encoding,
            schema=schema,
        )

    @property
    def tracks(self) -> Tracks[SessionTrack]:
        """All tracks: `session.tracks.flush()`, `session.tracks.list()`."""
        return self._open_live("tracks").tracks

    def parameters(self) -> Parameters:
        """Return the session's parameters: `session.parameters().set(learning_rate=1e-3)`."""
        return self._open_live("parameters").parameters

    def files(self) -> SessionFiles:
        """Return the session's files, to upload to and to list."""
        return SessionFiles(self._open_live("files").files)

    def file(
        self,
        *,
        file_path: str | os.PathLike[str] | None = None,
        prefix: str = "/",
        description: str | None = None,
        tags: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        file_id: str | None = None,
        dest_path: str | os.PathLike[str] | None = None,
    ) -> SessionFile:
        """Return one file, to save, list, download or delete; see `SessionFile` for the arguments."""
        return SessionFile(
            self._open_live("file").files,
            file_path=file_path,
            prefix=prefix,
            description=description,
            tags=tags,
            metadata=metadata,
            file_id=file_id,
            dest_path=dest_path,
        )

    def _begin(self) -> Live[SessionTrack]:
        return Live(
            self.path, self._prefix, SessionTrack, metadata=self._said, timestamps="auto", options=self._options
        )

    def _open_live(self, use: str) -> Live[SessionTrack]:
        live = self._run.live
        if live is None:
            raise _closed(use)
        return live


def _closed(what: str) -> StateError:
    return StateError(
        f"Cannot use {what} on closed session. Use 'with Session(...) as session:' or call session.open() first."
    )
