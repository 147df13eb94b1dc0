"""The parameters of a run: flattened, merged, kept, and there again when the run goes on."""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import math
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ml_dash_mcap.errors import FieldError, UsageError
from ml_dash_mcap.experiment import Experiment
from ml_dash_mcap.recording import Recording
from ml_dash_mcap.run.parameters import flatten, nest
from tests.support import disk
from tests.support.case_ids import stable_repr


@pytest.fixture
def exp(tmp_path: Path) -> Iterator[Experiment]:
    with Experiment("a/b", root=tmp_path).run as started:
        yield started


def on_disk(exp: Experiment) -> dict[str, Any]:
    exp.run.complete()
    merged: dict[str, str] = {}
    for record in disk.metadata(exp.path, "ml_dash.parameters"):
        merged.update(record)
    return {name: json.loads(text) for name, text in merged.items()}


def test_nested_parameters_get_dotted_names_and_later_calls_merge(exp: Experiment) -> None:
    assert exp.params.set(model={"lr": 0.001, "layers": 4}, optimizer="adam") is exp.params
    exp.params.log(model={"lr": 0.01})
    expected = {"model.lr": 0.01, "model.layers": 4, "optimizer": "adam"}
    assert exp.params.get() == exp.params.get(flatten=True) == expected
    assert exp.params.get(flatten=False) == {"model": {"lr": 0.01, "layers": 4}, "optimizer": "adam"}
    assert on_disk(exp) == expected


@dataclasses.dataclass
class Config:
    lr: float = 0.1
    layers: int = 4


@pytest.mark.parametrize(
    "values",
    [
        {"lr": 0.1, "layers": 4},
        collections.OrderedDict(lr=0.1, layers=4),
        Config(),
        Config,
        argparse.Namespace(lr=0.1, layers=4),
        types.SimpleNamespace(lr=0.1, layers=4),
    ],
    ids=stable_repr,
)
def test_parameters_may_come_in_a_dict_or_what_is_like_one(exp: Experiment, values: Any) -> None:
    assert exp.params.set(values, layers=5) is exp.params, "names win over the dict"
    exp.params.log({"model": {"self": 1, "values": 2}}, nested=values)
    expected = {"lr": 0.1, "layers": 5, "model.self": 1, "model.values": 2, "nested.lr": 0.1, "nested.layers": 4}
    assert exp.params.get() == expected
    assert on_disk(exp) == expected


@pytest.mark.parametrize("values", [5, "lr", [("lr", 0.1)], object()], ids=stable_repr)
def test_parameters_in_what_is_no_dict_are_refused(exp: Experiment, values: Any) -> None:
    with pytest.raises(UsageError, match="pass a dict, or values by name"):
        exp.params.set(values)
    assert exp.params.get() == {}


@pytest.mark.parametrize(
    "values", [{1: "a", "1": "b"}, {"a.b": 1, "a": {"b": 2}}, {"x": {1: 2, "1": 3}}], ids=stable_repr
)
def test_two_parameters_that_get_one_name_are_refused(exp: Experiment, values: Any) -> None:
    with pytest.raises(FieldError, match="two parameters are called"):
        exp.params.set(values)
    assert exp.params.get() == {}


def test_dotted_names_may_be_given_as_such(exp: Experiment) -> None:
    exp.params.set(**{"model.lr": 0.1})
    assert exp.params.get(flatten=False) == {"model": {"lr": 0.1}}


def test_parameters_are_on_the_disk_when_the_process_reads_them_while_recording(exp: Experiment) -> None:
    exp.params.set(lr=0.1)
    exp.flush()
    with Recording(exp.path) as recording:
        assert recording.params == {"lr": 0.1}


def test_a_run_that_goes_on_has_the_parameters_of_the_earlier_one(tmp_path: Path) -> None:
    with Experiment("a/b", root=tmp_path).run as exp:
        exp.params.set(lr=0.1, model={"layers": 4})
    with Experiment("a/b", root=tmp_path).run as exp:
        assert exp.params.get() == {"lr": 0.1, "model.layers": 4}
        exp.params.set(lr=0.2)
        assert exp.params.get() == {"lr": 0.2, "model.layers": 4}
    assert on_disk(exp) == {"lr": 0.2, "model.layers": 4}


def test_numpy_values_tuples_dataclasses_and_classes_are_taken(exp: Experiment) -> None:
    @dataclasses.dataclass
    class Optimizer:
        name: str
        betas: tuple[float, float]

    class Args:
        batch_size = 64
        _private = 1

        def method(self) -> None: ...

    exp.params.set(lr=np.float64(0.1), steps=np.int64(5), gains=np.arange(3), on=np.bool_(True), shape=(1, 2))
    exp.params.set(optimizer=Optimizer("adam", (0.9, 0.99)), Args=Args)
    expected = {
        "lr": 0.1,
        "steps": 5,
        "gains": [0, 1, 2],
        "on": True,
        "shape": [1, 2],
        "optimizer.name": "adam",
        "optimizer.betas": [0.9, 0.99],
        "Args.batch_size": 64,
    }
    assert exp.params.get() == expected
    assert on_disk(exp) == expected


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_kept(tmp_path: Path, value: float) -> None:
    with Experiment("a/b", root=tmp_path).run as exp:
        exp.params.set(limit=value)
        assert repr(exp.params.get()["limit"]) == repr(value)
    with Experiment("a/b", root=tmp_path).run as exp:
        assert repr(exp.params.get()["limit"]) == repr(value)


def test_a_parameter_that_cannot_be_stored_is_named_and_nothing_of_its_call_is_taken(exp: Experiment) -> None:
    with pytest.raises(FieldError, match=r"model\.bad"):
        exp.params.set(good=1, model={"bad": object()})
    assert exp.params.get() == {}
    assert on_disk(exp) == {}


def test_what_get_returns_is_a_copy(exp: Experiment) -> None:
    given_list = [1, 2]
    exp.params.set(gains=given_list, empty={})
    given_list.append(3)
    exp.params.get()["gains"].append(4)
    exp.params.get(flatten=False)["empty"]["x"] = 5
    assert exp.params.get() == {"gains": [1, 2], "empty": {}}


def test_a_name_inside_another_one_s_plain_value_stays_dotted(exp: Experiment) -> None:
    exp.params.set(**{"a": 1, "a.b": 2, "a.b.c": 3, "d": {}, "d.e": 4})
    assert exp.params.get(flatten=False) == {"a": 1, "a.b": 2, "a.b.c": 3, "d": {"e": 4}}


def test_setting_nothing_changes_nothing(exp: Experiment) -> None:
    exp.params.set()
    assert exp.params.get() == {}


nested = st.recursive(
    st.integers() | st.text() | st.none(),
    lambda inner: st.dictionaries(st.text("abc", min_size=1), inner, max_size=3),
    max_leaves=10,
)


@given(st.dictionaries(st.text("abc", min_size=1), nested))
def test_nest_undoes_flatten(values: dict[str, Any]) -> None:
    assert nest(flatten(values)) == values


@given(st.dictionaries(st.text("ab.", min_size=1).filter(lambda name: ".." not in f".{name}."), st.integers()))
def test_nesting_keeps_every_value(flat: dict[str, int]) -> None:
    assert flatten(nest(flat)) == flat
