"""No row that `append` takes costs the writer more than a bounded multiple of it, or stops the writer."""

from __future__ import annotations

import json
import logging
import random
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ml_dash_mcap import Recorder, RecorderOptions, Recording
from ml_dash_mcap.capture import prepare_block, row_forms, segment_sink
from ml_dash_mcap.codecs import json_forms, json_skeleton
from ml_dash_mcap.codecs.json_skeleton import Skeletons
from ml_dash_mcap.rows import schema
from tests.support import disk
from tests.support.case_ids import stable_repr
from tests.support.examples import examples

MIB = 1024 * 1024

_CHILD = """
import json, resource, sys
from pathlib import Path
import numpy as np
import orjson, zstandard
from ml_dash_mcap import Recorder, RecorderOptions

def memory(name):
    return int(Path("/proc/self/status").read_text().split(name + ":")[1].split()[0]) * 1024

folder, spare = sys.argv[1], int(sys.argv[2])
options = RecorderOptions(sync_interval_s=0, chunk_bytes=1_500_000, backlog_bytes=32 * 1024 * 1024)
with Recorder(folder, options) as recorder:
    topic = recorder.topic("a")
    for number in range(20):
        topic.append(x=float(number), _ts=0.001 * number)
    recorder.flush()
    resource.setrlimit(resource.RLIMIT_AS, (memory("VmSize") + spare,) * 2)
    time_s = 1.0
{program}
stats = recorder.stats()
print(json.dumps([stats["accepted"], stats["written"], stats["failure"], stats["fallbacks"], memory("VmHWM")]))
"""


def child(folder: Path, program: str, spare: int) -> tuple[int, dict[str, int]]:
    """Run a program of appends in a process that gets so much memory besides what it has; what it wrote and counted."""
    source = _CHILD.replace("{program}", textwrap.indent(textwrap.dedent(program), "    "))
    ended = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", source, str(folder), str(spare)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr[-3000:]
    accepted, written, failure, fallbacks, _ = json.loads(ended.stdout)
    assert (written, failure) == (accepted, None)
    assert list(folder.glob("*.active")) == []
    return written, fallbacks


PROGRAMS: dict[str, str] = {
    "three long texts, then small rows": """
        for number in range(3):
            topic.append(x="x" * 1_000_000, _ts=time_s + number)
            recorder.flush()
        for number in range(10_000):
            topic.append(x=number + 0.5, _ts=time_s + 10 + number)
    """,
    "texts of all lengths": """
        for number in range(600):
            topic.append(x="ab" * (number * 50), _ts=time_s + number)
    """,
    "words that all differ": """
        chance = __import__("random").Random(1)
        for number in range(3000):
            word = "".join(chance.choices("abcdefgh", k=8))
            topic.append(x=word * (number % 400), _ts=time_s + number)
    """,
    "quotes, which are escaped": """
        for number in range(60):
            topic.append(x='"' * 100_000, _ts=time_s + number)
    """,
    "NaN in each row": """
        for number in range(15_000):
            topic.append(x=float("nan"), n=number, _ts=time_s + number)
    """,
    "keys that differ in each row": """
        for number in range(15_000):
            topic.append(**{f"k{number}": 1}, _ts=time_s + number)
    """,
    "thousands of fields": """
        for number in range(40):
            topic.append(**{f"f{field}": field + 0.5 for field in range(6000)}, _ts=time_s + number)
    """,
    "thousands of fields in dicts, all different": """
        for number in range(40):
            row = {f"{number}_{field}": {str(key): key for key in range(60)} for field in range(100)}
            topic.append(x=row, _ts=time_s + number)
    """,
    "long keys": """
        for number in range(60):
            topic.append(**{"k" * 100_000 + str(number): 1}, _ts=time_s + number)
    """,
    "deep nesting": """
        for number in range(2000):
            value = number
            for level in range(150):
                value = [value] if level % 2 else {"a": value}
            topic.append(x=value, _ts=time_s + number)
    """,
    "many topics": """
        topics = [recorder.topic(f"t{number}") for number in range(3000)]
        for number in range(6):
            for one in topics:
                one.append(x=number, text="x" * number, _ts=time_s + number)
    """,
    "many topics with long rows": """
        topics = [recorder.topic(f"t{number}") for number in range(300)]
        for number in range(3):
            for one in topics:
                one.append(x="x" * 60_000, _ts=time_s + number)
    """,
    "rows of one time": """
        for number in range(8000):
            topic.append(**{f"f{number % 50}": number}, _ts=time_s + number // 1000)
    """,
}


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("name", PROGRAMS)
def test_ordinary_input_is_written_in_little_memory(tmp_path: Path, name: str) -> None:
    """The limit: 64 blocks of 1.5 MB, and 32 MB for what the allocator keeps."""
    assert child(tmp_path / "run", PROGRAMS[name], 128 * MIB)[1] == {}


