"""The registry of foreign formats: one entry each, in one table that everything asks.

Importing this module, and asking it what lies at a path, imports no format. The modules that read and write a format
are named in its entry and are imported when they are needed. `register` adds a format from outside.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeAlias

from ..codecs.ros.distros import METADATA_FILE
from ..errors import FormatError, UsageError
from ..file_names import ACTIVE_SUFFIX, SEGMENT_SUFFIX
from ..suggestions import did_you_mean
from . import file_signs as signs
from .file_start import FileStart, Sign

Progress = Callable[[int, int], object]
"""Called now and then with the rows done and the rows in all."""

Reference: TypeAlias = str | Callable[..., Any]
"""A function or class; or where it lies below this folder, such as "tables.csv.read:record", to be imported later."""

Ability = Literal["read", "write", "stream", "render"]
"""The abilities that a format may have."""


@dataclass(frozen=True, slots=True)
class NoOptions:
    """The options of a format that has none."""


@dataclass(frozen=True, slots=True)
class Format:
    """A format: how its files are told from others, and what reads and writes them. None is what it cannot do.

    Example:
        >>> def read(src, recorder, options, progress):
        ...     recorder.topic("notes").append(_ts=0.0, text=src.read_text())
        >>> def write(job, options):
        ...     rows = [row for topic in job.topics for row in job.part(topic).rows()]
        ...     job.dest.write_text("".join(row["text"] for row in rows))
        ...     return job.dest
        >>> register(Format("note", suffixes=(".note",), detect=named(".note"), read=read, write=write))
        >>> convert("shopping.note", "runs/shopping")
    """

    name: str
    _: KW_ONLY
    suffixes: tuple[str, ...] = ()
    """Suffixes of destinations that mean this format, such as ".csv"; in small letters."""
    detect: Sign | None = None
    """Tells whether what lies at a path has this format; `file_start` has what such functions are made of."""
    inside: tuple[str, ...] = ()
    """Endings of names; only a folder with a file of such a name is worth asking `detect` about."""
    read: Reference | None = None
    """`read(src, recorder, options, progress)` appends what a file or folder has to a recorder."""
    carry: Reference | None = None
    """`carry(src, folder, prefix, options, progress)` makes a recording in a folder; used instead of `read`."""
    as_it_lies: Reference | None = None
    """`as_it_lies(src)` returns the MCAP files at a path in the order of writing; None if they must be converted."""
    read_options: Reference = NoOptions
    """The dataclass of the options of `read` or `carry`."""
    write: Reference | None = None
    """`write(job, options)` writes a recording and returns where the result is."""
    write_options: Reference = NoOptions
    """The dataclass of the options of `write`."""
    stream: Reference | None = None
    """`stream(part, info, out)` writes a topic's rows to an open file."""
    render: Reference | None = None
    """`render(part)` returns a topic's rows as a value."""
    contents: str = r"(?!)"
    """A regular expression for the names of all files in a folder that `write` makes. A file has none."""
    landmark: str = ""
    """The name of a file that is in each such folder."""

    def can(self, ability: Ability) -> bool:
        """Whether the format can do something."""
        if ability == "read":
            return self.read is not None or self.carry is not None
        return getattr(self, ability) is not None


_PACKAGE = r"[^/]+/(package\.xml|CMakeLists\.txt|msg/[^/]+\.msg)"
"""The files of the package that defines the messages of a bag."""

OF_RECORDINGS = r"[^/]+\.mcap(\.active)?|\.ml_dash-[^/]+\.(json|journal)|files/.+"
"""The files in the folder of a recording."""

_BAG_FILES = r"[^/]+\.(mcap|db3|db3-wal|db3-shm|mcap\.zstd|db3\.zstd)"

