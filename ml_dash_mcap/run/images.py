"""Turns arrays of pixels into image and video files."""

from __future__ import annotations

import io
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from ..errors import FieldError

if TYPE_CHECKING:
    from PIL.Image import Image

_QUALITY_FORMATS = frozenset({"JPEG", "WEBP"})
_EIGHT_BIT_ONLY = frozenset({"JPEG", "WEBP", "GIF", "BMP"})


def encode(array: Any, name: str, quality: int) -> bytes:
    """Return an image file's bytes.

    Args:
        array: Pixels, [height, width] or [height, width, 1, 3 or 4], or anything that numpy makes that of.
            uint8 is stored as it is; uint16, without colours, as a 16-bit image (depth in mm, say), for which the
            format must have 16 bits, as PNG has; bool as 0 and 255; other integers must lie in 0..255; floats must lie
            in 0..1 and are scaled to 0..255 and rounded.
        name: The file's name; its suffix chooses the format.
        quality: Of JPEG and WebP, 1 to 100.

    Raises:
        FieldError: The shape, the values or the suffix do not make an image.
        ImportError: Pillow is not installed.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError("save_image() needs Pillow: pip install pillow") from error
    suffix = PurePosixPath(name).suffix.lower()
    kind = Image.registered_extensions().get(suffix)
    if kind is None or kind not in Image.SAVE:
        raise FieldError(f"save_image() to {name!r}: no image format has the suffix {suffix!r}; use .png or .jpg")
    pixels = _as_pixels(array, name)
    if pixels.dtype.itemsize > 1 and kind in _EIGHT_BIT_ONLY:
        raise FieldError(f"save_image() to {name!r}: {kind} has no 16-bit pixels; save as .png, or pass uint8")
    image = Image.fromarray(pixels)
    if kind == "JPEG" and image.mode == "RGBA":
        image = _on_white(image)
    file = io.BytesIO()
    image.save(file, format=kind, **({"quality": quality} if kind in _QUALITY_FORMATS else {}))
    return file.getvalue()


def _as_pixels(array: Any, name: str) -> Any:
    """Return the pixels as uint8, or as uint16 where they were that, without an axis of one channel."""
    import numpy as np

    pixels = np.asarray(array)
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[:, :, 0]
    colours = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.ndim not in (2, 3) or colours not in (1, 3, 4) or 0 in pixels.shape:
        raise FieldError(
            f"save_image() to {name!r}: shape {pixels.shape}; an image is [height, width] or [height, width, 3 or 4]"
        )
    if pixels.dtype == np.uint8 or (pixels.dtype == np.uint16 and colours == 1):
        return np.ascontiguousarray(pixels)
    if pixels.dtype.kind == "b":
        return pixels.astype(np.uint8) * 255
    if pixels.dtype.kind not in "iuf":
        raise FieldError(f"save_image() to {name!r}: pixels of type {pixels.dtype}; pass uint8, uint16, bool or floats")
    return _scaled(pixels, name)


def _scaled(pixels: Any, name: str) -> Any:
    """Return floats in 0..1, or integers in 0..255, as uint8."""
    import numpy as np

    low, high = pixels.min(), pixels.max()
    floats = pixels.dtype.kind == "f"
    largest = 1 if floats else 255
    if not (low >= 0 and high <= largest):  # NaN fails it too
        hint = "scale them, or pass array.astype(numpy.uint8)" if floats else "pass uint8, or uint16 without colours"
        raise FieldError(
            f"save_image() to {name!r}: {pixels.dtype} values from {low} to {high}, not in 0..{largest}; {hint}"
        )
    return np.rint(pixels * 255.0).astype(np.uint8) if floats else pixels.astype(np.uint8)


def _on_white(image: Image) -> Image:
    """Return an image without its alpha channel, as it looks on white (JPEG has no alpha)."""
    from PIL import Image

    background = Image.new("RGB", image.size, (255, 255, 255))
    background.paste(image, mask=image.getchannel("A"))
    return background


def write_video(place: Path, frames: Any, name: str, fps: float, options: dict[str, Any]) -> None:
    """Write a video file.

    Args:
        place: Where to; its suffix chooses the format.
        frames: A list of images or an array of them, each as `encode` takes it, 8 bits.
        name: The file's name, for error messages.
        fps: Frames a second.
        options: For imageio's `imwrite`.

    Raises:
        FieldError: There is no frame, or one is no image.
        ImportError: imageio, or its encoder for the format, is not installed.
    """
    try:
        import imageio.v3 as iio
    except ImportError as error:
        raise ImportError("save_video() needs imageio and an encoder: pip install 'imageio[ffmpeg]'") from error
    import numpy as np

    pixels = [_as_pixels(frame, name) for frame in frames]
    if not pixels:
        raise FieldError(f"save_video() to {name!r}: there is no frame")
    if any(frame.dtype.itemsize > 1 for frame in pixels):
        raise FieldError(f"save_video() to {name!r}: a video has no 16-bit pixels; pass uint8")
    # imageio's GIF writer takes ms a frame; its video writers take frames a second.
    timing = {"duration": 1000 / fps} if place.suffix.lower() == ".gif" else {"fps": fps}
    try:
        iio.imwrite(place, np.stack(pixels), **{**timing, **options})
    except (ImportError, OSError) as error:  # imageio says with an OSError that no plugin writes the format
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise ImportError(
            f"save_video() to {name!r}: imageio has no encoder for it; pip install 'imageio[ffmpeg]'"
        ) from error
