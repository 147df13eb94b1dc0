"""What the writer learns of rows by looking at their bytes is what a look at each of their values tells."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ml_dash_mcap.options import RecorderOptions
from ml_dash_mcap.recorder import Recorder
from ml_dash_mcap.rows import schema
from ml_dash_mcap.rows.value_shapes import of_values
from tests.support import disk
from tests.support.examples import examples

Row = dict[str, Any]

keys = st.sampled_from(
    ["q", "q1", "q2", "e", "1e5", "-", "a/b", "a b", "\\", '"', "\n", "x:", ",", "[", "{}", "null", "\u00e4"]
)
numbers = st.sampled_from([0, 1, -1, 116, 2**63, 0.5, -0.5, 1e16, 1e-7, 1.5e300, 1e22, math.nan, math.inf])
texts = st.sampled_from(
    [
        "",
        "1",
        "1e5",
        "-",
        "e",
        "a1",
        "a2",
        '"',
        "\\",
        '\\"',
        '":1,"q2":"',
        "\n",
        "\x1f",
        "\u00e4",
        "null",
        "[]",
        "x" * 30,
    ]
)
scalars = st.none() | st.booleans() | numbers | texts | st.sampled_from([b"", b"\0", b"abc"])
values = st.recursive(
    scalars, lambda one: st.lists(one, max_size=3) | st.dictionaries(keys, one, max_size=2), max_leaves=5
)
rows = st.dictionaries(keys, values, max_size=4)
blocks = st.lists(st.lists(st.tuples(st.sampled_from("ab"), rows), max_size=6), max_size=4)


@given(blocks)
@settings(
    deadline=None,
    max_examples=examples(150),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@example([[("a", {"q1": 1}), ("a", {"q2": 1})]])
@example([[("a", {"q": 116}), ("a", {"q": 1e16})]])
@example([[("a", {"q": [1]}), ("a", {"q": []})]])
@example([[("a", {"q": []}), ("a", {"q": [1]})]])
@example([[("a", {"q1": math.nan, "q2": None}), ("a", {"q1": None, "q2": math.nan})]])
@example([[("a", {"q": {"q1": math.nan, "q2": None}}), ("a", {"q": {"q1": None, "q2": math.nan}})]])
@example([[("a", {"q": b"abc"}), ("a", {"q": "YWJj"})]])
@example([[("a", {"q": 1}), ("b", {"q": 0.5}), ("a", {"q": 0.5}), ("b", {"q": 1})]])
@example([[("a", {"q": '"', "q1": 1})], [("a", {"q": '"', "q2": 1})]])
@example([[("a", {"q": "\\", "e": 1})], [("a", {"q": "\\", "q2": 1})]])
def test_the_schema_in_the_file_is_the_one_that_a_look_at_every_row_gives(
    tmp_path_factory: pytest.TempPathFactory, drawn: list[list[tuple[str, Row]]]
) -> None:
    folder = tmp_path_factory.mktemp("skeleton")
    options = RecorderOptions(flush_interval_s=60, sync_interval_s=0, chunk_bytes=65536, backlog_bytes=131072)
    seen: dict[str, list[Row]] = {}
    with Recorder(folder, options) as recorder:
        time = 0.0
        for block in drawn:
            for topic, row in block:
                time += 1.0
                recorder.topic(topic).append(**row, _ts=time)
                seen.setdefault(topic, []).append({**row, "_ts": time})
            recorder.flush()
    for topic, listed in seen.items():
        assert in_file(folder, topic) == schema.to_json(of_values(listed), topic)


def in_file(folder: Path, topic: str) -> Any:
    return json.loads(disk.channel(folder, topic)[1].data)


@given(st.lists(st.tuples(rows, st.sampled_from([1.0, 2.0])), max_size=8))
@settings(
    deadline=None,
    max_examples=examples(150),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_merging_in_the_writer_gives_valid_json_without_a_key_twice(
    tmp_path_factory: pytest.TempPathFactory, drawn: list[tuple[Row, float]]
) -> None:
    folder = tmp_path_factory.mktemp("merging")
    with Recorder(
        folder, RecorderOptions(flush_interval_s=60, sync_interval_s=0, chunk_bytes=65536, backlog_bytes=131072)
    ) as recorder:
        for row, time in drawn:
            recorder.topic("a").append(**row, _ts=time)
    for _, payload in disk.payloads(folder):
        json.loads(payload, object_pairs_hook=without_repetition)


def without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    assert len({key for key, _ in pairs}) == len(pairs), f"a key stands in a payload twice: {pairs}"
    return dict(pairs)


def test_many_forms_of_one_length_do_not_confuse_the_writer(tmp_path: Path) -> None:
    letters = [chr(ord("a") + number) for number in range(26)]
    names = [one + other for one in letters for other in letters]
    with Recorder(tmp_path) as recorder:
        for turn in range(3):
            for number, name in enumerate(names):
                recorder.topic("a").append(**{name: turn + 0.5 * (turn == 2)}, _ts=float(turn * 1000 + number))
            recorder.flush()
    properties = in_file(tmp_path, "a")["properties"]
    assert {name: properties.get(name) for name in names} == {name: {"type": "number"} for name in names}


def test_long_texts_that_all_differ_are_learned_without_keeping_them(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        for number in range(300):
            recorder.topic("a").append(
                image=bytes([number % 256]) * 5000, text="xyz"[number % 3] * 5000, n=number, _ts=float(number)
            )
        recorder.topic("a").append(n=0.5, _ts=1e3)
    assert in_file(tmp_path, "a")["properties"] == {
        "image": {"type": "string", "contentEncoding": "base64"},
        "text": {"type": "string"},
        "n": {"type": "number"},
        "_ts": {"type": "number"},
    }
