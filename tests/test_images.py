"""Images, figures and videos among the files of a run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap.errors import FieldError
from ml_dash_mcap.experiment import Experiment

Image = pytest.importorskip("PIL.Image")


@pytest.fixture
def exp(tmp_path: Path) -> Iterator[Experiment]:
    with Experiment("a/b", root=tmp_path / "root").run as started:
        yield started


def pixels(exp: Experiment, name: str) -> Any:
    with Image.open(exp.path / "files" / name) as image:
        return np.asarray(image)


# Images


@pytest.mark.parametrize("shape", [(4, 6), (4, 6, 1), (4, 6, 3), (4, 6, 4)])
def test_uint8_pixels_come_back_from_png_as_they_were(exp: Experiment, shape: tuple[int, ...]) -> None:
    array = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    exp.files("frames").save_image(array, to="a.png")
    assert (pixels(exp, "frames/a.png") == array.squeeze()).all()


def test_depth_of_16_bits_comes_back_from_png_as_it_was(exp: Experiment) -> None:
    array = np.array([[0, 1, 65535], [300, 5000, 7]], dtype=np.uint16)
    exp.files("depth").save_image(array, to="a.png")
    assert (pixels(exp, "depth/a.png") == array).all()


def test_floats_from_0_to_1_are_scaled_and_rounded(exp: Experiment) -> None:
    exp.files.save_image(np.array([[0.0, 0.5, 1.0, 0.003]]), to="a.png")
    assert pixels(exp, "a.png").tolist() == [[0, 128, 255, 1]]


def test_bools_and_small_integers_are_pixels_too(exp: Experiment) -> None:
    exp.files.save_image(np.array([[True, False]]), to="a.png")
    exp.files.save_image([[0, 255], [7, 8]], to="b.png")
    assert (pixels(exp, "a.png").tolist(), pixels(exp, "b.png").tolist()) == ([[255, 0]], [[0, 255], [7, 8]])


def test_jpeg_quality_changes_the_size_and_alpha_is_put_on_white(exp: Experiment) -> None:
    array = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    good = exp.files.save_image(array, to="good.jpg")
    bad = exp.files.save_image(array, to="bad.JPEG", quality=10)
    assert good["sizeBytes"] > 2 * bad["sizeBytes"]
    assert good["contentType"] == "image/jpeg"
    exp.files.save_image(np.zeros((8, 8, 4), np.uint8), to="clear.jpg")
    assert (pixels(exp, "clear.jpg") == 255).all()


def test_an_array_that_is_not_contiguous_is_an_image(exp: Experiment) -> None:
    array = np.arange(96, dtype=np.uint8).reshape(8, 4, 3)[::-1, ::-1]
    exp.files.save_image(array, to="a.png")
    assert (pixels(exp, "a.png") == array).all()


@pytest.mark.parametrize(
    ("array", "name", "message"),
    [
        (np.zeros(5, np.uint8), "a.png", r"shape \(5,\)"),
        (np.zeros((2, 2, 2), np.uint8), "a.png", r"shape \(2, 2, 2\)"),
        (np.zeros((0, 2), np.uint8), "a.png", r"shape \(0, 2\)"),
        (np.zeros((2, 2), np.uint8), "a.xyz", "suffix '.xyz'"),
        (np.zeros((2, 2), np.uint8), "a", "suffix ''"),
        (np.full((2, 2), 254.3), "a.png", r"from 254.3 to 254.3, not in 0..1"),
        (np.full((2, 2), np.nan), "a.png", "not in 0..1"),
        (np.full((2, 2), -1), "a.png", "not in 0..255"),
        (np.full((2, 2, 3), 300, np.uint16), "a.png", "not in 0..255"),
        (np.zeros((2, 2), np.uint16), "a.jpg", "JPEG has no 16-bit pixels"),
        (np.array([["a"]]), "a.png", "pixels of type"),
    ],
)
def test_what_is_no_image_is_an_error_that_says_why(exp: Experiment, array: Any, name: str, message: str) -> None:
    with pytest.raises(FieldError, match=message):
        exp.files.save_image(array, to=name)
    assert not (exp.path / "files").exists()


def test_without_pillow_the_error_says_what_to_install(exp: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ImportError, match="pip install pillow"):
        exp.files.save_image(np.zeros((2, 2), np.uint8), to="a.png")


# Figures and videos


def test_a_figure_is_saved_and_closed(exp: Experiment) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.plot([1, 2], [3, 4])
    described = exp.files("plots").save_fig(to="plot.png", dpi=20)
    assert described["contentType"] == "image/png"
    assert plt.get_fignums() == []
    figure = plt.figure()
    exp.files("plots").save_fig(figure, to="plot.svg")
    assert b"<svg" in (exp.path / "files" / "plots" / "plot.svg").read_bytes()


def test_a_video_has_every_frame(exp: Experiment) -> None:
    pytest.importorskip("imageio")
    frames = [np.full((16, 16, 3), 25 * number, np.uint8) for number in range(10)]
    exp.files("videos").save_video(frames, to="a.gif", fps=10)
    with Image.open(exp.path / "files" / "videos" / "a.gif") as video:
        assert (video.n_frames, video.info["duration"]) == (10, 100)


def test_a_video_without_its_encoder_says_what_to_install(exp: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio", None)
    monkeypatch.setitem(sys.modules, "imageio.v3", None)
    with pytest.raises(ImportError, match="pip install"):
        exp.files.save_video([np.zeros((16, 16, 3), np.uint8)], to="a.mp4")
    assert exp.files.list() == []


def test_a_video_without_frames_or_of_16_bits_is_an_error(exp: Experiment) -> None:
    pytest.importorskip("imageio")
    with pytest.raises(FieldError, match="there is no frame"):
        exp.files.save_video([], to="a.gif")
    with pytest.raises(FieldError, match="16-bit"):
        exp.files.save_video(np.zeros((2, 4, 4), np.uint16), to="a.gif")
