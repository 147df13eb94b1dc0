"""The options of reading and writing motion capture files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from ...errors import OptionError
from ...meaning import rotations, space
from ...meaning.mocap_objects import MARKERS_TOPIC
from ..text.headers import check_on_bad

Rate: TypeAlias = float | Literal["median"] | None
"""Frames a second; "median" for one over the median distance of the rows; None for the rows as they are."""


@dataclass(frozen=True, kw_only=True)
class TakeReadOptions:
    """How every motion capture file is read."""

    on_bad: Literal["raise", "missing"] = "raise"
    """What to do with cells that are no numbers, or with a C3D file that ends too early: "raise", or "missing" to leave
    out what is not there and warn."""
    start: float | None = None
    """The time stamp of the file's time 0, or of its first frame, in s; it comes before what the file says."""

    def __post_init__(self) -> None:
        check_on_bad(self.on_bad)


@dataclass(frozen=True, kw_only=True)
class MotiveReadOptions(TakeReadOptions):
    """How CSV files of Motive are read."""

    timezone: str = "UTC"
    """The time zone of the file's start time, which the file does not state: an IANA name."""
    length_units: Literal["m", "cm", "mm"] | None = None
    """Of the file, instead of what it says."""


@dataclass(frozen=True, kw_only=True)
class ViconReadOptions(TakeReadOptions):
    """How CSV files of Vicon are read."""

    topic: str = MARKERS_TOPIC
    """The topic of markers that belong to no set or subject."""


@dataclass(frozen=True, kw_only=True)
class QtmReadOptions(ViconReadOptions):
    """How TSV files of QTM are read."""

    timezone: str = "UTC"
    """The time zone of the file's time stamp, which the file does not state: an IANA name."""


@dataclass(frozen=True, kw_only=True)
class TrcReadOptions(ViconReadOptions):
    """How marker files are read."""

    length_units: Literal["m", "cm", "mm"] | None = None
    """Of the file, instead of what it says."""


@dataclass(frozen=True, kw_only=True)
class C3dReadOptions(TrcReadOptions):
    """How C3D files are read."""


@dataclass(frozen=True, kw_only=True)
class StoReadOptions(TakeReadOptions):
    """How storage files are read."""

    topic: str | None = None
    """The name of the topic; by default "joints", for quaternions "orientations", for vectors "vectors"."""


@dataclass(frozen=True, kw_only=True)
class WideReadOptions(TakeReadOptions):
    """How wide tables are read."""

    topic: str | None = None
    """The topic of columns that do not say theirs; the file's name by default."""


@dataclass(frozen=True, kw_only=True)
class TakeOptions:
    """The options of making a take of a recording. A format has those that its class takes."""

    rate: Rate = None
    """Frames a second, or "median", to resample to. None for the rows as they are: they must be evenly spaced, but in
    storage files and wide tables, which have times."""
    up: Literal["z", "y"] | None = field(default=None, init=False)
    """Which axis points up. A topic is turned if another one does there, which its metadata says (`up`; "z" if it does
    not say). None turns nothing: what was recorded without a word of axes has z up in the file, and what came from a
    file with y up has y up again. OpenSim's models have "y"."""
    canonical: bool = field(default=True, init=False)
    """Whether quaternions are negated to follow each other without jumps."""
    quat_order: Literal["xyzw", "wxyz"] | None = field(default=None, init=False)
    """The order of the recording's quaternions, if its metadata does not state it."""
    on_bad: Literal["raise", "missing"] = field(default="raise", init=False)
    """Whether a quaternion or matrix that is no rotation is an error, or missing."""

    def __post_init__(self) -> None:
        if self.up is not None:
            check("up", self.up, space.UPS)
        check("on_bad", self.on_bad, ("raise", "missing"))
        if self.quat_order is not None:
            check("quat_order", self.quat_order, tuple(rotations.ORDERS))


@dataclass(frozen=True, kw_only=True)
class TextOptions(TakeOptions):
    """The options of writing a take as a text file."""

    decimals: int | None = None
    """How many each number has; None for as many as it needs to come back the same."""

    def __post_init__(self) -> None:
        decimals = self.decimals
        if decimals is not None and (not isinstance(decimals, int) or not 0 < decimals <= 17):
            raise OptionError(f"decimals={decimals!r}: pass 1 to 17, or None for as many as each number needs")
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class StoWriteOptions(TextOptions):
    """How storage files are written."""

    what: Literal["joints", "all"] = "joints"
    """"joints", or "all" fields of numbers."""


@dataclass(frozen=True, kw_only=True)
class QtmWriteOptions(TextOptions):
    """How TSV files of QTM are written."""

    up: Literal["z", "y"] | None = None
    on_bad: Literal["raise", "missing"] = "raise"


@dataclass(frozen=True, kw_only=True)
class TrcWriteOptions(QtmWriteOptions):
    """How marker files are written."""

    length_units: Literal["m", "mm"] = "m"
    """Of the file."""

    def __post_init__(self) -> None:
        check("length_units", self.length_units, ("m", "mm"))
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class ViconWriteOptions(QtmWriteOptions):
    """How CSV files of Vicon are written."""

    canonical: bool = True
    quat_order: Literal["xyzw", "wxyz"] | None = None


@dataclass(frozen=True, kw_only=True)
class MocapWriteOptions(ViconWriteOptions):
    """How CSV files of motion capture are written."""

    layout: Literal["motive", "wide"] = "motive"
    """"motive" has rigid bodies and markers, for whatever reads Motive's exports. "wide" has one column a number, for
    topics of any numbers, and `_ts` as its time; only `rate` and `decimals` count there."""
    format_version: Literal["1.23", "1.25"] = "1.23"
    """The version of Motive's format; "1.25" has a row of parents."""
    length_units: Literal["m", "cm", "mm"] = "m"
    """Of the file."""
    joints: Literal["sto", "columns"] | None = "sto"
    """Joint angles are in an OpenSim file `<name>.joints.sto` beside it, or columns (which strict readers refuse), or
    left out."""

    def __post_init__(self) -> None:
        check("layout", self.layout, ("motive", "wide"))
        check("format_version", self.format_version, ("1.23", "1.25"))
        check("length_units", self.length_units, ("m", "cm", "mm"))
        if self.joints is not None:
            check("joints", self.joints, ("sto", "columns"))
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class C3dWriteOptions(TakeOptions):
    """How C3D files are written."""

    length_units: Literal["m", "mm"] = "m"
    """Of the file."""
    up: Literal["z", "y"] | None = None
    joints: bool = True
    """Whether joint angles are analog channels."""
    canonical: bool = True
    quat_order: Literal["xyzw", "wxyz"] | None = None
    on_bad: Literal["raise", "missing"] = "raise"

    def __post_init__(self) -> None:
        check("length_units", self.length_units, ("m", "mm"))
        super().__post_init__()


def check(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise OptionError if an option has none of the values that there are."""
    if value not in choices:
        raise OptionError(f"{name}={value!r}: pass one of {', '.join(map(repr, choices))}")
