"""From the ROS messages of a channel to rows, whichever way they are serialised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..errors import ConversionWarning, UndecodedWarning
from ..mcap.records import Schema
from .encoded_channel import ODD_FIELD, RAW_FIELD, Decoder, EncodedChannel
from .ros import message_decoder as ros_decode
from .ros.definition_sources import Supply
from .ros.distros import Likely

DIGEST_KEYS = {True: "md5sum", False: "topic_type_hash"}
"""What a channel's metadata calls the hash of its type, in ROS 1 and in ROS 2."""


def is_described(schema: Schema, encodings: tuple[str, ...]) -> bool:
    """Whether a schema is in one of some languages, or names a type of which the recorder knew no definition."""
    return schema.encoding in encodings or (not schema.encoding and not schema.data and "/" in schema.name)


def decoder(encoded: EncodedChannel, *, is_ros1: bool) -> Decoder:
    """Return what makes rows of a channel's ROS messages.

    Args:
        encoded: The channel.
        is_ros1: Whether they are serialised as in ROS 1, and not as CDR.

    Raises:
        EncodingError: The definition is broken, or missing.
    """
    channel, schema = encoded.channel, encoded.schema
    digest = channel.metadata.get(DIGEST_KEYS[is_ros1], "")
    supply = Supply(encoded.decoding.definitions, encoded.likely(), is_ros1, digest)
    text = schema.data.decode(errors="replace")  # comments may be in anything

    replaced = _Once(
        lambda: encoded.warn(
            UndecodedWarning, " has texts that are no UTF-8: what is wrong in them is U+FFFD in its rows, as ROS has it"
        )
    )
    carries = encoded.decoding.on_unknown != "raise"
    described = (schema.name, schema.encoding, text)
    definition = ros_decode.definition(*described, supply)
    has_fields = bool(definition.messages[definition.root])
    misfit: ros_decode.Misfit | None = encoded.misfit(ODD_FIELD if has_fields else RAW_FIELD) if carries else None
    if definition.guesses:
        for guess in definition.guesses:
            encoded.warn(
                ConversionWarning, f": {guess}; pass definitions={{{schema.name!r}: <its .msg text>}} to say it"
            )
        misfit = _other_distributions(encoded, described, supply, misfit)
    return ros_decode.decoder(*described, is_ros1=is_ros1, supply=supply, replaced=replaced, misfit=misfit)


def _other_distributions(
    encoded: EncodedChannel, described: tuple[str, str, str], supply: Supply, otherwise: ros_decode.Misfit | None
) -> ros_decode.Misfit:
    """Return what reads a message that does not fit the likeliest distribution as that of another that it fits."""
    definitions = [ros_decode.definition(*described, supply).messages]
    decoders: dict[str, Decoder] = {}
    for name in supply.likely.names[1 : supply.likely.certain]:
        others = Likely((name, *(other for other in supply.likely.names if other != name)), 1)
        definition = ros_decode.definition(*described, replace(supply, likely=others))
        if definition.messages not in definitions:
            definitions.append(definition.messages)
            decoders[name] = ros_decode.decoder(*described, supply=replace(supply, likely=others))

    def take(payload: bytes, why: ValueError) -> Any:
        for name, decode in decoders.items():
            try:
                row = decode(payload)
            except ValueError:
                continue
            encoded.warn(ConversionWarning, f" has messages that only the {encoded.schema.name} of {name} fits")
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
