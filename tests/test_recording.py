"""A recording gives what was recorded: by topic, in ml-dash's shapes, from folders, files, and files in progress."""

import math
import os
import shutil
from collections.abc import Mapping

import pytest

from ml_dash_mcap import Recorder, RecorderOptions
from ml_dash_mcap.errors import (
    DamagedFileError,
    FormatError,
    MissingRecordingError,
    NotFoundError,
    RangeError,
    StateError,
    StorageError,
)
from ml_dash_mcap.recording import Recording
from tests.support.files import draft, finished, save, unfinished

ARM = {
    "type": "object",
    "properties": {"q": {"type": "array", "items": {"type": "integer"}}, "_ts": {"type": "number"}},
}
ARM_LATER = {
    "type": "object",
    "properties": {
        "q": {"type": "array", "items": {"type": "number"}},
        "cam": {
            "type": "object",
            "properties": {"pos": {"type": "number"}, "img": {"type": "string", "contentEncoding": "base64"}},
        },
        "_ts": {"type": "number"},
    },
}


@pytest.fixture
def run(tmp_path):
    """A run of a finished segment and one in progress, which share the row at 4/30 s."""
    folder = tmp_path / "alice" / "run"
    save(
        folder / "20260101T000000Z_0001.mcap",
        [
            {"robot": [{"q": [i], "_ts": i / 30} for i in range(3)], "imu": [{"a": 0.5, "_ts": 0.0}]},
            {
                "robot": [{"q": [i], "_ts": i / 30} for i in range(3, 5)],
                "ml_dash/metrics/train": [{"loss": 0.5, "_ts": 0.1}],
            },
            {
                "ml_dash/log": [{"level": 2, "message": "hello", "_ts": 0.2}],
                "ml_dash/files": [{"path": "a.png", "_ts": 0.2}],
            },
        ],
        kinds={"ml_dash/metrics/train": "metric", "ml_dash/log": "log", "ml_dash/files": "file"},
        schemas={"robot": ARM},
        described={"robot": {"description": "an arm", "tags": '["a"]', "metadata": '{"unit": "rad"}'}},
        metadata=[
            ("ml_dash", {"prefix": "alice/run"}),
            ("ml_dash.run", {"status": "running", "host": "x"}),
            ("ml_dash.parameters", {"lr": "0.1", "net.layers": "[1, 2]", "name": '"a"'}),
        ],
    )
    save(
        folder / "20260101T000000Z_0002.mcap.active",
        [
            {
                "robot": [
                    {"q": [40], "cam": {"pos": 1.5}, "_ts": 4 / 30},
                    {"cam": {"pos": 2.5, "img": "x"}, "_ts": 5 / 30},
                ]
            }
        ],
        schemas={"robot": ARM_LATER},
        metadata=[
            ("ml_dash.parameters", {"lr": "0.2"}),
            ("ml_dash.run", {"status": "completed"}),
            ("ml_dash.topic", {"topic": "robot", "tags": '["b"]'}),
        ],
    )
    return folder


def test_topics_are_sorted_and_our_own_are_not_among_them(run):
    assert list(Recording(run).topics) == ["imu", "robot"]


def test_a_topic_is_summed_up_over_all_segments(run):
    info = Recording(run).topics["robot"]
    assert (info.name, info.kind, info.count, info.encoding) == ("robot", "track", 6, "json")
    assert (info.start, info.end, info.duration) == (0.0, 5 / 30, 5 / 30)
    assert info.rate == pytest.approx(30)
    assert {name: str(field) for name, field in info.fields.items()} == {
        "q": "number[]",
        "cam.pos": "number",
        "cam.img": "bytes",
    }
    assert info.schema["properties"]["q"] == {"type": "array", "items": {"type": "number"}}
    assert (info.description, info.tags, info.metadata) == ("an arm", ("b",), {"unit": "rad"})


