"""What recordings in every store do, as tests: inherit from `RecordingLaws`, and give it a fixture `store`."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import pyarrow.parquet as pq
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from ml_dash_mcap import Recorder, RecorderOptions, Recording, convert, recordings
from ml_dash_mcap.errors import (
    DamagedFileError,
    DestinationExistsError,
    FormatError,
    MissingRecordingError,
    PrefixError,
    StaleVersionError,
    StateError,
    UsageError,
)
from ml_dash_mcap.store.block_cache import BLOCK_BYTES
from ml_dash_mcap.store.store import ByteRange, Content, Store, StoredObject
from tests.support.store_laws import names, read

ROWS = 4000
RATE = 100.0
EVENT_STEP = 100
EVENTS = ROWS // EVENT_STEP
ROW_BYTES = 1500
"""Of noise, so that chunks are as large as their rows."""


class Counting:
    """A store that notes what is asked of another one."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.asked: list[Sequence[ByteRange]] = []
        """The ranges of each call, clipped to their object."""

    @property
    def url(self) -> str:
        return self.store.url

    def list(self, prefix: str = "", *, recursive: bool = True) -> Sequence[StoredObject]:
        return self.store.list(prefix, recursive=recursive)

    def head(self, name: str) -> StoredObject:
        return self.store.head(name)

    def read_ranges(self, stored: StoredObject, ranges: Sequence[ByteRange]) -> Sequence[bytes]:
        self.asked.append([(start, min(end, stored.size)) for start, end in ranges])
        return self.store.read_ranges(stored, ranges)

    def put(self, name: str, content: Content) -> str:
        return self.store.put(name, content)

    def put_new(self, name: str, content: Content) -> str:
        return self.store.put_new(name, content)

    def replace(self, name: str, content: Content, version: str) -> str:
        return self.store.replace(name, content, version)

    def delete(self, name: str) -> None:
        self.store.delete(name)

    def bytes(self) -> int:
        return sum(end - start for ranges in self.asked for start, end in ranges)


def upload(store: Store, folder: Path, prefix: str) -> None:
    for path in sorted(folder.iterdir()):
        if path.is_file():
            store.put(f"{prefix}/{path.name}", path)


