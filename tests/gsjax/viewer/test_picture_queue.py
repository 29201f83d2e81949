"""Who gets which picture when, by a clock that the test turns."""

from types import SimpleNamespace

import numpy as np

from gsjax.viewer.page_camera import PageCamera
from gsjax.viewer.picture_queue import REST, PictureQueue, Request


def camera(x):
    return PageCamera(np.array([x, 0.0, 0.0]), np.array([1.0, 0, 0, 0]), 1.0, 64, 48)


A, B = camera(1.0), camera(2.0)


def take_all(queue):
    """All that is due now."""
    requests = []
    while (request := queue.take(0)) is not None:
        requests.append(request)
    return requests


def test_a_camera_gets_a_coarse_picture_at_once_and_the_full_one_when_it_rests_and_coarse_ones_come_first():
    clock = SimpleNamespace(now=100.0)
    queue = PictureQueue(lambda: clock.now)
    queue.move("me", A)
    assert take_all(queue) == [Request("me", A, False)]
    clock.now += 0.9 * REST
    assert take_all(queue) == []
    clock.now += 0.2 * REST
    assert take_all(queue) == [Request("me", A, True)]
    clock.now += 100
    assert take_all(queue) == []
    queue.redraw()
    clock.now += 0.01
    queue.move("you", B)
    assert take_all(queue) == [Request("me", A, False), Request("you", B, False), Request("me", A, True)]
