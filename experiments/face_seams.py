"""Whole photos drawn from a run whose photos were read as faces, and whether the faces' borders show (`panoramas.py`).

A photo is drawn twice, on the six faces of the cube that training read, and on those of a turned cube. A border of the
first cube shows in the first drawing if its two sides were learned apart or are drawn apart, in the second only if they
were learned apart. A border of the turned cube shows in the first drawing never, in the second if it is drawn apart.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from made_room import (
    OPERATOR_BELOW,
    Seen,
    is_below,
    look_along,
    pixel_rays,
    poses,
    room_lens,
    surface_textures,
    true_photo,
)

from gsjax.cameras import Camera
from gsjax.colors import to_bytes
from gsjax.errors import InputError
from gsjax.io.images import cv2, read_image, write_image
from gsjax.io.lenses import Lens, pinhole_views
from gsjax.render import gallery
from gsjax.runs.result import Result, open_result
from gsjax.runs.run import Run

PHOTOS = 2  # held out, and as many trained on
SIDE = 4  # pixels on each side of a border whose means are compared
RIM = 2  # pixels that a face is drawn larger on each side, so that it can be read up to its border
CORNERS = 60.0  # degrees from the axis on: what one plane loses of a fisheye photo
TURNS = {"trained": np.eye(3), "turned": np.asarray(cv2.Rodrigues(np.radians(45) * np.array([0.6, 0.8, 0.0]))[0])}


class RoomPhoto(NamedTuple):
    """A photo of the made room and what was really there."""

    file: Path
    lens: Lens
    viewmat: np.ndarray  # [4, 4] in the run's coordinates
    colors: np.ndarray  # [H, W, 3] 0..1, without an operator
    distances: np.ndarray  # [H, W] metres
    apart: np.ndarray  # [H, W] bool: where a panorama shows the operator, or a fisheye photo's corners


def seams(run: Path, out: Path) -> dict[str, dict[str, float]]:
    """How well whole photos are drawn, and how far their errors jump across borders of faces and within faces.

    Args:
        run: A finished run of photos of the made room.
        out: Picture to write: a held-out photo as it was taken, and as it is drawn.

    Returns:
        By what was drawn, `psnr`, and `psnr_apart` of the operator's place or the corners. Of 255 the mean jump of the
        colours' error at borders of the `trained` cube, of the `turned` one, and `within` faces of both; the same of
        distances, in thousandths, medians.

    Raises:
        InputError: It is no finished run of photos that were read as faces.
    """
    result = open_result(run)
    fronts = [index for index, name in enumerate(result.names) if "_front." in name]
    if not fronts:
        raise InputError(f"{run}: its photos were not read as faces")
    rows = {}
    for label, held_out in (("held out", True), ("trained", False)):
        chosen = [index for index in fronts if result.held_out[index] == held_out][:PHOTOS]
        photos = [_room_photo(result, index) for index in chosen]
        for cube, turn in TURNS.items():
            drawn = [draw(result, photo, turn) for photo in photos]
            rows[f"{label}, {cube} faces"] = _figures(photos, drawn)
            if held_out and cube == "trained":
                _write_pair(out, photos[0], drawn[0])
    return rows


def draw(result: Result, photo: RoomPhoto, turn: np.ndarray) -> Seen:
    """`[H, W, 3]` colours and `[H, W]` distances (0: nothing) of a whole photo, from faces of a cube.

    Args:
        result: What is drawn.
        photo: Its camera.
        turn: `[3, 3]` rotation of the cube; the identity's faces are those that photos are read as.
    """
    rays = pixel_rays(photo.lens) @ turn.T
    views = pinhole_views(room_lens("panorama", round(2 * np.pi * _density(photo.lens))))
    cameras = [_face_camera(view.rotation @ turn, view.K, view.width, photo.viewmat) for view in views]
    colors, distances = np.zeros(rays.shape, np.float32), np.zeros(rays.shape[:2], np.float32)
    nearest = cube_faces(rays)
    pictures = gallery.pictures(result.gaussians, cameras, result.background, result.depth_mode)
    for face, (view, camera, picture) in enumerate(zip(views, cameras, pictures, strict=True)):
        chosen = nearest == face
        local, at = rays[chosen] @ view.rotation.T, np.full((*chosen.shape, 2), -1, np.float32)
        at[chosen] = (local @ np.asarray(camera.K, np.float64).T / local[:, 2:])[:, :2] - 0.5
        colors[chosen] = cv2.remap(picture.colors, at, None, cv2.INTER_LINEAR)[chosen]
        distances[chosen] = cv2.remap(picture.depth, at, None, cv2.INTER_LINEAR)[chosen] / local[:, 2]
    return Seen(colors, distances)


def cube_faces(rays: np.ndarray) -> np.ndarray:
    """`[...]` which face each of the rays `[..., 3]` meets, by the order of `gsjax.io.lenses.pinhole_views`."""
    ahead = np.stack([view.rotation[2] for view in pinhole_views(room_lens("panorama", 8))])
    return np.argmax(rays @ ahead.T, axis=-1)


def _density(lens: Lens) -> float:
    """Pixels a radian, in a photo's middle."""
    return lens.width / (2 * np.pi) if lens.model == "EQUIRECTANGULAR" else lens.params[0]


