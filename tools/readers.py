"""The contenders of the reading benchmark: how each one's users read a topic."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from recordings import ROS_FIELDS, ROS_TYPE, TOPIC
from robot_rows import WIDTHS

if TYPE_CHECKING:
    import pyarrow as pa

ReadRow = dict[str, Any]
NS_PER_S = 10**9
ALL = 2**31  # more rows than there are


class Reader(Protocol):
    """An opened recording."""

    def table(self, columns: Sequence[str] | None) -> pa.Table:
        """Return the topic as an Arrow table, or some columns of it."""

    def rows(self) -> Iterable[ReadRow]:
        """Return or yield the topic's rows as dicts."""

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        """Return the rows between two times, both of which lie between rows."""

    def close(self) -> None:
        """Let go of everything."""


class Ours:
    """`Recording(folder)[topic]` with `.to_arrow(columns=...)`, `.rows()`, `.rows(start, end)`."""

    def __init__(self, folder: Path) -> None:
        from ml_dash_mcap import Recording

        self._recording = Recording(folder)
        self.close = self._recording.close

    def table(self, columns: Sequence[str] | None) -> pa.Table:
        return self._recording[TOPIC].to_arrow(columns=columns)

    def rows(self) -> Iterator[ReadRow]:
        return self._recording[TOPIC].rows()

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        return list(self._recording[TOPIC].rows(start_s, end_s))


class OursAsArrow(Ours):
    """The same, a window by `.to_arrow(start, end)` and then `.to_pylist()`."""

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        return self._recording[TOPIC].to_arrow(start_s, end_s).to_pylist()  # type: ignore[no-any-return]


class FromRows:
    """What readers share that know rows only: a table is made of them by `pyarrow.Table.from_pylist`."""

    def rows(self) -> Iterable[ReadRow]:
        raise NotImplementedError

    def table(self, columns: Sequence[str] | None) -> pa.Table:
        import pyarrow as pa

        if columns is None:
            return pa.Table.from_pylist(list(self.rows()))
        return pa.Table.from_pylist([{name: row[name] for name in columns} for row in self.rows()])


class Mcap(FromRows):
    """`make_reader(file).iter_messages(topics=...)`, which uses the index, and `json.loads(message.data)`."""

    loads: Callable[[bytes], ReadRow] = staticmethod(json.loads)

    def __init__(self, folder: Path) -> None:
        from mcap.reader import make_reader

        (path,) = folder.glob("*.mcap")
        self._file = path.open("rb")
        self._reader = make_reader(self._file)
        self.close = self._file.close

    def rows(self) -> Iterator[ReadRow]:
        loads = self.loads
        return (loads(message.data) for _, _, message in self._reader.iter_messages(topics=[TOPIC]))

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        start_ns, end_ns = int(start_s * NS_PER_S), int(end_s * NS_PER_S)
        found = self._reader.iter_messages(topics=[TOPIC], start_time=start_ns, end_time=end_ns)
        return [self.loads(message.data) for _, _, message in found]


class McapOrjson(Mcap):
    """The same with `orjson.loads`."""

    def __init__(self, folder: Path) -> None:
        from orjson import loads

        super().__init__(folder)
        self.loads = loads


class Rosbags(FromRows):
    """`AnyReader([bag]).messages(connections, start, stop)` and `.deserialize`; its arrays become the dicts' values."""

    def __init__(self, folder: Path) -> None:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        types = get_typestore(Stores.ROS2_JAZZY)
        types.register(get_types_from_msg(ROS_FIELDS, ROS_TYPE))
        self._reader = AnyReader([folder / "bag"], default_typestore=types)
        self._reader.open()
        self.close = self._reader.close

    def rows(self, start_ns: int | None = None, stop_ns: int | None = None) -> Iterator[ReadRow]:
        connections = [one for one in self._reader.connections if one.topic == f"/{TOPIC}"]
        for connection, time_ns, data in self._reader.messages(connections, start_ns, stop_ns):
            message = self._reader.deserialize(data, connection.msgtype)
            yield {"_ts": time_ns / NS_PER_S, **{name: getattr(message, name) for name in WIDTHS}}

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        return list(self.rows(int(start_s * NS_PER_S), int(end_s * NS_PER_S)))


