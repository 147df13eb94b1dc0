"""Bags with one odd part: the rest of them is read, and the odd part is named."""

from __future__ import annotations

import sqlite3
import tracemalloc
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer

from ml_dash_mcap.conversion import convert
from ml_dash_mcap.errors import ConversionWarning, DamagedFileError, MissingRecordingError, StorageError
from ml_dash_mcap.formats.ros import read as rosbag
from ml_dash_mcap.formats.ros.bag_sqlite.read import SqliteBag
from ml_dash_mcap.recording import Recording

STRING = (1, "/s", "std_msgs/msg/String", "cdr")


def string(text: str) -> bytes:
    """A std_msgs/String in little-endian CDR: its header, the length with the NUL at the end, the text."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def write_db(path: Path, rows: Iterable[tuple[Any, Any, Any]], topics: Iterable[tuple[Any, ...]] = (STRING,)) -> Path:
    """Write version 1 of rosbag2's schema; ids of topics have no declared type, so that they stay what they are."""
    path.parent.mkdir(exist_ok=True)
    base = sqlite3.connect(path)
    base.execute("CREATE TABLE topics(id, name TEXT, type TEXT, serialization_format TEXT)")
    base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp INTEGER, data BLOB)")
    base.executemany("INSERT INTO topics VALUES(?, ?, ?, ?)", topics)
    base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    base.commit()
    base.close()
    return path