def test_a_topic_with_one_row_has_no_rate(run):
    info = Recording(run).topics["imu"]
    assert (info.count, info.rate, info.duration) == (1, 0.0, 0.0)


def test_rows_are_merged_across_segments_and_stay_nested(run):
    assert list(Recording(run)["robot"].rows()) == [
        {"q": [0], "_ts": 0.0},
        {"q": [1], "_ts": 1 / 30},
        {"q": [2], "_ts": 2 / 30},
        {"q": [3], "_ts": 3 / 30},
        {"q": [40], "cam": {"pos": 1.5}, "_ts": 4 / 30},
        {"cam": {"pos": 2.5, "img": "x"}, "_ts": 5 / 30},
    ]


def test_reading_gives_flat_entries_of_a_range_with_both_ends(run):
    assert Recording(run)["robot"].read(start=3 / 30, end=4 / 30) == {
        "entries": [{"timestamp": 3 / 30, "q": [3]}, {"timestamp": 4 / 30, "q": [40], "cam.pos": 1.5}],
        "count": 2,
    }


def test_columns_choose_fields_and_the_rows_stay(run):
    entries = Recording(run)["robot"].read(start=4 / 30, columns=["cam.pos"])["entries"]
    assert entries == [{"timestamp": 4 / 30, "cam.pos": 1.5}, {"timestamp": 5 / 30, "cam.pos": 2.5}]


def test_what_the_run_said_last_counts(run):
    recording = Recording(run)
    assert recording.params == {"lr": 0.2, "net.layers": [1, 2], "name": "a"}
    assert recording.run == {"status": "completed", "host": "x"}
    assert recording.metadata[0] == ("ml_dash", {"prefix": "alice/run"})
    assert len(recording.metadata) == 6


def test_parameters_may_be_literals_that_json_does_not_have(tmp_path):
    said = [("ml_dash", {"parameters": '{"a": [NaN]}'}), ("ml_dash.parameters", {"b": "-Infinity", "c": "no JSON"})]
    save(tmp_path / "a_0001.mcap", [], metadata=said)
    assert repr(Recording(tmp_path).params) == "{'a': [nan], 'b': -inf, 'c': 'no JSON'}"


def test_parameters_that_a_segment_repeats_count_if_the_segment_that_set_them_is_gone(tmp_path):
    said = [("ml_dash", {"parameters": '{"lr": 0.1, "n": 3}'}), ("ml_dash.parameters", {"n": "4"})]
    save(tmp_path / "a_0002.mcap", [], metadata=said)
    assert Recording(tmp_path).params == {"lr": 0.1, "n": 4}


def test_logs_metrics_and_files_have_their_own_places(run):
    recording = Recording(run)
    assert recording.logs == [{"level": 2, "message": "hello", "_ts": 0.2}]
    assert dict(recording.metrics) == {"train": [{"loss": 0.5, "_ts": 0.1}]}
    assert recording.files == [{"path": "a.png", "_ts": 0.2}]


def test_the_times_of_a_recording_are_those_of_all_topics(run):
    recording = Recording(run)
    assert (recording.start, recording.end, recording.duration) == (0.0, 0.2, 0.2)


def test_one_segment_is_a_recording_too(run):
    with Recording(run / "20260101T000000Z_0002.mcap.active") as recording:
        assert recording.topics["robot"].count == 2
    with Recording(str(run / "20260101T000000Z_0001.mcap")) as recording:
        assert recording.topics["robot"].count == 5


def test_other_files_in_the_folder_do_not_matter(run):
    (run / "files").mkdir()
    (run / "files" / "a.mcap").write_bytes(b"a user's own")
    (run / ".hidden.mcap").write_bytes(b"")
    (run / "notes.txt").write_bytes(b"")
    assert [path.name[-6:] for path in Recording(run).segments] == ["1.mcap", "active"]


