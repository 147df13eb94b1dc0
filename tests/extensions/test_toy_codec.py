"""An encoding that is added in this file alone; and whichever method of a codec fails, the recording goes on."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ml_dash_mcap import Experiment, Recorder, RecorderOptions, Recording
from ml_dash_mcap.codecs import codec_table
from ml_dash_mcap.codecs import json as json_codec
from ml_dash_mcap.codecs.encoded_channel import Row
from ml_dash_mcap.codecs.own_rows import own_schema
from ml_dash_mcap.codecs.row_codec import RowCodec
from ml_dash_mcap.errors import OptionError, TopicError, UndecodedWarning
from ml_dash_mcap.mcap.file_reader import McapFile
from ml_dash_mcap.mcap.records import Schema
from ml_dash_mcap.recovery.unfinished_segments import finish
from ml_dash_mcap.rows.shape import Shape
from ml_dash_mcap.run import logs
from tests.support import disk

ENCODING = "toy"


# The encoding: rows as Python spells them, in hexadecimal digits; its schema lists the fields


def decode(payload: bytes) -> Row:
    text = bytes.fromhex(payload.decode()).decode()
    row: Row = eval(text, {"nan": float("nan"), "inf": float("inf")})
    return row


def encoded(row: Mapping[str, Any]) -> bytes:
    return repr(dict(row)).encode().hex().encode()


class ToyCodec(RowCodec):
    message_encoding = ENCODING
    schema_encoding = "toyschema"
    encode_row = staticmethod(encoded)
    decode = staticmethod(decode)

    def schema(self, shape: Shape | None, title: str) -> bytes:
        return ("" if shape is None else "\n".join(shape.fields)).encode() + b"\n"

    def padded(self, schema: bytes, length: int) -> bytes:
        return schema.ljust(length, b"\n")

    def mended(self, schema: bytes) -> bytes | None:
        return None if schema.isascii() else b"\n" * len(schema)


CODEC = ToyCodec()


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the encoding: a line in the table."""
    monkeypatch.setitem(codec_table.CODECS, ENCODING, __name__)


@pytest.mark.usefixtures("toys")
def test_a_toy_encoding_is_recorded_merged_read_and_exported(tmp_path: Path) -> None:
    with Recorder(tmp_path, RecorderOptions(encoding=ENCODING)) as recorder:
        arm, other = recorder.topic("arm"), recorder.topic("other", encoding="json")
        for n in range(50):
            arm.append(q=[n / 7, float("nan")], _ts=n / 10).append(grip=n, blob=b"\0", _ts=n / 10)
            other.append(n=n, _ts=n / 10)
        arm.append_columns(_ts=np.arange(100.0, 110.0), q=np.ones((10, 2)), late=np.arange(10))
        assert (arm.encoding, other.encoding) == (ENCODING, "json")
    channel, schema = disk.channel(tmp_path, "arm")
    assert (channel.message_encoding, schema.encoding, schema.data.split()) == (
        ENCODING,
        "toyschema",
        [b"q", b"_ts", b"grip", b"blob", b"late"],
    )
    rows = [{"q": [n / 7, float("nan")], "grip": n, "blob": b"\0", "_ts": n / 10} for n in range(50)]
    rows += [{"q": [1.0, 1.0], "late": n, "_ts": 100.0 + n} for n in range(10)]
    with Recording(tmp_path) as recording:
        assert [repr(row) for row in recording["arm"].rows()] == [repr(row) for row in rows]
        assert recording["arm"].to_arrow().column("grip").to_pylist()[:50] == list(range(50))
        assert recording.topics["arm"].encoding == ENCODING
        copy = recording["arm"].read(format="mcap")
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "a.mcap").write_bytes(copy)
    with Recording(tmp_path / "copy") as recording:
        assert [repr(row) for row in recording["arm"].rows()] == [repr(row) for row in rows]
        assert recording.topics["arm"].encoding == ENCODING


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize(
    ("encoding", "bare"),
    [("json", b'{"type":"object"}'), ("cbor", b'{"type":"object"}'), (ENCODING, b"")],
)
def test_a_schema_that_a_crash_cut_while_it_grew_is_replaced_by_one_without_fields(
    tmp_path: Path, encoding: str, bare: bytes
) -> None:
    path = active_segment(tmp_path, encoding)
    before = disk_schema(path)
    content = path.read_bytes()
    path.write_bytes(content.replace(before.data, (b"\xff" + before.data[1:])))
    with Recording(finish(path, ())) as recording:
        assert list(recording["arm"].rows()) == [{"grip": 1, "_ts": 1.0}]
    after = disk_schema(path.with_suffix(""))
    assert (after.data.strip(), len(after.data), after.encoding) == (bare, len(before.data), before.encoding)


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize("encoding", ["json", "cbor", "protobuf", ENCODING])
def test_a_whole_schema_stays_as_it_is_when_a_segment_is_finished(tmp_path: Path, encoding: str) -> None:
    path = active_segment(tmp_path, encoding)
    before = disk_schema(path)
    finish(path, ())
    assert disk_schema(path.with_suffix("")) == before


