"""The content of a session file: written when a recorder opens a folder, read by a recovery after a crash."""

from __future__ import annotations

import glob
import json
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..file_names import JOURNAL_FILE, SESSION_FILE
from ..store.session_lock import SessionLock


@dataclass(frozen=True, slots=True)
class SessionRecord:
    """One session, and where the buffers of its journal are."""

    session: str
    journals: str = ""
    """The pattern of the paths of its buffers."""
    about: Mapping[str, str] = field(default_factory=dict)
    """The constant part of the `ml_dash` metadata record."""
    host: str | None = None
    """The machine of its recorder."""
    path: str | None = None
    """The path of its session file."""
    inode: int | None = None
    """The inode of its session file. A copy of the file has another inode."""

    @classmethod
    def of(cls, session: str, journals: str, about: Mapping[str, str], lock: SessionLock) -> SessionRecord:
        """Return the record of a session of this process that holds its lock."""
        return cls(session, journals, about, socket.gethostname(), str(lock.path.absolute()), lock.inode)

    @classmethod
    def read(cls, session_file: Path) -> SessionRecord:
        """Read a session file. It may be empty, or come from another machine or program."""
        try:
            entries = json.loads(session_file.read_bytes())
        except ValueError:  # the process died while it wrote this, before it recorded anything
            entries = {}
        if not isinstance(entries, dict):
            entries = {}
        prefix, _, suffix = SESSION_FILE.partition("{session}")
        session = str(entries.get("session") or session_file.name.removeprefix(prefix).removesuffix(suffix))
        about = {str(key): str(value) for key, value in dict(entries.get("about") or {}).items()}
        path: Any = entries.get("path")
        return cls(
            session,
            str(entries.get("journals") or ""),
            about,
            entries.get("host"),
            path if isinstance(path, str) else None,
            entries.get("inode"),
        )

    def to_bytes(self) -> bytes:
        """Return the content of the session file."""
        entries = {
            "session": self.session,
            "pid": os.getpid(),
            "host": self.host,
            "journals": self.journals,
            "about": dict(self.about),
            "path": self.path,
            "inode": self.inode,
        }
        return json.dumps(entries).encode()

    def buffer_paths(self) -> list[Path]:
        """Return the session's buffers. A session file from outside could name buffers of other, living recorders."""
        # The buffers are deleted after a recovery, so a file from outside must not name any but this session's.
        folder, _, name = self.journals.rpartition("/")
        if not self.session.isalnum() or name != JOURNAL_FILE.format(session=self.session, number="*"):
            return []
        return [Path(path) for path in glob.glob(f"{glob.escape(folder)}/{name}") if os.path.isfile(path)]

    def original(self, lock: SessionLock) -> Path | None:
        """Return the session file of which this one is a copy, made with its folder, if the original is still there.

        Args:
            lock: Of the file that this was read from.
        """
        if self.path is None or self.inode in (None, lock.inode):
            return None
        original = Path(self.path)
        return original if original != lock.path.absolute() and original.exists() else None


def buffer_path(folder: Path, session: str, number: object) -> Path:
    """Return the path of a buffer of a session; `*` as its number gives the pattern of all."""
    return folder.absolute() / JOURNAL_FILE.format(session=session, number=number)
