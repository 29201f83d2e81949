"""Do the faces of a mesh look outwards? The views say so: what a camera sees first must face it."""

from collections.abc import Sequence

import numpy as np

from gsjax.meshing.ray_queries import ray_caster
from gsjax.scene.cameras import Camera, viewmat_center
from gsjax.scene.meshes import Mesh, face_normals

SIDE = 64  # Rays along the longer side of a view: enough to tell a share.
MOST_VIEWS = 24


def facing_share(mesh: Mesh, cameras: Sequence[Camera]) -> float:
    """Share of the view rays whose first triangle faces the camera, over up to 24 views; 1 where no ray hits.

    A sound mesh has 0.99 and more; what is missing looks through a hole at an inner side.
    """
    cast, normals = ray_caster(mesh), face_normals(mesh)
    chosen = np.unique(np.linspace(0, len(cameras) - 1, min(MOST_VIEWS, len(cameras))).astype(int))
    faces_cameras = []
    for index in chosen:
        origin, directions = _rays(cameras[index])
        hits = cast(origin, directions)
        hit = np.isfinite(hits.distances)
        faces_cameras.append(np.sum(normals[hits.faces[hit]] * directions[hit], axis=1) < 0)
    found = np.concatenate(faces_cameras)
    return float(found.mean()) if len(found) else 1.0


def orient_outward(mesh: Mesh, cameras: Sequence[Camera]) -> tuple[Mesh, float]:
    """The mesh, its faces turned about if most of them look away from the views, and its facing share then."""
    share = facing_share(mesh, cameras)
    if share < 1 - share:
        return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]), mesh.colors), 1 - share
    return mesh, share


def _rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Origin `[3]` and directions `[R, 3]` through the view, up to 64 along its longer side, spread evenly."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    factor = min(1.0, SIDE / max(camera.width, camera.height))
    columns, rows = (
        (np.arange(count) + 0.5) * size / count
        for size in (camera.width, camera.height)
        for count in [max(round(factor * size), 1)]
    )
    x, y = np.meshgrid((columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1])
    directions = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1) @ viewmat[:3, :3]
    return viewmat_center(viewmat), directions
