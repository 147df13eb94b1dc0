"""Options that the formats of motion capture share, and their checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...errors import OptionError
from ...meaning import rotations, space
from .take_clock import Rate


@dataclass(frozen=True, slots=True)
class TakeOptions:
    """What the formats of motion capture have in common."""

    rate: Rate = None
    up: str | None = None
    canonical: bool = True
    quat_order: str | None = None
    on_bad: Literal["raise", "missing"] = "raise"

    def __post_init__(self) -> None:
        if self.up is not None:
            check("up", self.up, space.UPS)
        check("on_bad", self.on_bad, ("raise", "missing"))
        if self.quat_order is not None:
            check("quat_order", self.quat_order, tuple(rotations.ORDERS))


def check(name: str, value: object, known: tuple[str, ...]) -> None:
    """Raise OptionError if an option has none of the values that there are."""
    if value not in known:
        raise OptionError(f"{name}={value!r}: pass one of {', '.join(map(repr, known))}")


def check_decimals(decimals: int | None) -> None:
    """Raise OptionError unless something is a number of decimals."""
    if decimals is not None and (not isinstance(decimals, int) or not 0 < decimals <= 17):
        raise OptionError(f"decimals={decimals!r}: pass 1 to 17, or None for as many as each number needs")
