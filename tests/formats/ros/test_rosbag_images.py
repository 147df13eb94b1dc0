"""Paths of images become messages with the images, where that is asked for; the rows keep the paths."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap import Experiment
from ml_dash_mcap.conversion import convert
from ml_dash_mcap.errors import ConversionError, ConversionWarning, OptionError
from ml_dash_mcap.formats.ros import bag_images
from ml_dash_mcap.recording import Recording
from tests.support.bags import Found, export, record, with_rosbags

JPEG = b"\xff\xd8\xff" + bytes(100)
PNG = b"\x89PNG\r\n" + bytes(50)
ROWS: list[dict[str, Any]] = [
    {"frame_id": 0, "path": "a.jpg", "_ts": 1.0},
    {"frame_id": 1, "path": "deep/b.png", "_ts": 2.0},
]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A recording with two images beside it."""
    record(tmp_path / "run", {"cam": ROWS})
    put(tmp_path / "run")
    return tmp_path / "run"


def put(folder: Path) -> None:
    (folder / "deep").mkdir(parents=True)
    (folder / "a.jpg").write_bytes(JPEG)
    (folder / "deep/b.png").write_bytes(PNG)


def pictures(bag: Path) -> dict[str, list[tuple[int, str, bytes]]]:
    """Return the compressed images of a bag, by topic: time, format and data."""
    found: dict[str, list[Found]] = {}
    for one in with_rosbags(bag):
        if one.type == "sensor_msgs/msg/CompressedImage":
            found.setdefault(one.topic, []).append(one)
    return {
        topic: [(one.time_ns // 10**9, one.message.format, bytes(one.message.data)) for one in said]
        for topic, said in found.items()
    }


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "rosbag1"])
def test_the_images_are_in_the_bag_and_the_rows_come_back_with_their_paths(
    run: Path, tmp_path: Path, kind: str
) -> None:
    if kind == "rosbag1":
        bag = export(run, tmp_path / "out.bag", "rosbag1", embed_images=True)
    else:
        bag = export(run, tmp_path / "out", storage=kind, embed_images=True)
    assert pictures(bag) == {"/cam/image/compressed": [(1, "jpeg", JPEG), (2, "png", PNG)]}
    with Recording(convert(bag, tmp_path / "back")) as back:
        assert {name: list(back[name].rows()) for name in back.topics} == {"cam": ROWS}


def test_paths_stay_texts_where_nobody_asked(run: Path, tmp_path: Path) -> None:
    (found,) = {one.topic for one in with_rosbags(export(run, tmp_path / "bag"))}
    assert found == "/cam"


def test_images_that_an_experiment_saved_are_found_by_their_names(tmp_path: Path) -> None:
    with Experiment("a/b/c", root=tmp_path / "root").run as exp:
        exp.files("frames").save_image(np.zeros((4, 4, 3), np.uint8), to="frame_0.png")
        exp.tracks("cam").append(path="frames/frame_0.png", _ts=1.0)
    ((_, format_, data),) = pictures(export(Path(exp.path), tmp_path / "bag", embed_images=True))[
        "/cam/image/compressed"
    ]
    assert (format_, data[:4]) == ("png", b"\x89PNG")


def test_paths_begin_at_the_folder_that_is_given(tmp_path: Path) -> None:
    record(tmp_path / "run", {"cam": ROWS})
    put(tmp_path / "elsewhere")
    bag = export(tmp_path / "run", tmp_path / "bag", embed_images=tmp_path / "elsewhere")
    assert len(pictures(bag)["/cam/image/compressed"]) == 2


def test_paths_may_be_absolute_and_fields_are_told_apart_by_their_names(run: Path, tmp_path: Path) -> None:
    row = {"rgb_path": str(run / "a.jpg"), "left": {"depthPath": "deep/b.PNG"}, "note": "a.jpg is nice"}
    (run / "deep/b.PNG").write_bytes(PNG)
    record(tmp_path / "other", {"cam": [row]})
    found = pictures(export(tmp_path / "other", tmp_path / "bag", embed_images=run))
    assert {topic: one[0][1] for topic, one in found.items()} == {
        "/cam/rgb/compressed": "jpeg",
        "/cam/left/depth/compressed": "png",
    }


