"""The page without a browser: a browser is a stand-in that keeps what it is sent."""

import socket
import threading
import time
import warnings
from contextlib import contextmanager

import numpy as np
import pytest
from small_scenes import camera_at, cloud

from gsjax import cli
from gsjax.errors import InputError
from gsjax.rendering import backdrop
from gsjax.scene.colors import to_bytes
from gsjax.viewer import page as pages
from gsjax.viewer.page import SIDE, News, Page, check_port
from gsjax.viewer.page_camera import camera_of, page_camera, picture_size
from gsjax.viewer.picture_queue import PictureQueue
from gsjax.viewer.pictures import COLOR, draw_picture
from gsjax.viewer.viewed_scene import ViewedScene

SCENE = cloud(30)
AT = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), size=(32, 32))
VIEWED = ViewedScene("cloud", AT, np.array([0, 0, 4.0]), np.array([0, -1.0, 0]), 4.0, gaussians=SCENE,
    background=np.array([0.1, 0.9, 0.4], np.float32))  # fmt: skip


class Visitor:
    """What `Page` knows of a browser."""

    def __init__(self):
        self.received, self.scene = [], self

    def set_background_image(self, image, format):
        self.received.append((image, format))


@contextmanager
def served(monkeypatch, viewed=VIEWED, **options):
    """A page, the browser that it thinks is there, and its loop in a thread."""
    monkeypatch.setattr(pages, "LONGEST", ("32", "960"))
    with Page(viewed, host="127.0.0.1", port=0, **options) as page:
        state = Visitor()
        monkeypatch.setattr(page.server, "get_clients", lambda: {"me": state})
        if SIDE in page.switches:
            page.switches[SIDE].value = "32"
        working = threading.Thread(target=page.work)
        working.start()
        try:
            yield page, state
        finally:
            page.close()
            working.join()


def wait(true):
    until = time.monotonic() + 600  # Of which compilation on a busy machine takes most.
    while not true():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_a_browser_is_sent_what_its_camera_sees_coarse_then_whole_and_nothing_for_no_camera(monkeypatch):
    camera = page_camera(AT)
    with served(monkeypatch) as (page, state):
        page.queue.move("me", camera)
        wait(lambda: len(state.received) == 2 and page.queue.is_idle)
        page.queue.move("me", camera._replace(position=np.full(3, np.nan)))
        wait(lambda: page.queue.is_idle)
        page.queue.move("gone", camera)
        wait(lambda: page.queue.is_idle)
        assert page._status.content.startswith("32x32 in ")
    (coarse, form), (whole, exact) = state.received
    assert (form, exact) == ("jpeg", "png") and coarse.shape == (16, 16, 3)
    size = picture_size(camera, 32)
    expected = draw_picture(COLOR, SCENE, camera_of(camera, size), VIEWED.background)
    np.testing.assert_array_equal(whole, expected)


def test_news_bring_the_background_that_is_learned_and_only_the_full_picture(monkeypatch):
    """One colour in all directions, as coefficients: what the browser draws its splats over."""
    behind = np.array([0.2, 0.4, 0.8], np.float32)
    news = [News(SCENE, "step 1 of 2", backdrop.constant_coefficients(behind, 0))]
    monkeypatch.setattr(pages, "PATIENCE", 0.01)
    monkeypatch.setattr(PictureQueue, "redraw", lambda queue, *, only_full=False: redraws.append(only_full))
    redraws, start_event = [], threading.Event()
    with served(monkeypatch, news=lambda: news.pop() if news and start_event.is_set() else None) as (page, state):
        page.queue.move("me", page_camera(AT))
        wait(lambda: state.received)
        redraws.clear()
        start_event.set()
        wait(lambda: redraws)
        page.queue.move("me", page_camera(AT))
        wait(lambda: len(state.received) == 2)
    (before, _), (after, _) = state.received
    np.testing.assert_array_equal(before, np.broadcast_to(to_bytes(VIEWED.background), before.shape))
    np.testing.assert_array_equal(after, np.broadcast_to(to_bytes(behind), after.shape))
    assert redraws == [True]


def test_a_browser_that_leaves_while_it_is_drawn_for_disturbs_nobody(monkeypatch):
    """viser warns of what is sent to a closed connection, and warnings are errors here: the loop would end."""

    def closed(image, format):
        warnings.warn("Queued a message on a closed connection", RuntimeWarning, stacklevel=1)

    with served(monkeypatch) as (page, state):
        clients, draw = {"me": state, "other": Visitor()}, pages.draw_picture

        def draw_and_leave(*what):
            clients.pop("me", None)
            page.queue.remove("me")
            return draw(*what)

        monkeypatch.setattr(page.server, "get_clients", lambda: clients)
        monkeypatch.setattr(state, "set_background_image", closed)
        monkeypatch.setattr(pages, "draw_picture", draw_and_leave)
        page.queue.move("me", page_camera(AT))
        wait(lambda: not len(page.queue) and page.queue.is_idle)
        page.queue.move("other", page_camera(AT))
        wait(lambda: len(clients["other"].received) == 2)


def test_a_port_in_use_and_others_that_cannot_be_are_one_line(capsys, tmp_path):
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        line = f"port={port} on 127.0.0.1: Address already in use; choose another port"
        # Before anything is read or made.
        assert cli.main(["view", str(tmp_path / "absent"), "--port", str(port)]) == 2
        assert cli.main(["train", "absent", "--out", str(tmp_path / "run"), "--view", "--port", str(port)]) == 2
        assert capsys.readouterr().err == 2 * f"gsjax: error: {line}\n"
        assert not (tmp_path / "run").exists()
    with pytest.raises(InputError, match="port=65536 is not between 0 and 65535"):
        check_port("127.0.0.1", 65536)
    with pytest.raises(InputError, match="host=..: is no name of a host"):
        check_port("..", 0)


def answer(page, *lines):
    """First line of what the server says to a request for a WebSocket."""
    headers = (
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: " + 22 * "A" + "==",
    )
    request = "\r\n".join(["GET / HTTP/1.1", *headers, *lines, "", ""])
    with socket.create_connection(("127.0.0.1", page.server.get_port()), timeout=10) as connection:
        connection.sendall(request.encode())
        return connection.recv(200).split(b"\r\n")[0].decode()


def test_no_page_but_its_own_reads_what_is_for_this_machine(monkeypatch):
    with served(monkeypatch) as (page, _):
        port = page.server.get_port()
        own = f"Host: 127.0.0.1:{port}"
        assert answer(page, own).startswith("HTTP/1.1 101 ")  # a program
        tunnel = "Host: localhost:9000", "Origin: http://localhost:9000"
        assert answer(page, *tunnel).startswith("HTTP/1.1 101 ")
        foreign = [
            (own, "Origin: https://somewhere.example"),
            (own, f"Origin: http://127.0.0.1:{port + 1}"),
            ("Host: rebound.example", "Origin: http://rebound.example"),
            ("Host: 127.0.0.1.rebound.example",),
            ("Host: [",),
        ]
        for lines in foreign:
            assert answer(page, *lines).startswith("HTTP/1.1 403 "), lines
