"""A thread that appends at full speed and the writer take turns, and nobody else waits."""

from __future__ import annotations

import threading
from collections.abc import Callable

from ml_dash_mcap.capture.turn_taking import State, Turns


class Clock:
    """A clock that only moves when it is told to, or by a step each time it is read."""

    def __init__(self, step_s: float = 0.0) -> None:
        self.now_s = 100.0
        self._step_s = step_s

    def __call__(self) -> float:
        self.now_s += self._step_s
        return self.now_s


def never() -> int:
    raise AssertionError("a slow appender does not even ask")


def compressing_at_call(number: int, turns: Turns, behind: int = 0) -> Callable[[], int]:
    calls = iter(range(1, 1000))

    def waiting() -> int:
        if next(calls) == number:
            turns.writer = State.AWAY
        return behind

    waiting.calls = calls  # type: ignore[attr-defined]
    return waiting


def test_a_control_loop_never_stands_back() -> None:
    clock = Clock()
    turns = Turns(clock)
    turns.writer = State.RUNNING
    for second in range(1, 4):
        clock.now_s += 1.0
        turns.stand_back(second * 10_000, never)  # ten topics at 1 kHz


def test_an_appender_at_full_speed_stands_back_until_the_writer_compresses() -> None:
    turns = Turns(Clock())
    turns.writer = State.RUNNING
    waiting = compressing_at_call(4, turns)
    turns.stand_back(2000, waiting)
    assert next(waiting.calls) == 5  # type: ignore[attr-defined]


def test_it_stands_back_no_longer_than_a_turn() -> None:
    turns = Turns(Clock(step_s=0.004))
    turns.writer = State.RUNNING
    asked = []
    turns.stand_back(20_000, lambda: len(asked.append(None) or asked))  # type: ignore[func-returns-value]
    assert 5 <= len(asked) <= 20


def test_a_writer_that_is_far_behind_gets_more_than_its_turn() -> None:
    turns = Turns(Clock())
    turns.writer = State.AWAY
    behind = iter([3, 2, 1])
    turns.stand_back(2000, lambda: next(behind))
    assert next(behind, None) is None


def test_the_writer_waits_until_the_appender_stands_back() -> None:
    turns = Turns(Clock())
    turns.writer = State.AWAY
    turns.stand_back(2000, lambda: 0)
    turns.stand_back(4000, lambda: 0)
    writer = threading.Thread(target=turns.compressed)

    def waiting() -> int:
        writer.join(10)
        assert not writer.is_alive()
        turns.writer = State.RESTING
        return 0

    clock_of(turns).now_s += 0.01
    turns.stand_back(6000, lambda: 0 if turns.writer is State.AWAY else 1)
    writer.start()
    clock_of(turns).now_s += 0.01
    turns.stand_back(8000, waiting)


def test_who_waits_for_the_writer_hurries_it() -> None:
    turns = Turns(Clock())
    turns.writer = State.AWAY
    clock_of(turns).now_s += 0.01
    turns.stand_back(2000, lambda: 0)
    writer = threading.Thread(target=turns.compressed)
    writer.start()
    turns.hurry()
    writer.join(10)
    assert not writer.is_alive()


def test_the_writer_waits_for_nobody_once_the_appender_has_stopped() -> None:
    turns = Turns(Clock())
    turns.writer = State.AWAY
    clock_of(turns).now_s += 0.01
    turns.stand_back(2000, lambda: 0)
    clock_of(turns).now_s += 1.0
    turns.compressed()
    assert turns.writer is State.RUNNING


def clock_of(turns: Turns) -> Clock:
    assert isinstance(turns._clock, Clock)
    return turns._clock
