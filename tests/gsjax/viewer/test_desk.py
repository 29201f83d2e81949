"""Who gets which picture when, by a clock that the test turns."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from gsjax.viewer.desk import REST, Desk, Order
from gsjax.viewer.page_camera import PageCamera


def camera(x):
    return PageCamera(np.array([x, 0.0, 0.0]), np.array([1.0, 0, 0, 0]), 1.0, 64, 48)


A, B = camera(1.0), camera(2.0)


@pytest.fixture
def clock():
    return SimpleNamespace(now=100.0)


@pytest.fixture
def desk(clock):
    return Desk(lambda: clock.now)


def taken(desk):
    """All that is due now."""
    orders = []
    while (order := desk.take(0)) is not None:
        orders.append(order)
    return orders


def test_a_camera_gets_a_coarse_picture_at_once_and_the_full_one_when_it_rests(desk, clock):
    desk.moved("me", A)
    assert taken(desk) == [Order("me", A, False)]
    clock.now += 0.9 * REST
    assert taken(desk) == []
    clock.now += 0.2 * REST
    assert taken(desk) == [Order("me", A, True)]
    clock.now += 100
    assert taken(desk) == []


def test_only_the_newest_camera_counts_and_a_move_begins_anew(desk, clock):
    desk.moved("me", A)
    desk.moved("me", B)
    assert taken(desk) == [Order("me", B, False)]
    clock.now += 0.9 * REST
    desk.moved("me", A)
    clock.now += 0.9 * REST
    assert taken(desk) == [Order("me", A, False)]
    clock.now += 0.2 * REST
    assert taken(desk) == [Order("me", A, True)]


def test_coarse_pictures_come_first_and_who_waits_longest_is_served_first(desk, clock):
    desk.moved("first", A)
    clock.now += 2 * REST
    assert taken(desk) == [Order("first", A, False), Order("first", A, True)]
    desk.again()
    clock.now += 0.01
    desk.moved("second", B)
    assert taken(desk) == [Order("first", A, False), Order("second", B, False), Order("first", A, True)]
    clock.now += 2 * REST
    assert taken(desk) == [Order("second", B, True)]


def test_what_changes_by_itself_asks_for_full_pictures_only(desk, clock):
    desk.moved("me", A)
    clock.now += 2 * REST
    taken(desk)
    desk.again(only_full=True)
    assert taken(desk) == [Order("me", A, True)]
    desk.moved("me", B)
    desk.again(only_full=True)
    assert taken(desk) == [Order("me", B, False)], "the camera moves"


def test_of_a_browser_that_left_nothing_is_kept(desk, clock):
    desk.moved("me", A)
    assert len(desk) == 1
    desk.left("me")
    desk.left("nobody")
    clock.now += 10
    desk.again()
    assert len(desk) == 0 and taken(desk) == []


def test_waking_ends_one_wait_and_closing_all_of_them(desk):
    desk.wake()
    assert desk.take() is None and not desk.is_closed
    desk.moved("me", A)
    assert desk.take() == Order("me", A, False), "woken once"
    desk.close()
    assert desk.is_closed
    assert desk.take() is None


def test_who_waits_is_told_at_once():
    desk, orders = Desk(), []
    worker = threading.Thread(target=lambda: orders.extend([desk.take(), desk.take()]))
    worker.start()
    desk.moved("me", A)
    worker.join(60)
    assert orders == [Order("me", A, False), Order("me", A, True)]
