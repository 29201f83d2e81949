"""The browser's camera as one of ours, at a size of picture for which there is a program already."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gsjax.scene.cameras import Camera

ASPECTS = (1 / 2, 9 / 16, 2 / 3, 3 / 4, 1.0, 4 / 3, 3 / 2, 16 / 9, 2.0, 21 / 9)
"""Width over height of the pictures that are drawn: one program each. The page stretches them to its own."""
FOVS = np.radians([0.5, 170.0])  # Vertical fields of view that a picture can have.
BLOCK = 16  # Sides are multiples of it, pixels: a tile of the rasterizer is never cut.


class PageCamera(NamedTuple):
    """A browser's view. Camera axes are ours: x right, y down, z forward."""

    position: np.ndarray  # [3] world
    wxyz: np.ndarray  # [4] quaternion of the rotation from camera to world
    fov: float  # vertical, radians
    width: int  # of the page, pixels
    height: int


def picture_size(page: PageCamera, longest: int) -> tuple[int, int]:
    """Width and height, about `longest` pixels at most, of the aspect in `ASPECTS` that is nearest to the page's.

    A page without an area is square.
    """
    page_aspect = page.width / page.height if page.width > 0 and page.height > 0 else 1.0
    aspect = ASPECTS[np.argmin(np.abs(np.log(ASPECTS) - np.log(page_aspect)))]
    width, height = longest * min(1.0, aspect), longest * min(1.0, 1 / aspect)
    return max(BLOCK, round(width / BLOCK) * BLOCK), max(BLOCK, round(height / BLOCK) * BLOCK)


def camera_of(page: PageCamera, size: tuple[int, int]) -> Camera | None:
    """The pinhole camera whose picture of `size`, stretched over the page, is what the page's camera sees.

    Where the two aspects differ, so do the focal lengths. Fields of view are clipped to `FOVS`.

    Returns:
        A numpy camera; None where the page has no camera: numbers that are not finite, or no rotation.
    """
    numbers = np.concatenate([page.position, page.wxyz, [page.fov]]).astype(np.float64)
    if not np.isfinite(numbers).all() or np.linalg.norm(numbers[3:7]) < 1e-9:
        return None
    width, height = size
    half = np.tan(0.5 * np.clip(page.fov, *FOVS))
    aspect = page.width / page.height if page.width > 0 and page.height > 0 else width / height
    viewmat = np.eye(4)
    viewmat[:3, :3] = Rotation.from_quat(numbers[3:7], scalar_first=True).as_matrix().T
    viewmat[:3, 3] = -viewmat[:3, :3] @ numbers[:3]
    focal = 0.5 * width / (half * aspect), 0.5 * height / half
    K = np.array([[focal[0], 0, 0.5 * width], [0, focal[1], 0.5 * height], [0, 0, 1]])
    return Camera(viewmat.astype(np.float32), K.astype(np.float32), width, height)


def page_camera(camera: Camera) -> PageCamera:
    """The browser's camera that is where ours is and sees as far up and down, on a page of its size.

    A browser's principal point is in the middle: that of a photo which is off it is not kept.
    """
    viewmat, K = (np.asarray(matrix, np.float64) for matrix in (camera.viewmat, camera.K))
    rotation = viewmat[:3, :3].T
    return PageCamera(
        position=-rotation @ viewmat[:3, 3],
        wxyz=Rotation.from_matrix(rotation).as_quat(scalar_first=True),
        fov=float(2 * np.arctan(0.5 * camera.height / K[1, 1])),
        width=camera.width,
        height=camera.height,
    )
