"""A film of a run: a camera that flies along a path, around the scene, or past the photos."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tqdm import tqdm

from gsjax.camera_path import Keyframes, camera_of, fly, through
from gsjax.cameras import Camera
from gsjax.colors import to_bytes
from gsjax.errors import InputError
from gsjax.io.films import check_film, film_writer, read_path
from gsjax.io.temporaries import sweep_beside
from gsjax.rendering import gallery
from gsjax.rendering.gallery import Picture
from gsjax.report.pictures import depth_picture, depth_span, surface_picture
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import Result, open_result
from gsjax.runs.viewpoints import camera_circle

ORBIT, THROUGH_PHOTOS = "orbit", "through_photos"
MOST_PHOTOS = 24  # Photos that a flight passes: of more it would tremble as the hand did.
MOST_FRAMES, SIDES = 36_000, (16, 4096)
USUAL_SIDE = 1280  # Longest side where none is asked for, pixels.
SPAN_VIEWS = 8  # Views that say which depths a film shows.


def film(
    run: str | Path,
    out: str | Path,
    *,
    path: str | Path = ORBIT,
    what: Literal["image", "depth", "normals"] = "image",
    seconds: float = 8.0,
    fps: float = 30.0,
    size: tuple[int, int] | None = None,
) -> dict[str, Any]:
    """Render a film.

    Args:
        run: Run folder, or a file of Gaussians.
        out: .mp4 or .webm, VP9.
        path: `"orbit"`: a circle around the scene. `"through_photos"`: past up to 24 photos of the run. Else a JSON
            file of keyframes in the coordinates of the run (`gsjax.io.films.read_path`).
        what: Colours; depths, near light and far dark, the same grey for the same depth all along; or normals in
            camera axes.
        seconds: Length.
        fps: Pictures a second.
        size: Width and height, pixels, even. None: those of the run's first photo, 1280 on the longer side at most.

    Returns:
        `frames`, `seconds`, `width`, `height` and `bytes`.

    Raises:
        InputError: A file cannot be read or written, or an option is out of range.
    """
    out = Path(out)
    check_film(out)
    for name, value, most in (("seconds", seconds, 3600), ("fps", fps, 240)):
        if not 0 < value <= most:
            raise InputError(f"--{name} {value:g} is not above 0 and {most} at most")
    count = max(1, round(seconds * fps))
    if count > MOST_FRAMES:
        raise InputError(f"--seconds {seconds:g} --fps {fps:g} are {count} pictures, more than {MOST_FRAMES}")
    if size is not None and not all(SIDES[0] <= side <= SIDES[1] and side % 2 == 0 for side in size):
        raise InputError(f"--size {size[0]}x{size[1]}: sides are even, and between {SIDES[0]} and {SIDES[1]} pixels")
    told = None if path in (ORBIT, THROUGH_PHOTOS) else read_path(path)
    require_apart(out, run, None if told is None else path)
    sweep_beside(out)
    result = open_result(run)
    width, height = size or _usual_size(result.cameras[0])
    keyframes = _keyframes(result, str(path), told, width / height)
    cameras = [camera_of(viewmat, fov, width, height) for viewmat, fov in zip(*fly(keyframes, count), strict=True)]
    draw = _drawing(result, cameras, what)
    shown = gallery.pictures(result.gaussians, cameras, result.background, result.depth_mode)
    with film_writer(out, fps, width, height) as add:
        for camera, picture in tqdm(zip(cameras, shown, strict=True), total=count, desc="film", unit="picture"):
            add(draw(picture, camera))
    return {"frames": count, "seconds": count / fps, "width": width, "height": height, "bytes": out.stat().st_size}


def _keyframes(result: Result, path: str, told: Keyframes | None, aspect: float) -> Keyframes:
    """The flight in local coordinates."""
    if told is not None:
        return told._replace(
            viewmats=np.stack([result.similarity.viewmat_to_local(viewmat) for viewmat in told.viewmats])
        )
    if path == ORBIT:
        circle = camera_circle(result.gaussians, result.cameras)
        return through(circle, len(circle), aspect, closed=True)
    if len(result.cameras) < 2:
        raise InputError(f"{result.source}: has one photo; a flight needs two or more")
    return through(result.cameras, MOST_PHOTOS, aspect, closed=False)


def _drawing(result: Result, cameras: list[Camera], what: str) -> Callable[[Picture, Camera], np.ndarray]:
    """How a picture of a film is made of a rendered view: `[H, W, 3]` uint8."""
    if what == "image":
        return lambda picture, _: to_bytes(picture.colors)
    if what == "normals":
        return lambda picture, camera: surface_picture(picture.depth, camera)
    some = cameras[:: max(1, len(cameras) // SPAN_VIEWS)]
    depths = [p.depth for p in gallery.pictures(result.gaussians, some, result.background, result.depth_mode)]
    span = depth_span(np.stack(depths))
    return lambda picture, _: depth_picture(picture.depth, span)


def _usual_size(camera: Camera) -> tuple[int, int]:
    """A photo's size, reduced, with even sides."""
    factor = max(1.0, max(camera.width, camera.height) / USUAL_SIDE)
    return 2 * max(8, round(camera.width / factor / 2)), 2 * max(8, round(camera.height / factor / 2))
