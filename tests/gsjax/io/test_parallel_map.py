import threading
import time

import pytest

from gsjax.io import parallel_map as module
from gsjax.io.parallel_map import parallel_map


@pytest.fixture(autouse=True)
def three_threads(monkeypatch):
    monkeypatch.setattr(module.os, "cpu_count", lambda: 3)


def test_results_come_in_order_whoever_is_ready_first():
    def made(number):
        time.sleep(0.02 * (3 - number % 4))
        return number

    assert list(parallel_map(made, range(12))) == list(range(12))
    assert list(parallel_map(made, ())) == []


def test_things_are_worked_on_beside_each_other_and_only_a_few_ahead():
    together, drawn = threading.Barrier(3, timeout=10), []

    def things():
        for number in range(9):
            drawn.append(number)
            yield number

    results = parallel_map(lambda number: together.wait(), things())
    next(results)
    assert len(drawn) == 4, "one more than there are threads"
    assert len(list(results)) == 8


def test_a_fault_comes_when_it_is_its_turn():
    def made(number):
        if number == 2:
            raise ValueError("the third")
        return number

    results = parallel_map(made, range(9))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ValueError, match="the third"):
        next(results)
