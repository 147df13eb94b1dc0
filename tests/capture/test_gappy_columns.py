"""Columns with gaps and dicts become the rows that a loop over append would have made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from ml_dash_mcap.capture import column_input as bulk
from ml_dash_mcap.codecs import cbor, json
from ml_dash_mcap.errors import FieldError
from ml_dash_mcap.mcap.message_records import MESSAGE_HEAD_BYTES
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.recording import Recording

HEAD = b"\x01\0\0\0\0\0"


def rows_of(times: Any, columns: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows that columns are encoded as, the same in every encoding."""
    in_json, in_cbor = (encoded_and_decoded(module, times, columns) for module in (json, cbor))
    assert repr(in_cbor) == repr(in_json)
    return in_json


def encoded_and_decoded(module: Any, times: Any, columns: dict[str, Any]) -> list[dict[str, Any]]:
    rows = []
    for encoded in bulk.encode(times, columns, "t", HEAD, module.CODEC):
        ends = [*encoded.starts[1:].tolist(), len(encoded.records)]
        rows += [
            module.decode(encoded.records[a + MESSAGE_HEAD_BYTES : b])
            for a, b in zip(encoded.starts.tolist(), ends, strict=True)
        ]
    return rows


def masked(values: Any, mask: Any) -> Any:
    return np.ma.MaskedArray(np.array(values, float), np.array(mask, bool))


def test_a_row_that_is_masked_lacks_the_field(tmp_path: Path) -> None:
    pos = masked([[1, 2, 3], [4, 5, 6]], [[0, 0, 0], [1, 1, 1]])
    with Recorder(tmp_path) as recorder:
        recorder.topic("m").append_columns(_ts=[0.0, 1.0], pos=pos, n=np.array([7, 8]))
    with Recording(tmp_path) as recording:
        assert list(recording["m"].rows()) == [{"pos": [1, 2, 3], "n": 7, "_ts": 0.0}, {"n": 8, "_ts": 1.0}]


def test_a_number_that_is_masked_beside_others_is_none() -> None:
    assert rows_of([0.0], {"p": masked([[1, 2, 3]], [[0, 1, 0]])}) == [{"p": [1.0, None, 3.0], "_ts": 0.0}]


def test_a_dict_of_arrays_is_a_dict_in_each_row_and_left_out_where_it_would_be_empty() -> None:
    markers = {"a,}": masked([[1, 2], [3, 4]], [[0, 0], [1, 1]]), "b": {"c": masked([5, 6], [0, 1])}}
    assert rows_of([0.0, 1.0], {"markers": markers}) == [
        {"markers": {"a,}": [1.0, 2.0], "b": {"c": 5.0}}, "_ts": 0.0},
        {"_ts": 1.0},
    ]


def test_what_is_not_finite_and_not_masked_is_kept() -> None:
    pos = masked([[1, np.nan], [np.inf, 2]], [[1, 0], [0, 0]])
    first, second = rows_of([0.0, 1.0], {"p": pos})
    assert first["p"][0] is None
    assert np.isnan(first["p"][1])
    assert second["p"] == [np.inf, 2.0]


@given(
    st.integers(1, 20).flatmap(lambda n: st.tuples(arrays.arrays(np.int64, (n, 2)), arrays.arrays(np.bool_, (n, 2))))
)
def test_integers_keep_all_their_bits(drawn: Any) -> None:
    values, mask = drawn
    rows = rows_of(np.arange(float(len(values))), {"n": np.ma.MaskedArray(values, mask)})
    for row, numbers, gaps in zip(rows, values.tolist(), mask.tolist(), strict=True):
        expected = [None if gap else number for number, gap in zip(numbers, gaps, strict=True)]
        assert row.get("n") == (None if all(gaps) else expected)


@pytest.mark.parametrize("beside", [["a"], "ab", np.array([1.0]), np.array(1.0), {"k": np.array([1.0])}, {"k": []}, {}])
def test_a_column_that_does_not_fit_beside_is_refused(beside: Any, tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder, pytest.raises(FieldError, match="'other"):
        recorder.topic("m").append_columns(_ts=[0.0, 1.0], p=masked([1, 2], [0, 1]), other=beside)


@pytest.mark.parametrize("shape", [(2, 0), (2, 0, 3), (2, 3, 0)])
def test_an_array_without_elements_stands_beside_a_dict(tmp_path: Path, shape: tuple[int, ...]) -> None:
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append_columns(_ts=[0.0, 1.0], empty=np.zeros(shape), beside={"n": np.array([1, 2])})
    with Recording(tmp_path) as recording:
        rows = list(recording["a"].rows())
    empty = np.zeros(shape).tolist()
    assert rows == [{"empty": empty[n], "beside": {"n": n + 1}, "_ts": float(n)} for n in range(2)]
