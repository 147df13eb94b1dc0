"""Reads the protobuf rows of one channel, block by block, as columns, without a Python object for each row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ...rows import typed_columns, zero_copy
from ...rows.dotted import FIELD_PREFIX
from ...rows.field_choice import is_wanted
from ...rows.plain_row import TIME_KEY, encodable
from ...rows.typed_columns import Column
from .. import payloads as payload_arrays
from ..codec import Columns
from ..encoded_channel import Decoder
from ..payloads import Payloads
from . import form_search, row_match, value_arrays
from .form_search import RowForm
from .layout import Member
from .row_decoder import RowDecoder
from .row_template import TIME_MEMBER, Leaf, Node
from .value_arrays import InexpressibleError


class ProtobufColumnReader:
    """Reads blocks of rows."""

    def __init__(self, decoder: Callable[[], Decoder], columns: Sequence[str] | None) -> None:
        """Begin to read.

        Args:
            decoder: Returns what makes rows of the messages.
            columns: Dotted names of those that are wanted; None for all.
        """
        self._decoder = decoder
        self._columns = columns

    def read(self, payloads: Sequence[bytes]) -> Columns | None:
        """Return the columns of rows, and which of them are left out."""
        forms, others = self._forms(payloads)
        if not forms:
            return None
        try:
            blocks = [dict(self._arrays(form)) for form in forms]
        except InexpressibleError:
            return None
        arrays = _joined(forms, blocks)
        return None if arrays is None else Columns(arrays, others)

    def read_exactly(self, payloads: Sequence[bytes]) -> dict[str, Any] | None:
        """Return columns that tell all that the rows do: of rows of one form, without bytes, NaN and infinities.

        Formats of text have such values in their own way.
        """
        forms, others = self._forms(payloads)
        if len(forms) != 1 or len(others) or _has_dots(forms[0].template.row):
            return None
        try:
            arrays = dict(self._arrays(forms[0]))
        except InexpressibleError:
            return None
        return arrays if all(map(_is_plain, arrays.values())) else None

    def _forms(self, payloads: Sequence[bytes]) -> tuple[list[RowForm], npt.NDArray[np.intp]]:
        decode = self._decoder()
        if not isinstance(decode, RowDecoder) or not len(payloads):
            return [], np.arange(len(payloads))
        return form_search.forms_of(_in_one_array(payloads), decode.layout)

    def _arrays(self, form: RowForm) -> Iterator[tuple[str, pa.Array]]:
        """Yield the columns of a form by dotted name."""
        values = form.rows.values
        names: set[str] = set()
        for name, node in _flat(form.template.row, ""):
            if name in names or name == TIME_KEY or name.startswith(f"{TIME_KEY}."):
                raise InexpressibleError
            names.add(name)
            if is_wanted(name, self._columns) or is_wanted(FIELD_PREFIX + name, self._columns):
                yield encodable(name), _array(node, values, len(form.rows.which))
        yield TIME_KEY, value_arrays.of_values(TIME_MEMBER, [values[form.template.time]])


def _in_one_array(payloads: Sequence[bytes]) -> Payloads:
    """Return payloads with some bytes behind the last, where the walk through rows may look."""
    return payload_arrays.joined([payloads if isinstance(payloads, Payloads) else payload_arrays.of_list(payloads)])


# -- columns -----------------------------------------------------------------------------------------------------------


def _flat(row: dict[str, Node], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield the dotted names of the values in a dict, and in the dicts in it."""
    for key, node in row.items():
        if isinstance(node, dict):
            yield from _flat(node, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", node


def _array(node: Any, values: Sequence[row_match.Values], rows: int) -> pa.Array:
    """Return the array of a field.

    Args:
        node: What the template says of it.
        values: Of the rows.
        rows: How many rows there are.
    """
    if isinstance(node, Leaf):
        array = value_arrays.of_values(node.member, [values[number] for number in node.values])
        is_list = node.member.slot.is_list and not node.member.slot.is_packed
        return value_arrays.listed(array, len(node.values), rows) if is_list else array
    return value_arrays.listed(_struct(node, values, rows * len(node)), len(node), rows)


def _struct(dicts: list[Any], values: Sequence[row_match.Values], rows: int) -> pa.Array:
    """Return an array of dicts that lie at several places of each row."""
    keys = list(dicts[0])
    if any(list(each) != keys for each in dicts):
        raise InexpressibleError
    children = []
    for key in keys:
        nodes = [each[key] for each in dicts]
        if isinstance(nodes[0], dict) and all(isinstance(node, dict) for node in nodes):
            children.append(_struct(nodes, values, rows))
        else:
            children.append(_array(_merged(nodes), values, rows))
    return pa.StructArray.from_arrays(children, keys)


def _merged(nodes: Sequence[Any]) -> Leaf:
    """Return the values of one field of several dicts as those of one field."""
    members: set[Member] = {node.member for node in nodes if isinstance(node, Leaf)}
    is_single = all(isinstance(node, Leaf) and len(node.values) == 1 for node in nodes)
    if not is_single or len(members) != 1:
        raise InexpressibleError
    member = members.pop()
    if member.slot.is_list and not member.slot.is_packed:
        raise InexpressibleError
    return Leaf(member, [number for node in nodes for number in node.values])


def _joined(forms: Sequence[RowForm], blocks: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the columns of several forms as columns of all their rows; None where a column is of no type."""
    if len(blocks) == 1:
        return blocks[0]
    order = np.argsort(np.concatenate([form.rows.which for form in forms]), kind="stable")
    indices = None if bool((np.diff(order) > 0).all()) else zero_copy.to_arrow(order)
    arrays: dict[str, Any] = {}
    for name in dict.fromkeys(name for block in blocks for name in block):
        parts = [
            Column(block[name] if name in block else pa.nulls(len(form.rows.which)))
            for form, block in zip(forms, blocks, strict=True)
        ]
        column = typed_columns.joined(parts)
        if column.is_text:
            return None
        array = typed_columns.whole(column.array)
        arrays[name] = array if indices is None else array.take(indices)
    return arrays


def _has_dots(row: dict[str, Any]) -> bool:
    """Whether a key has a dot in it."""
    nodes: Iterable[Any] = row.values()
    inner = [each for node in nodes for each in (node if isinstance(node, list) else [node]) if isinstance(each, dict)]
    return any("." in key for key in row) or any(map(_has_dots, inner))


def _is_plain(array: Any) -> bool:
    """Whether an array has no bytes, no numbers that are not finite, and no element of an unknown type."""
    type_ = array.type
    if pa.types.is_float64(type_):
        return bool(pc.all(pc.is_finite(array)).as_py() is not False)
    if pa.types.is_struct(type_):
        return all(map(_is_plain, array.flatten()))
    if type_.num_fields:
        return _is_plain(array.flatten())
    return bool(pa.types.is_string(type_) or pa.types.is_boolean(type_) or type_ in (pa.int64(), pa.uint64()))