@pytest.fixture(scope="session")
def local_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of several segments, with a topic in many chunks and one in few."""
    folder = tmp_path_factory.mktemp("local") / "demo"
    options = RecorderOptions(chunk_bytes=128 * 1024, segment_bytes=3_000_000)
    with Recorder(folder, options) as recorder:
        robot, event = recorder.topic("robot"), recorder.topic("event")
        for i in range(ROWS):
            robot.append(q=[i, 0.5], noise=os.urandom(ROW_BYTES // 2).hex(), _ts=i / RATE)
            if i % EVENT_STEP == 0:
                event.append(kind="mark", number=i, _ts=i / RATE)
                recorder.flush()
    return folder


class RecordingLaws:
    @pytest.fixture
    def stored(self, store: Store, local_run: Path) -> Store:
        """A store with the local run in it."""
        upload(store, local_run, "lab/demo")
        return store

    # -- reading -------------------------------------------------------------------------------------------------------

    def test_a_recording_in_a_store_is_what_it_is_in_a_folder(self, stored: Store, local_run: Path) -> None:
        with Recording("lab/demo", store=stored) as rec, Recording(local_run) as local:
            assert [path.name for path in rec.segments] == [path.name for path in local.segments]
            assert len(rec.segments) > 1
            assert list(rec) == list(local) == ["event", "robot"]
            assert {name: info.count for name, info in rec.topics.items()} == {"robot": ROWS, "event": EVENTS}
            assert list(rec["robot"].rows()) == list(local["robot"].rows())
            assert rec["robot"].to_arrow().equals(local["robot"].to_arrow())
            assert (rec.start, rec.end, rec.run, rec.metadata) == (local.start, local.end, local.run, local.metadata)
            assert [(run.id, run.status) for run in rec.runs] == [(run.id, run.status) for run in local.runs]
            assert rec.check()
            assert rec.finished
            assert not rec.losses

    def test_one_file_of_a_store_and_several_are_recordings_too(self, stored: Store, local_run: Path) -> None:
        segments = [f"lab/demo/{path.name}" for path in Recording(local_run).segments]
        with Recording(segments[0], store=stored) as rec, Recording(local_run / Path(segments[0]).name) as local:
            assert list(rec["robot"].rows()) == list(local["robot"].rows())
        with Recording(Path("lab") / "demo", store=stored) as rec:
            assert len(rec["robot"]) == ROWS
        with Recording([*segments, "lab/demo"], store=stored) as rec:
            assert len(rec.segments) == len(segments)  # none is opened twice
            assert len(rec["robot"]) == ROWS

    def test_a_window_fetches_the_chunks_that_hold_it_and_little_else(self, store: Store, local_run: Path) -> None:
        upload(store, local_run, "lab/demo")
        counting = Counting(store)
        with Recording("lab/demo", store=counting) as rec:
            opening = len(counting.asked)
            assert opening == len(rec.segments)  # one call each: its beginning and its end
            assert counting.bytes() <= 3 * BLOCK_BYTES * len(rec.segments)
            counting.asked.clear()
            assert len(rec["robot"].to_arrow(10.0, 10.5)) == 51
        with Recording(local_run) as local:
            chunks = [
                (chunk.offset, chunk.end + chunk.message_index_length)
                for file in local._opened()
                for chunk in file.index.chunks
                if chunk.start_ns <= 10.5e9 and chunk.end_ns >= 10.0e9
            ]
        assert 0 < len(counting.asked) <= 2
        assert counting.bytes() <= sum(end - start for start, end in chunks) + 2 * BLOCK_BYTES
        for ranges in counting.asked:
            for start, end in ranges:
                assert any(low - BLOCK_BYTES <= start and end <= high + BLOCK_BYTES for low, high in chunks)

    def test_files_are_opened_side_by_side(self, store: Store, local_run: Path) -> None:
        upload(store, local_run, "lab/demo")
        meeting, arrivals = threading.Barrier(2), itertools.count()

        class Waiting(Counting):
            def read_ranges(self, stored: StoredObject, ranges: Sequence[ByteRange]) -> Sequence[bytes]:
                if next(arrivals) < 2:
                    meeting.wait(timeout=30)
                return super().read_ranges(stored, ranges)

        with Recording("lab/demo", store=Waiting(store)) as rec:
            assert len(rec.segments) > 1

    def test_chunks_that_lie_far_apart_are_asked_for_together(self, store: Store, local_run: Path) -> None:
        upload(store, local_run, "lab/demo")
        counting = Counting(store)
        with Recording("lab/demo", store=counting) as rec:
            counting.asked.clear()
            assert len(list(rec["event"].rows())) == EVENTS
        assert len(counting.asked) == len(rec._files.segments.all)
        assert sum(map(len, counting.asked)) > EVENTS // 2
        assert counting.bytes() < sum(stored.size for stored in store.list()) / 5

    def test_two_readers_of_one_file_get_what_each_asks_for(self, stored: Store) -> None:
        with Recording("lab/demo", store=stored) as rec:
            both = zip(rec["event"].rows(), rec["robot"].rows(), strict=False)
            rows = [(event["number"], robot["_ts"]) for event, robot in both]
        assert rows == [(i * EVENT_STEP, i / RATE) for i in range(EVENTS)]

    def test_what_was_read_of_small_ranges_is_not_fetched_again(self, store: Store, local_run: Path) -> None:
        upload(store, local_run, "lab/demo")
        counting = Counting(store)
        with Recording("lab/demo", store=counting) as rec:
            assert rec.metadata == rec.metadata
            assert [rec.topics[name].count for name in rec] == [EVENTS, ROWS]
            assert rec.start == 0.0
            counting.asked.clear()
            assert rec.metadata
            assert rec.runs
            assert counting.asked == []

    # -- what changes meanwhile ----------------------------------------------------------------------------------------

    def test_a_refresh_finds_new_files_and_versions(self, store: Store, local_run: Path) -> None:
        paths = Recording(local_run).segments
        store.put(f"run/{paths[0].name}", paths[0])
        with Recording("run", store=store) as rec:
            before = len(rec["robot"])
            assert not rec.refresh()
            store.put(f"run/{paths[1].name}", paths[1])
            assert rec.refresh()
            assert len(rec["robot"]) > before
            store.put(f"run/{paths[1].name}", paths[0])
            assert rec.refresh()
            assert len(rec["robot"]) == before  # the same rows twice, which merge
            for path in paths[:2]:
                store.delete(f"run/{path.name}")
            assert rec.refresh()
            assert rec.segments == []

    def test_a_file_that_is_replaced_while_it_is_read_is_an_error_and_not_a_mixture(
        self, store: Store, local_run: Path
    ) -> None:
        paths = Recording(local_run).segments
        store.put("run/1.mcap", paths[0])
        with Recording("run", store=store) as rec:
            store.put("run/1.mcap", paths[1])
            with pytest.raises(StaleVersionError):
                list(rec["robot"].rows())

    # -- what is no recording ------------------------------------------------------------------------------------------

    def test_a_name_without_a_recording_says_where_recordings_are(self, stored: Store) -> None:
        for name in ("", "lab"):
            with pytest.raises(MissingRecordingError, match="demo"):
                Recording(name, store=stored)
        for name in ("lab/", "/lab", "../lab"):
            with pytest.raises(PrefixError):
                Recording(name, store=stored)
        with pytest.raises(MissingRecordingError, match="no recording here"):
            Recording("absent", store=stored)
        with pytest.raises(UsageError):
            Recording(5, store=stored)  # type: ignore[arg-type]

    def test_what_is_said_of_a_name_without_a_recording_names_the_store_and_what_can_be_read(
        self, store: Store
    ) -> None:
        store.put("bags/field/field_0.db3", b"SQLite format 3\0")
        store.put("tables/p.csv", b"t,x\n0,1\n")
        with pytest.raises(MissingRecordingError) as missing:
            Recording("nope", store=store)
        assert f"{store.url}/nope" in str(missing.value)
        assert "bag" not in str(missing.value) and "table" not in str(missing.value)
        with pytest.raises(MissingRecordingError, match=r"field_0\.db3.*bags and tables in a store are not read"):
            Recording("bags/field", store=store)
        for name in ("tables/p.csv", "bags/field/field_0.db3"):
            with pytest.raises(FormatError, match="bags and tables in a store are not read: copy them") as refused:
                Recording(name, store=store)
            assert f"{store.url}/{name}" in str(refused.value)

    def test_a_file_of_a_store_is_a_recording_by_its_content_whatever_its_name_ends_with(
        self, store: Store, local_run: Path
    ) -> None:
        store.put("backup/demo.bin", Recording(local_run).segments[0])
        with Recording("backup/demo.bin", store=store) as rec:
            assert "robot" in rec

    @pytest.mark.breaks_files
    def test_every_loss_names_its_file_by_the_path_that_segments_have(self, store: Store, local_run: Path) -> None:
        whole = Recording(local_run).segments[0].read_bytes()
        store.put("run/1.mcap", whole + b"behind")
        store.put("run/2.mcap", b"hello, world")
        with Recording("run", store=store, on_damage="skip") as rec:
            assert [(type(loss.path), loss.path) for loss in rec.losses] == [
                (PurePosixPath, PurePosixPath("run/2.mcap")),
                (PurePosixPath, PurePosixPath("run/1.mcap")),
            ]

    def test_a_file_that_is_no_mcap_is_damaged(self, store: Store) -> None:
        store.put("run/notes.mcap", b"hello, world")
        with pytest.raises(DamagedFileError, match="no MCAP file"):
            Recording("run", store=store)
        with Recording("run", store=store, on_damage="skip") as rec:
            assert [loss.path.name for loss in rec.losses] == ["notes.mcap"]
        with pytest.raises(DamagedFileError):
            Recording("run/notes.mcap", store=store, on_damage="skip")

    def test_a_file_that_was_cut_is_read_as_far_as_it_goes(self, store: Store, local_run: Path) -> None:
        whole = Recording(local_run).segments[0].read_bytes()
        store.put("run/1.mcap.active", whole[: len(whole) // 2])
        with Recording("run", store=store) as rec:
            assert not rec.finished
            assert 0 < len(rec["robot"]) < ROWS
        assert names(store) == ["run/1.mcap.active"]  # nothing is recovered there

    def test_a_closed_recording_is_not_read(self, stored: Store) -> None:
        rec = Recording("lab/demo", store=stored)
        rec.close()
        rec.close()
        with pytest.raises(StateError):
            list(rec)

    # -- the catalogue -------------------------------------------------------------------------------------------------

    def test_the_catalogue_lists_the_recordings_of_a_store(self, stored: Store, local_run: Path) -> None:
        upload(stored, local_run, "lab/a/second")
        stored.put("lab/notes.txt", b"")
        stored.put("lab/.hidden/1.mcap", b"")
        stored.put("lab/broken/1.mcap", b"no MCAP")
        entries = list(recordings("", store=stored))
        assert [entry.path.as_posix() for entry in entries] == ["lab/a/second", "lab/broken", "lab/demo"]
        [local] = recordings(local_run)
        assert [entry.status for entry in entries] == [local.status, "damaged", local.status]
        for entry in (entries[0], entries[2]):
            assert (entry.start, entry.end, entry.topics, entry.files, entry.bytes) == (
                local.start, local.end, local.topics, local.files, local.bytes,
            )  # fmt: skip
        assert [entry.path.as_posix() for entry in recordings("lab/a", store=stored)] == ["lab/a/second"]
        assert [entry.path.as_posix() for entry in recordings("lab/.hidden", store=stored)] == ["lab/.hidden"]

    # -- exports -------------------------------------------------------------------------------------------------------

    def test_an_export_into_a_store_is_what_it_is_in_a_folder(
        self, store: Store, local_run: Path, tmp_path: Path
    ) -> None:
        with Recording(local_run) as rec:
            assert rec.export("out/event.parquet", store=store, topics=["event"]).as_posix() == "out/event.parquet"
            rec.export("out/all", store=store, format="jsonl", end=1.0)
            rec.export(tmp_path / "event.parquet", topics=["event"])
            rec.export(tmp_path / "all", format="jsonl", end=1.0)
        assert names(store) == ["out/all/event.jsonl", "out/all/robot.jsonl", "out/event.parquet"]
        for name in names(store):
            assert read(store, name) == (tmp_path / name.removeprefix("out/")).read_bytes()

    def test_a_recording_in_a_store_is_exported_to_a_folder_and_into_its_store(
        self, stored: Store, tmp_path: Path
    ) -> None:
        with Recording("lab/demo", store=stored) as rec:
            rec.export(tmp_path / "event.parquet", topics=["event"])
            rec.export(tmp_path / "event.parquet", topics=["event"], overwrite=True)
            rec.export("lab/event.parquet", store=stored, topics=["event"])
            rec.export(tmp_path / "bag", format="rosbag2", topics=["event"])
        assert pq.read_table(tmp_path / "event.parquet").num_rows == EVENTS
        assert read(stored, "lab/event.parquet") == (tmp_path / "event.parquet").read_bytes()

    def test_a_bag_in_a_store_goes_out_as_the_bag_in_its_folder_does(self, store: Store, tmp_path: Path) -> None:
        bag, types = tmp_path / "bag", get_typestore(Stores.ROS2_JAZZY)
        writer = Ros2Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP)
        with writer:
            numbers = writer.add_connection("/numbers", "std_msgs/msg/Int32", typestore=types)
            message = types.types["std_msgs/msg/Int32"](7)
            writer.write(numbers, 1_700_000_000_000_000_001, types.serialize_cdr(message, "std_msgs/msg/Int32"))
        yaml = YAML(typ="safe")
        metadata = yaml.load(bag / "metadata.yaml")
        metadata["rosbag2_bagfile_information"]["custom_data"] = {"site": "lab"}  # which is not in the MCAP file
        yaml.dump(metadata, bag / "metadata.yaml")
        upload(store, bag, "bag")
        with Recording(bag) as local, Recording("bag", store=store) as rec:
            outs = [one.export(tmp_path / name / "out", format="rosbag2") for one, name in ((local, "a"), (rec, "b"))]
        texts = [(out / "metadata.yaml").read_text(encoding="utf-8") for out in outs]
        assert "site" in texts[0]
        assert texts[0] == texts[1]

    def test_what_is_there_stays_unless_it_may_be_replaced(self, stored: Store) -> None:
        stored.put("out/all/mine.txt", b"kept")
        stored.put("out/one.parquet", b"an earlier one")
        with Recording("lab/demo", store=stored) as rec:
            for overwrite in (False, True):
                with pytest.raises(DestinationExistsError):
                    rec.export("out/all", store=stored, format="csv", topics=["event"], overwrite=overwrite)
                with pytest.raises(DestinationExistsError):
                    rec.export("lab/demo", store=stored, format="csv", topics=["event"], overwrite=overwrite)
                with pytest.raises(DestinationExistsError):
                    rec.export("out", store=stored, format="csv", topics=["event"], overwrite=overwrite)
            with pytest.raises(DestinationExistsError):
                rec.export("out/one.parquet", store=stored, topics=["event"])
            assert read(stored, "out/one.parquet") == b"an earlier one"
            rec.export("out/one.parquet", store=stored, topics=["event"], overwrite=True)
        assert read(stored, "out/one.parquet")[:4] == b"PAR1"
        assert read(stored, "out/all/mine.txt") == b"kept"

    def test_a_folder_that_is_replaced_has_nothing_of_the_earlier_one(self, store: Store, local_run: Path) -> None:
        with Recording(local_run) as rec:
            rec.export("out", store=store, format="jsonl", end=0.5)
            rec.export("out", store=store, format="jsonl", topics=["event"], overwrite=True)
        assert names(store) == ["out/event.jsonl"]

    def test_an_export_that_fails_puts_nothing_there(self, store: Store, local_run: Path) -> None:
        def interrupt(done: int, total: int) -> None:
            raise KeyboardInterrupt

        with Recording(local_run) as rec, pytest.raises(KeyboardInterrupt):
            rec.export("out", store=store, format="csv", progress=interrupt)
        assert names(store) == []

    def test_a_name_that_leaves_the_store_is_refused(self, store: Store, local_run: Path) -> None:
        with Recording(local_run) as rec, pytest.raises(PrefixError):
            rec.export("../out.parquet", store=store, topics=["event"])

    def test_a_recording_is_converted_into_a_store(self, store: Store, local_run: Path) -> None:
        convert(local_run, "out/event.parquet", store=store, topics=["event"])
        convert(local_run, "out/event.parquet", store=store, topics=["event"], overwrite=True)
        assert names(store) == ["out/event.parquet"]

    def test_a_foreign_file_becomes_a_recording_in_a_store(self, store: Store, tmp_path: Path) -> None:
        (tmp_path / "arm.csv").write_text("_ts,x\n0.0,1.5\n0.5,2.5\n", encoding="utf-8")
        assert convert(tmp_path / "arm.csv", "runs/arm", store=store).as_posix() == "runs/arm"
        convert(tmp_path / "arm.csv", "runs/arm", store=store, overwrite=True)
        with Recording("runs/arm", store=store) as rec:
            assert [row["x"] for row in rec["arm"].rows()] == [1.5, 2.5]
        assert len(names(store)) == 1
        with pytest.raises(DestinationExistsError, match="is there already"):
            convert(tmp_path / "arm.csv", "runs/arm", store=store)
        store.put("others/1.mcap", b"\x89MCAP0\r\n of another program")
        with pytest.raises(DestinationExistsError, match="another program"):
            convert(tmp_path / "arm.csv", "others", store=store, overwrite=True)
