"""From a message's payload to a row."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import orjson

from ..errors import ConversionWarning, EncodingError, UndecodedWarning
from ..mcap.records import Channel, Schema
from ..rows.encode import EXACT_KEY
from ..rows.json_text import restore
from . import json_depth
from .decoding import DEFAULT, Decoding
from .ros import distros
from .ros import message_decoder as ros_decode
from .ros.definition_sources import Supply
from .ros.distros import Likely

Row = dict[str, Any]
Decoder = Callable[[bytes], "Row | None"]
"""Returns a message's row; None for one that is left out."""

RAW_FIELD = "data"
"""Holds the payload of messages that are not decoded."""

ODD_FIELD = "_data"
"""Holds the payload of a message that is not decoded among others that are, and may have a field `data`."""

DIGEST_KEYS = {True: "md5sum", False: "topic_type_hash"}
"""What a channel's metadata calls the hash of its type, in ROS 1 and in ROS 2."""

_ROS = ("ros1", "cdr")

_MOST_DIGITS = 21
"""Of an integer in 64 bits, and its sign."""

_NO_SCHEMA = Schema(0, "", "", b"")


@dataclass(frozen=True, slots=True)
class _Case:
    """A channel whose messages are to be decoded."""

    channel: Channel
    schema: Schema
    decoding: Decoding
    likely: Callable[[], Likely]

    def warn(self, category: type[Warning], what: str) -> None:
        warnings.warn(f"topic {self.channel.topic!r}{what}", category, stacklevel=2)

    @property
    def hint(self) -> str:
        """What to pass so that the messages are decoded; empty where there is nothing."""
        if self.channel.message_encoding not in _ROS:
            return ""
        return f"; pass definitions={{{self.schema.name!r}: <its .msg text>}} to decode it"

    def give_up(self, why: str, hint: str = "", field: str = RAW_FIELD) -> Decoder:
        """Return what stands for a decoder where there is none, and tell the user.

        Raises:
            EncodingError: The user wants it so.
        """
        how = self.decoding.on_unknown
        if how == "raise":
            raise EncodingError(f"topic {self.channel.topic!r}{why}{hint}")
        if how == "skip":
            self.warn(UndecodedWarning, f"{why}; it is left out{hint}")
            return _leave_out
        self.warn(UndecodedWarning, f"{why}; its rows have the bytes of each as {field!r}{hint}")
        return lambda payload: {field: payload}

    def misfit(self, field: str = ODD_FIELD) -> Callable[[bytes, Exception], Row | None]:
        """Return what takes a message that is not what its schema says; the user is told of the first one."""
        odd: list[Decoder] = []

        def take(payload: bytes, why: Exception) -> Row | None:
            if not odd:
                encoding = self.channel.message_encoding
                what = f" has a message of {len(payload)} bytes that is no {self.schema.name} in {encoding}: {why}"
                odd.append(self.give_up(f"{what}; such a message is not decoded", self.hint, field))
            return odd[0](payload)

        return take


def decoder(
    channel: Channel,
    schema: Schema | None,
    decoding: Decoding = DEFAULT,
    likely: Callable[[], Likely] = distros.likely,
) -> Decoder:
    """Return the function that turns a channel's payloads into rows.

    It raises a `ValueError` for a payload that is not in the encoding that the channel announces. Rows of an encoding
    that nobody here decodes, or whose schema cannot be used, have the payload as their only field; an
    `UndecodedWarning` says so. So has, as `_data`, a ROS or protobuf message that is not what its definition says.

    Args:
        channel: The channel.
        schema: Its schema.
        decoding: What to do with messages that these do not say enough of.
        likely: Returns the distributions of ROS 2 that they may come from; called where a definition is missing.

    Raises:
        EncodingError: The messages cannot be decoded, and that is to be an error.
    """
    case = _Case(channel, schema or _NO_SCHEMA, decoding, likely)
    make = DECODERS.get(channel.message_encoding)
    described = f" has messages in the encoding {channel.message_encoding!r} with a schema in {case.schema.encoding!r}"
    try:
        found = make(case) if make is not None else None
    except EncodingError as error:
        name = case.schema.name
        what = f": its schema {name!r} is no {case.schema.encoding} that can be used"
        return case.give_up(
            f"{what if case.schema.encoding else f'{described}, of the type {name!r}'}: {error}", case.hint
        )
    return found or case.give_up(f"{described}, which is not decoded")


def _leave_out(payload: bytes) -> None:
    return None


def _json_decoder(case: _Case) -> Decoder:
    return decode_json


def decode_json(payload: bytes) -> Row:
    """Decode a JSON payload, with its non-finite numbers and bytes restored.

    Whatever is not an object becomes the field `value`, and an empty payload a row without fields.
    """
    if not json_depth.is_within(payload, json_depth.MOST):
        raise ValueError(f"it is nested deeper than {json_depth.MOST} levels")
    try:
        row = orjson.loads(payload)
    except orjson.JSONDecodeError:
        row = _decode_lenient(payload)
    if not isinstance(row, dict):
        return {"value": row}
    if EXACT_KEY in row:
        return restore(row)
    return row