class MlDash(FromRows):
    """`exp.tracks(topic).read(start_timestamp, end_timestamp, columns)["entries"]` of a local run."""

    def __init__(self, folder: Path) -> None:
        from ml_dash import Experiment

        stack = ExitStack()
        exp = stack.enter_context(Experiment(prefix="bench/read/run", dash_root=str(folder)).run)
        self._track = exp.tracks(TOPIC)
        self.close = stack.close

    def table(self, columns: Sequence[str] | None) -> pa.Table:
        import pyarrow as pa

        return pa.Table.from_pylist(self._track.read(columns=columns)["entries"])

    def rows(self) -> list[ReadRow]:
        return self._track.read()["entries"]  # type: ignore[no-any-return]

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        return self._track.read(start_s, end_s)["entries"]  # type: ignore[no-any-return]


class Dreamlake(FromRows):
    """`episode.track(topic).read(0, limit)["data"]` and `.read_by_time(start, end, limit)["data"]`, of a local root."""

    def __init__(self, folder: Path) -> None:
        from dreamlake import Episode

        stack = ExitStack()
        self._track = stack.enter_context(Episode(prefix="bench/read", root=str(folder))).track(TOPIC)
        self.close = stack.close

    def rows(self) -> list[ReadRow]:
        return [point["data"] for point in self._track.read(0, ALL)["data"]]

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        return [point["data"] for point in self._track.read_by_time(start_s, end_s, ALL)["data"]]


class Rerun:
    """A server of its own on the .rrd, `dataset.filter_contents(...).reader(index="time")`, `.to_arrow_table()`."""

    def __init__(self, folder: Path) -> None:
        import rerun as rr

        recording = str(folder / "bench.rrd")
        self._server = rr.server.Server(host="127.0.0.1", datasets={"bench": [recording]})
        self._dataset = self._server.client().get_dataset("bench")
        self.close = self._server.shutdown

    def table(self, columns: Sequence[str] | None) -> pa.Table:
        return self._renamed(self._frame(columns).to_arrow_table())

    def rows(self) -> list[ReadRow]:
        return self.table(None).to_pylist()  # type: ignore[no-any-return]

    def window(self, start_s: float, end_s: float) -> list[ReadRow]:
        import pyarrow as pa
        from datafusion import col, lit

        start, end = (pa.scalar(int(one * NS_PER_S), pa.timestamp("ns")) for one in (start_s, end_s))
        frame = self._frame(None).filter((col("time") >= lit(start)) & (col("time") <= lit(end)))
        return self._renamed(frame.to_arrow_table()).to_pylist()  # type: ignore[no-any-return]

    def _frame(self, columns: Sequence[str] | None) -> Any:
        entities = [f"/{TOPIC}/**"] if columns is None else [f"/{TOPIC}/{name}" for name in columns]
        return self._dataset.filter_contents(entities).reader(index="time")

    def _renamed(self, table: pa.Table) -> pa.Table:
        return table.rename_columns([name.removeprefix(f"/{TOPIC}/").partition(":")[0] for name in table.column_names])


@dataclass(frozen=True, slots=True)
class Contender:
    """One way of reading a topic."""

    title: str  # as the tables print it
    form: str  # what it reads, one of recordings.FORMS
    open: Callable[[Path], Reader]  # its docstring says what is timed


CONTENDERS = {
    "ours": Contender("ml-dash-mcap", "ours", Ours),
    "typed": Contender("ml-dash-mcap, protobuf", "typed", Ours),
    "ours-arrow": Contender("ml-dash-mcap, by way of Arrow", "ours", OursAsArrow),
    "mcap": Contender("mcap, json", "mcap", Mcap),
    "mcap-orjson": Contender("mcap, orjson", "mcap", McapOrjson),
    "mcap-ours": Contender("mcap, json, on our file", "ours", Mcap),
    "rosbags": Contender("rosbags", "rosbag2", Rosbags),
    "ml-dash": Contender("ml-dash", "ml-dash", MlDash),
    "dreamlake": Contender("dreamlake", "dreamlake", Dreamlake),
    "rerun": Contender("rerun", "rerun", Rerun),
}