_BUILT_IN = (
    Format(
        "rosbag1",
        suffixes=(".bag",),
        detect=signs.rosbag1,
        carry="ros.read:carry",
        read_options="ros.bag_options:RosbagReadOptions",
        write="ros.write_ros1:export",
        write_options="ros.bag_options:Rosbag1WriteOptions",
        contents=_PACKAGE,
    ),
    Format(
        "rosbag2",
        detect=signs.rosbag2,
        inside=(METADATA_FILE, *signs.ROS2_PACKED),
        carry="ros.read:carry",
        read_options="ros.bag_options:RosbagReadOptions",
        as_it_lies="ros.read:read_as_it_is",
        write="ros.write_ros2:export",
        write_options="ros.bag_options:Rosbag2WriteOptions",
        contents=rf"{METADATA_FILE}|{_BAG_FILES}|{_PACKAGE}",
        landmark=METADATA_FILE,
    ),
    Format(
        "mocap",
        detect=signs.motive,
        read="mocap.motive.read:record",
        read_options="mocap.take_options:MotiveReadOptions",
        write="mocap.motive.write:export",
        write_options="mocap.take_options:MocapWriteOptions",
        render="mocap.mocap_dict:render",
    ),
    Format(
        "sto",
        suffixes=(".sto",),
        detect=signs.sto,
        read="mocap.sto.read:record",
        read_options="mocap.take_options:StoReadOptions",
        write="mocap.sto.write:export",
        write_options="mocap.take_options:StoWriteOptions",
    ),
    Format(
        "trc",
        suffixes=(".trc",),
        detect=signs.trc,
        read="mocap.trc.read:record",
        read_options="mocap.take_options:TrcReadOptions",
        write="mocap.trc.write:export",
        write_options="mocap.take_options:TrcWriteOptions",
    ),
    Format(
        "qtm",
        suffixes=(".tsv",),
        detect=signs.qtm,
        read="mocap.qtm.read:record",
        read_options="mocap.take_options:QtmReadOptions",
        write="mocap.qtm.write:export",
        write_options="mocap.take_options:QtmWriteOptions",
    ),
    Format(
        "vicon",
        detect=signs.vicon,
        read="mocap.vicon.read:record",
        read_options="mocap.take_options:ViconReadOptions",
        write="mocap.vicon.write:export",
        write_options="mocap.take_options:ViconWriteOptions",
    ),
    Format(
        "wide",
        detect=signs.wide,
        read="mocap.wide.read:record",
        read_options="mocap.take_options:WideReadOptions",
    ),
    Format(
        "c3d",
        suffixes=(".c3d",),
        detect=signs.c3d,
        read="mocap.c3d.read:record",
        read_options="mocap.take_options:C3dReadOptions",
        write="mocap.c3d.write:export",
        write_options="mocap.take_options:C3dWriteOptions",
    ),
    Format(
        "parquet",
        suffixes=(".parquet",),
        detect=signs.parquet,
        inside=(".parquet", ".pq"),
        read="tables.parquet.read:record",
        read_options="tables.table_options:ParquetReadOptions",
        write="tables.parquet.write:export",
        write_options="tables.table_options:ParquetWriteOptions",
        render="tables.parquet.write:render",
        contents=r"[^/]+\.parquet",
    ),
    Format(
        "jsonl",
        suffixes=(".jsonl",),
        detect=signs.jsonl,
        inside=(".jsonl", ".ndjson"),
        read="tables.jsonl.read:record",
        read_options="tables.table_options:TableReadOptions",
        write="tables.jsonl.write:export",
        stream="tables.jsonl.write:stream",
        render="tables.jsonl.text:render",
        contents=r"[^/]+\.jsonl",
    ),
    Format(
        "csv",
        suffixes=(".csv",),
        detect=signs.csv,
        inside=(".csv", ".tsv"),
        read="tables.csv.read:record",
        read_options="tables.table_options:CsvReadOptions",
        write="tables.csv.write:export",
        stream="tables.csv.write:stream",
        contents=r"[^/]+\.csv",
    ),
    Format(
        "dreamlake",
        write="dreamlake:export",
        contents=r"session\.json|parameters\.json|tracks/.+/(data\.jsonl|metadata\.json)",
        landmark="session.json",
    ),
    Format("json", render="tables.row_entries:render"),
    Format(
        "mcap",
        write="mcap.write:export",
        write_options="mcap.mcap_options:McapWriteOptions",
        render="mcap_rows:render",
        contents=OF_RECORDINGS,
    ),
)
"""In the order in which they are asked whether a file is theirs: `csv` after those with more in a file of that name."""

_formats: dict[str, Format] = {entry.name: entry for entry in _BUILT_IN}