def test_an_unknown_topic_is_a_key_error_that_names_similar_ones(run):
    with pytest.raises(NotFoundError, match=r"no topic 'robt' in the recording; did you mean 'robot'\?") as caught:
        Recording(run)["robt"]
    assert isinstance(caught.value, KeyError)
    with pytest.raises(NotFoundError, match="there are 'imu', 'robot'"):
        Recording(run).topics["xyz"]


@pytest.mark.parametrize("format", ["json", "jsonl", "mocap", "parquet", "mcap"])
def test_an_unknown_topic_or_column_is_an_error_in_every_format(run, format):
    recording = Recording(run)
    with pytest.raises(NotFoundError, match="no topic 'xyz'"):
        recording.read("xyz", format=format)
    with pytest.raises(NotFoundError, match="no column 'absent'"):
        recording["robot"].read(columns=["q", "absent"], format=format)


def test_an_unknown_format_is_a_value_error(run):
    with pytest.raises(FormatError, match="Unsupported format: csv") as caught:
        Recording(run)["robot"].read(format="csv")
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(("start", "end"), [(2.0, 1.0), (math.nan, None)])
def test_a_range_that_makes_no_sense_is_an_error_at_the_call(run, start, end):
    reader = Recording(run)["robot"]
    with pytest.raises(RangeError):
        reader.rows(start, end)
    with pytest.raises(RangeError):
        reader.read(start, end)


def test_a_path_without_a_recording_is_a_file_not_found_error(run, tmp_path):
    with pytest.raises(MissingRecordingError, match="no recording here") as caught:
        Recording(tmp_path / "absent")
    assert isinstance(caught.value, FileNotFoundError)
    with pytest.raises(MissingRecordingError, match="but in the folders below it: alice/run"):
        Recording(tmp_path)


@pytest.mark.parametrize("on_damage", ["raise", "skip"])
@pytest.mark.parametrize("names", [[], ["notes.txt"], [".x.mcap"], ["a.mcap.txt", "b/c.txt"], list("abcdefgh")])
def test_a_folder_of_other_things_is_no_recording_and_the_error_says_what_is_one(tmp_path, names, on_damage):
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(MissingRecordingError, match=r"a recording is a folder with \.mcap files in it") as caught:
        Recording(tmp_path, on_damage=on_damage)
    assert ("it is empty" in str(caught.value)) is (not names)
    assert all(name.split("/")[0] in str(caught.value) for name in names[:5])


def test_the_folder_of_a_system_is_no_recording():
    with pytest.raises(MissingRecordingError, match="no recording here"):
        Recording("/etc")


def test_a_folder_of_other_things_among_several_is_an_error_too(run, tmp_path):
    (tmp_path / "other").mkdir()
    with pytest.raises(MissingRecordingError, match="other"):
        Recording([run, tmp_path / "other"])


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_a_folder_that_may_not_be_read_is_a_storage_error(tmp_path):
    (tmp_path / "closed").mkdir(mode=0)
    with pytest.raises(StorageError, match="cannot be read"):
        Recording(tmp_path / "closed")


def test_a_run_that_has_just_begun_is_a_recording_of_nothing_so_far_and_not_finished(tmp_path):
    with Recorder(tmp_path / "run") as recorder, Recording(tmp_path / "run") as rec:
        assert (list(rec.topics), rec.start, rec.duration, rec.segments) == ([], None, 0.0, [])
        assert not rec.finished
        assert not rec.check().findings
        recorder.topic("robot").append(q=1, _ts=1.0)
        recorder.flush()
        assert rec.refresh()
        assert (rec.topics["robot"].count, rec.finished) == (1, False)
    with Recording(tmp_path / "run") as rec:
        assert rec.finished


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_fields_that_rows_get_while_a_recording_is_open_are_read_after_a_refresh(tmp_path, encoding):
    rows = [{"q": [1.5, 2.5]}, {"q": [3.5, 4.5], "mode": "hold"}, {"q": ["broken"], "pose": {"x": 1}}]
    expected = [{**row, "_ts": float(n)} for n, row in enumerate(rows)]
    with Recorder(tmp_path / "run", RecorderOptions(encoding=encoding)) as recorder:
        recorder.topic("robot").append(**expected[0])
        recorder.flush()
        with Recording(tmp_path / "run") as rec:
            for count, row in enumerate(expected[1:], 2):
                recorder.topic("robot").append(**row)
                recorder.flush()
                assert rec.refresh()
                assert list(rec["robot"].rows()) == expected[:count]
                assert rec["robot"].to_arrow().num_rows == count
            assert "pose.x" in rec["robot"].to_arrow().column_names