def write_mcap(path: Path, payloads: Iterable[bytes], serialized_metadata: str = "") -> Path:
    """Write a file as rosbag2 does, with Foxglove's writer; the first message is at 5 ns."""
    path.parent.mkdir(exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/s", "cdr", schema)
        for at, payload in enumerate(payloads, start=5):
            writer.add_message(channel, at, payload, at)
        if serialized_metadata:
            writer.add_metadata("rosbag2", {"serialized_metadata": serialized_metadata})
        writer.finish()
    return path


def texts(path: Path, topic: str = "/s", **options: Any) -> list[str]:
    with Recording(path, **options) as recording:
        return [row["data"] for row in recording[topic].rows()] if topic in recording else []


@pytest.mark.parametrize("lead", [0, 600], ids=["from the start", "behind small ones"])
def test_large_messages_in_sqlite_are_in_memory_a_few_at_a_time(tmp_path: Path, lead: int) -> None:
    size = 2 << 20
    rows = ((1, at, b"x" * (size if at >= lead else 10)) for at in range(lead + 40))
    bag = SqliteBag(write_db(tmp_path / "b_0.db3", rows))
    tracemalloc.start()
    try:
        count = sum(len(block) for block in bag.blocks({1}))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        bag.close()
    assert count == lead + 40
    assert peak < 10 * size  # all together are 40


@pytest.mark.parametrize("number", [10**12, -1, None, "x", 2.5, b"\1"])
def test_the_id_of_a_topic_may_be_anything(tmp_path: Path, number: Any) -> None:
    topics = [(number, "/s", "std_msgs/msg/String", "cdr"), (7, "/t", "std_msgs/msg/String", "cdr")]
    write_db(tmp_path / "b" / "b_0.db3", [(7, 5, string("t")), (number, 6, string("s"))], topics)
    assert texts(tmp_path / "b") == ["s"]
    assert texts(tmp_path / "b", "/t") == ["t"]


def test_a_row_on_a_topic_that_is_not_in_the_table_costs_only_itself(tmp_path: Path) -> None:
    write_db(tmp_path / "b" / "b_0.db3", [(1, 5, string("a")), (9, 6, string("b")), (1, 7, string("c"))])
    with pytest.raises(DamagedFileError, match=r"topic 9, which is not in the table"):
        convert(tmp_path / "b", tmp_path / "raised")
    with pytest.warns(ConversionWarning, match=r"topic 9, which is not in the table; it is left out"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == ["a", "c"]


@pytest.mark.parametrize("pages", [[30], [30, 31, 32], [30, 90]])
def test_a_broken_page_in_sqlite_costs_only_the_rows_in_it(tmp_path: Path, pages: list[int]) -> None:
    count = 6000
    path = write_db(tmp_path / "b" / "b_0.db3", ((1, 5 + at, string(f"m{at}" * 4)) for at in range(count)))
    data = bytearray(path.read_bytes())
    for page in pages:
        data[4096 * page : 4096 * page + 8] = b"\xff" * 8
    path.write_bytes(data)
    base = sqlite3.connect(path)
    readable = []
    for number in range(1, count + 1):  # the judge: SQLite, asked for each row alone
        try:
            readable += base.execute("SELECT timestamp - 5 FROM messages WHERE id = ?", (number,)).fetchall()
        except sqlite3.Error:
            continue
    base.close()
    assert count - 150 * len(pages) < len(readable) < count
    with pytest.raises(DamagedFileError, match=r"b_0\.db3.*malformed"):
        convert(tmp_path / "b", tmp_path / "raised")
    with pytest.warns(ConversionWarning, match=r"b_0\.db3.*no messages with the ids \d+ to \d+.* can be read"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == [f"m{at}" * 4 for (at,) in readable]


@pytest.mark.parametrize(
    "topic", [(1, b"/s", "a/msg/B", "cdr"), (1, "/s", b"\xff", "cdr"), (1, None, "a/msg/B", "cdr")]
)
def test_a_topic_whose_name_or_type_is_no_text_is_named(tmp_path: Path, topic: tuple[Any, ...]) -> None:
    rows = [(1, 5, string("a")), (2, 6, string("b"))]
    write_db(tmp_path / "b" / "b_0.db3", rows, [topic, (2, "/t", "std_msgs/msg/String", "cdr")])
    with pytest.raises(DamagedFileError, match=r"the topic with the id 1 .* not both text"):
        Recording(tmp_path / "b")
    with pytest.warns(ConversionWarning, match="not both text"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run", "/t") == ["b"]


def test_a_folder_or_a_dangling_link_in_place_of_a_file_is_named(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_db(tmp_path / name / "x_0.db3", [(1, 5, string("a"))])
    (tmp_path / "a" / "x_1.db3").mkdir()
    (tmp_path / "b" / "x_1.db3").symlink_to("nowhere")
    with pytest.raises(StorageError, match=r"x_1\.db3"):
        Recording(tmp_path / "a")
    with pytest.raises(MissingRecordingError, match=r"x_1\.db3"):
        Recording(tmp_path / "b")


def test_any_damage_to_a_sqlite_file_is_one_of_our_errors_or_a_warning(tmp_path: Path) -> None:
    path = write_db(tmp_path / "b" / "b_0.db3", [(1, 5 + at, string(f"{at}")) for at in range(300)])
    sound = path.read_bytes()
    random = np.random.default_rng(5)
    for _ in range(60):
        data = bytearray(sound)
        place = int(random.integers(0, 4096 if random.random() < 0.5 else len(data) - 8))
        data[place : place + 8] = random.integers(0, 256, 8, np.uint8).tobytes()
        path.write_bytes(data)
        for salvages in (False, True):
            try:
                bag = SqliteBag(path, salvages=salvages)
            except DamagedFileError:
                continue
            try:
                list(bag.blocks(bag.channels.keys()))
            except DamagedFileError:
                assert not salvages
            finally:
                bag.close()


def test_a_packed_message_that_announces_a_huge_size_is_left_out_alone(tmp_path: Path) -> None:
    pack = zstandard.ZstdCompressor().compress
    huge = b"\x28\xb5\x2f\xfd\xe0" + (1 << 40).to_bytes(8, "little") + b"\1\0\0"  # RFC 8878: content of 1 TiB, no block
    write_mcap(tmp_path / "b" / "b_0.mcap", [pack(string("a")), huge, pack(string("c"))])
    with pytest.raises(DamagedFileError, match="1099511627776 bytes"):
        convert(tmp_path / "b", tmp_path / "raised")
    with pytest.warns(ConversionWarning, match=r"at 6 ns .*1099511627776 bytes.*left out"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == ["a", "c"]


def test_messages_packed_one_by_one_are_unpacked_where_only_the_files_say_so(tmp_path: Path) -> None:
    pack = zstandard.ZstdCompressor().compress
    inside = "rosbag2_bagfile_information:\n  compression_mode: MESSAGE\n  compression_format: zstd\n"
    write_mcap(tmp_path / "b" / "b_0.mcap", [pack(string("a")), pack(string("b"))], inside)
    write_metadata(tmp_path / "b", "[b_0.mcap]")
    assert texts(tmp_path / "b") == ["a", "b"]
    convert(tmp_path / "b", tmp_path / "run")
    assert texts(tmp_path / "run") == ["a", "b"]
    convert(tmp_path / "run", tmp_path / "again")  # its file repeats the record, and its messages are unpacked
    assert texts(tmp_path / "again") == ["a", "b"]


def test_packed_messages_that_nobody_announces_are_not_read_as_they_are(tmp_path: Path) -> None:
    pack = zstandard.ZstdCompressor().compress
    write_mcap(tmp_path / "b" / "b_0.mcap", [])
    write_mcap(tmp_path / "b" / "b_1.mcap", [pack(string("a"))])
    write_mcap(tmp_path / "plain" / "b_0.mcap", [string("a")])
    assert rosbag.read_as_it_is(tmp_path / "b") is None
    assert rosbag.read_as_it_is(tmp_path / "plain") == [tmp_path / "plain" / "b_0.mcap"]


@pytest.mark.parametrize("name", ["b_0.mcap", "b_1.mcap", "b_1.db3", "b_1.mcap.zstd", "b_1.db3.zstd"])
@pytest.mark.parametrize(
    "content", [b"", b"no file of a bag at all, and long enough for a head"], ids=["empty", "broken"]
)
def test_a_file_that_cannot_be_opened_is_left_out_where_the_rest_is_wanted(
    tmp_path: Path, name: str, content: bytes
) -> None:
    write_mcap(tmp_path / "b" / ("b_1.mcap" if name == "b_0.mcap" else "b_0.mcap"), [string("a")])
    (tmp_path / "b" / name).write_bytes(content)
    with pytest.raises(DamagedFileError, match=str(tmp_path / "b" / name)):
        convert(tmp_path / "b", tmp_path / "raised")
    with pytest.warns(ConversionWarning, match=f"{tmp_path / 'b' / name}.*; the file is left out"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == ["a"]


def test_the_only_file_of_a_bag_is_not_left_out(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "b_0.db3").write_bytes(b"")
    with pytest.raises(DamagedFileError, match=r"b_0\.db3"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")


def write_metadata(folder: Path, names: str) -> None:
    text = f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths: {names}\n"
    (folder / "metadata.yaml").write_text(text)


@pytest.mark.parametrize("names", ["[b_0.mcap, b_0.mcap]", "[b/b_0.mcap, b_0.mcap]"])
def test_a_file_that_the_metadata_name_twice_is_read_once(tmp_path: Path, names: str) -> None:
    write_mcap(tmp_path / "b" / "b_0.mcap", [string("a")])
    write_metadata(tmp_path / "b", names)
    assert texts(tmp_path / "b") == ["a"]
    convert(tmp_path / "b", tmp_path / "run")
    assert texts(tmp_path / "run") == ["a"]


@pytest.mark.parametrize(
    "names", ["5", "b_0.mcap", "[1]", "[null]", "{a: 1}", "[[b_0.mcap]]", r'["a\0b"]', "false", "''"]
)
def test_metadata_that_list_no_names_are_named(tmp_path: Path, names: str) -> None:
    write_mcap(tmp_path / "b" / "b_0.mcap", [string("a")])
    write_metadata(tmp_path / "b", names)
    with pytest.raises(DamagedFileError, match=r"metadata\.yaml.*relative_file_paths"):
        Recording(tmp_path / "b")
    with pytest.raises(DamagedFileError, match=r"metadata\.yaml.*relative_file_paths"):
        convert(tmp_path / "b", tmp_path / "run")


def test_files_that_the_metadata_do_not_name_are_named_in_a_warning(tmp_path: Path) -> None:
    for number in range(3):
        write_mcap(tmp_path / "b" / f"b_{number}.mcap", [string(f"{number}")])
    write_metadata(tmp_path / "b", "[b_1.mcap]")
    with pytest.warns(ConversionWarning, match=r"does not name b_0\.mcap, b_2\.mcap; .* not read"):
        assert texts(tmp_path / "b") == ["1"]
    with pytest.warns(ConversionWarning, match=r"does not name b_0\.mcap, b_2\.mcap; .* not read"):
        convert(tmp_path / "b", tmp_path / "run")


def test_what_is_lost_of_a_packed_file_is_told_by_the_name_of_that_file(tmp_path: Path) -> None:
    path = write_db(tmp_path / "b" / "b_0.db3", [(1, 5, string("a")), (9, 6, string("b"))])
    packed = path.with_name("b_0.db3.zstd")
    packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    path.unlink()
    with pytest.warns(ConversionWarning, match=f"^{packed}: a message is on topic 9"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")
    with pytest.raises(DamagedFileError, match=f"^{packed}, "):
        convert(tmp_path / "b", tmp_path / "raised")


def test_what_is_lost_of_a_packed_mcap_file_is_told_by_the_name_of_that_file(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "b" / "b_0.mcap", [string("a")])
    packed = path.with_name("b_0.mcap.zstd")
    packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()[:-20]))  # without its end
    path.unlink()
    with pytest.warns(ConversionWarning, match=f"^{packed}"):
        convert(tmp_path / "b", tmp_path / "run", on_damage="skip")
    assert texts(tmp_path / "run") == ["a"]
