"""One topic in the indexes of a recording's files: its channels, its chunks, the times of its messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from ..codecs.decode import codec_of
from ..file_names import KIND_KEY, TRACK
from ..mcap.file_index import FileIndex, replanned
from ..mcap.records import Channel
from . import plan
from .file import File
from .plan import ChunkPlan, Located

LAST_NS = 2**64 - 1
"""The last time that MCAP can say, in ns."""

_Range = tuple[int, int]
_State = list[tuple[FileIndex, int]]


def is_merged(channel: Channel) -> bool:
    """Whether a channel's rows of one time stamp are one row: those of tracks, unless nobody here can decode them."""
    return channel.metadata.get(KIND_KEY) == TRACK and codec_of(channel) is not None


class StoredTopic:
    """A topic of a recording, which need not exist: then it has no channels.

    Its chunks are looked up once: a plan is kept until an index changes. Any thread may call it.

    Attributes:
        name: Of the topic.
    """

    __slots__ = ("_files", "_plans", "_state", "name")

    def __init__(self, files: Sequence[File] | Callable[[], Sequence[File]], name: str) -> None:
        """Look nothing up yet.

        Args:
            files: The recording's files in the order of writing, or a function that returns them.
            name: Of the topic.
        """
        self.name = name
        self._files = files
        self._state: _State = []
        self._plans: dict[_Range, ChunkPlan] = {}

    @property
    def files(self) -> Sequence[File]:
        """The recording's files, in the order of writing.

        Raises:
            StateError: The recording is closed.
        """
        return self._files() if callable(self._files) else self._files

    def check_open(self) -> None:
        """Raise StateError if the recording is closed, before a generator would."""
        _ = self.files

    @property
    def channels(self) -> list[tuple[File, Channel]]:
        """The topic's channels, in the order of writing."""
        return [(file, channel) for file in self.files for channel in file.index.channels_of(self.name).values()]

    @property
    def kind(self) -> str | None:
        """The kind of the topic; None if no channel names it."""
        kinds = (channel.metadata.get(KIND_KEY) for _, channel in self.channels)
        return next((kind for kind in kinds if kind is not None), None)

    @property
    def is_track(self) -> bool:
        """Whether rows of one time stamp are one row, see `is_merged`."""
        return self.kind == TRACK and all(codec_of(channel) is not None for _, channel in self.channels)

    def chunks(self, start_ns: int = 0, end_ns: int = LAST_NS) -> ChunkPlan:
        """Return the chunks that may hold messages with log times in [start_ns, end_ns], by their start times."""
        files = self.files
        state = [file.state for file in files]
        if not _is_same(state, self._state):
            self._state, self._plans = state, {}
        # This state's own dict: a thread that sees a newer state makes a new one, and plans are never mixed.
        plans = self._plans
        planned = plans.get((start_ns, end_ns))
        if planned is not None:
            return planned
        everything = plans.get((0, LAST_NS))
        if everything is not None:
            return everything.within(start_ns, end_ns)
        channels = [index.channels_of(self.name) for index, _ in state]
        planned = plans[start_ns, end_ns] = plan.chunks([index for index, _ in state], channels, start_ns, end_ns)
        return planned

    def times_in(self, located: Located) -> npt.NDArray[np.uint64]:
        """Return the log times of the topic's messages in one chunk, in ns; reads its message indexes."""
        file = self.files[located.file]
        times = [file.message_index(located.chunk, id_).times_ns for id_ in file.index.channels_of(self.name)]
        if len(times) == 1:
            return times[0]
        return np.concatenate(times) if times else np.empty(0, np.uint64)

    @replanned
    def times(self, start_ns: int = 0, end_ns: int = LAST_NS) -> npt.NDArray[np.uint64]:
        """Return the log times of the topic's messages in [start_ns, end_ns], in no order, [N], in ns."""
        times = [self.times_in(located) for located in self.chunks(start_ns, end_ns)]
        joined: npt.NDArray[np.uint64] = np.concatenate(times) if times else np.empty(0, np.uint64)
        is_wanted: npt.NDArray[np.bool_] = (joined >= np.uint64(start_ns)) & (joined <= np.uint64(max(end_ns, 0)))
        return joined[is_wanted]

    @replanned
    def first_ns(self, start_ns: int = 0) -> int | None:
        """Return the earliest log time from one on, in ns; None if all are earlier. Reads few message indexes."""
        first: int | None = None
        chunks = self.chunks(start_ns, LAST_NS)
        for at, chunk_start_ns in enumerate(chunks.start_ns.tolist()):
            # Chunks come by start time, so no later one has an earlier message.
            if first is not None and chunk_start_ns > first:
                break
            times = self.times_in(chunks[at])
            times = times[times >= np.uint64(min(start_ns, LAST_NS))]
            if len(times):
                first = int(times.min()) if first is None else min(first, int(times.min()))
        return first

    @replanned
    def last_ns(self, end_ns: int = LAST_NS) -> int | None:
        """Return the latest log time up to one, in ns; None if all are later. Reads few message indexes."""
        last: int | None = None
        chunks = self.chunks(0, end_ns)
        for at in np.argsort(chunks.end_ns, kind="stable")[::-1].tolist():
            # Here they come by end time, the latest first.
            if last is not None and int(chunks.end_ns[at]) < last:
                break
            times = self.times_in(chunks[at])
            times = times[times <= np.uint64(end_ns)]
            if len(times):
                last = int(times.max()) if last is None else max(last, int(times.max()))
        return last


def _is_same(state: _State, before: _State) -> bool:
    """Whether the indexes are the same objects as before, and were not corrected since."""
    return len(state) == len(before) and all(
        now[0] is then[0] and now[1] == then[1] for now, then in zip(state, before, strict=True)
    )