_HUGE = """
import sys
from pathlib import Path
import orjson
from ml_dash_mcap import Recorder

def peak():
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) * 1024

with Recorder(sys.argv[1]) as recorder:
    topic = recorder.topic("a")
    topic.append(x=1, _ts=0.5)
    recorder.flush()
    value = VALUE
    orjson.dumps({"x": value})
    before = peak()
    topic.append(x=value, y=1, _ts=1.0)
    recorder.flush()
    for number in range(10_000):
        topic.append(x=number + 0.5, _ts=2.0 + number)
print(recorder.stats()["written"], recorder.stats()["failure"], recorder.stats()["fallbacks"], peak() - before)
"""


@pytest.mark.about_json
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(
    "value", ["'x' * SIZE", "'\"a' * (SIZE // 3)", "[[]] * (SIZE // 3)", "[{}] * (SIZE // 3)", "[0.5] * (SIZE // 4)"]
)
def test_one_huge_row_costs_a_small_multiple_of_it(tmp_path: Path, value: str) -> None:
    """A row of 20 MB: append and its journal have four copies of it, the writer decodes no millions of values."""
    size = 20_000_000
    source = _HUGE.replace("VALUE", value.replace("SIZE", str(size)))
    command = [sys.executable, "-X", "faulthandler", "-c", source, str(tmp_path / "run")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr[-3000:]
    written, failure, fallbacks, peak = ended.stdout.split()
    assert (written, failure, fallbacks) == ("10002", "None", "{}")
    assert int(peak) < 10 * size
    properties = json.loads(disk.channel(tmp_path / "run", "a")[1].data)["properties"]
    assert properties == {"y": {"type": "integer"}, "_ts": {"type": "number"}}  # x is text or a list, and numbers


mixes = st.lists(
    st.tuples(
        st.sampled_from(["text", "quotes", "floats", "nan", "bytes", "keys", "dicts"]),
        st.sampled_from([1, 30, 1000, 30_000, 300_000]),
        st.integers(1, 5),
        st.booleans(),
    ),
    min_size=1,
    max_size=6,
)

_MIX = """
chance = __import__("random").Random(5)
make = {
    "text": lambda size: "x" * chance.randrange(size),
    "quotes": lambda size: '"' * (size // 2),
    "floats": lambda size: [0.5] * (size // 4),
    "nan": lambda size: [float("nan")] * (size // 10),
    "bytes": lambda size: chance.randbytes(size),
    "keys": lambda size: {str(chance.random()): 1 for _ in range(size // 20)},
    "dicts": lambda size: [{"a": {}}] * (size // 10),
}
for kind, size, count, flushes in MIX:
    for _ in range(count * max(1, min(500, 100_000 // size))):
        topic.append(x=make[kind](size), _ts=time_s)
        time_s += 1
    if flushes:
        recorder.flush()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@settings(max_examples=examples(8), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(mixes)
def test_any_mix_of_rows_is_written_in_a_bounded_multiple_of_the_block(
    tmp_path_factory: pytest.TempPathFactory, mix: list[Any]
) -> None:
    folder = tmp_path_factory.mktemp("mix") / "run"
    assert child(folder, _MIX.replace("MIX", repr(mix)), 128 * MIB)[1] == {}


@settings(max_examples=examples(10), deadline=None)
@given(st.lists(st.sampled_from(["a", "b"]).flatmap(lambda key: st.tuples(st.just(key), st.text(max_size=5)))))
def test_what_is_remembered_of_forms_is_bounded(pairs: list[tuple[str, str]]) -> None:
    skeletons = Skeletons()
    for number in range(400):
        skeletons.begin_block()
        for key, text in pairs or [("a", "")]:
            skeletons.learn(json.dumps({f"{key}{number}": text * 3000}).encode())
        assert len(skeletons.forms) <= 1024 + len(pairs)
        assert skeletons.size <= 2 * MIB


# What fails on the way for many rows at once


def appended(folder: Path) -> dict[str, Any]:
    """Append rows of many kinds, close, and return the recorder's figures."""
    recorder = Recorder(folder, RecorderOptions(flush_interval_s=60))
    for number in range(50):
        recorder.topic("a").append(x=number, q=[0.5], _ts=float(number))
        recorder.topic("a").append(y="text", x=number + 0.5, _ts=float(number))
        recorder.topic("b").append(z=[float("nan"), 1.0], _ts=float(number))
    recorder.close()
    return recorder.stats()


def contents(folder: Path) -> tuple[Any, Any]:
    with Recording(folder) as recording:
        rows = {topic: [repr(row) for row in recording[topic].rows()] for topic in recording.topics}
    return rows, {topic: json.loads(disk.channel(folder, topic)[1].data) for topic in rows}


def raises(error: Exception) -> Callable[..., Any]:
    def call(*_: Any, **__: Any) -> Any:
        raise error

    return call


FAILURES = {
    "telling the forms of a block's rows": (json_forms, "guess"),
    "merging the rows of a block": (row_forms.RowForms, "keys_of"),
    "compressing a chunk": (segment_sink, "compressor"),
}


@pytest.mark.parametrize("error", [MemoryError(), ValueError("odd"), RecursionError()], ids=stable_repr)
@pytest.mark.parametrize("what", FAILURES)
def test_what_fails_for_a_block_is_done_row_by_row_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, what: str, error: Exception
) -> None:
    assert appended(tmp_path / "well")["fallbacks"] == {}
    place, name = FAILURES[what]
    failing = raises(error)
    if name == "compressor":
        failing.name = "zstd"  # type: ignore[attr-defined]
        monkeypatch.setattr(place, name, lambda _: failing)
    else:
        monkeypatch.setattr(place, name, failing)
    with caplog.at_level(logging.WARNING):
        stats = appended(tmp_path / "ill")
    assert stats["written"] == stats["accepted"] == 150
    assert stats["failure"] is None
    assert stats["fallbacks"] == {what: stats["fallbacks"][what]}
    assert [record.message for record in caplog.records if record.message.startswith(what)] != []
    monkeypatch.undo()
    assert contents(tmp_path / "ill") == contents(tmp_path / "well")


