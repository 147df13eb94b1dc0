"""Rows come in time order and merged, whatever order, chunk and file they were written in."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ml_dash_mcap.errors import DamagedFileError, RangeError, UndecodedWarning
from ml_dash_mcap.query import counts, topic_rows
from ml_dash_mcap.query.file import File
from ml_dash_mcap.query.stored_topic import StoredTopic
from tests.support.assemble import Draft, bundle
from tests.support.examples import examples
from tests.support.files import Row, draft, finished, ns, save, unfinished

NANO = math.nextafter(1.0, 2.0)
"""Shares its nanosecond with 1.0."""

TIMES = st.sampled_from([0.0, 1.0, NANO, 1 / 30, 2 / 30, 0.5, 1.7e9, math.nextafter(1.7e9, 2e9), 3.0])
ROWS = st.builds(
    lambda ts, fields: {**fields, "_ts": ts}, TIMES, st.dictionaries(st.sampled_from("abc"), st.integers(0, 9))
)
RECORDINGS = st.lists(st.lists(st.lists(ROWS, max_size=5), max_size=4), min_size=1, max_size=3)
"""Files of chunks of rows."""


def merged(recording: list[list[list[Row]]]) -> list[Row]:
    """The model: a dict from time stamp to row."""
    by_time: dict[float, Row] = {}
    for row in (row for file in recording for chunk in file for row in chunk):
        by_time.setdefault(row["_ts"], {}).update(row)
    return [by_time[ts] for ts in sorted(by_time)]


def open_all(folder, recording, **how) -> list[File]:
    return [
        File(
            save(folder / f"{number}.mcap{'.active' if number % 2 else ''}", [{"t": chunk} for chunk in chunks], **how)
        )
        for number, chunks in enumerate(recording)
    ]


@settings(max_examples=examples(150), deadline=None)
@given(recording=RECORDINGS)
def test_rows_are_those_of_a_dict_from_time_stamp_to_row(tmp_path_factory, recording):
    files = open_all(tmp_path_factory.mktemp("run"), recording)
    assert list(topic_rows.read(StoredTopic(files, "t"))) == merged(recording)


@settings(max_examples=examples(150), deadline=None)
@given(recording=RECORDINGS, ends=st.tuples(TIMES, TIMES).map(sorted))
def test_a_range_takes_the_rows_between_its_ends_and_at_them(tmp_path_factory, recording, ends):
    files = open_all(tmp_path_factory.mktemp("run"), recording)
    low, high = ends
    assert list(topic_rows.read(StoredTopic(files, "t"), low, high)) == [
        row for row in merged(recording) if low <= row["_ts"] <= high
    ]


@settings(max_examples=examples(150), deadline=None)
@given(recording=RECORDINGS)
def test_the_count_and_the_times_are_those_of_the_rows(tmp_path_factory, recording):
    unmerged = open_all(tmp_path_factory.mktemp("run"), recording, library="someone else")
    expected = merged(recording)
    assert counts.count(StoredTopic(unmerged, "t")) == len(expected)
    start, _ = counts.first(StoredTopic(unmerged, "t"))
    assert (start, counts.last_time(StoredTopic(unmerged, "t"))) == (
        (expected[0]["_ts"], expected[-1]["_ts"]) if expected else (None, None)
    )


@settings(max_examples=examples(100), deadline=None)
@given(recording=RECORDINGS)
def test_the_count_of_our_own_files_whose_chunks_are_merged_is_that_of_the_rows(tmp_path_factory, recording):
    chunkwise = [[merged([[chunk]]) for chunk in file] for file in recording]
    assert counts.count(StoredTopic(open_all(tmp_path_factory.mktemp("run"), chunkwise), "t")) == len(merged(recording))


def test_later_fields_win_across_files_and_fields_that_only_one_row_has_stay(tmp_path):
    files = open_all(tmp_path, [[[{"a": 1, "b": {"x": 1}, "_ts": 1.0}]], [[{"b": {"y": 2}, "c": None, "_ts": 1.0}]]])
    assert list(topic_rows.read(StoredTopic(files, "t"))) == [{"a": 1, "b": {"y": 2}, "c": None, "_ts": 1.0}]
    assert list(next(topic_rows.read(StoredTopic(files, "t")))) == ["a", "b", "c", "_ts"]


def test_rows_that_share_a_nanosecond_and_not_the_double_stay_two(tmp_path):
    assert ns(1.0) == ns(NANO)
    files = open_all(tmp_path, [[[{"a": 2, "_ts": NANO}], [{"a": 1, "_ts": 1.0}]]])
    assert list(topic_rows.read(StoredTopic(files, "t"))) == [{"a": 1, "_ts": 1.0}, {"a": 2, "_ts": NANO}]


@pytest.mark.parametrize("kind", ["log", "metric", "file", None])
def test_only_tracks_are_merged(tmp_path, kind):
    written = [{"a": 1, "_ts": 1.0}, {"a": 2, "_ts": 1.0}, {"a": 3, "_ts": 1.0}]
    files = open_all(tmp_path, [[written[:2]], [written[2:]]], kinds={"t": kind})
    assert list(topic_rows.read(StoredTopic(files, "t"))) == written
    assert counts.count(StoredTopic(files, "t")) == 3


def test_late_rows_are_sorted_with_those_of_earlier_chunks(tmp_path):
    files = open_all(
        tmp_path,
        [[[{"a": i, "_ts": float(i)} for i in range(0, 10, 2)], [{"a": i, "_ts": float(i)} for i in (9, 1, 5)]]],
    )
    assert [row["a"] for row in topic_rows.read(StoredTopic(files, "t"))] == [0, 1, 2, 4, 5, 6, 8, 9]


def test_non_finite_numbers_and_bytes_are_restored(tmp_path):
    exact = {"NaN": {"/q": [1]}, "-Infinity": {"": ["low"]}, "bytes": {"": ["img"]}}
    files = open_all(tmp_path, [[[{"q": [1.0, None], "low": None, "img": "AAE=", "_exact": exact, "_ts": 1.5}]]])
    (row,) = topic_rows.read(StoredTopic(files, "t"))
    assert repr(row) == "{'q': [1.0, nan], 'low': -inf, 'img': b'\\x00\\x01', '_ts': 1.5}"


def foreign(tmp_path, *messages: tuple[int, bytes], encoding: str = "json") -> list[File]:
    drafted = draft([{"t": [{"_ts": time / 1e9} for time, _ in messages]}], kinds={"t": None}, library="someone else")
    inside = drafted.data[2].inside
    for message, (time, data) in zip(inside, messages, strict=True):
        message.log_time, message.data = time, data
    drafted.data[1].message_encoding = encoding
    path = tmp_path / "foreign.mcap"
    path.write_bytes(finished(Draft([*drafted.data[:2], *bundle(inside)])))
    return [File(path)]


def test_foreign_messages_take_their_log_time(tmp_path):
    files = foreign(
        tmp_path, (1_700_000_000_123_456_789, b'{"a": 1}'), (1_700_000_000_123_456_790, b'{"a": 2, "_ts": "x"}')
    )
    time = 1_700_000_000_123_456_789 / 1e9
    assert list(topic_rows.read(StoredTopic(files, "t"))) == [{"a": 1, "_ts": time}, {"a": 2, "_ts": time}]
    assert list(topic_rows.read(StoredTopic(files, "t"), time, time)) == list(topic_rows.read(StoredTopic(files, "t")))


def test_foreign_json_may_have_nan_literals_and_be_no_object(tmp_path):
    files = foreign(tmp_path, (1, b'{"a": NaN}'), (2, b"[1, 2]"), (3, b""))
    assert (
        repr(list(topic_rows.read(StoredTopic(files, "t"))))
        == "[{'a': nan, '_ts': 1e-09}, {'value': [1, 2], '_ts': 2e-09}, {'_ts': 3e-09}]"
    )


def test_a_message_that_is_not_in_its_encoding_is_an_error_that_names_file_topic_and_time(tmp_path):
    files = foreign(tmp_path, (7, b"{nonsense"))
    with pytest.raises(DamagedFileError, match=r"foreign\.mcap, byte \d+: a message of topic 't' at 7 ns"):
        list(topic_rows.read(StoredTopic(files, "t")))


def test_messages_in_an_encoding_that_nobody_here_decodes_are_their_bytes_with_a_warning(tmp_path):
    files = foreign(tmp_path, (7, b"\x00"), (8, b""), encoding="flatbuffer")
    with pytest.warns(UndecodedWarning, match="topic 't' has messages in the encoding 'flatbuffer'") as warned:
        found = list(topic_rows.read(StoredTopic(files, "t")))
    assert found == [{"data": b"\x00", "_ts": 7e-9}, {"data": b"", "_ts": 8e-9}]
    assert len(warned) == 1


@pytest.mark.parametrize(("start", "end"), [(2, 1), (math.nan, None), (None, math.nan), ("x", None), ([1], 2)])
def test_a_range_that_makes_no_sense_is_a_value_error(start, end):
    with pytest.raises(RangeError) as caught:
        topic_rows.check_range(start, end)
    assert isinstance(caught.value, ValueError)


def test_a_time_range_reads_only_the_chunks_that_it_needs(tmp_path):
    chunks = [{"t": [{"q": [0.5] * 3000, "_ts": float(n * 10 + i)} for i in range(10)]} for n in range(20)]
    path = save(tmp_path / "a.mcap", chunks)
    file = File(path)
    before = file.source.bytes_read
    assert len(list(topic_rows.read(StoredTopic([file], "t"), 55.0, 56.0))) == 2
    assert file.source.bytes_read - before < path.stat().st_size / 15


def test_a_file_in_progress_gives_the_rows_of_a_finished_one(tmp_path):
    drafted = draft([{"t": [{"a": i, "_ts": float(i)} for i in range(9)]}])
    (tmp_path / "a").write_bytes(unfinished(drafted))
    (tmp_path / "b").write_bytes(finished(drafted))
    assert list(topic_rows.read(StoredTopic([File(tmp_path / "a")], "t"))) == list(
        topic_rows.read(StoredTopic([File(tmp_path / "b")], "t"))
    )
