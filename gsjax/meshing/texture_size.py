"""How large a texture is worth its time: as fine as the views that it is painted from, and no finer."""

import math
from collections.abc import Sequence

import numpy as np

from gsjax.meshing.texture import may_be_seen
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh, face_normals

TEXELS_PER_PIXEL = 4.0  # Two along either side: with fewer, what lies between pixels is lost (docs/texture.md).
TEXELS_PER_TRIANGLE = 16.0  # Room for charts and the gaps between them, where triangles are smaller than pixels.
FILLED = 0.5  # Of the square, by charts (measured: 0.49 to 0.53).
STEP = 256  # Sides are multiples of this.


def texture_side(mesh: Mesh, cameras: Sequence[Camera], *, least: int, most: int) -> int:
    """Side of the smallest texture that holds what the cameras tell apart on the surface, texels.

    Args:
        mesh: Outward triangles.
        cameras: One a view.
        least: Texels.
        most: Texels.
    """
    finest = np.zeros(mesh.num_faces)
    for camera in cameras:
        finest = np.maximum(finest, pixels_of_faces(mesh, camera))
    texels = max(TEXELS_PER_PIXEL * finest.sum(), TEXELS_PER_TRIANGLE * mesh.num_faces) / FILLED
    return min(max(STEP * math.ceil(math.sqrt(texels) / STEP), least), most)


def pixels_of_faces(mesh: Mesh, camera: Camera) -> np.ndarray:
    """`[F]` pixels that a triangle covers in a view, at its centre's distance and slant; what hides it is not asked.

    0 of those that face away, lie beside the image or have their centre behind the camera; an image's at most.
    """
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    corners = (mesh.vertices @ viewmat[:3, :3].T + viewmat[:3, 3])[mesh.faces]
    center = corners.mean(axis=1)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_shown = may_be_seen(mesh, face_normals(mesh), camera) & (center[:, 2] > 0)
    depth = np.where(is_shown, center[:, 2], 1.0)
    # The derivative of the projection: an area A with normal n at p covers fx fy A |n . p| / z^3.
    covered = K[0, 0] * K[1, 1] * np.abs(np.sum(doubled * center, axis=1)) / 2 / depth**3
    return np.where(is_shown, np.minimum(covered, camera.width * camera.height), 0.0)
