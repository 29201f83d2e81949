"""How far a picture is from the nearest photo, from wherever the picture is taken."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import map_coordinates

from gsjax.cameras import Camera, viewmat_centers
from gsjax.colors import to_bytes
from gsjax.scene import Pixels

FULL_SCALE = 0.5  # Mean difference of the channels that is shown as white.
UNKNOWN = np.array([0.16, 0.18, 0.25])  # Colour where the photo says nothing.


def nearest_photo(camera: Camera, cameras: Sequence[Camera]) -> int:
    """Index of the camera nearest in place and direction.

    Half a turn weighs as much as pi times the median distance of the cameras from their middle.
    """
    places, directions = _places(cameras), np.stack([np.asarray(c.viewmat, np.float64)[2, :3] for c in cameras])
    scale = np.median(np.linalg.norm(places - places.mean(0), axis=1)) or 1.0
    (place,), direction = _places([camera]), np.asarray(camera.viewmat, np.float64)[2, :3]
    turned = np.arccos(np.clip(directions @ direction, -1, 1))
    return int(np.argmin(np.linalg.norm(places - place, axis=1) / scale + turned))


def photo_colors(pixels: Pixels, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`[H, W, 3]` float32 colours of a photo over the background, and `[H, W]` float32, 1 where it may be used."""
    colors = pixels.image.astype(np.float32) / 255
    if pixels.matte is not None:
        coverage = pixels.matte[..., None].astype(np.float32) / 255
        colors = colors * coverage + (1 - coverage) * background.astype(np.float32)
    valid = np.ones(colors.shape[:2], np.float32) if pixels.valid is None else (pixels.valid > 127).astype(np.float32)
    return colors, valid


def seen_by_photo(
    depth: np.ndarray, camera: Camera, photo: tuple[np.ndarray, np.ndarray], photo_camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """What a photo shows of the points that a picture shows.

    A pixel without a depth is read as far off, at the largest one. What hides a point from the photo is not looked
    for: from another place than the photo's, edges in depth cast shadows of a false error.

    Args:
        depth: `[H, W]` camera z of the picture, 0 where nothing is.
        camera: The picture's.
        photo: As `photo_colors` gives it.
        photo_camera: The photo's.

    Returns:
        `[H, W, 3]` float32 colours, read bilinearly, and `[H, W]` bool, where the photo shows the point and may be
        used.
    """
    (fx, _, cx), (_, fy, cy), _ = np.asarray(camera.K, np.float64)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    far = depth.max() if depth.max() > 0 else 1.0
    points = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], -1) * np.where(depth > 0, depth, far)[..., None]
    to_photo = np.asarray(photo_camera.viewmat, np.float64) @ np.linalg.inv(np.asarray(camera.viewmat, np.float64))
    points = points @ to_photo[:3, :3].T + to_photo[:3, 3]
    in_front = points[..., 2] > 1e-6
    (fx, _, cx), (_, fy, cy), _ = np.asarray(photo_camera.K, np.float64)
    z = np.where(in_front, points[..., 2], 1.0)
    column, row = points[..., 0] / z * fx + cx, points[..., 1] / z * fy + cy
    colors, valid = photo
    height, width = valid.shape
    inside = in_front & (column >= 0) & (column <= width) & (row >= 0) & (row <= height)
    at = np.where(inside, np.clip([row - 0.5, column - 0.5], 0, [[[height - 1]], [[width - 1]]]), 0)
    read = [map_coordinates(part, at, order=1) for part in (*np.moveaxis(colors, -1, 0), valid)]
    return np.stack(read[:3], -1), inside & (read[3] > 0.999)


def error_picture(rendered: np.ndarray, seen: np.ndarray, known: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` uint8: mean absolute difference of the channels from black over red and yellow to white.

    Args:
        rendered: `[H, W, 3]` 0..1.
        seen: `[H, W, 3]` 0..1.
        known: `[H, W]` bool; grey blue where False.
    """
    strength = np.abs(rendered - seen).mean(-1, keepdims=True) / FULL_SCALE
    return to_bytes(np.where(known[..., None], np.clip(3 * strength - np.arange(3), 0, 1), UNKNOWN))


def _places(cameras: Sequence[Camera]) -> np.ndarray:
    """`[C, 3]` camera centres in the world."""
    views = np.stack([np.asarray(c.viewmat, np.float64) for c in cameras])
    return viewmat_centers(views)
