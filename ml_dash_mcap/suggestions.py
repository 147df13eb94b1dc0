"""What a misspelt name was probably meant to be."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from .errors import NotFoundError

T = TypeVar("T")

_SIMILARITY = 0.55
"""From 0 to 1, as difflib counts it: what two names have at least in common."""
_MARGIN = 0.1
"""Names that are less like it than the best one by more than this are not worth a word."""
_SUGGESTED = 3
_LISTED = 20


def similar(name: object, known: Iterable[str]) -> list[str]:
    """Return the names that look most like one, the best first; upper and lower case, `-` and `_` are the same."""
    matcher = difflib.SequenceMatcher(b=_folded(str(name)))
    likeness = {}
    for one in known:
        matcher.set_seq1(_folded(one))
        if matcher.real_quick_ratio() >= _SIMILARITY and matcher.quick_ratio() >= _SIMILARITY:
            likeness[one] = matcher.ratio()
    least = max(_SIMILARITY, max(likeness.values(), default=0.0) - _MARGIN)
    near = [one for one, ratio in likeness.items() if ratio >= least]
    return sorted(near, key=lambda one: -likeness[one])[:_SUGGESTED]


def hint(name: object, known: Iterable[str], *, spelling: str = "{!r}", listing: str = "there are {}") -> str:
    """Return what to say of a name that is not known: the names like it, or else all there are.

    Args:
        name: What the caller wrote.
        known: What could have been meant.
        spelling: How a name is shown, such as "{}=" for an argument.
        listing: The words around all names, where none is similar.

    Example:
        >>> hint("formt", ["format", "topics"], spelling="{}=")
        'did you mean format=?'
    """
    names = list(known)
    question = did_you_mean(name, names, spelling=spelling)
    if question:
        return question
    shown = ", ".join(map(spelling.format, names[:_LISTED])) + (", ..." if len(names) > _LISTED else "")
    return listing.format(shown or "none")


def not_found(what: str, name: object, names: Iterable[str], where: str = "") -> NotFoundError:
    """Return the error for a name that is not there, with the names that look most like it, and where it was sought."""
    return NotFoundError(f"no {what} {name!r} in the recording; {hint(name, names)}" + (f" ({where})" if where else ""))


def did_you_mean(name: object, known: Iterable[str], *, spelling: str = "{!r}") -> str:
    """Return the question for the names like one; empty if there is none like it."""
    near = similar(name, known)
    return f"did you mean {' or '.join(map(spelling.format, near))}?" if near else ""


def checks_names(error: type[Exception]) -> Callable[[type[T]], type[T]]:
    """Let a dataclass refuse an argument that it does not have with `error`, naming the one that was meant."""

    def decorate(cls: type[T]) -> type[T]:
        plain: Any = cls.__init__
        names = list(inspect.signature(plain).parameters)[1:]

        @functools.wraps(plain)
        def __init__(self: Any, *positional: Any, **given: Any) -> None:  # noqa: N807 - it takes the place of that
            if positional:
                raise error(f"{cls.__name__}() takes its values by name, as in {cls.__name__}({names[0]}=...)")
            for name in given:
                if name not in names:
                    what = hint(name, names, spelling="{}=", listing="it has {}")
                    raise error(f"{cls.__name__}() has no {name}=; {what}")
            plain(self, **given)

        cls.__init__ = __init__  # type: ignore[method-assign]
        return cls

    return decorate


def _folded(name: str) -> str:
    return name.casefold().replace("-", "_")