def _decode_lenient(payload: bytes) -> Any:
    """Decode what other writers take for JSON: NaN and Infinity literals, lone surrogates, or nothing at all."""
    return json.loads(payload, parse_int=_integer) if payload.strip() else {}


def _integer(digits: str) -> int | float:
    """Return what orjson makes of an integer: a double, where it needs more than 64 bits."""
    value = int(digits) if len(digits) <= _MOST_DIGITS else math.inf
    return value if -(2**63) <= value < 2**64 else float(digits)


def _protobuf_decoder(case: _Case) -> Decoder | None:
    if case.schema.encoding != "protobuf":
        return None
    from . import protobuf

    decode = protobuf.decoder(case.schema.name, case.schema.data)
    if case.decoding.on_unknown == "raise":
        return decode
    misfit = case.misfit()

    def decode_or_carry(payload: bytes) -> Row | None:
        try:
            return decode(payload)
        except (ValueError, RecursionError) as error:
            return misfit(payload, error)

    return decode_or_carry


def _ros1_decoder(case: _Case) -> Decoder | None:
    return _ros_decoder(case, is_ros1=True) if _describes_ros(case.schema, ("ros1msg",)) else None


def _cdr_decoder(case: _Case) -> Decoder | None:
    return _ros_decoder(case, is_ros1=False) if _describes_ros(case.schema, ("ros2msg", "ros2idl", "omgidl")) else None


def _describes_ros(schema: Schema, encodings: tuple[str, ...]) -> bool:
    """Whether a schema is in one of some languages, or names a type of which the recorder knew no definition."""
    return schema.encoding in encodings or (not schema.encoding and not schema.data and "/" in schema.name)


def _ros_decoder(case: _Case, *, is_ros1: bool) -> Decoder:
    channel, schema = case.channel, case.schema
    digest = channel.metadata.get(DIGEST_KEYS[is_ros1], "")
    supply = Supply(case.decoding.definitions, case.likely(), is_ros1, digest)
    text = schema.data.decode(errors="replace")  # comments may be in anything

    replaced = _Once(
        lambda: case.warn(
            UndecodedWarning, " has texts that are no UTF-8: what is wrong in them is U+FFFD in its rows, as ROS has it"
        )
    )
    carries = case.decoding.on_unknown != "raise"
    described = (schema.name, schema.encoding, text)
    found = ros_decode.definition(*described, supply)
    has_fields = bool(found.messages[found.root])
    misfit: ros_decode.Misfit | None = case.misfit(ODD_FIELD if has_fields else RAW_FIELD) if carries else None
    if found.guesses:
        for guess in found.guesses:
            case.warn(ConversionWarning, f": {guess}; pass definitions={{{schema.name!r}: <its .msg text>}} to say it")
        misfit = _other_distributions(case, described, supply, misfit)
    return ros_decode.decoder(*described, is_ros1=is_ros1, supply=supply, replaced=replaced, misfit=misfit)


def _other_distributions(
    case: _Case, described: tuple[str, str, str], supply: Supply, otherwise: ros_decode.Misfit | None
) -> ros_decode.Misfit:
    """Return what reads a message that does not fit the likeliest distribution as that of another that it fits."""
    known = [ros_decode.definition(*described, supply).messages]
    decoders: dict[str, Decoder] = {}
    for name in supply.likely.names[1 : supply.likely.certain]:
        others = Likely((name, *(one for one in supply.likely.names if one != name)), 1)
        found = ros_decode.definition(*described, replace(supply, likely=others))
        if found.messages not in known:
            known.append(found.messages)
            decoders[name] = ros_decode.decoder(*described, supply=replace(supply, likely=others))

    def take(payload: bytes, why: ValueError) -> Any:
        for name, decode in decoders.items():
            try:
                row = decode(payload)
            except ValueError:
                continue
            case.warn(ConversionWarning, f" has messages that only the {case.schema.name} of {name} fits")
            return row
        if otherwise is None:
            raise why
        return otherwise(payload, why)

    return take


class _Once:
    """Does something when it is called for the first time."""

    def __init__(self, do: Callable[[], object]) -> None:
        self._do = do
        self._is_done = False

    def __call__(self) -> None:
        if not self._is_done:
            self._is_done = True
            self._do()


DECODERS: Mapping[str, Callable[[_Case], Decoder | None]] = {
    "json": _json_decoder,
    "protobuf": _protobuf_decoder,
    "ros1": _ros1_decoder,
    "cdr": _cdr_decoder,
}
"""Message encoding to what makes a decoder for a channel; None for a schema in a language that does not go with it."""
