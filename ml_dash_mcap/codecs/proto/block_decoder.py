"""Decodes blocks of rows by code that is compiled for each of their templates.

Generated code is used for speed: a row of 29 floats takes a twentieth of the time.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ...mcap.message_records import MESSAGE_HEAD_BYTES
from ...rows.plain_row import TIME_KEY
from .. import payloads as payload_arrays
from ..encoded_channel import DecodedRun, Row
from ..payloads import Payloads
from . import form_search, row_match, wire
from .layout import Kind, Layout, Member
from .row_encoder import decode_array
from .row_match import MatchedRows
from .row_template import Enter, FixedRun, Leaf, Node, RowTemplate, Varying

_MOST_DEPTH = 40
"""Dicts that lie deeper in each other are not compiled."""

_MOST_NAMED = 16
"""Lists with more numbers are read by numpy, others together with the rest of their row."""

DecodeSome = Callable[[Any], list[Row]]
"""Decodes rows of one template: their bytes with what lies between them, if the template is fixed; otherwise a sequence
of rows."""


_MOST_REMEMBERED = 8
"""So many templates are tried on a block before it is searched for others."""


class BlockReader:
    """Finds the rows of blocks that can be decoded many at once. Any thread may call it."""

    def __init__(self, layout: Layout) -> None:
        """Begin with a topic.

        Args:
            layout: Of its rows.
        """
        self._layout = layout
        self._templates: dict[bool, list[tuple[RowTemplate, DecodeSome]]] = {False: [], True: []}
        """Those that some rows had lately, the latest first, of rows without and with the heads of their messages."""

    def block(self, payloads: Sequence[bytes]) -> RowBlock:
        """Look at rows."""
        in_one_array = payloads if isinstance(payloads, Payloads) else payload_arrays.of_list(payloads)
        has_heads = in_one_array.has_heads
        block = RowBlock(payloads, in_one_array)
        waiting = np.arange(len(payloads))
        for template, decode in self._templates[has_heads]:
            if len(waiting) < form_search.LEAST_ROWS:
                return block
            rows = row_match.match(in_one_array, waiting, template)
            if len(rows.which):
                block.add(rows, template, decode)
                waiting = form_search.without(waiting, rows.which)
        forms, _ = form_search.forms_of(in_one_array, self._layout, waiting)
        for form in forms:
            new_decode = compiled(form.template, MESSAGE_HEAD_BYTES if has_heads else 0)
            if new_decode is not None:
                latest = [(form.template, new_decode), *self._templates[has_heads]]
                self._templates[has_heads] = latest[:_MOST_REMEMBERED]
                block.add(form.rows, form.template, new_decode)
        return block


class RowBlock:
    """Rows that can be decoded many at once, where they are of a template."""

    def __init__(self, payloads: Sequence[bytes], in_one_array: Payloads) -> None:
        """Begin with rows of no template.

        Args:
            payloads: The rows.
            in_one_array: The same.
        """
        self.times = np.full(len(payloads), np.nan)
        self._payloads = payloads
        self._in_one_array = in_one_array
        self._form_of = np.full(len(payloads), -1)
        self._forms: list[tuple[RowTemplate, DecodeSome]] = []

    def add(self, rows: MatchedRows, template: RowTemplate, decode: DecodeSome) -> None:
        """Note the rows of a template."""
        self._form_of[rows.which] = len(self._forms)
        self.times[rows.which] = rows.values[template.time].joined().view("<f8")
        self._forms.append((template, decode))

    def runs(self, among: npt.NDArray[np.bool_]) -> Iterator[DecodedRun]:
        """Yield runs of consecutive rows, which together are all rows.

        Args:
            among: The rows that may be decoded with others, [N]; the time stamps of these are no NaN.
        """
        form_of = np.where(among, self._form_of, -1)
        edges = np.flatnonzero(np.diff(form_of)) + 1
        start = 0
        for end in (*edges.tolist(), len(form_of)):
            form = int(form_of[start])
            yield DecodedRun(start, end, None if form < 0 else functools.partial(self._decoded, self._forms[form]))
            start = end

    def _decoded(self, form: tuple[RowTemplate, DecodeSome], start: int, end: int) -> list[Row]:
        template, decode = form
        if not template.is_fixed:
            if not isinstance(self._payloads, list):
                self._payloads = list(self._payloads)
            return decode(self._payloads[start:end])
        # Rows of one length lie at equal distances: with the head of its message before each, or a byte behind it.
        rows = self._in_one_array
        before, behind = (MESSAGE_HEAD_BYTES, 0) if rows.has_heads else (0, 1)
        first = int(rows.starts[start]) - before
        return decode(rows.data.data[first : first + (end - start) * (before + template.length + behind)])


# -- code --------------------------------------------------------------------------------------------------------------


def compiled(template: RowTemplate, before: int = 0) -> DecodeSome | None:
    """Return a function that decodes rows of a template; None where it is nested too deep.

    It raises a `ValueError` if a text in one of them is no UTF-8.

    Args:
        template: Of the rows.
        before: How many bytes lie before each row, if the template is fixed; if there are none, one lies behind it.
    """
    if _depth(template.row) > _MOST_DEPTH:
        return None
    code = _Code(template, before)
    return _compiled(code.source(), tuple(code.formats), tuple(code.lists))


@functools.lru_cache(maxsize=256)
def _compiled(source: str, formats: tuple[str, ...], lists: tuple[tuple[str, tuple[int, ...]], ...]) -> DecodeSome:
    """Compile code.

    Args:
        source: The code. What is not ours in it are keys, as `repr` spells them.
        formats: Of `struct`, one for each run.
        lists: Of the lists that numpy reads: the type of their numbers, and the lengths of all but the first dimension.
    """
    names: dict[str, Any] = {
        "__builtins__": {},
        "array": decode_array,
        "length": wire.read_varint,
        "len": len,
    }
    for number, format_ in enumerate(formats):
        layout = struct.Struct(format_)
        names |= {f"iterate{number}": layout.iter_unpack, f"unpack{number}": layout.unpack_from}
    for number, (dtype, lengths) in enumerate(lists):
        names[f"numbers{number}"] = functools.partial(_numbers, np.dtype(dtype), lengths)
    exec(compile(source, "<rows>", "exec"), names)
    decode: DecodeSome = names["decode"]
    return decode


class _Code:
    """Writes the function for one template."""

    def __init__(self, template: RowTemplate, before: int) -> None:
        self._before = before
        self.formats: list[str] = []
        self.lists: list[tuple[str, tuple[int, ...]]] = []
        self._template = template
        self._terms: dict[int, str] = {}
        """The expression of each value."""

    def source(self) -> str:
        """Return the source of the function `decode`."""
        template = self._template
        if template.is_fixed:
            names = self._fixed(0, template.length, self._before, 0 if self._before else 1)
            return f"def decode(rows): return [{self._row()} for ({names}) in iterate0(rows)]"
        lines = ["rows = []", "for data in payloads:", " at = 0"]
        for number, step in enumerate(template.steps):
            lines += [f" {line}" for line in self._step(number, step)]
        lines += [f" rows += [{self._row()}]", "return rows"]
        return "\n ".join(["def decode(payloads):", *lines])

    def _step(self, number: int, step: Any) -> list[str]:
        if isinstance(step, FixedRun):
            run = len(self.formats)
            return [f"({self._fixed(number, step.length)}) = unpack{run}(data, at)", f"at += {step.length}"]
        size = ["size = data[at]", "at += 1", "if size > 127: size, at = length(data, at - 1, len(data))"]
        if isinstance(step, Varying):
            name = f"v{step.value}"
            self._terms[step.value] = self._bytes_term(self._template.members[step.value], name)
            return [*size, f"{name} = data[at:at + size]", "at += size"]
        return size if isinstance(step, Enter) else []

    def _fixed(self, number: int, length: int, before: int = 0, behind: int = 0) -> str:
        """Take the values of a run; returns the names that they are unpacked to.

        Args:
            number: Of the step.
            length: Of the run.
            before: How many bytes lie before each row.
            behind: How many bytes lie behind it.
        """
        format_, names, at = f"<{before}x", "", 0
        for value, place in enumerate(self._template.places):
            if place is None or place.step != number:
                continue
            code, own_names, term = self._value(value, place.length)
            format_ += f"{place.at - at}x{code}"
            names += "".join(f"{name}, " for name in own_names)
            at = place.at + place.length
            self._terms[value] = term
        self.formats.append(f"{format_}{length + behind - at}x")
        return names

    def _value(self, value: int, length: int) -> tuple[str, Sequence[str], str]:
        """Return the format of a value, the names that it is unpacked to, and its expression."""
        member = self._template.members[value]
        code, name = member.slot.kind.struct_code, f"v{value}"
        if code is None:
            return f"{length}s", [name], self._bytes_term(member, name)
        if not member.slot.is_list:
            return code, [name], name
        count = length // member.slot.kind.packed_bytes
        if not 0 < count <= _MOST_NAMED or member.slot.lengths:
            return f"{length}s", [name], self._bytes_term(member, name)
        names = [f"{name}_{at}" for at in range(count)]
        return f"{count}{code}", names, f"[{', '.join(names)}]"

    def _bytes_term(self, member: Member, name: str) -> str:
        """Return the expression of a value by that of its bytes."""
        kind = member.slot.kind
        if kind.struct_code is not None:
            self.lists.append((f"<{kind.struct_code}", member.slot.lengths or ()))
            return f"numbers{len(self.lists) - 1}({name})"
        if kind is Kind.ARRAY:
            return f"array({name}, 0, len({name}))"
        return f"{name}.decode()" if kind is Kind.TEXT else name

    def _row(self) -> str:
        items = [self._item(key, node) for key, node in self._template.row.items()]
        return f"{{{', '.join([*items, f'{TIME_KEY!r}: {self._terms[self._template.time]}'])}}}"

    def _item(self, key: str, node: Node) -> str:
        if isinstance(node, list):
            return f"{key!r}: [{', '.join(map(self._dict, node))}]"
        if isinstance(node, dict):
            return f"{key!r}: {self._dict(node)}"
        terms = [self._terms[value] for value in node.values]
        is_list = node.member.slot.is_list and not node.member.slot.is_packed
        return f"{key!r}: [{', '.join(terms)}]" if is_list else f"{key!r}: {terms[0]}"

    def _dict(self, row: dict[str, Node]) -> str:
        return f"{{{', '.join([self._item(key, node) for key, node in row.items()])}}}"


def _numbers(dtype: np.dtype[Any], lengths: tuple[int, ...], data: bytes) -> list[Any]:
    """Return packed numbers as a list, or a list of lists."""
    values = np.frombuffer(data, dtype)
    if dtype.kind == "b":
        values = np.frombuffer(data, np.uint8) != 0
    numbers: list[Any] = (values.reshape(-1, *lengths) if lengths and len(values) else values).tolist()
    return numbers


def _depth(node: Node) -> int:
    if isinstance(node, Leaf):
        return 0
    return 1 + max(map(_depth, node if isinstance(node, list) else node.values()), default=0)
