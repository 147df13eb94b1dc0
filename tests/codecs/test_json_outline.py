"""The outline of a row is the row with its lists and dicts emptied."""

from __future__ import annotations

from typing import Any
from unittest import mock

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.codecs import json_outline
from tests.support.examples import examples

texts = st.text(st.sampled_from('ab"\\[]{},:\n\u00e4'), max_size=6)
values = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats(allow_nan=False, allow_infinity=False) | texts,
    lambda one: st.lists(one, max_size=3) | st.dictionaries(texts, one, max_size=3),
    max_leaves=10,
)


@pytest.mark.parametrize("at_once", [1, 7, 1024])
@settings(max_examples=examples(150), deadline=None)
@given(row=st.dictionaries(texts, values, max_size=5))
def test_the_outline_is_the_row_with_its_containers_emptied(row: dict[str, Any], at_once: int) -> None:
    with mock.patch.object(json_outline, "_AT_ONCE", at_once):
        found = orjson.loads(json_outline.of(orjson.dumps(row)))
    assert found == {name: type(value)() if isinstance(value, (list, dict)) else value for name, value in row.items()}