def test_an_encoding_with_schemas_of_its_own_that_does_not_know_torn_ones_keeps_them() -> None:
    class Plain(RowCodec):
        schema_encoding = "toyschema"
        encode_row = staticmethod(encoded)
        decode = staticmethod(decode)

    assert Plain().mended(b"no JSON") is None


@pytest.mark.parametrize(
    ("text", "length"), [(b"", None), (b"{", None), (b'{"a', 3), (b"[1]", 3), (b'{"type":"o' * 3, 30)]
)
def test_a_json_schema_is_mended_where_there_is_room(text: bytes, length: int | None) -> None:
    mended = json_codec.CODEC.mended(text)
    assert (None if mended is None else len(mended)) == length
    assert mended is None or json.loads(mended) in ({}, {"type": "object"})


def active_segment(folder: Path, encoding: str) -> Path:
    """Return a segment as a recorder that dies leaves it."""
    (folder / "dead").mkdir()
    with Recorder(folder / "run", RecorderOptions(encoding=encoding)) as recorder:
        recorder.topic("arm").append(grip=1, _ts=1.0).flush()
        [active] = (folder / "run").glob("*.active")
        return Path(shutil.copy(active, folder / "dead"))


def disk_schema(path: Path) -> Schema:
    file = McapFile(path)
    try:
        [schema] = file.index.schemas.values()
        return schema
    finally:
        file.close()


def test_an_encoding_that_nobody_knows_is_carried_as_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(codec_table.CODECS, ENCODING, __name__)
    with Recorder(tmp_path, RecorderOptions(encoding=ENCODING)) as recorder:
        recorder.topic("arm").append(n=1, _ts=1.0)
    monkeypatch.delitem(codec_table.CODECS, ENCODING)
    with Recording(tmp_path) as recording, pytest.warns(UndecodedWarning, match="encoding 'toy'"):
        assert list(recording["arm"].rows()) == [{"data": encoded({"n": 1, "_ts": 1.0}), "_ts": 1.0}]


@pytest.mark.parametrize("encoding", ["cbro", "cdr", "", 5, "JSON"])
def test_an_encoding_that_rows_cannot_be_recorded_in_is_refused(tmp_path: Path, encoding: Any) -> None:
    with pytest.raises(OptionError, match=r"encoding=.*(did you mean '(cbor|json)'|'json', 'cbor'|must be the name)"):
        Recorder(tmp_path / "run", RecorderOptions(encoding=encoding))
    assert not (tmp_path / "run").exists()
    with Recorder(tmp_path) as recorder, pytest.raises(OptionError, match="encoding="):
        recorder.topic("a", encoding=encoding)


def test_a_topic_keeps_its_encoding(tmp_path: Path) -> None:
    with Recorder(tmp_path) as recorder:
        topic = recorder.topic("a", encoding="cbor")
        assert recorder.topic("a") is recorder.topic("a", encoding="cbor") is topic
        with pytest.raises(TopicError, match="in the encoding 'cbor' already, not 'json'"):
            recorder.topic("a", encoding="json")


# A codec that fails


METHODS = (
    *("forms", "schema", "padded", "cut", "cuts", "keys_of", "time_of", "with_time", "join", "join_disjoint"),
    *("begin_block", "forget", "learn", "of_rows", "shape_of", "form_keys"),
)
"""What the writer thread asks a codec, and the forms of it."""

NOT_NEEDED = {"json": ("forget", "keys_of", "join_disjoint"), "toy": ("forget", "keys_of", "learn", "cuts")}
"""What the rows of these tests do not need, as long as nothing else fails."""