def test_a_run_that_ends_without_a_row_is_a_finished_recording_of_nothing(tmp_path):
    with Recorder(tmp_path / "run"):
        rec = Recording(tmp_path / "run")
    rec.refresh()
    assert (rec.finished, list(rec.topics)) == (True, [])
    rec.close()


def test_an_open_recording_whose_files_are_gone_has_none(tmp_path):
    with Recorder(tmp_path / "run") as recorder:
        recorder.topic("robot").append(q=1, _ts=1.0)
    with Recording(tmp_path / "run") as rec:
        for path in rec.segments:
            path.unlink()
        rec.refresh()
        assert (rec.segments, rec.finished) == ([], False)


def test_a_file_that_is_no_mcap_is_an_error_that_says_so(tmp_path):
    path = tmp_path / "notes.mcap"
    path.write_bytes(b"hello, world")
    with pytest.raises(DamagedFileError, match=r"notes\.mcap, byte 0: this is no MCAP file"):
        Recording(path)
    path.write_bytes(b"")
    with pytest.raises(DamagedFileError, match="the file is empty"):
        Recording(path)


def test_a_recording_takes_in_what_is_written_while_it_is_open(tmp_path):
    chunks = [{"robot": [{"n": n, "_ts": float(n)}]} for n in range(4)]
    active = tmp_path / "a_0001.mcap.active"
    active.write_bytes(b"")
    recording = Recording(tmp_path)
    assert list(recording.topics) == []
    for count in range(1, 4):
        active.write_bytes(unfinished(draft(chunks[:count])))
        assert recording.refresh()
        assert not recording.refresh()
        assert recording.topics["robot"].count == count
        assert [row["n"] for row in recording["robot"].rows()] == list(range(count))
    active.write_bytes(finished(draft(chunks)))
    active.rename(tmp_path / "a_0001.mcap")
    save(tmp_path / "a_0002.mcap.active", [{"robot": [{"n": 4, "_ts": 4.0}], "imu": [{"_ts": 0.0}]}])
    assert recording.refresh()
    assert [row["n"] for row in recording["robot"].rows()] == [0, 1, 2, 3, 4]
    assert list(recording.topics) == ["imu", "robot"]
    assert [path.name for path in recording.segments] == ["a_0001.mcap", "a_0002.mcap.active"]


def test_one_segment_that_is_finished_while_it_is_open_stays_open(tmp_path):
    active = save(tmp_path / "a.mcap.active", [{"robot": [{"n": 1, "_ts": 1.0}]}])
    recording = Recording(active)
    active.write_bytes(finished(draft([{"robot": [{"n": 1, "_ts": 1.0}, {"n": 2, "_ts": 2.0}]}])))
    active.rename(tmp_path / "a.mcap")
    assert recording.refresh()
    assert recording.topics["robot"].count == 2


def test_a_segment_that_was_replaced_is_read_anew(tmp_path):
    path = save(tmp_path / "a.mcap", [{"robot": [{"n": 1, "_ts": 1.0}]}])
    recording = Recording(tmp_path)
    save(tmp_path / "b", [{"robot": [{"n": 2, "_ts": 2.0}]}]).rename(path)
    assert recording.refresh()
    assert list(recording["robot"].rows()) == [{"n": 2, "_ts": 2.0}]


