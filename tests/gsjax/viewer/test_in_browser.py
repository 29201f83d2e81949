"""The page in a real browser, headless; without one on the machine this file skips."""

import threading
import time

import devtools
import numpy as np
import pytest
from small_scenes import camera_at, cloud

from gsjax.rendering import gallery
from gsjax.scene.colors import to_bytes
from gsjax.viewer import page as pages
from gsjax.viewer.page import SIDE, Page
from gsjax.viewer.page_camera import PageCamera, camera_of, page_camera
from gsjax.viewer.viewed_scene import ViewedScene

SIZE = 720, 480  # Of the page, and of its full picture: no pixel is resampled.
FREE = slice(215, 475), slice(5, 715)  # Rows and columns that no panel covers.
CLOSE, FAR = 40.0, 25.0  # dB: the same picture, but for PNG's rounding; another one.
PATIENCE, AGAIN = 90.0, 4.0  # Seconds until it fails, and between two tries.
FIRST = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), size=SIZE, focal=500.0)
SECOND = camera_at((1.2, -0.5, 0.4), (0.0, 0.0, 4.0), size=SIZE, focal=500.0)
VIEWED = ViewedScene("cloud", FIRST, np.array([0, 0, 4.0]), np.array([0, -1.0, 0]), 4.0, gaussians=cloud(30),
    background=np.array([0.1, 0.9, 0.4], np.float32))  # fmt: skip


@pytest.fixture
def browser():
    if devtools.program() is None:
        pytest.skip("there is no Chromium on this machine")
    return devtools.browser


def wait(true):
    until = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < until
        time.sleep(0.05)


def psnr(shot, picture):
    squared = np.mean((shot[FREE].astype(float) - picture[FREE].astype(float)) ** 2)
    return 10 * np.log10(255**2 / max(squared, 1e-9))


def screenshot(client, tab, at: PageCamera, picture):
    """The screenshot from a camera: once it shows the picture, or else the last one."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        with client.atomic():
            client.camera.position, client.camera.wxyz, client.camera.fov = at.position, at.wxyz, at.fov
        again = time.monotonic() + AGAIN
        while time.monotonic() < again:
            if psnr(shot := tab.screenshot(), picture) > CLOSE:
                return shot
            time.sleep(0.2)  # The browser draws on a processor here.
    return shot


def test_a_known_pose_shows_the_known_picture_a_moved_camera_another_and_who_leaves_is_forgotten(browser, monkeypatch):
    monkeypatch.setattr(pages, "LONGEST", (str(max(SIZE)), "960"))
    poses = [page_camera(camera) for camera in (FIRST, SECOND)]
    cameras = [camera_of(at._replace(width=SIZE[0], height=SIZE[1]), SIZE) for at in poses]
    views = gallery.pictures(VIEWED.gaussians, cameras, VIEWED.background)
    pictures = [to_bytes(picture.colors) for picture in views]
    with Page(VIEWED, host="127.0.0.1", port=0) as page:
        page.switches[SIDE].value = str(SIZE[0])
        working = threading.Thread(target=page.work)
        working.start()
        try:
            with browser(*SIZE) as tab:
                tab.call("Page.enable")
                tab.call("Page.navigate", url=page.address)
                wait(lambda: len(page.queue) and page.queue.is_idle)
                (client,) = page.server.get_clients().values()
                shots = [screenshot(client, tab, *arguments) for arguments in zip(poses, pictures, strict=True)]
            wait(lambda: not len(page.queue) and not page.server.get_clients())
            assert working.is_alive()
        finally:
            page.close()
            working.join()
    for index, shot in enumerate(shots):
        assert psnr(shot, pictures[index]) > CLOSE
        assert psnr(shot, pictures[1 - index]) < FAR
