"""Draw the pictures of real captures that the pages show, with a label above every panel.

    python experiments/pictures.py room SCAN --out docs/assets/room.jpg          # SCAN: of `gsjax scan`
    python experiments/pictures.py fox RUN --out docs/assets/fox.gif             # RUN: with RUN/mesh.ply
    python experiments/pictures.py walls RUN ... --meshes FILE ... --titles TITLE ... --out docs/assets/room_flat.jpg

No picture holds a photo, as the data sets are for non-commercial research. An error map shows what differs.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.io.files import atomic_path
from gsjax.io.images import cv2
from gsjax.io.video_writer import write_video

if TYPE_CHECKING:  # They import jax.
    from gsjax.runs.result import Result
    from gsjax.scene.cameras import Camera

Panel = tuple[str, np.ndarray]
"""A title, and a picture `[H, W, 3]` uint8."""

GAP = 8  # white pixels between panels
ERROR_GAIN = 8  # A difference of 32 of 255 is black.
ENLARGED = 1.5  # of a view, against its photo
WALL_VIEWS = 0, 3  # of the held-out ones
FILM = 216, 288  # pixels of a panel
FRAMES, FPS, STEP = 24, 7.0, 8  # of the film; its colours are multiples of 8 of 255, so that the file stays small
SWING, LIFT = 35.0, 8.0  # of its camera, degrees to each side, and up and down
FIELD = 1.45  # tangents of its field of view, in those of the photos


def sheet(rows: Sequence[Sequence[Panel]], width: int, *, size: float = 18) -> np.ndarray:
    """`[H, W, 3]` uint8: rows of panels below their titles of `size` points, `width` pixels in all."""
    columns = max(map(len, rows))
    each = (width - GAP * (columns - 1)) // columns
    strips = []
    for row in rows:
        panels = [np.concatenate([title_strip(title, each, size), fitted(picture, each)]) for title, picture in row]
        gap = np.full((len(panels[0]), GAP, 3), 255, np.uint8)
        strip = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
        strips += [strip, np.full((GAP, strip.shape[1], 3), 255, np.uint8)]
    return np.concatenate(strips[:-1])


def write_jpeg(out: str, picture: np.ndarray) -> None:
    """Write a picture at a quality of 85; without subsampling, which blurs the hues of normals."""
    options = [cv2.IMWRITE_JPEG_QUALITY, 85, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    encoded = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), options)[1]
    with atomic_path(out) as temporary:
        temporary.write_bytes(encoded.tobytes())


def title_strip(title: str, width: int, size: float) -> np.ndarray:
    """`[H, width, 3]` uint8: dark text on white, `size` points of 100 to an inch."""
    from gsjax.report.figures import new_figure

    figure = new_figure(width / 100, 2.2 * size / 100)
    figure.text(0.5, 0.5, title, size=size, color="0.1", ha="center", va="center")
    figure.canvas.draw()
    return np.array(figure.canvas.buffer_rgba())[..., :3]


def fitted(picture: np.ndarray, width: int) -> np.ndarray:
    """A picture of another width, its sides in the same proportion."""
    height = round(picture.shape[0] * width / picture.shape[1])
    return cv2.resize(
        picture, (width, height), interpolation=cv2.INTER_AREA if width < picture.shape[1] else cv2.INTER_CUBIC
    )


def room(scan: Path, out: str) -> None:
    """Render, its error and its normals above, the three meshes below, of the first held-out view of a scan."""
    from gsjax.meshing.export import read_mesh, read_textured
    from gsjax.meshing.pictures import texture_colors
    from gsjax.report.pictures import mesh_picture, surface_picture
    from gsjax.runs.result import open_result, scene_of_run
    from gsjax.scene.colors import to_bytes

    result, textured = open_result(scan / "run"), read_textured(scan / "mesh.glb")
    if textured is None:
        raise InputError(f"{scan / 'mesh.glb'}: has no texture")
    index = result.held_out.index(True)
    frame = next(f for f in scene_of_run(scan / "run").held_out_frames if f.name == result.names[index])
    camera, large = result.cameras[index], enlarged(result.cameras[index], ENLARGED)
    small, picture = _rendered(result, camera), _rendered(result, large)
    photo = frame.pixels().image
    local = result.similarity.mesh_to_local
    coarse, refined = (local(read_mesh(scan / folder / "mesh.ply")) for folder in ("run", "refined"))
    above = [
        ("render of the Gaussians", to_bytes(picture.colors)),
        (f"its error against the photo, {ERROR_GAIN} times", error_map(photo, to_bytes(small.colors))),
        ("normals of its depth", surface_picture(picture.depth, large)),
    ]
    below = [
        ("coarse mesh", mesh_picture(coarse, large)),
        ("refined mesh", mesh_picture(refined, large)),
        ("refined mesh, textured", mesh_picture(local(textured.mesh), large, texture_colors(textured))),
    ]
    write_jpeg(out, sheet([above, below], 1440))
    print(frame.name)


def error_map(photo: np.ndarray, render: np.ndarray) -> np.ndarray:
    """The difference of a photo and a render, after one gain a colour for the exposure of the photo."""
    from gsjax.report.pictures import difference_picture
    from gsjax.scene.colors import to_bytes

    values = render.astype(np.float64)
    gains = np.sum(photo * values, axis=(0, 1)) / np.maximum(np.sum(values**2, axis=(0, 1)), 1)
    return difference_picture(photo, to_bytes(np.clip(gains * values / 255, 0, 1)), ERROR_GAIN)


def enlarged(camera: "Camera", factor: float) -> "Camera":
    """The same view with `factor` times as many pixels along each side."""
    from gsjax.scene.cameras import Camera

    K = np.asarray(camera.K) * np.array([[factor], [factor], [1]], np.float32)
    return Camera(camera.viewmat, K, round(factor * camera.width), round(factor * camera.height))


def _rendered(result: "Result", camera: "Camera"):
    from gsjax.rendering import gallery

    return next(gallery.pictures(result.gaussians, [camera], result.background, result.depth_mode))


def walls(runs: Sequence[Path], meshes: Sequence[str], titles: Sequence[str], out: str) -> None:
    """Meshes of runs of one scene in two held-out views, a column each."""
    from gsjax.meshing.export import read_mesh
    from gsjax.report.pictures import mesh_picture
    from gsjax.runs.result import open_result

    columns = []
    for run, file in zip(runs, meshes, strict=True):
        result = open_result(run)
        mesh = result.similarity.mesh_to_local(read_mesh(file))
        held_out = [index for index, is_held_out in enumerate(result.held_out) if is_held_out]
        indices = [held_out[view] for view in WALL_VIEWS]
        columns.append([mesh_picture(mesh, enlarged(result.cameras[index], ENLARGED)) for index in indices])
    names = [Path(result.names[index]).stem for index in indices]
    rows = [
        [(f"{name}: {title}", picture) for title, picture in zip(titles, pictures, strict=True)]
        for name, pictures in zip(names, zip(*columns, strict=True), strict=True)
    ]
    write_jpeg(out, sheet(rows, 1440))


def fox(run: Path, out: str) -> None:
    """A film on an arc around what the photos show: the render, and the mesh."""
    from gsjax.meshing.export import read_mesh
    from gsjax.meshing.pictures import headlight, smooth_pictures
    from gsjax.rendering import gallery
    from gsjax.runs.result import open_result
    from gsjax.scene.colors import to_bytes

    result = open_result(run)
    mesh = result.similarity.mesh_to_local(read_mesh(run / "mesh.ply"))
    cameras = arc(result.cameras)
    renders = gallery.pictures(result.gaussians, cameras, result.background, result.depth_mode)
    meshes = smooth_pictures(mesh, cameras, shading=headlight, side=2)
    frames = []
    for render, grey in zip(renders, meshes, strict=True):
        over_white = grey.colors + 1 - grey.alphas[..., None]
        panels = [("render", to_bytes(render.colors)), ("mesh", to_bytes(over_white))]
        frame = sheet([panels], 2 * FILM[0] + GAP, size=16)
        frames.append(np.minimum(np.round(frame / STEP) * STEP, 255).astype(np.uint8))
    write_video(out, frames, FPS, frames[0].shape[1], frames[0].shape[0])


def arc(cameras: Sequence["Camera"]) -> list["Camera"]:
    """Views on a closed path before the point that the photos face, at their median distance."""
    from gsjax.scene.cameras import Camera, viewmat_center

    viewmats = np.stack([np.asarray(camera.viewmat, np.float64) for camera in cameras])
    centers, axes, ups = np.stack([viewmat_center(v) for v in viewmats]), viewmats[:, 2, :3], -viewmats[:, 1, :3]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    target = np.linalg.solve(across.sum(0), np.einsum("nij,nj->i", across, centers))
    up = _unit(ups.mean(0))
    mean = _unit(np.median(centers, axis=0) - target)
    back = _unit(mean - up * (mean @ up))
    side, radius = np.cross(up, back), np.median(np.linalg.norm(centers - target, axis=1))
    width, height = FILM
    first = cameras[0]
    focal = float(first.K[0, 0]) * width / first.width / FIELD
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
    views = []
    for turn in np.arange(FRAMES) / FRAMES * 2 * np.pi:
        azimuth, elevation = np.radians(SWING) * np.sin(turn), np.radians(LIFT) * np.cos(turn)
        away = np.cos(elevation) * (np.cos(azimuth) * back + np.sin(azimuth) * side) + np.sin(elevation) * up
        forward, center = -away, target + radius * away
        right = _unit(np.cross(forward, up))
        viewmat = np.eye(4)
        viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        viewmat[:3, 3] = -viewmat[:3, :3] @ center
        views.append(Camera(viewmat.astype(np.float32), K, width, height))
    return views


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def main() -> None:
    """Read the arguments and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", choices=("room", "fox", "walls"))
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    parser.add_argument("--meshes", nargs="+", default=[], metavar="FILE", help="of walls: a mesh of each run")
    parser.add_argument("--titles", nargs="+", default=[], metavar="TITLE", help="of walls: their titles")
    parser.add_argument("--out", required=True, metavar="FILE")
    arguments = parser.parse_args()
    if arguments.picture == "walls":
        walls(arguments.runs, arguments.meshes, arguments.titles, arguments.out)
    else:
        {"room": room, "fox": fox}[arguments.picture](arguments.runs[0], arguments.out)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
