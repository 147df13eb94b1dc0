"""Turns fields of many rows into the columns of camera messages: images, and the parameters of the lens."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ....codecs.ros.message_columns import Column, Constant, Ragged, texts
from ....errors import ConversionWarning
from ....meaning import units
from . import stated_texts
from .context import BadRows, Context
from .lossless import MessageField, names_image

Array = npt.NDArray[Any]

_DEPTHS: Mapping[str, tuple[str, np.dtype[Any]]] = {
    "float64": ("32FC1", np.dtype("<f4")),
    "int64": ("16UC1", np.dtype("<u2")),
}
_UINT32 = 2**32 - 1
_COLORS = {1: "mono8", 3: "rgb8", 4: "rgba8"}
_BAYER = ("bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8")
_SAME_PIXELS: Mapping[int | str, tuple[str, ...]] = {
    1: ("mono8", "8UC1", *_BAYER),
    3: ("rgb8", "bgr8", "8UC3"),
    4: ("rgba8", "bgra8", "8UC4"),
    "float64": ("32FC1",),
    "int64": ("16UC1", "mono16"),
    "uint64": ("16UC1", "mono16"),
}
"""Channels of a byte, or what a depth is in, to the encodings that these bytes can be (sensor_msgs/image_encodings)."""


def camera_info(context: Context, values: dict[str, Array]) -> dict[str, Column] | BadRows:
    """Return the columns of sensor_msgs/CameraInfo."""
    count = len(context.rows)
    for role in ("width", "height"):
        if role not in values:
            continue
        odd = _outside(values[role], _UINT32)
        if odd.any():
            size = values[role][int(np.argmax(odd))].item()
            return BadRows(odd, f"field {context.derived.key(role)!r} is {size!r}, which is no number of pixels")
    k = values["k"].reshape(count, 9).astype(np.float64)
    p = np.zeros((count, 3, 4))
    p[:, :, :3] = k.reshape(count, 3, 3)
    distortion = values["d"].astype(np.float64) if "d" in values else Constant([])
    # ROS's model with 5 parameters (sensor_msgs/distortion_models); fewer or more are not guessed at.
    model = "plumb_bob" if "d" in values and values["d"].shape[1] == 5 else ""
    models = context.details.get("distortion_model")
    r = _matrices(context, "r", np.tile(np.eye(3).reshape(9), (count, 1)))
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {
        "header": context.header,
        "height": values["height"].astype(np.uint32) if "height" in values else Constant(0),
        "width": values["width"].astype(np.uint32) if "width" in values else Constant(0),
        "distortion_model": Constant(model) if models is None else stated_texts.texts_or(models, model),
        # ROS 2 calls these fields d, k, r and p, and ROS 1 D, K, R and P; a definition takes the names that it has.
        **dict.fromkeys(("d", "D"), distortion),
        **dict.fromkeys(("k", "K"), k),
        **dict.fromkeys(("r", "R"), r),
        **dict.fromkeys(("p", "P"), _matrices(context, "p", p.reshape(count, 12))),
        "binning_x": Constant(0),
        "binning_y": Constant(0),
        "roi": Constant(region),
    }


def _matrices(context: Context, role: str, otherwise: Array) -> Array:
    """Return the matrices that rows state, and others for those that do not, [N, size]."""
    stated = context.details.get(role)
    if stated is None:
        return otherwise
    matrices = np.asarray(stated.values, np.float64).reshape(otherwise.shape)
    return np.where(stated.is_there[:, None], matrices, otherwise)


def image(context: Context, values: dict[str, Array]) -> dict[str, Column] | BadRows:
    """Return the columns of sensor_msgs/Image."""
    data = values["data"]
    field = context.derived.fields["data"][-1]
    count, height, width = data.shape[:3]
    if data.ndim == 4:
        encoding, high = _COLORS[data.shape[3]], 255
        dtype: np.dtype[Any] = np.dtype("u1")
    else:
        (encoding, dtype), high = _DEPTHS["float64" if field.kind.startswith("float") else "int64"], 65535
        data = _depths(context, data, 1e-3 if dtype.kind == "u" else 1.0)
    if dtype.kind == "u":
        bad = np.asarray(_outside(data, high).reshape(count, -1).any(axis=1))
        if bad.any():
            what = f"field {context.derived.key('data')!r} has pixels that are no integers"
            return BadRows(bad, f"{what} or outside 0 to {high}, which {encoding} cannot say")
    pixels = np.ascontiguousarray(data, dtype).reshape(count, -1).view(np.uint8)
    return {
        "header": context.header,
        "height": Constant(height),
        "width": Constant(width),
        "encoding": _encodings(context, encoding, field, data),
        "is_bigendian": Constant(0),
        "step": Constant(pixels.shape[1] // max(height, 1)),
        "data": pixels,
    }


def _encodings(context: Context, encoding: str, field: MessageField, data: Array) -> Column:
    """Return what the pixels are: what rows state, where the pixels can be that."""
    stated = context.details.get("encoding")
    if stated is None:
        return Constant(encoding)
    fitting = _SAME_PIXELS[data.shape[3] if data.ndim == 4 else field.kind]
    names = stated_texts.texts_of(stated, encoding)
    odd = sorted({name for name in names if name not in fitting})
    if odd:
        warnings.warn(
            f"{context.derived.topic}: field {context.derived.key('encoding')!r} is {odd[0]!r}, which the pixels of"
            f" {context.derived.key('data')!r} are not; they are taken for {encoding}",
            ConversionWarning,
            stacklevel=2,
        )
    return texts([name if name in fitting else encoding for name in names])


def _depths(context: Context, data: Array, metres: float) -> Array:
    """Return depths in ROS's unit, which is so many metres (https://www.ros.org/reps/rep-0118.html)."""
    unit = units.of_field(
        context.derived.metadata.get("units"), [field.key for field in context.derived.fields["data"]]
    )
    scale = units.scale("length", unit) if unit is not None else None
    if scale is None or scale.factor == metres:
        return data
    scaled = data * (scale.factor / metres)
    return np.round(scaled) if metres < 1 else scaled


