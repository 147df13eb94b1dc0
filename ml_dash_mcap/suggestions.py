"""Suggestions for misspelt names, as error messages make them."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from .errors import NotFoundError

T = TypeVar("T")

_SIMILARITY = 0.55
"""The least ratio of difflib, from 0 to 1, at which two names are called similar."""
_MARGIN = 0.1
"""Names whose ratio is smaller than the best one by more than this are not suggested."""
_SUGGESTED = 3
_LISTED = 20


def similar(name: object, candidates: Iterable[str]) -> list[str]:
    """Return the candidates that are most similar to a name, the best first. Case, and `-` for `_`, do not matter."""
    # difflib prepares its second text once and compares many first texts with it.
    matcher = difflib.SequenceMatcher(b=_folded(str(name)))
    ratios = {}
    for candidate in candidates:
        matcher.set_seq1(_folded(candidate))
        # Both are upper bounds of `ratio` that cost much less (difflib's documentation).
        if matcher.real_quick_ratio() >= _SIMILARITY and matcher.quick_ratio() >= _SIMILARITY:
            ratios[candidate] = matcher.ratio()
    least = max(_SIMILARITY, max(ratios.values(), default=0.0) - _MARGIN)
    near = [candidate for candidate, ratio in ratios.items() if ratio >= least]
    return sorted(near, key=lambda candidate: -ratios[candidate])[:_SUGGESTED]


def hint(name: object, candidates: Iterable[str], *, spelling: str = "{!r}", listing: str = "there are {}") -> str:
    """Return a hint for a name that does not exist: the candidates that are similar to it, or else all candidates.

    Args:
        name: What the caller wrote.
        candidates: The names that exist.
        spelling: How a name is shown, such as "{}=" for an argument.
        listing: The words around all candidates, if none is similar.

    Example:
        >>> hint("formt", ["format", "topics"], spelling="{}=")
        'did you mean format=?'
    """
    names = list(candidates)
    question = did_you_mean(name, names, spelling=spelling)
    if question:
        return question
    shown = ", ".join(map(spelling.format, names[:_LISTED])) + (", ..." if len(names) > _LISTED else "")
    return listing.format(shown or "none")


def not_found(what: str, name: object, names: Iterable[str], where: str = "") -> NotFoundError:
    """Return the error for a name that does not exist, with similar names and with the place that was searched."""
    return NotFoundError(f"no {what} {name!r} in the recording; {hint(name, names)}" + (f" ({where})" if where else ""))


def did_you_mean(name: object, candidates: Iterable[str], *, spelling: str = "{!r}") -> str:
    """Return the question whether a similar name was meant; empty if no candidate is similar."""
    near = similar(name, candidates)
    return f"did you mean {' or '.join(map(spelling.format, near))}?" if near else ""


def checks_names(error: type[Exception]) -> Callable[[type[T]], type[T]]:
    """Let a dataclass raise `error` for an argument that it does not have, with a hint at the one that was meant."""

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