def register(format: Format) -> None:
    """Add a format for this process: `convert`, `export`, `Recording(path)` and the command line then know it.

    A format that is registered is asked for a file before those that were there.

    Raises:
        UsageError: There is a format of that name, or what was passed is no Format; also a TypeError.
    """
    global _formats
    if not isinstance(format, Format):
        raise UsageError(f"register({format!r}): pass a Format(...), not {type(format).__name__}")
    if format.name in _formats:
        raise UsageError(f"register(): there is a format {format.name!r} already; choose another name")
    # A new dict instead of a change: another thread may be going through the old one.
    _formats = {format.name: format, **_formats}


def unregister(name: str) -> None:
    """Forget a format that `register` added; one that is not there is no error."""
    if name not in {entry.name for entry in _BUILT_IN}:
        _formats.pop(name, None)


def names(ability: Ability) -> list[str]:
    """Return the names of the formats that can do something, sorted."""
    return sorted(name for name, entry in _formats.items() if entry.can(ability))


def find(name: str | None, ability: Ability) -> Format | None:
    """Return the format of a name; None if there is none that can do what is asked for."""
    entry = _formats.get(name) if name is not None else None
    return entry if entry is not None and entry.can(ability) else None


def hint(name: object, ability: Ability) -> str:
    """Return the end of an error message for an unknown format: the format that was probably meant, and all formats."""
    return f"{did_you_mean(name, names(ability))} the formats are {', '.join(names(ability))}".strip()


def load(reference: Reference) -> Any:
    """Return a function or class of an entry."""
    if not isinstance(reference, str):
        return reference
    module, _, name = reference.partition(":")
    return getattr(import_module(f".{module}", __package__), name)


def detect(path: str | Path) -> str | None:
    """Return the format of what is at a path; None if it is none of them, or nothing is there."""
    path = Path(path)
    if not path.exists():
        return None
    # All signs share one start of the file, which is read once.
    start = FileStart(path)
    return next((name for name, entry in _formats.items() if entry.detect and entry.detect(start)), None)


def may_be_foreign(path: Path) -> bool:
    """Whether `detect` is worth asking about what is at a path: not for the segments of a recording."""
    if not path.is_dir():
        return path.is_file() and not path.name.removesuffix(ACTIVE_SUFFIX).endswith(SEGMENT_SUFFIX)
    endings = tuple(ending for entry in _formats.values() for ending in entry.inside)
    try:
        return any(inside.name.endswith(endings) for inside in path.iterdir())
    except OSError:  # opening the folder reports why it cannot be read
        return False


def suffix_format(dest: Path) -> str | None:
    """Return the format that the suffix of a destination means; None if it means none."""
    suffix = dest.suffix.lower()
    return next((name for name, entry in _formats.items() if suffix in entry.suffixes), None)


def format_of(dest: Path) -> str:
    """Return the format that the suffix of a destination means.

    Raises:
        FormatError: It means none; the message names all formats and suffixes.
    """
    name = suffix_format(dest)
    if name is None:
        suffixes = ", ".join(f"{suffix} ({name})" for name, entry in _formats.items() for suffix in entry.suffixes)
        raise FormatError(
            f"{str(dest)!r} does not say which format to write: pass format=, one of {', '.join(names('write'))};"
            f" or end it with {suffixes}"
        )
    return name


def option_names(options: Reference) -> list[str]:
    """Return the names of the options that a dataclass of options has."""
    return [field.name for field in fields(load(options)) if field.init]


def make_options(options: Reference, given: Mapping[str, Any], subject: str) -> Any:
    """Return a dataclass of options with what a caller gave.

    Args:
        options: The dataclass.
        given: Option to its value; or an instance of the dataclass as `options`, where None is no options.
        subject: Whose options they are, for the error message.

    Raises:
        UsageError: There is no such option, or options are given in both ways.
        OptionError: An option has a value that it cannot have.
    """
    kind = load(options)
    instance = given.get("options")
    given = {name: value for name, value in given.items() if name != "options"}
    if instance is not None:
        if not isinstance(instance, kind):
            raise UsageError(f"{subject} takes {kind.__name__} as options=, not {type(instance).__name__}")
        if given:
            raise UsageError(f"{subject} got options= and {', '.join(given)}= too; put them into {kind.__name__}(...)")
        return instance
    offered = option_names(kind)
    for name in given:
        if name not in offered:
            meant = did_you_mean(name, offered, spelling="{}=")
            raise UsageError(
                f"{subject} has no option {name!r}; it has {', '.join(offered) or 'none'}. {meant}".rstrip(" .")
            )
    return kind(**given)
