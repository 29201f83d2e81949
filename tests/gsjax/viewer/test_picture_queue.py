"""Who gets which picture when, by a clock that the test turns."""

from types import SimpleNamespace

import numpy as np
import pytest

from gsjax.viewer.page_camera import PageCamera
from gsjax.viewer.picture_queue import REST, PictureQueue, Request


def camera(x):
    return PageCamera(np.array([x, 0.0, 0.0]), np.array([1.0, 0, 0, 0]), 1.0, 64, 48)


A, B = camera(1.0), camera(2.0)


@pytest.fixture
def clock():
    return SimpleNamespace(now=100.0)


@pytest.fixture
def queue(clock):
    return PictureQueue(lambda: clock.now)


def taken(queue):
    """All that is due now."""
    requests = []
    while (request := queue.take(0)) is not None:
        requests.append(request)
    return requests


def test_a_camera_gets_a_coarse_picture_at_once_and_the_full_one_when_it_rests(queue, clock):
    queue.move("me", A)
    assert taken(queue) == [Request("me", A, False)]
    clock.now += 0.9 * REST
    assert taken(queue) == []
    clock.now += 0.2 * REST
    assert taken(queue) == [Request("me", A, True)]
    clock.now += 100
    assert taken(queue) == []


def test_only_the_newest_camera_counts_and_a_move_begins_anew(queue, clock):
    queue.move("me", A)
    queue.move("me", B)
    assert taken(queue) == [Request("me", B, False)]
    clock.now += 0.9 * REST
    queue.move("me", A)
    clock.now += 0.9 * REST
    assert taken(queue) == [Request("me", A, False)]
    clock.now += 0.2 * REST
    assert taken(queue) == [Request("me", A, True)]


def test_coarse_pictures_come_first_and_who_waits_longest_is_served_first(queue, clock):
    queue.move("first", A)
    clock.now += 2 * REST
    assert taken(queue) == [Request("first", A, False), Request("first", A, True)]
    queue.redraw()
    clock.now += 0.01
    queue.move("second", B)
    assert taken(queue) == [Request("first", A, False), Request("second", B, False), Request("first", A, True)]
    clock.now += 2 * REST
    assert taken(queue) == [Request("second", B, True)]


def test_what_changes_by_itself_asks_for_full_pictures_only(queue, clock):
    queue.move("me", A)
    clock.now += 2 * REST
    taken(queue)
    queue.redraw(only_full=True)
    assert taken(queue) == [Request("me", A, True)]
    queue.move("me", B)
    queue.redraw(only_full=True)
    assert taken(queue) == [Request("me", B, False)], "the camera moves"


def test_of_a_browser_that_left_nothing_is_kept(queue, clock):
    queue.move("me", A)
    assert len(queue) == 1
    queue.remove("me")
    queue.remove("nobody")
    clock.now += 10
    queue.redraw()
    assert len(queue) == 0 and taken(queue) == []


def test_waking_ends_one_wait_and_closing_all_of_them(queue):
    queue.wake()
    assert queue.take() is None and not queue.is_closed
    queue.move("me", A)
    assert queue.take() == Request("me", A, False), "woken once"
    queue.close()
    assert queue.is_closed
    assert queue.take() is None
