"""Nested rows become dotted columns and back to what was asked for, and no field is lost on the way."""

import pytest

from ml_dash_mcap.errors import UsageError
from ml_dash_mcap.rows.dotted import flatten
from ml_dash_mcap.rows.field_choice import check_columns, project

ROW = {"q": [1, 2], "cam": {"pos": [0], "lens": {"f": 35}}, "a.b": 1, "_ts": 0.5}


def test_nested_dicts_become_dotted_names_and_the_time_comes_first():
    assert list(flatten(ROW, "timestamp").items()) == [
        ("timestamp", 0.5),
        ("q", [1, 2]),
        ("cam.pos", [0]),
        ("cam.lens.f", 35),
        ("a.b", 1),
    ]


def test_a_field_named_like_the_time_column_is_kept_under_fields():
    assert flatten({"timestamp": 9, "q": 1, "_ts": 0.5}, "timestamp") == {
        "timestamp": 0.5,
        "fields.timestamp": 9,
        "q": 1,
    }


def test_a_nested_field_does_not_overwrite_a_field_with_a_dot_in_its_name():
    assert flatten({"a.b": 1, "a": {"b": 2}, "_ts": 0.5}, "timestamp") == {"timestamp": 0.5, "a.b": 1, "a.b#2": 2}


def test_an_empty_dict_is_kept():
    assert flatten({"a": {}, "b": {"c": {}}, "_ts": 0.5}, "t") == {"t": 0.5, "a": {}, "b.c": {}}


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (["q"], {"q": [1, 2]}),
        (["cam"], {"cam": {"pos": [0], "lens": {"f": 35}}}),
        (["cam.lens"], {"cam": {"lens": {"f": 35}}}),
        (["cam.lens.f", "cam.pos"], {"cam": {"lens": {"f": 35}, "pos": [0]}}),
        (["cam.pos", "cam"], {"cam": {"pos": [0], "lens": {"f": 35}}}),
        (["cam", "cam.pos"], {"cam": {"pos": [0], "lens": {"f": 35}}}),
        (["a.b"], {"a.b": 1}),
        (["absent", "cam.absent", "q.x"], {}),
        (["_ts"], {}),
    ],
)
def test_columns_reach_into_nested_dicts_and_absent_ones_are_left_out(columns, expected):
    assert project(ROW, columns) == {**expected, "_ts": 0.5}


def test_the_name_that_a_hidden_field_comes_back_under_also_chooses_it():
    assert project({"timestamp": 9, "_ts": 0.5}, ["fields.timestamp"]) == {"timestamp": 9, "_ts": 0.5}


def test_choosing_columns_changes_nothing_in_the_row():
    before = repr(ROW)
    project(ROW, ["cam.pos", "cam.lens.f"])["cam"]["new"] = 1
    assert repr(ROW) == before


def test_an_empty_list_of_columns_means_all():
    assert check_columns([]) is None
    assert check_columns(None) is None
    assert check_columns(("q",)) == ["q"]


@pytest.mark.parametrize("columns", ["q", b"q", [1], ["q", None]])
def test_columns_that_are_no_list_of_names_are_a_type_error(columns):
    with pytest.raises(UsageError) as caught:
        check_columns(columns)
    assert isinstance(caught.value, TypeError)
