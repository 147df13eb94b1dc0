"""Work done ahead keeps its order, and no more of it is held than memory allows."""

from __future__ import annotations

import pytest

from ml_dash_mcap.store import read_ahead

MIB = 1024 * 1024


@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_results_come_in_the_order_of_the_items(count):
    assert list(read_ahead.in_order(lambda item: item * 10, range(count))) == [item * 10 for item in range(count)]


def test_what_a_call_raises_comes_out_in_its_place():
    results = read_ahead.in_order(lambda item: 60 // (3 - item), range(5))
    assert [next(results), next(results), next(results)] == [20, 30, 60]
    with pytest.raises(ZeroDivisionError):
        next(results)


@pytest.mark.parametrize(("mib", "most"), [(60, 2), (100, 1), (500, 1)])
def test_heavy_items_are_not_held_together(mib, most):
    taken, most_held = 0, 0

    def items():
        nonlocal taken
        for item in range(12):
            taken += 1
            yield item

    for done, _ in enumerate(read_ahead.in_order(lambda item: item, items(), weigh=lambda _: mib * MIB)):
        most_held = max(most_held, taken - done)
    assert most <= most_held <= most + 2  # the first two are taken to see whether there are two, one is handed over
