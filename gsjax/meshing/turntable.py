"""A mesh on a turntable: pictures from a circle around it, as an animation or a strip."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsjax.cameras import look_at
from gsjax.errors import InputError
from gsjax.io.files import atomic_path
from gsjax.meshes import Mesh, unit_or_zero
from gsjax.meshing.pictures import Shading, render_mesh, vertex_colors
from gsjax.meshing.rays import front_faces_only, ray_caster

ELEVATION = np.radians(20.0)
FOCAL = 1.8  # In sides of the picture: a view of 31 degrees.
MARGIN = 1.05
OVERSAMPLING = 2  # Rays along each side of a pixel.
SECONDS = 4.0  # A turn takes.


def turntable(
    mesh: Mesh,
    *,
    frames: int = 36,
    size: int = 512,
    up: np.ndarray = np.array([0.0, 0.0, 1.0]),  # noqa: B008
    shading: Shading = vertex_colors,
) -> Iterator[np.ndarray]:
    """Pictures from a circle around the mesh, 20 degrees above its middle.

    Faces are seen from outside only, as viewers of glTF show them: a room is looked into through its walls. The circle
    leaves out the farthest hundredth of the vertices at every side: stray ones do not shrink the rest.

    Args:
        mesh: What to show.
        frames: Pictures in a full turn.
        size: Side of each, pixels.
        up: `[3]` the world's direction that points up in the pictures, any length.
        shading: Colours of what is seen.

    Yields:
        `[size, size, 3]` uint8, on white.
    """
    low, high = np.quantile(mesh.vertices[np.unique(mesh.faces)].astype(np.float64), [0.01, 0.99], axis=0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-12)
    fine = size * OVERSAMPLING
    K = np.array([[FOCAL * fine, 0, fine / 2], [0, FOCAL * fine, fine / 2], [0, 0, 1]])
    distance = MARGIN * radius * float(np.hypot(1, 2 * FOCAL))
    cast = front_faces_only(mesh, ray_caster(mesh))
    for viewmat in _circle(middle, distance, unit_or_zero(np.asarray(up, np.float64)), frames):
        picture = render_mesh(mesh, viewmat, K, fine, fine, shading=shading, cast=cast)
        blocks = picture.reshape(size, OVERSAMPLING, size, OVERSAMPLING, 3)
        yield np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def write_turntable(path: str | Path, pictures: list[np.ndarray]) -> None:
    """Writes a .gif that turns for ever, or a .png with the pictures side by side.

    Args:
        path: Its suffix says which.
        pictures: `[S, S, 3]` uint8 each.

    Raises:
        InputError: Unknown suffix, or the file cannot be written.
    """
    check_suffix(path)
    from PIL import Image

    with atomic_path(path) as temporary:
        if temporary.suffix.lower() == ".png":
            Image.fromarray(np.concatenate(pictures, axis=1)).save(temporary)
        else:
            first, *rest = (Image.fromarray(picture) for picture in pictures)
            milliseconds = max(round(1000 * SECONDS / len(pictures)), 20)
            first.save(temporary, save_all=True, append_images=rest, duration=milliseconds, loop=0)


def check_suffix(path: str | Path) -> None:
    """InputError unless it is one that `write_turntable` knows."""
    if Path(path).suffix.lower() not in (".gif", ".png"):
        raise InputError(f"{path}: turntables end in .gif or .png")


def _circle(middle: np.ndarray, distance: float, up: np.ndarray, count: int) -> Iterator[np.ndarray]:
    """`[4, 4]` world to camera (OpenCV axes) of cameras that look at the middle from around and above."""
    helper = np.eye(3)[np.argmin(np.abs(up))]
    first = unit_or_zero(np.cross(up, helper))
    second = np.cross(up, first)
    for angle in 2 * np.pi * np.arange(count) / count:
        outward = np.cos(angle) * first + np.sin(angle) * second
        yield look_at(middle + distance * (np.cos(ELEVATION) * outward + np.sin(ELEVATION) * up), middle, up)
