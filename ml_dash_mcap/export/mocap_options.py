"""Checks of the options that the formats of motion capture share."""

from __future__ import annotations

from ..errors import OptionError


def check(name: str, value: object, known: tuple[str, ...]) -> None:
    """Raise OptionError if an option has none of the values that there are."""
    if value not in known:
        raise OptionError(f"{name}={value!r}: pass one of {', '.join(map(repr, known))}")


def check_decimals(decimals: int | None) -> None:
    """Raise OptionError unless something is a number of decimals."""
    if decimals is not None and (not isinstance(decimals, int) or not 0 < decimals <= 17):
        raise OptionError(f"decimals={decimals!r}: pass 1 to 17, or None for as many as each number needs")