def test_a_mapping_says_which_field_and_topic(run: Path, tmp_path: Path) -> None:
    said = {"/camera/compressed": {"type": "sensor_msgs/CompressedImage", "data": "path"}, "image/compressed": None}
    bag = export(run, tmp_path / "bag", embed_images=True, mapping={"cam": said})
    assert [topic for topic, found in pictures(bag).items() if len(found) == 2] == ["/camera/compressed"]
    with pytest.raises(ConversionError, match=r"'path' is string, which does not fit.*pass embed_images=True"):
        export(run, tmp_path / "bag2", mapping={"cam": said})


def test_rows_without_a_path_have_no_image(tmp_path: Path) -> None:
    rows = [{"path": "a.jpg"}, {"n": 1}, {"path": None}, {"path": "", "n": 2}, {"path": "a.jpg"}]
    record(tmp_path / "run", {"cam": rows})
    put(tmp_path / "images")
    with pytest.warns(ConversionWarning, match=r"'cam', row 3 .*'path' is '', which is no path"):
        bag = export(tmp_path / "run", tmp_path / "bag", embed_images=tmp_path / "images")
    assert len(pictures(bag)["/cam/image/compressed"]) == 2


def test_many_images_are_not_all_in_memory_at_once(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bag_images, "_PORTION_BYTES", 3 * len(JPEG))
    rows = [{"path": "a.jpg", "_ts": float(number)} for number in range(1, 50)]
    record(tmp_path / "other", {"cam": rows, "more": [{"x": 0.5, "_ts": 20.5}]})
    seen: list[int] = []
    bag = export(
        tmp_path / "other",
        tmp_path / "bag",
        embed_images=run,
        progress=lambda done, _: seen.append(done),
        storage="sqlite3",
    )
    assert [one[0] for one in pictures(bag)["/cam/image/compressed"]] == list(range(1, 50))
    assert max(after - before for before, after in itertools.pairwise(seen)) <= 3
    with Recording(convert(bag, tmp_path / "back")) as back:
        assert list(back["cam"].rows()) == rows


# -- what cannot be embedded ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        (
            "deep/b.png",
            None,
            r"'cam', row 1 \(_ts=2\.0\): field 'path' names 'deep/b\.png', and there is no such file in",
        ),
        ("deep/b.png", b"GIF89a", r"'cam', row 1 .*names 'deep/b\.png', which is neither JPEG nor PNG"),
        ("a.jpg", b"", r"'cam', row 0 .*names 'a\.jpg', which is neither"),
    ],
)
def test_a_file_that_is_no_image_is_named_with_its_row(
    run: Path, tmp_path: Path, name: str, content: bytes | None, match: str
) -> None:
    if content is None:
        (run / name).unlink()
    else:
        (run / name).write_bytes(content)
    with pytest.raises(ConversionError, match=match):
        export(run, tmp_path / "out/bag", embed_images=True)
    assert not (tmp_path / "out").exists()
    with pytest.warns(ConversionWarning, match=match):
        bag = export(run, tmp_path / "bag", embed_images=True, on_bad="lossless")
    assert [len(found) for found in pictures(bag).values()] == [1]
    with Recording(convert(bag, tmp_path / "back")) as back:
        assert list(back["cam"].rows()) == ROWS


def test_a_file_that_is_too_large_for_an_image_is_named(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag_images, "_FILE_BYTES", len(JPEG) - 1)
    with pytest.raises(ConversionError, match=r"row 0 .*a\.jpg', which has more than"):
        export(run, tmp_path / "bag", embed_images=True)


@pytest.mark.parametrize("said", ["nowhere", 1, None])
def test_a_folder_of_images_that_is_not_there_is_named(run: Path, tmp_path: Path, said: Any) -> None:
    with pytest.raises(OptionError, match=f"embed_images={said!r}"):
        export(run, tmp_path / "bag", embed_images=said)


def test_an_export_that_finds_no_paths_says_so(tmp_path: Path) -> None:
    record(tmp_path / "run", {"cam": [{"path": "a.gif"}]})
    with pytest.warns(ConversionWarning, match="embed_images: no field holds paths of .jpg or .png files"):
        export(tmp_path / "run", tmp_path / "bag", embed_images=True)
