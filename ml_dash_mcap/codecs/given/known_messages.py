"""Gives protobuf's well-known messages their values from Python's own: times, spans, wrapped numbers, JSON values."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Mapping
from typing import Any

from google.protobuf import json_format
from google.protobuf.descriptor import Descriptor
from google.protobuf.message import Message

from ... import clock
from ...rows.plain_row import PlainRow
from ...time_hints import unit_hint
from . import scalar_values
from .unfit_values import UnfitValueError, shown, takes

Known = Callable[[Any, Any], bool]
"""Gives a message its value; returns whether it did, for a value of this kind."""

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_FIRST_S, _LAST_S = -62_135_596_800, 253_402_300_799
"""The seconds of a Timestamp: the years 1 to 9999 (timestamp.proto)."""
_LONGEST_S = 315_576_000_000
"""The seconds of a Duration: 10,000 years either way (duration.proto)."""

_TIMESTAMP, _DURATION = "google.protobuf.Timestamp", "google.protobuf.Duration"
_JSON_LIKE = ("google.protobuf.Struct", "google.protobuf.Value", "google.protobuf.ListValue")
_WRAPPERS = tuple(
    f"google.protobuf.{name}Value"
    for name in ("Double", "Float", "Int64", "UInt64", "Int32", "UInt32", "Bool", "String", "Bytes")
)


def converter(descriptor: Descriptor) -> Known | None:
    """Return the function that gives messages of a well-known type their value; None for other types.

    The function raises a `UnfitValueError`.
    """
    name = descriptor.full_name
    if name in _WRAPPERS:
        return _wrapper(descriptor)
    return {_TIMESTAMP: _set_timestamp, _DURATION: _set_duration}.get(name, _set_json if name in _JSON_LIKE else None)


def takes_none(descriptor: Descriptor) -> bool:
    """Whether None is a value of a type, and does not mean that the field is left out."""
    return bool(descriptor.full_name == "google.protobuf.Value")


def expected(descriptor: Descriptor) -> str:
    """Return what a field of a message type takes, for error messages."""
    name = descriptor.full_name
    if name == _TIMESTAMP:
        return "a time: seconds since 1970, a datetime with its zone, or a dict of seconds and nanos"
    if name == _DURATION:
        return "a span: seconds, a timedelta, or a dict of seconds and nanos"
    return f"a dict of the fields of {name}"


def pack(target: Message, value: Message) -> bool:
    """Put a message of any type into an Any; returns whether the target is one."""
    if target.DESCRIPTOR.full_name != "google.protobuf.Any":
        return False
    target.Pack(value)
    return True


def _set_timestamp(target: Any, value: Any) -> bool:
    nanoseconds = _time_ns(value)
    if nanoseconds is None:
        return False
    seconds, nanos = divmod(nanoseconds, clock.NS_PER_S)
    if not _FIRST_S <= seconds <= _LAST_S:
        hint = unit_hint(value, "seconds") if isinstance(value, (int, float)) and value > 0 else ""
        raise UnfitValueError(f"takes a time of the years 1 to 9999; {shown(value)} s since 1970 is none{hint}")
    target.seconds, target.nanos = seconds, nanos
    return True


def _set_duration(target: Any, value: Any) -> bool:
    nanoseconds = _span_ns(value)
    if nanoseconds is None:
        return False
    if abs(nanoseconds) > _LONGEST_S * clock.NS_PER_S:
        raise UnfitValueError(f"takes a span of at most 10,000 years; {shown(value)} s is longer")
    seconds, nanos = divmod(abs(nanoseconds), clock.NS_PER_S)
    sign = -1 if nanoseconds < 0 else 1
    target.seconds, target.nanos = sign * seconds, sign * nanos  # both have the sign (duration.proto)
    return True


def _time_ns(value: Any) -> int | None:
    """Return a time since 1970 in ns; None for a value that is no time."""
    if isinstance(value, datetime.datetime):  # pandas.Timestamp is one, with nanoseconds of its own
        if value.tzinfo is None:
            raise UnfitValueError(f"takes a time; {shown(value)} has no time zone: pass when.astimezone()")
        return _microseconds(value - _EPOCH) * 1000 + int(getattr(value, "nanosecond", 0))
    if getattr(getattr(value, "dtype", None), "kind", "") == "M" and getattr(value, "ndim", None) == 0:
        return _numpy_ns(value, "datetime64[ns]")
    return _seconds_ns(value)


def _span_ns(value: Any) -> int | None:
    """Return a span in ns; None for a value that is no span."""
    if isinstance(value, datetime.timedelta):
        return _microseconds(value) * 1000 + int(getattr(value, "nanoseconds", 0)) % 1000
    if getattr(getattr(value, "dtype", None), "kind", "") == "m" and getattr(value, "ndim", None) == 0:
        return _numpy_ns(value, "timedelta64[ns]")
    return _seconds_ns(value)


def _microseconds(span: datetime.timedelta) -> int:
    return (span.days * 86_400 + span.seconds) * 1_000_000 + span.microseconds


def _numpy_ns(value: Any, unit: str) -> int:
    if value != value:
        raise UnfitValueError("takes a time; NaT is none")
    nanoseconds = value.astype(unit)
    if nanoseconds.astype(value.dtype) != value:  # numpy wraps around without a word
        raise UnfitValueError(f"takes a time; {shown(value)} is beyond what 64 bits of ns hold")
    return int(nanoseconds.astype("int64"))


def _seconds_ns(value: Any) -> int | None:
    """Return a number of seconds in ns, rounded as the time stamps of rows are."""
    number = scalar_values.plain(value)
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        return None
    if isinstance(number, int):
        return int(number) * clock.NS_PER_S
    if not math.isfinite(number):
        raise takes("a finite number of seconds", value)
    if number < 0:
        return -clock.to_nanoseconds(-float(number))
    return clock.to_nanoseconds(float(number))


def _wrapper(descriptor: Descriptor) -> Known:
    convert = scalar_values.converter(descriptor.fields_by_name["value"])

    def set_value(target: Any, value: Any) -> bool:
        if isinstance(value, Mapping):
            return False
        target.value = convert(value)
        return True

    return set_value


def _set_json(target: Any, value: Any) -> bool:
    """Give a Struct, a Value or a ListValue what its JSON says."""
    try:
        json_format.ParseDict(PlainRow("", packs=False).row({"value": value})["value"], target)
    except (json_format.ParseError, TypeError, ValueError) as error:
        raise takes("what JSON can say", value) from error
    return True
