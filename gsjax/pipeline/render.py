"""Pictures and films of a run, of Gaussians, or of a mesh."""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.files import make_folder
from gsjax.io.images import write_image
from gsjax.io.keyframe_files import read_keyframes
from gsjax.io.machine import require_memory
from gsjax.io.temporary_files import sweep_beside
from gsjax.io.video_writer import GIF_BYTES, SUFFIXES, is_video, write_video
from gsjax.meshing.export import is_mesh_file, read_mesh, read_textured
from gsjax.meshing.pictures import shading_of, smooth_pictures
from gsjax.rendering import gallery
from gsjax.rendering.gallery import Picture
from gsjax.report.pictures import depth_picture, depth_span, surface_picture
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import open_result
from gsjax.runs.viewpoints import camera_circle, camera_circle_of_mesh
from gsjax.scene.camera_path import Keyframes, at_all, camera_of, fly, through
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes
from gsjax.scene.similarity import Similarity, of_points

Views = Literal["all", "held_out", "turntable", "through_photos"]
What = Literal["image", "depth", "normals"]

SECONDS = 8.0
FPS, GIF_FPS = 30.0, 10.0
MOST_PHOTOS = 24  # That a path passes: with more of them the camera shakes as the hand did.
MOST_PICTURES, SIDES = 36_000, (16, 4096)
USUAL_SIDE, GIF_SIDE = 1280, 512  # Longest side of a film whose size is not given, pixels.
SPAN_VIEWS = 8  # Views that set the range of depths of a film.
RAYS = 2  # Along a pixel of a mesh, and down it.
UP = 0.0, 0.0, 1.0


@dataclass(frozen=True)
class _Source:
    """A run, Gaussians or a mesh; all in local coordinates."""

    path: Path
    similarity: Similarity  # to local coordinates from those of the files
    names: tuple[str, ...]  # of its views; a mesh has none
    cameras: tuple[Camera, ...]
    held_out: tuple[bool, ...]
    circle: Callable[[], list[Camera]]  # views around it
    draw: Callable[[Sequence[Camera]], Iterator[Picture]]


def render(
    source: str | Path,
    out: str | Path,
    *,
    views: Views = "all",
    path: str | Path | None = None,
    what: What | None = None,
    seconds: float | None = None,
    fps: float | None = None,
    size: tuple[int, int] | None = None,
    up: tuple[float, float, float] | None = None,
) -> Path:
    """Write pictures into a folder, or a film.

    A folder gets NAME_color.png, NAME_depth.png and NAME_normal.png of every view, see `picture_stems`. A film shows
    one of these along a camera path.

    Args:
        source: Run folder, file of Gaussians, or mesh. A mesh has no views of its own, and is seen from outside.
        out: A film (.mp4, .webm, .gif) or else a folder.
        views: All views or the held-out ones, for a folder; `"turntable"`: 36 views of a circle around the scene, or a
            film along it; `"through_photos"`: a film past up to 24 of the photos.
        path: For a film in place of `views`: a JSON file of keyframes in the coordinates of the source, see
            `gsjax.io.keyframe_files.read_keyframes`.
        what: What a film shows: colours (default); depths, near light and far dark, with one scale for the whole film;
            or normals in camera axes.
        seconds: Length of a film; default 8.
        fps: Pictures a second; default 30, and 10 of a GIF.
        size: Width and height of a film, pixels, even. Default: those of the first view, 1280 on the longer side at
            most, and 512 of a GIF.
        up: Direction of the world that is up in a turntable of a mesh; default z.

    Returns:
        `out`.

    Raises:
        InputError: A file cannot be read or written, or an option is out of range or does not fit the others.
    """
    source, out = Path(source), Path(out)
    _check(out, views, path, {"what": what, "seconds": seconds, "fps": fps, "size": size})
    require_apart(out, source, path)
    keyframes = None if path is None else read_keyframes(path)
    if not is_video(out):
        _write_pictures(out, _open(source, up), views)
        return out
    is_gif = out.suffix.lower() == ".gif"
    seconds = SECONDS if seconds is None else seconds
    fps = (GIF_FPS if is_gif else FPS) if fps is None else fps
    count = _count(seconds, fps, size)
    sweep_beside(out)
    opened = _open(source, up)
    width, height = size or _usual_size(opened, GIF_SIDE if is_gif else USUAL_SIDE)
    if is_gif:
        require_memory(f"{out}: {count} pictures of {width}x{height}", GIF_BYTES * count * width * height)
    flight = _keyframes(opened, views, keyframes, width / height)
    cameras = [camera_of(viewmat, fov, width, height) for viewmat, fov in zip(*fly(flight, count), strict=True)]
    write_video(out, _pictures(opened, cameras, what or "image"), fps, width, height)
    return out


def picture_stems(names: Sequence[str]) -> list[str]:
    """Unique stems for the files of views: the photo's name without its suffix where that is unique."""
    whole = [name.replace("/", "_") for name in names]
    short = [os.path.splitext(name)[0] for name in whole]
    alike = Counter(short)
    stems = [brief if alike[brief] == 1 else name for brief, name in zip(short, whole, strict=True)]
    alike = Counter(stems)
    return [stem if alike[stem] == 1 else f"{stem}_{index}" for index, stem in enumerate(stems)]