class Failing:
    """A codec that does what another does, but for one method, which fails."""

    def __init__(self, codec: Any, method: str, error: BaseException) -> None:
        self._codec, self._method, self._error = codec, method, error

    def for_channel(self, *about: Any, **more: Any) -> Any:
        return self

    def __getattr__(self, name: str) -> Any:
        if name == "forms" and self._method not in ("forms", *METHODS[:10]):
            return lambda: FailingForms(self._codec.forms(), self._method, self._error)
        real = getattr(self._codec, name)
        return failing(real, self._error) if name == self._method else real


class FailingForms:
    def __init__(self, forms: Any, method: str, error: BaseException) -> None:
        self._forms, self._error = forms, error
        self._method = "keys_of" if method == "form_keys" else method

    def __getattr__(self, name: str) -> Any:
        real = getattr(self._forms, name)
        return failing(real, self._error) if name == self._method else real


def failing(real: Callable[..., Any], error: BaseException) -> Callable[..., Any]:
    def call(*args: Any) -> Any:
        if args[:1] == (None,):  # the schema before the first row is asked for where the topic is opened
            return real(*args)
        raise error

    return call


class Undecodable(ToyCodec):
    """A codec of which rows come, and none goes back."""

    def __init__(self, error: BaseException) -> None:
        self.decode = failing(decode, error)


ERRORS = [ValueError("odd"), MemoryError(), RecursionError(), KeyError("x")]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("codec", [json_codec.CODEC, CODEC], ids=lambda codec: codec.message_encoding)
def test_a_codec_that_fails_loses_no_row_and_leaves_the_writer_alive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, codec: Any, method: str, error: BaseException
) -> None:
    stats = record_and_read(tmp_path, monkeypatch, Failing(codec, method, error))
    if method not in NOT_NEEDED[codec.message_encoding]:
        assert stats["fallbacks"]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_rows_that_the_writer_cannot_decode_are_all_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    assert record_and_read(tmp_path, monkeypatch, Undecodable(error))["fallbacks"]


def record_and_read(root: Path, monkeypatch: pytest.MonkeyPatch, codec: Any) -> Any:
    """Record with a codec that fails, read without it that no row is lost, and return the recorder's statistics."""
    with monkeypatch.context() as failing_codecs:
        failing_codecs.setattr(codec_table, "find", lambda encoding: codec)
        failing_codecs.setattr(logs, "own_schema", lambda *names: replace(own_schema(*names), codec=codec))
        with Experiment("a/b", root=root, options=RecorderOptions(flush_interval_s=60)).run as exp:
            exp.log("before the first row of a track")
            arm = exp.tracks("arm")
            for n in range(20):  # rows that merge by their bytes, after being decoded, and not at all
                arm.append(q=n, _ts=n / 10).append(w=0.5, _ts=n / 10).append(q=n + 1, _ts=n / 10).append(
                    q=0, _ts=n / 10 + 1e-12
                )
                arm.append(a=n, _ts=50.0 + n).append(b=n, _ts=50.0 + n)
            exp.flush()
            arm.append_columns(_ts=np.arange(80.0, 90.0), c=np.arange(10))
            arm.append(last=True, late=[0.5], _ts=100.0).flush()
            stats = exp.stats()
            assert stats["written"] == stats["accepted"]
            assert stats["failure"] is None
    monkeypatch.setitem(codec_table.CODECS, ENCODING, __name__)
    with Recording(exp.path) as recording:
        rows = list(recording["arm"].rows())
        assert rows[-1] == {"last": True, "late": [0.5], "_ts": 100.0}
        assert [row["q"] for row in rows if "w" in row] == list(range(1, 21))
        assert [(row["a"], row["b"]) for row in rows if "a" in row] == [(n, n) for n in range(20)]
        assert [row["c"] for row in rows if "c" in row] == list(range(10))
        assert [row["message"] for row in recording.logs] == ["before the first row of a track"]
    return stats


@pytest.mark.parametrize("method", ["dumps", "encode_exactly"])
def test_a_codec_that_cannot_encode_a_row_tells_whoever_appends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    codec = Failing(json_codec.CODEC, method, ValueError("odd"))
    monkeypatch.setattr(codec_table, "find", lambda encoding: codec)
    with Recorder(tmp_path) as recorder:
        arm = recorder.topic("arm").append(n=1, _ts=1.0)
        if method == "encode_exactly":
            with pytest.raises(ValueError, match="odd"):
                arm.append(n=b"no JSON", _ts=2.0)
        arm.append(n=3, _ts=3.0).flush()
        assert recorder.stats()["written"] == 2
    monkeypatch.undo()
    assert [json.loads(payload)["n"] for _, payload in disk.payloads(tmp_path)] == [1, 3]
