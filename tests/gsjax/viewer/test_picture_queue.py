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


def take_all(queue):
    """All that is due now."""
    requests = []
    while (request := queue.take(0)) is not None:
        requests.append(request)
    return requests


def test_a_camera_gets_a_coarse_picture_at_once_and_the_full_one_when_it_rests(queue, clock):
    queue.move("me", A)
    assert take_all(queue) == [Request("me", A, False)]
    clock.now += 0.9 * REST
    assert take_all(queue) == []
    clock.now += 0.2 * REST
    assert take_all(queue) == [Request("me", A, True)]
    clock.now += 100
    assert take_all(queue) == []


def test_coarse_pictures_come_first_and_who_waits_longest_is_served_first(queue, clock):
    queue.move("first", A)
    clock.now += 2 * REST
    assert take_all(queue) == [Request("first", A, False), Request("first", A, True)]
    queue.redraw()
    clock.now += 0.01
    queue.move("second", B)
    assert take_all(queue) == [Request("first", A, False), Request("second", B, False), Request("first", A, True)]
    clock.now += 2 * REST
    assert take_all(queue) == [Request("second", B, True)]
