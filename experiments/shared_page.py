"""A page of `gsjax share` in a headless browser, beside what gsjax draws of its run (`share_check.py`)."""

import json
import time
from pathlib import Path

import numpy as np
from devtools import PATIENCE, Tab, browser

from gsjax.camera_path import camera_of
from gsjax.colors import to_bytes
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.films import read_path
from gsjax.io.images import write_image
from gsjax.measures.images import psnr
from gsjax.render import gallery
from gsjax.runs.result import Result, open_result

REST, LOOKS = 1.0, 3  # seconds between two looks, longer than a flight takes; so many alike and the page is still
CHANGED = 8  # of 255
WITHOUT_PANELS = "for (const part of document.querySelectorAll('nav, h1')) part.style.visibility = 'hidden'"
LOADED = "performance.getEntriesByType('resource').map(entry => entry.name)"


def check_page(page: Path, run: Path, out: Path, views: int) -> dict[str, dict[str, float]]:
    """Looks at a page from where its photos were taken, then at its mesh.

    At each photo the page keeps a keyframe, and gsjax draws the run from there: the page turns upright what was held
    askew, so the photo's own camera is not quite the page's.

    Args:
        page: The file, which is opened from the disk.
        run: The run that it was made of.
        out: Folder for pictures, the page's left and ours right, and for `path.json`, the keyframes.
        views: How many photos to look from, two or more.

    Returns:
        By a photo's name `psnr` between the two pictures; by "mesh", if there is one, `changed`: the share of pixels
        that are not as those of the Gaussians.

    Raises:
        InputError: The browser cannot show the page, or it loads something from elsewhere.
    """
    result = open_result(run)
    first = result.cameras[0]
    with browser(first.width, first.height) as tab:
        tab.call("Page.enable")
        tab.call("Page.navigate", url=page.resolve().as_uri())
        _require_shown(tab, page)
        tab.evaluate(WITHOUT_PANELS)
        bookmarks = json.loads(tab.evaluate("document.getElementById('view').textContent"))["bookmarks"]
        shown = {}
        for index, bookmark in enumerate(bookmarks[:views]):
            shown[bookmark["name"]] = _after_choice(tab, "bookmarks", str(index))
            tab.evaluate("document.getElementById('keyframe').click()")
        json_files.write(out / "path.json", {"keyframes": json.loads(tab.evaluate("JSON.stringify(keyframes)"))})
        rows = _beside_ours(shown, result, out)
        if tab.evaluate("document.getElementById('show') !== null"):
            splats, mesh = _after_choice(tab, "show", "splats"), _after_choice(tab, "show", "mesh")
            write_image(out / "mesh.png", mesh)
            rows["mesh"] = {"changed": float((np.abs(mesh.astype(int) - splats) > CHANGED).any(axis=-1).mean())}
        for name in tab.evaluate(LOADED):
            if not name.startswith(("blob:", "data:", "file:")):
                raise InputError(f"{page}: loads {name}")
    return rows


def _beside_ours(shown: dict[str, np.ndarray], result: Result, out: Path) -> dict[str, dict[str, float]]:
    """Writes what the page showed beside what gsjax draws from its keyframes; their PSNR by the photos' names."""
    keyframes, rows = read_path(out / "path.json"), {}
    for index, (name, picture) in enumerate(shown.items()):
        viewmat = result.similarity.viewmat_to_local(keyframes.viewmats[index])
        camera = camera_of(viewmat, keyframes.fovs[index], *picture.shape[1::-1])
        (ours,) = gallery.pictures(result.gaussians, [camera], result.background, result.depth_mode)
        write_image(out / f"view_{index}.png", np.concatenate([picture, to_bytes(ours.colors)], axis=1))
        rows[name] = {"psnr": float(psnr(picture / 255.0, to_bytes(ours.colors) / 255.0))}
    return rows


def _require_shown(tab: Tab, page: Path) -> None:
    """Waits until the page has loaded, which it says no more then."""
    try:
        tab.wait_for("document.readyState === 'complete' && !/^Loading/.test("
                     "document.getElementById('message')?.textContent ?? '')")  # fmt: skip
    except TimeoutError as error:
        raise InputError(f"{page}: still loads after {PATIENCE:.0f} seconds") from error
    said = tab.evaluate("document.querySelector('p#message')?.textContent")
    if said:
        raise InputError(f"{page}: {said}")


def _after_choice(tab: Tab, menu: str, value: str) -> np.ndarray:
    """`[H, W, 3]` uint8 of the page at rest, once this is chosen in a menu."""
    tab.evaluate(f"{{const menu = document.getElementById('{menu}'); menu.value = '{value}';"
                 " menu.dispatchEvent(new Event('change'))}")  # fmt: skip
    looks = []
    until = time.monotonic() + PATIENCE
    while len(looks) < LOOKS or any((look != looks[-1]).any() for look in looks[-LOOKS:]):
        if time.monotonic() > until:
            raise InputError(f"the page still moves after {PATIENCE:.0f} seconds")
        time.sleep(REST)
        looks.append(tab.screenshot())
    return looks[-1]
