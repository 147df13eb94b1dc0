"""Compiles, for a topic whose rows are all alike, an `append` that makes and puts their records in one go.

It does what `Topic.append` does, for arguments like those that came before; any others go to `Topic.append`. Generated
code is used for speed: the record of a row of 29 floats is made by one `struct.pack` of the arguments themselves, which
takes six tenths of the time (tools/bench_append.py).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from .codecs.proto.compiled_rows import FAILURES, AppendCode, compiled
from .codecs.proto.row_source import NotCompilableError
from .mcap.message_records import MESSAGE_FIXED_BYTES, MESSAGE_OPCODE
from .timestamps import MISSING

_TEXT = """
def append(self, /, *_positional, _ts=_M, timestamp=_M, _exact=_M, {parameters}, **_others):
    try:
        if _positional or _others or timestamp is not _M or _exact is not _M: raise ValueError
        if type(_ts) is not float or not 0.0 < _ts < {end_s!r}: raise ValueError
        _time_s = _ts
        {lines}
        _whole = int(_ts)
        _time_ns = _whole * 1000000000 + int((_ts - _whole) * 1e9 + 0.5)
        {record}
    except _FAILURES:
        return self._append_otherwise(_positional, {given}, _others)
    _journal = self._journal
    with _journal.lock:
        _buffer = _journal.active
        _start = _buffer.end
        _end = _start + {size}
        if _end <= _buffer.limit:
            # As in Topic.append: no call between these lines, and the opcode comes last.
            _memory = _buffer.map
            _memory[_start + 1 : _end] = _tail
            _memory[_start] = 5
            _buffer.end = _end
            _journal.last_s = _ts
            _buffer.starts.append(_start)
            if _journal.eager is None:
                return self
    if _end > _buffer.limit:
        _journal.add(_OPCODE + _tail, self.name, _ts)
    if _journal.eager is not None:
        _journal.eager()
    return self
"""

_HEAD_BYTES = 8 + 6
"""Of a record, before its times: the length, the channel id and the sequence number."""


def compile_append(code: AppendCode, head: bytes, end_s: float) -> Callable[..., Any] | None:
    """Return the function `append` of a topic; None where the code has too many levels or names.

    Args:
        code: Encodes the arguments.
        head: Channel id and sequence number as they stand in a Message record.
        end_s: The first time stamp that is too late, in s.
    """
    names = {**code.names, "_M": MISSING, "_FAILURES": FAILURES, "_OPCODE": bytes((MESSAGE_OPCODE,))}
    first, *others = code.terms
    if others:
        names |= {"_first": struct.Struct(f"<{code.first_format}").pack, "_head": head}
        names["_pack_head"] = struct.Struct("<Q6sQQ").pack
        terms = [f"_first({first})"] if code.first_format else []
        record = [
            f"_payload = {' + '.join([*terms, *others])}",
            f"_tail = _pack_head(len(_payload) + {MESSAGE_FIXED_BYTES}, _head, _time_ns, _time_ns) + _payload",
        ]
        size = "len(_tail) + 1"
    else:
        payload_bytes = struct.calcsize(f"<{code.first_format}")
        names["_pack"] = struct.Struct(f"<{_HEAD_BYTES}sQQ{code.first_format}").pack
        names["_head"] = struct.pack("<Q", payload_bytes + MESSAGE_FIXED_BYTES) + head
        record = [f"_tail = _pack(_head, _time_ns, _time_ns, {first})"]
        size = str(1 + _HEAD_BYTES + 16 + payload_bytes)
    text = _TEXT.format(
        parameters=", ".join(f"{key}=_M" for key in code.keys),
        end_s=end_s,
        lines="\n        ".join(code.lines),
        record="\n        ".join(record),
        given="{'_ts': _ts, 'timestamp': timestamp, '_exact': _exact, "
        + ", ".join(f"{key!r}: {key}" for key in code.keys)
        + "}",
        size=size,
    )
    try:
        append: Callable[..., Any] = compiled(text, names, "append")
    except NotCompilableError:
        return None
    return append
