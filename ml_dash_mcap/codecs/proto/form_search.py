"""Sorts rows by their templates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..payloads import Payloads
from . import row_match, row_template
from .layout import Layout
from .row_match import MatchedRows
from .row_template import RowTemplate

MOST_TEMPLATES = 16
"""So many templates are looked for in a block; the rows of the others are decoded one by one."""

LEAST_ROWS = 16
"""A template costs as much as some rows that are decoded one by one."""


class RowForm(NamedTuple):
    """The rows of one template, and what they are."""

    rows: MatchedRows
    template: RowTemplate


def forms_of(
    payloads: Payloads, layout: Layout, among: npt.NDArray[np.intp] | None = None
) -> tuple[list[RowForm], npt.NDArray[np.intp]]:
    """Sort rows by their templates.

    Args:
        payloads: All rows.
        layout: Of the topic.
        among: The numbers of the rows to sort; None for all.

    Returns:
        The forms, and the numbers of the rows that are of none, in their order.
    """
    waiting = np.arange(len(payloads)) if among is None else among
    forms: list[RowForm] = []
    others: list[npt.NDArray[np.intp]] = []
    for _ in range(MOST_TEMPLATES):
        if len(waiting) < LEAST_ROWS:
            break
        form = _widest(payloads, waiting, layout)
        if form is None:
            others.append(waiting[:1])
            waiting = waiting[1:]
            continue
        if len(form.rows.which) >= LEAST_ROWS:
            forms.append(form)
        else:
            others.append(form.rows.which)
        waiting = without(waiting, form.rows.which)
    return forms, np.sort(np.concatenate([*others, waiting]))


def without(which: npt.NDArray[np.intp], taken: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Return numbers without some of them."""
    return which[:0] if len(taken) == len(which) else np.setdiff1d(which, taken, assume_unique=True)


def _widest(payloads: Payloads, waiting: npt.NDArray[np.intp], layout: Layout) -> RowForm | None:
    """Return the rows that are laid out like the first one; the sort of template is taken that most rows have."""
    first = payloads[int(waiting[0])]
    best: RowForm | None = None
    for differ in (row_template.ALL_ALIKE, row_template.TEXTS_DIFFER, row_template.LENGTHS_DIFFER):
        template = row_template.of_row(first, layout, differ)
        if template is None:
            return None
        form = RowForm(row_match.match(payloads, waiting, template), template)
        if best is None or len(form.rows.which) > len(best.rows.which):
            best = form
        if len(best.rows.which) == len(waiting):
            break
    return best