def _outside(values: Array, high: int) -> npt.NDArray[np.bool_]:
    """Tell which values are no integers from 0 to a bound."""
    bad: npt.NDArray[np.bool_] = ~((values >= 0) & (values <= high) & (values == np.floor(values)))
    return bad


def compressed(context: Context, values: dict[str, Any]) -> dict[str, Column] | BadRows:
    """Return the columns of sensor_msgs/CompressedImage."""
    data = _pictures(context, values["data"])
    if isinstance(data, BadRows):
        return data
    spans = zip(data.starts.tolist(), data.lengths.tolist(), strict=True)
    # The first bytes tell PNG and JPEG apart; names of files and formats that rows state may be wrong.
    formats = [_format(data.items[start : start + min(length, 8)].tobytes()) for start, length in spans]
    bad = np.array([not format_ for format_ in formats])
    if bad.any():
        if context.load is not None and context.derived.fields["data"][-1].kind == "string":
            name = _text(values["data"], int(np.argmax(bad)))
            return BadRows(bad, f"field {context.derived.key('data')!r} names {name!r}, which is neither JPEG nor PNG")
        return BadRows(bad, f"field {context.derived.key('data')!r} is neither a JPEG nor a PNG", is_other=True)
    stated = context.details.get("format")
    if stated is not None:  # such as "bgr8; jpeg compressed bgr8"
        both = zip(stated_texts.texts_of(stated, ""), formats, strict=True)
        formats = [name if kind in name.replace("jpg", "jpeg") else kind for name, kind in both]
    return {"header": context.header, "format": texts(formats), "data": data}


def _pictures(context: Context, given: Ragged) -> Ragged | BadRows:
    """Return the images, [N], whether a field has them or names their files."""
    if context.load is None or context.derived.fields["data"][-1].kind != "string":
        return given
    key = context.derived.key("data")
    names = [_text(given, number) for number in range(len(context.rows))]
    others = np.array([not names_image(name) for name in names])
    if others.any():
        what = f"field {key!r} is {names[int(np.argmax(others))]!r}, which is no path of a .jpg or .png file"
        return BadRows(others, what, is_other=True)
    files: list[bytes] = []
    missing = np.zeros(len(names), np.bool_)
    why = ""
    for number, name in enumerate(names):
        try:
            files.append(context.load(name))
        except ValueError as error:
            missing[number] = True
            why = why or f"field {key!r} {error}"
    if why:
        return BadRows(missing, why)
    lengths = np.fromiter(map(len, files), np.int64, len(files))
    return Ragged.behind_each_other(np.frombuffer(b"".join(files), np.uint8), lengths)


def _text(column: Ragged, number: int) -> str:
    start = int(column.starts[number])
    return bytes(column.items[start : start + int(column.lengths[number])]).decode()


def _format(head: bytes) -> str:
    if head.startswith(b"\x89PNG"):
        return "png"
    return "jpeg" if head.startswith(b"\xff\xd8") else ""
