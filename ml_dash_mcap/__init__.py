"""A recorder for robots: a control loop logs to it, and it leaves MCAP files that open everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .version import __version__

if TYPE_CHECKING:
    from .capture.prepared_block import PreparedBlock
    from .capture.sink import SessionInfo, Sink
    from .capture.stats import SinkStats, Stats
    from .catalog import CatalogEntry, recordings
    from .codecs.codec import Codec
    from .conversion import convert
    from .errors import (
        AlignmentError,
        BacklogFullError,
        ConversionError,
        ConversionWarning,
        DamagedFileError,
        DestinationExistsError,
        EncodingError,
        EntryNotFoundError,
        FieldError,
        ForeignFileError,
        FormatError,
        IntegerRangeError,
        MissingObjectError,
        MissingRecordingError,
        NotFoundError,
        OptionError,
        PrefixError,
        RangeError,
        RecorderError,
        StaleVersionError,
        StateError,
        StorageError,
        TimestampError,
        TopicError,
        UndecodedWarning,
        UsageError,
    )
    from .experiment import Experiment
    from .formats.mcap.mcap_options import McapWriteOptions
    from .formats.mocap.take_options import (
        C3dReadOptions,
        C3dWriteOptions,
        MocapWriteOptions,
        MotiveReadOptions,
        QtmReadOptions,
        QtmWriteOptions,
        StoReadOptions,
        StoWriteOptions,
        TrcReadOptions,
        TrcWriteOptions,
        ViconReadOptions,
        ViconWriteOptions,
        WideReadOptions,
    )
    from .formats.registry import Format
    from .formats.ros.bag_options import Rosbag1WriteOptions, Rosbag2WriteOptions, RosbagReadOptions
    from .formats.tables.table_options import (
        CsvReadOptions,
        ParquetReadOptions,
        ParquetWriteOptions,
        TableReadOptions,
    )
    from .inspect.episodes import Episode
    from .inspect.field_shapes import Field
    from .inspect.findings import Finding, Report
    from .inspect.gaps import Gap
    from .inspect.runs import RunInfo
    from .inspect.topics import TopicInfo
    from .mcap.limits import Limits
    from .mcap.losses import Loss
    from .options import RecorderOptions
    from .query.attachments import Attachment, Attachments
    from .recorder import Recorder
    from .recording import Recording
    from .recovery import Recovered, recover
    from .rows.result_dicts import (
        Entries,
        Page,
        Take,
        TimePage,
    )
    from .run.dreamlake_tracks import SessionTrack
    from .run.tracks import Track, TrackSlice
    from .selection import Selection
    from .session import Session
    from .store.local import LocalFolder
    from .store.objects import ObjectStore
    from .store.store import Store, StoredObject
    from .topic import Topic
    from .topic_reader import TopicReader

__all__ = [
    "AlignmentError",
    "Attachment",
    "Attachments",
    "BacklogFullError",
    "C3dReadOptions",
    "C3dWriteOptions",
    "CatalogEntry",
    "Codec",
    "ConversionError",
    "ConversionWarning",
    "CsvReadOptions",
    "DamagedFileError",
    "DestinationExistsError",
    "EncodingError",
    "Entries",
    "EntryNotFoundError",
    "Episode",
    "Experiment",
    "Field",
    "FieldError",
    "Finding",
    "ForeignFileError",
    "Format",
    "FormatError",
    "Gap",
    "IntegerRangeError",
    "Limits",
    "LocalFolder",
    "Loss",
    "McapWriteOptions",
    "MissingObjectError",
    "MissingRecordingError",
    "MocapWriteOptions",
    "MotiveReadOptions",
    "NotFoundError",
    "ObjectStore",
    "OptionError",
    "Page",
    "ParquetReadOptions",
    "ParquetWriteOptions",
    "PrefixError",
    "PreparedBlock",
    "QtmReadOptions",
    "QtmWriteOptions",
    "RangeError",
    "Recorder",
    "RecorderError",
    "RecorderOptions",
    "Recording",
    "Recovered",
    "Report",
    "Rosbag1WriteOptions",
    "Rosbag2WriteOptions",
    "RosbagReadOptions",
    "RunInfo",
    "Selection",
    "Session",
    "SessionInfo",
    "SessionTrack",
    "Sink",
    "SinkStats",
    "StaleVersionError",
    "StateError",
    "Stats",
    "StoReadOptions",
    "StoWriteOptions",
    "StorageError",
    "Store",
    "StoredObject",
    "TableReadOptions",
    "Take",
    "TimePage",
    "TimestampError",
    "Topic",
    "TopicError",
    "TopicInfo",
    "TopicReader",
    "Track",
    "TrackSlice",
    "TrcReadOptions",
    "TrcWriteOptions",
    "UndecodedWarning",
    "UsageError",
    "ViconReadOptions",
    "ViconWriteOptions",
    "WideReadOptions",
    "__version__",
    "convert",
    "recordings",
    "recover",
]

_HOMES = {
    "PreparedBlock": "capture.prepared_block",
    "SessionInfo": "capture.sink",
    "Sink": "capture.sink",
    "SinkStats": "capture.stats",
    "Stats": "capture.stats",
    "CatalogEntry": "catalog",
    "Codec": "codecs.codec",
    "recordings": "catalog",
    "convert": "conversion",
    "Experiment": "experiment",
    "C3dReadOptions": "formats.mocap.take_options",
    "C3dWriteOptions": "formats.mocap.take_options",
    "MocapWriteOptions": "formats.mocap.take_options",
    "MotiveReadOptions": "formats.mocap.take_options",
    "QtmReadOptions": "formats.mocap.take_options",
    "QtmWriteOptions": "formats.mocap.take_options",
    "StoReadOptions": "formats.mocap.take_options",
    "StoWriteOptions": "formats.mocap.take_options",
    "TrcReadOptions": "formats.mocap.take_options",
    "TrcWriteOptions": "formats.mocap.take_options",
    "ViconReadOptions": "formats.mocap.take_options",
    "ViconWriteOptions": "formats.mocap.take_options",
    "WideReadOptions": "formats.mocap.take_options",
    "McapWriteOptions": "formats.mcap.mcap_options",
    "Format": "formats.registry",
    "Rosbag1WriteOptions": "formats.ros.bag_options",
    "Rosbag2WriteOptions": "formats.ros.bag_options",
    "RosbagReadOptions": "formats.ros.bag_options",
    "CsvReadOptions": "formats.tables.table_options",
    "ParquetReadOptions": "formats.tables.table_options",
    "ParquetWriteOptions": "formats.tables.table_options",
    "TableReadOptions": "formats.tables.table_options",
    "Episode": "inspect.episodes",
    "Field": "inspect.field_shapes",
    "Finding": "inspect.findings",
    "Report": "inspect.findings",
    "Gap": "inspect.gaps",
    "RunInfo": "inspect.runs",
    "TopicInfo": "inspect.topics",
    "Limits": "mcap.limits",
    "Loss": "mcap.losses",
    "RecorderOptions": "options",
    "Attachment": "query.attachments",
    "Attachments": "query.attachments",
    "Recorder": "recorder",
    "Recording": "recording",
    "Recovered": "recovery",
    "recover": "recovery",
    "Entries": "rows.result_dicts",
    "Page": "rows.result_dicts",
    "Take": "rows.result_dicts",
    "TimePage": "rows.result_dicts",
    "SessionTrack": "run.dreamlake_tracks",
    "Track": "run.tracks",
    "TrackSlice": "run.tracks",
    "Selection": "selection",
    "Session": "session",
    "LocalFolder": "store.local",
    "ObjectStore": "store.objects",
    "Store": "store.store",
    "StoredObject": "store.store",
    "Topic": "topic",
    "TopicReader": "topic_reader",
}
"""Where each public name is defined; what is not here comes from `errors`."""


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that importing the package loads nothing heavy."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{_HOMES.get(name, 'errors')}"), name)
    # Later uses find the name in the module and do not come here again.
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
