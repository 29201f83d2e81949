"""Rays against triangles on the CPU (Open3D, Embree): built once for a surface, cast many times."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gsjax.mesh import Mesh
from gsjax.meshing.libraries import load_open3d


class FirstHits(NamedTuple):
    """The first triangle on each of R rays."""

    distances: np.ndarray  # [R] float32 in lengths of the ray's direction, inf where there is none
    faces: np.ndarray  # [R] int64, meaningless where there is none
    barycentrics: np.ndarray  # [R, 3] float32 weights of the triangle's corners


Cast = Callable[[np.ndarray, np.ndarray], FirstHits]
"""From origins `[R, 3]` (or one, `[3]`) and directions `[R, 3]` of any length to what they hit first."""


def ray_caster(mesh: Mesh) -> Cast:
    """The function that casts rays at a mesh; it holds the mesh's search tree."""
    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(mesh.vertices, np.float32), mesh.faces.astype(np.uint32))

    def cast(origins: np.ndarray, directions: np.ndarray) -> FirstHits:
        rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=1)
        answer = scene.cast_rays(o3d.core.Tensor(np.ascontiguousarray(rays, np.float32)))
        uv = answer["primitive_uvs"].numpy()
        return FirstHits(
            answer["t_hit"].numpy(),
            answer["primitive_ids"].numpy().astype(np.int64),
            np.concatenate([1 - uv.sum(axis=1, keepdims=True), uv], axis=1),
        )

    return cast
