"""Opens `gsjax view` in a real browser without a display, and compares what it shows with the renderer's pictures.

    python experiments/page_check.py RUN --out pictures

Needs Chromium. Two cameras of the run, and one to which the mouse drags, must show their own picture and no other;
every switch leaves a screenshot to look at. Then the browser leaves, and nothing of it may be left.
"""

import argparse
import threading
import time
from pathlib import Path

import numpy as np
from devtools import Tab, browser

from gsjax import tables
from gsjax.cli import environment
from gsjax.io.images import write_image
from gsjax.render import gallery
from gsjax.report.pictures import to_bytes
from gsjax.viewer.page import CAMERAS, MESH, SHOW, Page
from gsjax.viewer.page_camera import PageCamera, camera_of, page_camera
from gsjax.viewer.pictures import COLOR
from gsjax.viewer.scenery import MESH_COLORS, MESH_SHAPE
from gsjax.viewer.subject import Subject, open_subject

SIZE = 960, 640  # Of the page, and of its full picture: no pixel is resampled.
FREE = slice(200, 630), slice(5, 600)  # Rows and columns that no panel covers.
PATIENCE = 300.0  # seconds


def wait_until(true, what: str) -> None:
    """Exits where it never comes true."""
    until = time.monotonic() + PATIENCE
    while not true():
        if time.monotonic() > until:
            raise SystemExit(f"waited {PATIENCE:g} seconds for {what}")
        time.sleep(0.1)


class Visit:
    """A browser on the page of a subject."""

    def __init__(self, page: Page, tab: Tab):
        """Opens it."""
        self.page, self.tab = page, tab
        tab.call("Page.enable")
        tab.call("Page.navigate", url=page.address)
        wait_until(lambda: page.server.get_clients(), "the browser to come")
        (self.client,) = page.server.get_clients().values()

    def rest(self) -> np.ndarray:
        """The screenshot once all pictures are there."""
        time.sleep(1.0)
        wait_until(lambda: self.page.desk.is_idle, "the picture")
        time.sleep(2.0)  # On its way to the browser, which draws on a processor here.
        return self.tab.screenshot()

    def look(self, at: PageCamera) -> np.ndarray:
        """The screenshot from a camera."""
        camera = self.client.camera
        with self.client.atomic():
            camera.position, camera.wxyz, camera.fov = at.position, at.wxyz, at.fov
        return self.rest()

    def told(self) -> PageCamera:
        """The camera that the browser tells of."""
        camera = self.client.camera
        return PageCamera(camera.position, camera.wxyz, camera.fov, camera.image_width, camera.image_height)


def expected(subject: Subject, at: PageCamera) -> np.ndarray:
    """What `gsjax.render` draws there."""
    camera = camera_of(at._replace(width=SIZE[0], height=SIZE[1]), SIZE)
    (picture,) = gallery.pictures(subject.gaussians, [camera], subject.background, subject.depth_mode)
    return to_bytes(picture.colors)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Over the rows and columns that no panel covers, dB."""
    squared = np.mean((a[FREE].astype(float) - b[FREE].astype(float)) ** 2)
    return float(10 * np.log10(255**2 / max(squared, 1e-9)))


def check(page: Page, tab: Tab, out: Path) -> dict[str, dict[str, float]]:
    """PSNR of every screenshot against the three pictures."""
    visit, subject = Visit(page, tab), page.subject
    first, second = (page_camera(list(subject.cameras.values())[index]) for index in (0, len(subject.cameras) // 2))
    shots, cameras = {}, {}
    for name, at in (("first", first), ("second", second)):
        shots[name], cameras[name] = visit.look(at), at
    tab.press(300, 450, to=(380, 400))
    shots["dragged"] = visit.rest()
    cameras["dragged"] = visit.told()
    pictures = {name: expected(subject, at) for name, at in cameras.items()}
    visit.look(first)
    for kind in page.switches[SHOW].options:
        page.switches[SHOW].value = kind
        shots[kind] = visit.rest()
    page.switches[SHOW].value = COLOR
    for choice in (MESH_COLORS, MESH_SHAPE) if subject.mesh is not None else ():
        page.switches[MESH].value = choice
        shots[f"mesh {choice}"] = visit.rest()
    page.switches[CAMERAS].value = True
    visit.look(first._replace(position=first.position - 0.3 * subject.scale * subject.up))
    shots["cameras"] = visit.rest()
    for name, shot in shots.items():
        write_image(out / f"{name.replace(' ', '_').replace(',', '')}.png", shot)
    for name, picture in pictures.items():
        write_image(out / f"expected_{name}.png", picture)
    return {
        f"page, {shown}": {f"render, {drawn}": psnr(shots[shown], picture) for drawn, picture in pictures.items()}
        for shown in cameras
    }


def main() -> None:
    """Reads the arguments, writes the screenshots, prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run")
    parser.add_argument("--out", type=Path, required=True, help="folder for the screenshots")
    given = parser.parse_args()
    environment.prepare()
    with Page(open_subject(given.run), host="127.0.0.1", port=0) as page:
        working = threading.Thread(target=page.work)
        working.start()
        try:
            with browser(*SIZE) as tab:
                table = check(page, tab, given.out)
            print(tables.compare(table))
            wait_until(lambda: not len(page.desk) and not page.server.get_clients(), "the browser to be forgotten")
        finally:
            page.close()
            working.join()
    print(f"screenshots: {given.out}")


if __name__ == "__main__":
    main()
