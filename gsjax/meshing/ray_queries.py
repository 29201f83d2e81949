"""Queries of a surface on the CPU (Open3D, Embree): the first triangle on a ray, and the nearest point."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gsjax.io.packages import require
from gsjax.scene.meshes import Mesh, face_normals


class FirstHits(NamedTuple):
    """The first triangle on each of R rays."""

    distances: np.ndarray  # [R] float32 in lengths of the ray's direction, inf where there is none
    faces: np.ndarray  # [R] int64, 0 where there is none
    barycentrics: np.ndarray  # [R, 3] float32 weights of the triangle's corners


Cast = Callable[[np.ndarray, np.ndarray], FirstHits]
"""From origins `[R, 3]` (or one, `[3]`) and directions `[R, 3]` of any length to what they hit first."""
MOST_BACK_FACES = 16  # That a ray passes on its way.
STEP = 1e-4  # Of the distance, by which a ray goes on behind a back face.


def ray_caster(mesh: Mesh) -> Cast:
    """The function that casts rays at a mesh; it holds the mesh's search tree."""
    o3d = require("open3d")
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(mesh.vertices, np.float32), mesh.faces.astype(np.uint32))

    def cast(origins: np.ndarray, directions: np.ndarray) -> FirstHits:
        rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=1)
        answer = scene.cast_rays(o3d.core.Tensor(np.ascontiguousarray(rays, np.float32)))
        uv = answer["primitive_uvs"].numpy()
        return FirstHits(
            answer["t_hit"].numpy(),
            np.where(np.isfinite(answer["t_hit"].numpy()), answer["primitive_ids"].numpy(), 0).astype(np.int64),
            np.concatenate([1 - uv.sum(axis=1, keepdims=True), uv], axis=1),
        )

    return cast


def front_faces_only(mesh: Mesh, cast: Cast) -> Cast:
    """The same for faces that are met from outside: rays pass through back faces, as viewers of glTF show a mesh."""
    normals = face_normals(mesh)

    def cast_on(origins: np.ndarray, directions: np.ndarray) -> FirstHits:
        origins = np.broadcast_to(origins, directions.shape)
        hits = cast(origins, directions)
        going, passed = np.arange(len(directions)), np.zeros(len(directions))
        for _ in range(MOST_BACK_FACES):
            from_inside = np.sum(normals[hits.faces[going]] * directions[going], axis=1) > 0
            going = going[np.isfinite(hits.distances[going]) & from_inside]
            if not len(going):
                return hits
            passed[going] = hits.distances[going] * (1 + STEP)
            onward = cast(origins[going] + passed[going, None] * directions[going], directions[going])
            for whole, part in zip(hits, onward, strict=True):
                whole[going] = part
            hits.distances[going] += passed[going]
        hits.distances[going] = np.inf
        return hits

    return cast_on


def closest_on_mesh(mesh: Mesh, queries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The point of a mesh that is nearest to each query `[P, 3]`, and the triangle that it is on.

    Open3D's search over Embree's tree, in float32 about the middle of the mesh: exact to 1e-7 of its size, wherever in
    the world it is. The mesh has one triangle at least.

    Returns:
        `[P, 3]` float64 points of the surface and `[P]` int64 indices of triangles. On an edge or a vertex any of the
        triangles around it may be named.

    Raises:
        InputError: Open3D cannot be loaded.
    """
    open3d = require("open3d")
    middle = 0.5 * (mesh.vertices.min(axis=0).astype(np.float64) + mesh.vertices.max(axis=0))

    def tensor(values: np.ndarray, dtype: type):
        return open3d.core.Tensor(np.ascontiguousarray(values, dtype))

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(mesh.vertices - middle, np.float32), tensor(mesh.faces, np.uint32))
    closest = scene.compute_closest_points(tensor(queries - middle, np.float32))
    return closest["points"].numpy() + middle, closest["primitive_ids"].numpy().astype(np.int64)