def _face_camera(rotation: np.ndarray, K: np.ndarray, side: int, viewmat: np.ndarray) -> Camera:
    turn = np.eye(4)
    turn[:3, :3] = rotation
    wider = (K + RIM * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])).astype(np.float32)
    size = side + 2 * RIM
    return Camera((turn @ viewmat).astype(np.float32), wider, size, size)


def _room_photo(result: Result, index: int) -> RoomPhoto:
    """The photo whose front face has this index in a run."""
    name = result.names[index].replace("_front.", ".")
    file = Path(Run(result.source).manifest["scene"]) / "images" / name
    height, width = read_image(file)[0].shape[:2]
    lens = room_lens("fisheye" if width == height else "panorama", width)
    rays, textures = pixel_rays(lens), surface_textures()
    pose = poses(len(list(file.parent.glob("*.png"))))[int(file.stem)]
    return RoomPhoto(
        file,
        lens,
        np.asarray(result.cameras[index].viewmat, np.float64),
        true_photo(lens, pose, textures),
        look_along(pose, rays.reshape(-1, 3), textures).distances.reshape(height, width),
        is_below(lens, OPERATOR_BELOW) if width > height else rays[..., 2] < np.cos(np.radians(CORNERS)),
    )


def _figures(photos: list[RoomPhoto], drawn: list[Seen]) -> dict[str, float]:
    """As `seams` returns them, over all pixels and borders of the photos."""
    squares = [np.square(seen.colors - photo.colors) for photo, seen in zip(photos, drawn, strict=True)]
    apart = [square[photo.apart] for photo, square in zip(photos, squares, strict=True)]
    figures = {"psnr": -10 * np.log10(np.mean(squares)), "psnr_apart": -10 * np.log10(np.mean(np.concatenate(apart)))}
    for quantity, errors_of, mean in (("color", _color_errors, np.mean), ("depth", _depth_errors, np.median)):
        collected = [jumps(errors_of(photo, seen), photo.lens) for photo, seen in zip(photos, drawn, strict=True)]
        for where in collected[0]:
            figures[f"{quantity}_{where}"] = mean(np.concatenate([found[where] for found in collected]))
    return figures


def _color_errors(photo: RoomPhoto, seen: Seen) -> np.ndarray:
    """`[H, W, 3]` of 255."""
    return 255 * (seen.colors - photo.colors)


def _depth_errors(photo: RoomPhoto, seen: Seen) -> np.ndarray:
    """`[H, W, 1]` thousandths, but for the run's unit of length; NaN where nothing is drawn."""
    hit = seen.distances > 0
    return np.where(hit, 1000 * np.log(np.where(hit, seen.distances, 1) / photo.distances), np.nan)[..., None]


def jumps(errors: np.ndarray, lens: Lens) -> dict[str, np.ndarray]:
    """How far the mean of `SIDE` pixels is from that of the next `SIDE` of its row or column, over all channels.

    Args:
        errors: `[H, W, C]` of a photo; NaN where there are none.
        lens: Of the photo.

    Returns:
        Of each pair whose two parts lie in one face each, in the faces of both cubes: by the name of the cube whose
        border lies between the parts, or "within" where none does.
    """
    rays = pixel_rays(lens)
    cubes = {name: cube_faces(rays @ turn.T) for name, turn in TURNS.items()}
    parts = {name: [] for name in (*cubes, "within")}
    for axis in (0, 1):
        window = _windows(errors, axis)
        jump = np.abs(window[..., SIDE:].mean(-1) - window[..., :SIDE].mean(-1)).mean(-1)
        pure, crossed = np.isfinite(jump), {}
        for name, faces in cubes.items():
            face = _windows(faces, axis)
            first, second = face[..., :1], face[..., -1:]
            pure = pure & (face[..., :SIDE] == first).all(-1) & (face[..., SIDE:] == second).all(-1)
            crossed[name] = (first != second)[..., 0]
        both, neither = np.all([*crossed.values()], axis=0), ~np.any([*crossed.values()], axis=0)
        for name, across in crossed.items():
            parts[name].append(jump[pure & across & ~both])
        parts["within"].append(jump[pure & neither])
    return {name: np.concatenate(part) for name, part in parts.items()}


def _windows(array: np.ndarray, axis: int) -> np.ndarray:
    """`[..., 2 * SIDE]` views of the neighbours along an axis."""
    return np.lib.stride_tricks.sliding_window_view(array, 2 * SIDE, axis)


def _write_pair(out: Path, photo: RoomPhoto, drawn: Seen) -> None:
    """The photo as it was taken, and beside it, or below a panorama, as it is drawn."""
    taken = read_image(photo.file)[0]
    write_image(out, np.concatenate([taken, to_bytes(drawn.colors)], axis=0 if taken.shape[1] > len(taken) else 1))
