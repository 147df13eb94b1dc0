"""Compiles, for a topic whose rows are all alike, an `append` that makes and puts their records in one go.

It does what `Topic.append` does, for arguments like those that came before; any others go to `Topic.append`. Generated
code is used for speed: one `struct.pack` of the arguments themselves makes the record of a row of 29 floats, in half of
the time (tools/bench_append.py). Nothing is packed into the journal's memory itself: a row that fails halfway, or one
of a signal handler that comes between, would leave bytes behind the last record there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from .codecs.proto.compiled_rows import FAILURES, AppendCode, compiled
from .codecs.proto.row_source import NotCompilableError
from .mcap.message_records import MESSAGE_FIXED_BYTES
from .timestamps import MISSING

_TEXT = """
def append(self, /, *_positional, {parameters}, _ts=_M, **_others):
    global _second
    try:
        if _positional or _others or type(_ts) is not float: raise ValueError
        _whole_s, _whole_ns = _second
        _part = _ts - _whole_s
        if not 0.0 < _part < 1.0:
            if not 0.0 < _ts < {end_s!r}: raise ValueError
            _whole_s = int(_ts)
            _whole_ns = _whole_s * 1000000000
            _second = _whole_s, _whole_ns
            _part = _ts - _whole_s
        _time_s = _ts
        {lines}
        _time_ns = _whole_ns + int(_part * 1e9 + 0.5)
        {record}
    except _FAILURES:
        return self._append_otherwise(_positional, locals(), _keys, _others)
    _journal = self._journal
    _lock = _journal.lock
    # Half the price of `with`. Nothing can come between `try` and the call that locks.
    try:
        _lock.acquire()
        _buffer = _journal.active
        _start = _buffer.end
        _end = _start + {size}
        _memory = _buffer.map
        # Making a slice may let the garbage collector run, and with it a finalizer that appends. So may the calls
        # above let a signal handler.
        _place = slice(_start + 1, _end)
        if _end <= _buffer.limit and _buffer.end == _start and _journal.active is _buffer:
            # As in Topic.append: no call between these lines, and the opcode comes last.
            _memory[_place] = _tail
            _memory[_start] = 5
            _buffer.end = _end
            _journal.last_s = _ts
            _buffer.starts.append(_start)
            if _journal.eager is None:
                return self
            _end = 0
    finally:
        try:
            _lock.release()
        except RuntimeError:  # an exception of a signal handler came while it waited
            pass
    if _end:
        return self._append_slowly(locals(), _keys)
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
    names = {**code.names, "_M": MISSING, "_FAILURES": FAILURES, "_second": (0, 0), "_keys": (*code.keys, "_ts")}
    first, *others = code.terms
    if others:
        names |= {"_first": struct.Struct(f"<{code.first_format}").pack, "_head": head}
        names["_pack_head"] = struct.Struct("<Q6sQQ").pack
        terms = [f"_first({first})"] if code.first_format else []
        record = (
            f"_payload = {' + '.join([*terms, *others])}; "
            f"_tail = _pack_head(len(_payload) + {MESSAGE_FIXED_BYTES}, _head, _time_ns, _time_ns) + _payload"
        )
        size = "len(_tail) + 1"
    else:
        payload_bytes = struct.calcsize(f"<{code.first_format}")
        names["_pack"] = struct.Struct(f"<{_HEAD_BYTES}sQQ{code.first_format}").pack
        names["_head"] = struct.pack("<Q", payload_bytes + MESSAGE_FIXED_BYTES) + head
        record = f"_tail = _pack(_head, _time_ns, _time_ns, {first})"
        size = str(1 + _HEAD_BYTES + 16 + payload_bytes)
    text = _TEXT.format(
        parameters=", ".join(f"{key}=_M" for key in code.keys),
        end_s=end_s,
        lines="\n        ".join(code.lines),
        record=record,
        size=size,
    )
    try:
        append: Callable[..., Any] = compiled(text, names, "append")
    except NotCompilableError:
        return None
    return append