def test_rows_that_are_being_read_are_those_of_when_reading_began(tmp_path):
    chunks = [{"robot": [{"n": n, "_ts": float(n)}]} for n in range(4)]
    active = tmp_path / "a.mcap.active"
    active.write_bytes(unfinished(draft(chunks[:3])))
    recording = Recording(tmp_path)
    found = recording["robot"].rows()
    first = next(found)
    active.write_bytes(unfinished(draft(chunks)))
    recording.refresh()
    assert [first["n"], *(row["n"] for row in found)] == [0, 1, 2]


def test_opening_a_long_recording_reads_its_summary_only(tmp_path):
    chunks = [{"robot": [{"q": [0.5] * 2000, "_ts": float(n * 10 + i)} for i in range(10)]} for n in range(50)]
    path = save(tmp_path / "a.mcap", chunks)
    with Recording(path) as recording:
        assert recording.topics["robot"].count == 500
        assert recording.start == 0.0
        read = sum(file.source.bytes_read for file in recording._opened())
        assert read < path.stat().st_size / 10


def test_a_closed_recording_says_so(run):
    recording = Recording(run)
    recording.close()
    recording.close()
    with pytest.raises(StateError, match="is closed"):
        recording["robot"]


def test_a_recording_may_be_moved_away_while_it_is_open(run, tmp_path):
    recording = Recording(run)
    shutil.move(run, tmp_path / "elsewhere")
    assert recording["robot"].read()["count"] == 6


# A recording as a mapping


def test_a_recording_is_a_mapping_from_the_names_of_topics_to_their_readers(run):
    with Recording(run) as rec:
        assert isinstance(rec, Mapping)
        assert list(rec) == list(rec.keys()) == list(rec.topics) == ["imu", "robot"]
        assert len(rec) == 2
        assert rec
        assert {name: list(topic) for name, topic in rec.items()} == {name: list(rec[name].rows()) for name in rec}
        assert [topic.name for topic in rec.values()] == ["imu", "robot"]
        assert {**rec}.keys() == dict(rec).keys() == {"imu", "robot"}
        assert rec.get("robot").name == "robot"
        assert rec.get("nothing") is None
        assert rec.get("nothing", 5) == 5
        assert rec.keys() >= {"robot"}
        assert "nothing" not in rec
        assert 3 not in rec
        with pytest.raises(KeyError, match="did you mean 'robot'"):
            rec["robto"]
        with pytest.raises(KeyError):
            rec[0]


def test_the_librarys_own_topics_are_there_by_name_and_not_iterated(run):
    with Recording(run) as rec:
        assert "ml_dash/log" in rec
        assert rec["ml_dash/log"].info.count == 1
        assert not [name for name in rec if name.startswith("ml_dash/")]


def test_two_recordings_are_equal_if_they_are_one_object_and_can_be_keys(run):
    with Recording(run) as rec, Recording(run) as other:
        assert rec == rec
        assert rec != other
        assert rec != dict(rec)
        assert {rec: "first", other: "second"}[rec] == "first"


def test_a_closed_recording_is_no_mapping_any_more(run):
    with Recording(run) as rec:
        names = iter(rec)
    assert list(names) == ["imu", "robot"], "the names were looked up before"
    for call in (lambda: list(rec), lambda: len(rec), lambda: rec.get("robot"), lambda: list(rec.items())):
        with pytest.raises(StateError, match="open it again"):
            call()


def test_a_recording_that_grows_has_its_new_topics_after_a_refresh(tmp_path):
    with Recorder(tmp_path) as recorder:
        recorder.topic("a").append(n=1, _ts=0.0)
        recorder.flush()
        with Recording(tmp_path) as rec:
            assert list(rec) == ["a"]
            recorder.topic("b").append(n=1, _ts=1.0)
            recorder.flush()
            rec.refresh()
            assert list(rec) == ["a", "b"]
