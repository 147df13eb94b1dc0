"""The files of a run: what is saved, what is recorded about it, and what is refused."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import io
import json
import os
import pickle
import threading
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap import shipped_schemas
from ml_dash_mcap.errors import FieldError, NotFoundError, PrefixError, StateError, StorageError, UsageError
from ml_dash_mcap.experiment import Experiment
from ml_dash_mcap.session import Session
from tests.support import disk, viewer_schema


@pytest.fixture
def exp(tmp_path: Path) -> Iterator[Experiment]:
    with Experiment("a/b", root=tmp_path / "root").run as started:
        yield started


def file_rows(exp: Experiment) -> list[dict[str, Any]]:
    exp.run.complete()
    return disk.rows(exp.path)["ml_dash/files"]


# What is saved and what is recorded


def test_a_saved_file_lies_under_files_and_is_described_in_ml_dash_s_shape(exp: Experiment) -> None:
    described = exp.files("configs").save_text("hello", to="deep/view.yaml")
    assert (exp.path / "files" / "configs" / "deep" / "view.yaml").read_text() == "hello"
    assert described.pop("uploadedAt") == described.pop("updatedAt")
    assert described == {
        "id": "configs/deep/view.yaml",
        "experimentId": "a/b",
        "path": "/configs/deep",
        "filename": "view.yaml",
        "description": None,
        "tags": [],
        "bindrs": [],
        "contentType": described["contentType"],
        "sizeBytes": 5,
        "checksum": hashlib.sha256(b"hello").hexdigest(),
        "metadata": None,
        "deletedAt": None,
    }


def test_every_saved_file_is_a_row_of_its_topic_within_the_viewers_subset(exp: Experiment) -> None:
    exp.tracks("robot").append(q=1.0, _ts=5.0)
    said: dict[str, Any] = {"description": "best", "tags": ["x"], "bindrs": ["y"], "metadata": {"epoch": 3}}
    exp.files("models", **said).save_blob(b"\0\1", to="a.bin")
    exp.files.save_json({"a": 1}, to="b.json")
    first, second = file_rows(exp)
    assert first.pop("saved").endswith("Z")
    assert first.pop("content_type") == "application/octet-stream"
    assert first == {
        "path": "models/a.bin",
        "bytes": 2,
        "sha256": hashlib.sha256(b"\0\1").hexdigest(),
        **said,
        "_ts": 5.0,
    }
    assert (second["path"], second["content_type"]) == ("b.json", "application/json")
    channel, schema = disk.channel(exp.path, "ml_dash/files")
    assert channel.metadata["kind"] == "file"
    assert viewer_schema.violations(json.loads(schema.data)) == []
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(second, shipped_schemas.load("ml_dash.file"))


def test_saving_again_replaces_the_file_and_the_last_row_counts(exp: Experiment) -> None:
    exp.files.save_text("one", to="a.txt")
    exp.files.save_text("three", to="a.txt")
    assert [(file["id"], file["sizeBytes"]) for file in exp.files.list()] == [("a.txt", 5)]
    assert [row["bytes"] for row in file_rows(exp)] == [3, 5]


def test_nobody_sees_half_a_file(exp: Experiment) -> None:
    exp.files.save_text("whole", to="model.pt")
    seen: list[list[str]] = []

    class Model:
        def __reduce__(self) -> Any:
            seen.append([file["id"] for file in exp.files.list()])
            raise OSError(28, "No space left on device")

    def write(place: Path) -> None:
        place.write_bytes(b"half")
        pickle.dumps(Model())

    with pytest.raises(StorageError, match="cannot save model"):
        exp.files._save("model.pt", write)
    assert seen == [["model.pt"]]
    assert exp.files("model.pt").read_text() == "whole"
    assert os.listdir(exp.path / "files") == ["model.pt"]


def test_threads_that_save_the_same_name_leave_one_whole_file_with_its_row_last(exp: Experiment) -> None:
    def save(letter: str) -> None:
        for _ in range(20):
            exp.files.save_text(letter * 5000, to="a.txt")

    threads = [threading.Thread(target=save, args=(letter,)) for letter in "abcd"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    content = (exp.path / "files" / "a.txt").read_bytes()
    assert len(content) == 5000
    assert len(set(content)) == 1
    assert exp.files.list()[0]["checksum"] == hashlib.sha256(content).hexdigest()
    assert len(file_rows(exp)) == 80


def test_details_that_cannot_be_stored_are_refused_before_anything_is_written(exp: Experiment) -> None:
    with pytest.raises(TypeError, match="metadata"):
        exp.files("x", metadata={"a": object()}).save_text("hello", to="a.txt")
    assert not (exp.path / "files").exists()


def test_saving_after_the_end_is_an_error(exp: Experiment) -> None:
    files = exp.files("x")
    exp.run.complete()
    with pytest.raises(StateError, match="closed"):
        files.save_text("hello", to="a.txt")
    assert not (exp.path / "files").exists()


def test_a_file_where_a_folder_is_is_a_storage_error(exp: Experiment) -> None:
    exp.files("models").save_text("hello", to="a.txt")
    with pytest.raises(OSError, match="cannot save models"):
        exp.files.save_text("hello", to="models")
    with pytest.raises(OSError, match="cannot save"):
        exp.files("models/a.txt").save_text("hello", to="b.txt")


# Names


@pytest.mark.parametrize(
    "name",
    ["", "..", "../evil.txt", "a/../../evil", "/etc/passwd", "C:\\x", "C:x", "a\\b", "a\0b", "a//b", "a/", "x" * 256],
)
def test_a_name_that_would_leave_the_folder_is_refused(exp: Experiment, name: str) -> None:
    with pytest.raises(PrefixError, match="file name="):
        exp.files("frames").save_text("evil", to=name)
    assert not (exp.path / "files").exists()


@pytest.mark.parametrize("folder", ["..", "../..", "a/../../b", "/../x", "C:/x", "a\0"])
def test_a_folder_that_would_leave_the_run_s_is_refused(exp: Experiment, folder: str) -> None:
    with pytest.raises(PrefixError, match="folder="):
        exp.files(folder)
    with pytest.raises(PrefixError, match="folder="):
        exp.files.download(folder)


def test_a_name_may_have_255_bytes(exp: Experiment) -> None:
    name = "x" * 251 + ".txt"
    assert exp.files.save_text("long", to=name)["filename"] == name


@pytest.mark.parametrize(
    ("folder", "path"), [("/models", "/models"), ("models/", "/models"), ("/", "/"), (None, "/"), ("", "/")]
)
def test_a_leading_slash_of_a_folder_is_the_root_of_the_run_s_files(
    exp: Experiment, folder: str | None, path: str
) -> None:
    assert exp.files(folder).save_text("x", to="a.txt")["path"] == path
    assert exp.files(dir=folder)("b").save_text("x", to="a.txt")["path"] == f"{path.rstrip('/')}/b"


def test_names_that_are_no_text_are_type_errors(exp: Experiment) -> None:
    with pytest.raises(UsageError, match="file name="):
        exp.files.save_text("x", to=5)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="folder="):
        exp.files(5)  # type: ignore[arg-type]


# Other kinds


def test_json_takes_what_rows_take_and_refuses_what_json_has_not(exp: Experiment) -> None:
    @dataclasses.dataclass
    class Config:
        lr: float
        shape: tuple[int, ...]

    content = {
        "config": Config(0.1, (1, 2)),
        "a": np.arange(3),
        "b": np.float32(0.5),
        "when": datetime.date(2026, 1, 2),
    }
    exp.files.save_json(content, to="a.json")
    expected = {"config": {"lr": 0.1, "shape": [1, 2]}, "a": [0, 1, 2], "b": 0.5, "when": "2026-01-02"}
    assert json.loads(exp.files("a.json").read_text()) == expected
    for bad in (float("nan"), object(), {1, 2}):
        with pytest.raises(FieldError, match=r"save_json\(\) to 'b.json'"):
            exp.files.save_json({"x": bad}, to="b.json")
    assert not exp.files("b.json").exists()


def test_pickles_and_text_keep_their_content(exp: Experiment) -> None:
    exp.files.save_pkl({"a": [1, float("inf")]}, to="a.pkl")
    exp.files.save_text("grüß\r\n", to="a.txt")
    assert pickle.loads((exp.path / "files" / "a.pkl").read_bytes()) == {"a": [1, float("inf")]}
    assert (exp.path / "files" / "a.txt").read_bytes() == "grüß\r\n".encode()


# Finding


def test_upload_copies_a_file_under_its_own_or_another_name(exp: Experiment, tmp_path: Path) -> None:
    source = tmp_path / "model.pt"
    source.write_bytes(b"weights")
    assert exp.files("models").upload(source)["id"] == "models/model.pt"
    described = exp.files("models").upload(str(source), to="best.pt", description="best", tags="x", metadata={"a": 1})
    assert (described["id"], described["description"]) == ("models/best.pt", "best")
    assert (described["tags"], described["metadata"]) == (["x"], {"a": 1})
    assert source.read_bytes() == (exp.path / "files" / "models" / "best.pt").read_bytes() == b"weights"
    with pytest.raises(OSError, match="there is no such file"):
        exp.files.upload(tmp_path / "nope")


def test_list_takes_patterns_of_names_and_of_paths(exp: Experiment) -> None:
    for name in ("a.png", "b.jpg", "deep/c.png"):
        exp.files("images").save_text(name, to=name)
    exp.files.save_text("x", to="x.png")

    def ids(found: list[dict[str, Any]]) -> list[str]:
        return [file["id"] for file in found]

    assert ids(exp.files.list()) == ["images/a.png", "images/b.jpg", "images/deep/c.png", "x.png"]
    assert ids(exp.files("images").list("*.png")) == ["images/a.png", "images/deep/c.png"]
    assert ids(exp.files("images").list("deep/*")) == ["images/deep/c.png"]
    assert ids(exp.files.list("images/*.jpg")) == ["images/b.jpg"]
    assert ids(exp.files("nothing").list()) == []


def test_files_of_earlier_runs_and_files_put_there_by_hand_are_listed_too(exp: Experiment) -> None:
    exp.files("a", tags=["old"]).save_text("one", to="one.txt")
    with exp.run:
        pass
    (exp.path / "files" / "by_hand.txt").write_text("two")
    exp.run.start()
    old, by_hand = exp.files.list()
    assert exp.files("a/one.txt").list() == [old]
    assert (old["id"], old["tags"]) == ("a/one.txt", ["old"])
    assert (by_hand["id"], by_hand["sizeBytes"]) == ("by_hand.txt", 3)
    assert by_hand["checksum"] == hashlib.sha256(b"two").hexdigest()


def test_a_file_exists_and_a_folder_does_not(exp: Experiment) -> None:
    exp.files("configs").save_text("x", to="a.yaml")
    assert exp.files("configs/a.yaml").exists()
    assert not exp.files("configs").exists()
    assert not exp.files("configs/b.yaml").exists()
    with pytest.raises(KeyError, match=r"no file 'configs/b.yaml'"):
        exp.files("configs/b.yaml").read_text()


def test_download_copies_one_file_or_all_of_a_pattern(
    exp: Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a.png", "b.png", "c.txt"):
        exp.files("images").save_text(name, to=name)
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path / "out")
    assert exp.files("images/a.png").download() == "a.png"
    assert exp.files.download("images/b.png", to="copy.png") == "copy.png"
    assert exp.files("images").download("*.png", to="pngs") == ["pngs/a.png", "pngs/b.png"]
    assert exp.files("images").download("c.txt", to=tmp_path / "out") == str(tmp_path / "out" / "c.txt")
    assert Path("pngs/b.png").read_text() == Path("copy.png").read_text() == "b.png"
    for missing in ("nope.txt", "*.nope"):
        with pytest.raises(NotFoundError):
            exp.files("images").download(missing)
    assert sorted(os.listdir()) == ["a.png", "c.txt", "copy.png", "pngs"]


def test_a_file_that_is_not_what_was_saved_is_not_downloaded(exp: Experiment, tmp_path: Path) -> None:
    exp.files.save_text("hello", to="a.txt")
    (exp.path / "files" / "a.txt").write_text("hollo")
    with pytest.raises(StorageError, match="damaged"):
        exp.files("a.txt").download(to=tmp_path / "copy.txt")
    assert not (tmp_path / "copy.txt").exists()


def test_delete_removes_files_and_records_that_they_were_there(exp: Experiment) -> None:
    for name in ("a.png", "b.png", "c.txt"):
        exp.files("images").save_text(name, to=name)
    deleted = exp.files("images/c.txt").delete()
    assert isinstance(deleted, dict)
    assert deleted["id"] == "images/c.txt"
    assert deleted["deletedAt"].endswith("Z")
    several = exp.files("images").delete("*.png")
    assert isinstance(several, list)
    assert [one["id"] for one in several] == ["images/a.png", "images/b.png"]
    assert exp.files.list() == []
    with pytest.raises(NotFoundError):
        exp.files("images/c.txt").delete()
    assert [(row["path"], row.get("deleted", False)) for row in file_rows(exp)[3:]] == [
        ("images/c.txt", True),
        ("images/a.png", True),
        ("images/b.png", True),
    ]


# dreamlake's words


def test_a_session_uploads_lists_downloads_and_deletes(tmp_path: Path) -> None:
    source = tmp_path / "model.pt"
    source.write_bytes(b"weights")
    with Session("n", "w", local_path=tmp_path / "root") as session:
        first = session.files().upload(str(source), path="/models", tags=["best"])
        second = session.file(file_path=str(source), prefix="/others", description="x", metadata={"a": 1}).save()
        assert (first["path"], second["path"], second["metadata"]) == ("/models", "/others", {"a": 1})
        assert len(session.files().list()) == 2
        assert [file["id"] for file in session.files().list(path="/models")] == ["models/model.pt"]
        assert [file["id"] for file in session.files().list(tags=["best", "y"])] == ["models/model.pt"]
        assert [file["id"] for file in session.file(prefix="/others").list()] == ["others/model.pt"]
        copy = session.file(file_id=first["id"], dest_path=str(tmp_path / "copy.pt")).download()
        assert isinstance(copy, str)
        assert Path(copy).read_bytes() == b"weights"
        deleted = session.file(file_id=first["id"]).delete()
        assert isinstance(deleted, dict)
        assert deleted["id"] == first["id"]
        assert [file["id"] for file in session.file().list()] == ["others/model.pt"]
        for call in (session.file().save, session.file().download, session.file().delete):
            with pytest.raises(UsageError, match=r"session\.file\("):
                call()


def test_the_path_of_a_row_has_slashes_on_every_system(exp: Experiment) -> None:
    exp.files("a").save_blob(io.BytesIO(b"x").getvalue(), to="b/c.bin")
    assert PurePosixPath(file_rows(exp)[0]["path"]).parts == ("a", "b", "c.bin")
