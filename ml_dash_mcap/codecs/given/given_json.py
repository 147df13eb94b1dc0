"""JSON rows that a JSON Schema of the user's describes; each is checked as it is appended."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any

import orjson

from ...errors import EncodingError, FieldError, OptionError
from ...rows import json_text
from ...rows.plain_row import EXACT_KEY, TIME_KEY
from .. import json as json_encoding
from .. import json_schema
from .given_schema import GivenCodec, GivenSchema
from .unfit_values import spelled

if TYPE_CHECKING:
    from ..encoded_channel import Row

_TOLD = 3
"""So many faults of a row are named; most rows have one."""
_SHOWN = 200


class GivenJsonCodec(GivenCodec):
    """Rows as JSON objects that a schema allows. What is checked is the payload, which is all that others see.

    So the time stamp is not in the payload. A value that JSON does not have (NaN, bytes) is written as in all JSON
    rows, with the side key `_exact`, if the schema allows that.
    """

    message_encoding = "json"
    schema_encoding = json_schema.ENCODING
    default = staticmethod(json_text.plain)
    decode = staticmethod(json_encoding.decode)

    def __init__(self, name: str, data: bytes) -> None:
        """Prepare a schema.

        Args:
            name: Of the schema.
            data: Its text.

        Raises:
            EncodingError: It is no schema.
            OptionError: The package that checks rows is not installed.
        """
        self.name = name
        self.data = data
        self._validator = _validator(data)

    # -- append --------------------------------------------------------------------------------------------------------

    def dumps(self, fields: dict[str, Any], default: Any) -> bytes:
        """Encode a row and check it; its time stamp is no part of it."""
        fields.pop(TIME_KEY, None)
        payload = orjson.dumps(fields, default)
        # orjson writes NaN and infinities as null.
        if b"null" in payload or not self._validator.is_valid(orjson.loads(payload)):
            raise ValueError
        return payload

    def encode_row(self, row: Mapping[str, Any]) -> bytes:
        """Encode a row and check it."""
        return self.encode_exactly(row, "")

    def encode_exactly(self, fields: Mapping[str, Any], topic: str) -> bytes:
        """Encode a row, or say which of its values does not fit the schema."""
        row = orjson.loads(json_text.exact({**fields, TIME_KEY: None}, topic, packs=False))
        del row[TIME_KEY]
        faults = list(islice(self._validator.iter_errors(row), _TOLD))
        if faults:
            told = "; ".join(_spelled(fault) for fault in faults)
            raise FieldError(f"append() on topic {topic!r}: the row does not fit the schema: {told}{_hint(row)}")
        return orjson.dumps(row)


def of_schema(schema: Mapping[str, Any]) -> GivenSchema:
    """Return a JSON Schema that is given as a dict.

    Raises:
        EncodingError: It is no JSON, no JSON Schema, or one of something else than objects.
        OptionError: The package that checks rows is not installed.
    """
    try:
        text = orjson.dumps(dict(schema))
    except (TypeError, ValueError) as error:
        raise EncodingError(f"schema={schema!r} is no JSON Schema: it cannot be written as JSON: {error}") from error
    return _of_text(text)


@functools.lru_cache(maxsize=64)
def _of_text(text: bytes) -> GivenSchema:
    schema = orjson.loads(text)
    kinds = schema.get("type", "object")
    if kinds != "object" and "object" not in (kinds if isinstance(kinds, list) else ()):
        raise EncodingError(f"the JSON Schema has the type {kinds!r}, but a row is an object: pass one of objects")
    title = schema.get("title")
    name = title if isinstance(title, str) else ""
    return GivenSchema(name, text, GivenJsonCodec(name, text))


def _validator(text: bytes) -> Any:
    try:
        import jsonschema_rs
    except ModuleNotFoundError as error:
        raise OptionError(
            "a JSON Schema as schema= needs the package jsonschema-rs, which is not installed: pip install"
            " 'ml-dash-mcap[jsonschema]'"
        ) from error
    try:
        return jsonschema_rs.validator_for(orjson.loads(text), retriever=_refuse_to_fetch)
    except ValueError as error:  # its ValidationError and ReferencingError too
        why = getattr(error, "message", None) or str(error)
        path = spelled(getattr(error, "instance_path", ()))
        raise EncodingError(f"the JSON Schema cannot be used: {f'{path}: ' if path else ''}{_cut(why)}") from error


def _refuse_to_fetch(address: str) -> Row:
    raise ValueError(f"{address} lies outside of the schema, and is not fetched; put it under $defs")


def _spelled(fault: Any) -> str:
    place = spelled(fault.instance_path)
    return (f"field {place!r}: " if place else "") + _cut(fault.message)


def _cut(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN // 2]} ... {text[-_SHOWN // 2 :]}"


def _hint(row: Mapping[str, Any]) -> str:
    """Return what to know about values that JSON does not have."""
    if EXACT_KEY not in row:
        return ""
    spellings = ", ".join(row[EXACT_KEY])
    return f" (JSON has no {spellings}: it is null or base64 text there, and {EXACT_KEY!r} tells what it was)"
