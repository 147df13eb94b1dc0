"""The files of a run as users see them: saved from objects, listed, copied out, deleted."""

from __future__ import annotations

import datetime
import enum
import fnmatch
import json
import os
import pickle
import shutil
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import FieldError, NotFoundError, StorageError
from ..rows import json_text
from ..store import safe_paths
from . import images
from .file_store import Details, FileStore

Description = dict[str, Any]
"""The description of one file, in ml-dash's shape: id, path (its folder), filename, description, tags, bindrs,
contentType, sizeBytes, checksum (SHA-256), metadata, uploadedAt, updatedAt (ISO 8601, UTC) and deletedAt."""

Descriptions = list[Description]
Paths = list[str]


class Files:
    """One folder among the files of a run, or one file; a call gives another.

    Names are relative, with `/` between their parts on every system; one that would leave the folder is a
    `PrefixError`. What a `save_...` method returns is a `Description`.

    Example:
        >>> exp.files("frames").save_image(frame, to="frame_00001.jpg")
        >>> exp.files.save_json({"lr": 1e-3}, to="configs/first.json")
        >>> exp.files("frames").list("*.jpg")
        >>> exp.files("configs/first.json").read_text()
    """

    __slots__ = ("_details", "_path", "_store")

    def __init__(self, store: FileStore, path: PurePosixPath, details: Details) -> None:
        self._store = store
        self._path = path
        self._details = details

    def __repr__(self) -> str:
        return f"<Files {str(self._path)!r} in {str(self._store.folder)!r}>"

    def __call__(
        self,
        dir: str | None = None,
        *,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        bindrs: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> Files:
        """Return a folder inside this one, or a file in it.

        Args:
            dir: Its name; a leading slash stands for the root of the run's files. None is this folder itself.
            description: Kept with every file saved through what is returned, as are the others.
        """
        return Files(self._store, self._inside(dir), details(description, tags, bindrs, metadata))

    # Saving

    def upload(
        self,
        fpath: str | os.PathLike[str],
        *,
        to: str | None = None,
        description: str | None = None,
        tags: Iterable[str] | None = None,
        bindrs: Iterable[str] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> Description:
        """Copy a file from the disk into this folder.

        Args:
            fpath: The file.
            to: Its name here; its own name by default.

        Raises:
            StorageError: It is no file or cannot be read.
        """
        source = Path(fpath)
        if not source.is_file():
            raise StorageError(f"upload({str(fpath)!r}): there is no such file")
        stated = details(description, tags, bindrs, metadata)
        return self._save(to or source.name, lambda place: _copy(source, place), stated)

    def save_text(self, content: str, *, to: str) -> Description:
        """Save text as UTF-8."""
        return self.save_blob(content.encode(), to=to)

    def save_blob(self, data: bytes | bytearray | memoryview, *, to: str) -> Description:
        """Save bytes."""
        return self._save(to, lambda place: _write(place, data))

    def save_json(self, content: Any, *, to: str) -> Description:
        """Save a value as JSON, indented; numpy values, dataclasses, tuples and the like are taken.

        Raises:
            FieldError: It has no JSON (NaN and infinities have none: `save_pkl` keeps them).
        """
        try:
            text = json.dumps(content, indent=2, allow_nan=False, default=_plain)
        except (TypeError, ValueError) as error:
            raise FieldError(f"save_json() to {to!r}: {error}; save_pkl() keeps any Python value") from error
        return self.save_text(text, to=to)

    def save_pkl(self, content: Any, *, to: str) -> Description:
        """Save a Python value with pickle. Load such files only if you trust whoever wrote them."""
        return self.save_blob(pickle.dumps(content), to=to)

    def save_torch(self, model: Any, *, to: str) -> Description:
        """Save a model or a state dict with `torch.save`."""
        import torch  # type: ignore[import-not-found, unused-ignore]  # not a dependency; may or may not be there

        return self._save(to, lambda place: torch.save(model, place))

    def save_image(self, array: Any, *, to: str, quality: int = 95) -> Description:
        """Save pixels as an image; the suffix of `to` chooses the format.

        Args:
            array: [height, width] or [height, width, 3 or 4]: uint8; bool; uint16 without colours (stored as 16 bits,
                in PNG); floats in 0..1, which are scaled to 0..255 and rounded. Floats outside 0..1 are an error, not
                stretched to fit. JPEG has no alpha: the image is put on white.
            to: Such as "frame_00001.jpg".
            quality: Of JPEG and WebP, 1 to 100.

        Raises:
            FieldError: The shape, the values or the suffix do not make an image.
            ImportError: Pillow is not installed.
        """
        return self.save_blob(images.encode(array, to, quality), to=to)

    def save_fig(self, fig: Any = None, *, to: str, **options: Any) -> Description:
        """Save a matplotlib figure, pyplot's current one by default, and close it.

        Args:
            fig: The figure.
            to: Its suffix chooses the format.
            **options: For the figure's `savefig`.
        """
        from matplotlib import pyplot as plt

        figure = plt.gcf() if fig is None else fig
        described = self._save(to, lambda place: figure.savefig(place, **options))
        # pyplot keeps every figure in memory until it is closed.
        plt.close(figure)
        return described

    def save_video(self, frame_stack: Any, *, to: str, fps: float = 20, **options: Any) -> Description:
        """Save frames as a video; the suffix of `to` chooses the format.

        Args:
            frame_stack: A list of frames or an array, [frames, height, width] or [frames, height, width, 3], with
                the pixels that `save_image` takes, 8 bits each.
            to: Such as "camera.mp4".
            fps: Frames a second.
            **options: For imageio's `imwrite`.

        Raises:
            FieldError: There is no frame, or one is no image.
            ImportError: imageio, or its encoder for the format, is not installed.
        """
        return self._save(to, lambda place: images.write_video(place, frame_stack, to, fps, options))

    # Finding

    def list(self, pattern: str | None = None) -> Descriptions:
        """Return a description of every file in this folder and below it, sorted by path.

        Args:
            pattern: Keep files whose name, or whose path inside this folder or the run's files, matches it ("*.png").
        """
        descriptions = self._store.list(self._path)
        return descriptions if pattern is None else [file for file in descriptions if self._matches(file, pattern)]

    def exists(self) -> bool:
        """Whether this is a file (and not a folder, or nothing)."""
        return self._store.folder.joinpath(self._path).is_file()

    def read_text(self, encoding: str = "utf-8") -> str:
        """Return the text of this file.

        Raises:
            NotFoundError: It is no file.
        """
        return self._store.find(self._path).read_text(encoding=encoding)

    def download(self, pattern: str | None = None, *, to: str | os.PathLike[str] | None = None) -> str | Paths:
        """Copy this file, or files of this folder, out of the run, checking that they are what was saved.

        Args:
            pattern: A file of this folder, or a pattern such as "*.png" for several.
            to: The copy's path; for a pattern the folder, which is made. The working folder by default.

        Returns:
            The path of the copy; for a pattern a list of them.

        Raises:
            NotFoundError: There is no such file.
            StorageError: A copy cannot be written, or a file is not what was saved.
        """
        descriptions = self._select(pattern)
        if _is_pattern(pattern):
            folder = Path(to or ".")
            folder.mkdir(parents=True, exist_ok=True)
            return [self._copy(file, folder) for file in descriptions]
        return self._copy(descriptions[0], Path(to or descriptions[0]["filename"]))

    def delete(self, pattern: str | None = None) -> Description | Descriptions:
        """Delete this file, or files of this folder; the recording says that they were there.

        Args:
            pattern: A file of this folder, or a pattern such as "*.png" for several.

        Returns:
            The file's `id` and `deletedAt`; for a pattern a list of them.

        Raises:
            NotFoundError: There is no such file.
        """
        deleted = [self._store.delete(PurePosixPath(file["id"])) for file in self._select(pattern)]
        return deleted if _is_pattern(pattern) else deleted[0]

    def _save(self, to: str, write: Callable[[Path], None], stated: Details | None = None) -> Description:
        path = self._path.joinpath(*safe_paths.components(to, "file name"))
        return self._store.save(path, write, stated if stated and stated.fields() else self._details)

    def _inside(self, folder: str | None) -> PurePosixPath:
        if folder is None or folder == "":
            return self._path
        if isinstance(folder, str) and folder.startswith("/"):
            inside = folder.strip("/")
            return PurePosixPath(*safe_paths.components(inside, "folder")) if inside else PurePosixPath()
        name = folder.removesuffix("/") if isinstance(folder, str) else folder
        return self._path.joinpath(*safe_paths.components(name, "folder"))

    def _select(self, pattern: str | None) -> Descriptions:
        """Return the files that a pattern or a name means, or this file; at least one."""
        if pattern is not None and _is_pattern(pattern):
            descriptions = self.list(pattern)
            where = f"no file matches {pattern!r} in {str(self._path)!r}"
        else:
            path = self._path if pattern is None else self._inside(pattern)
            descriptions = self._store.list(path) if self._store.folder.joinpath(path).is_file() else []
            where = f"no file {str(path)!r} among the run's files"
        if not descriptions:
            raise NotFoundError(f"{where}; list() gives those there are")
        return descriptions

    def _matches(self, file: Description, pattern: str) -> bool:
        path = PurePosixPath(file["id"])
        inside = path.relative_to(self._path) if path != self._path else PurePosixPath(path.name)
        wanted = pattern.lstrip("/")
        return any(fnmatch.fnmatchcase(str(name), wanted) for name in (path.name, inside, path))

    def _copy(self, file: Description, to: Path) -> str:
        return self._store.copy(PurePosixPath(file["id"]), to, file["checksum"])


def details(
    description: str | None,
    tags: Iterable[str] | None,
    bindrs: Iterable[str] | None,
    metadata: Mapping[str, Any] | None,
) -> Details:
    """Return what a caller says about a file; one tag may come without a list."""
    listed = [(value,) if isinstance(value, str) else tuple(value or ()) for value in (tags, bindrs)]
    given = dict(metadata) if metadata is not None else None
    return Details(description=description, tags=listed[0], bindrs=listed[1], metadata=given)


def _plain(value: Any) -> Any:
    """Turn a value that `json` does not know into one that it does."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, (datetime.date, datetime.time)):
        return value.isoformat()
    return str(value) if isinstance(value, uuid.UUID) else json_text.plain_list(value)


def _is_pattern(name: str | None) -> bool:
    return name is not None and any(character in name for character in "*?[")


def _write(place: Path, data: bytes | bytearray | memoryview) -> None:
    place.write_bytes(data)


def _copy(source: Path, place: Path) -> None:
    shutil.copyfile(source, place)