def test_rows_that_cannot_be_merged_are_written_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    appended(tmp_path / "well")
    monkeypatch.setattr("ml_dash_mcap.codecs.json_merge.join", raises(MemoryError()))
    monkeypatch.setattr("ml_dash_mcap.codecs.json_cuts.cuts", raises(MemoryError()))
    stats = appended(tmp_path / "ill")
    assert stats["fallbacks"] == {"merging the rows of a block": 1, "merging rows of one time": 50}
    assert len(list(disk.payloads(tmp_path / "ill"))) == 150
    monkeypatch.undo()
    assert contents(tmp_path / "ill")[0] == contents(tmp_path / "well")[0]


def test_a_row_that_cannot_be_decoded_again_is_kept_without_a_schema(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    appended(tmp_path / "well")
    monkeypatch.setattr(json_skeleton, "restore_kinds", raises(MemoryError()))
    stats = appended(tmp_path / "ill")
    assert stats["written"] == 150
    assert stats["fallbacks"]["decoding a row"] == 150
    monkeypatch.undo()
    assert contents(tmp_path / "ill")[0] == contents(tmp_path / "well")[0]
    assert contents(tmp_path / "ill")[1]["a"]["properties"] == {"_ts": {"type": "number"}}


def test_a_schema_that_cannot_be_made_is_an_empty_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = schema.to_json
    monkeypatch.setattr(
        schema, "to_json", lambda shape, title: raises(ValueError("odd"))() if shape.kinds else made(shape, title)
    )
    stats = appended(tmp_path / "run")
    assert stats["written"] == 150
    assert set(stats["fallbacks"]) == {"making a topic's schema"}
    assert len(contents(tmp_path / "run")[0]["a"]) == 50


def test_memory_that_is_short_for_a_while_keeps_rows_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = 0
    pack = prepare_block.pack

    def scarce(block: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls < 3:
            raise MemoryError
        return pack(block)

    monkeypatch.setattr(prepare_block, "pack", scarce)
    assert appended(tmp_path / "run")["written"] == 150
    assert calls >= 3


@pytest.mark.about_json
def test_fields_beyond_what_a_schema_says_still_arrive(tmp_path: Path) -> None:
    chance = random.Random(3)
    row = {"".join(chance.choices("abcdefgh", k=200)): number for number in range(5000)} | {"k" * 5000: 1}
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(**row, _ts=1.0)
    with Recording(tmp_path) as recording:
        assert list(recording["a"].rows()) == [{**row, "_ts": 1.0}]
    properties = json.loads(disk.channel(tmp_path, "a")[1].data)["properties"]
    assert 2000 < len(properties) <= schema.MAX_FIELDS
    assert sum(map(len, properties)) <= 512 * 1024
