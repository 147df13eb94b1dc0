"""The rows that the next rows of a topic are expected to be like: as the rows before them, in turn."""

from __future__ import annotations

from collections.abc import Sequence

from .json_expected_text import ExpectedText

_MOST_IN_TURN = 16
"""Rows of so many kinds may come in turn, as those of a loop do that appends one moment's fields in several calls."""

_ROUNDS, _LEAST_ROWS = 3, 8
"""So often, and for so many rows, a turn was repeated before it is expected to go on. A topic with fewer rows so far is
taken at its word."""

HISTORY_ROWS = _ROUNDS * _MOST_IN_TURN
"""The number of rows that are looked at."""

_MOST_BYTES = 64 * 1024
"""Of the skeletons in a turn. Of longer ones the last is expected."""

Seen = tuple[bytes, int]
"""A row's skeleton, and its form."""


class ExpectedRows:
    """The turn that a topic's rows go on with. Used by the writer thread only."""

    def __init__(self) -> None:
        self.turn: list[ExpectedText] = []
        """The kinds of the next rows, again and again; empty if nothing is known."""
        self._seen: list[Seen] = []

    def advance(self, rows: int) -> None:
        """Note that so many rows came as expected."""
        first = rows % len(self.turn)
        self.turn = self.turn[first:] + self.turn[:first]
        self._seen = self._seen[first:] + self._seen[:first]

    def learn(self, rows: Sequence[Seen | None]) -> None:
        """Note the last rows that came, one to `HISTORY_ROWS`; None stands for a row that may be like no other."""
        # The rows before these were repetitions of the turn.
        history = [*(self._seen * HISTORY_ROWS)[-HISTORY_ROWS:], *rows][-HISTORY_ROWS:]
        texts = {(text.skeleton, text.form): text for text in self.turn}
        self.turn, self._seen = [], []
        for seen in _turn(history):
            text = texts.get(seen) or ExpectedText.of(*seen)
            if text is None:
                self.turn, self._seen = [], []
                return
            texts[seen] = text
            self.turn.append(text)
            self._seen.append(seen)


def _turn(history: Sequence[Seen | None]) -> Sequence[Seen]:
    """Return the shortest sequence of rows that the last rows repeat; the last row where there is none."""
    last = history[-1]
    if last is None:
        return []
    for length in range(1, min(_MOST_IN_TURN, len(history) - 1) + 1):
        rows = history[-max(_ROUNDS * length, _LEAST_ROWS) :]
        if rows[length:] == rows[:-length]:
            turn = [row for row in rows[-length:] if row is not None]
            if len(turn) == length and sum(len(skeleton) for skeleton, _ in turn) <= _MOST_BYTES:
                return turn
    return [last]