def _check(out: Path, views: Views, path: str | Path | None, of_films: dict[str, object]) -> None:
    if is_video(out):
        if path is None and views in ("all", "held_out"):
            raise InputError(f"out={out}: a film needs a path: turntable, through photos, or a file")
        return
    if path is not None or views == "through_photos":
        raise InputError(f"out={out}: a film ends in {', '.join(SUFFIXES)}")
    for name, value in of_films.items():
        if value is not None:
            raise InputError(f"{name} is for films, and out={out} does not end in {', '.join(SUFFIXES)}")


def _count(seconds: float, fps: float, size: tuple[int, int] | None) -> int:
    """The number of pictures of a film."""
    for name, value, most in (("seconds", seconds, 3600), ("fps", fps, 240)):
        if not 0 < value <= most:
            raise InputError(f"{name}={value:g} is not above 0 and {most} at most")
    count = max(1, round(seconds * fps))
    if count > MOST_PICTURES:
        raise InputError(f"seconds={seconds:g} and fps={fps:g} are {count} pictures, more than {MOST_PICTURES}")
    if size is not None and not all(SIDES[0] <= side <= SIDES[1] and side % 2 == 0 for side in size):
        raise InputError(f"size={size[0]}x{size[1]}: sides are even, and between {SIDES[0]} and {SIDES[1]} pixels")
    return count


def _open(source: Path, up: tuple[float, float, float] | None) -> _Source:
    if up is not None and not (np.any(up) and np.isfinite(up).all()):
        raise InputError(f"up={' '.join(f'{axis:g}' for axis in up)} is no direction")
    if source.is_file() and is_mesh_file(source):
        return _open_mesh(source, np.asarray(UP if up is None else up))
    if up is not None:
        raise InputError(f"{source}: is no mesh; up is for meshes, up in a run is up in its photos")
    result = open_result(source)
    draw = partial(gallery.pictures, background=result.background, depth_mode=result.depth_mode)
    return _Source(
        source,
        result.similarity,
        result.names,
        result.cameras,
        result.held_out,
        partial(camera_circle, result.gaussians, result.cameras),
        partial(draw, result.gaussians),
    )


def _open_mesh(source: Path, up: np.ndarray) -> _Source:
    textured = read_textured(source)
    mesh = read_mesh(source) if textured is None else textured.mesh
    shading = shading_of(textured)
    similarity = of_points(mesh.vertices)
    mesh = similarity.mesh_to_local(mesh)

    def draw_over_white(cameras: Sequence[Camera]) -> Iterator[Picture]:
        for picture in smooth_pictures(mesh, cameras, shading=shading, side=RAYS):
            yield picture._replace(colors=picture.colors + 1 - picture.alphas[..., None])

    return _Source(source, similarity, (), (), (), partial(camera_circle_of_mesh, mesh, up), draw_over_white)


def _write_pictures(out: Path, source: _Source, views: Views) -> None:
    if views == "turntable":
        cameras = source.circle()
        stems = [f"turn_{index:03d}" for index in range(len(cameras))]
    else:
        rows = [row for row, held_out in enumerate(source.held_out) if held_out or views == "all"]
        if not rows:
            raise InputError(f"{source.path}: has no {'' if views == 'all' else 'held-out '}views to render")
        all_stems = picture_stems(source.names)
        cameras, stems = [source.cameras[row] for row in rows], [all_stems[row] for row in rows]
    out = make_folder(out)
    pictures = zip(stems, cameras, source.draw(cameras), strict=True)
    for stem, camera, picture in tqdm(pictures, total=len(cameras), desc="render", unit="view"):
        write_image(out / f"{stem}_color.png", to_bytes(picture.colors))
        write_image(out / f"{stem}_depth.png", depth_picture(picture.depth))
        write_image(out / f"{stem}_normal.png", surface_picture(picture.depth, camera))


def _keyframes(source: _Source, views: Views, keyframes: Keyframes | None, aspect: float) -> Keyframes:
    """The camera path in local coordinates."""
    if keyframes is not None:
        local = np.stack([source.similarity.viewmat_to_local(viewmat) for viewmat in keyframes.viewmats])
        return keyframes._replace(viewmats=local)
    if views == "turntable":
        return at_all(source.circle(), aspect, closed=True)
    if len(source.cameras) < 2:
        raise InputError(f"{source.path}: has fewer than two photos to pass")
    return through(source.cameras, MOST_PHOTOS, aspect)


def _pictures(source: _Source, cameras: list[Camera], what: What) -> Iterator[np.ndarray]:
    """`[H, W, 3]` uint8 pictures of a film."""
    some = cameras[:: max(1, len(cameras) // SPAN_VIEWS)] if what == "depth" else []
    span = depth_span(np.stack([picture.depth for picture in source.draw(some)])) if some else None
    pictures = zip(cameras, source.draw(cameras), strict=True)
    for camera, picture in tqdm(pictures, total=len(cameras), desc="render", unit="picture"):
        if what == "image":
            yield to_bytes(picture.colors)
        elif what == "depth":
            yield depth_picture(picture.depth, span)
        else:
            yield surface_picture(picture.depth, camera)


def _usual_size(source: _Source, most: int) -> tuple[int, int]:
    """The size of the first view, reduced to `most` pixels along the longer side, with even sides."""
    first = source.cameras[0] if source.cameras else source.circle()[0]
    factor = max(1.0, max(first.width, first.height) / most)
    return 2 * max(8, round(first.width / factor / 2)), 2 * max(8, round(first.height / factor / 2))
