"""The surface of the analytic scene as a mesh and as evenly spread samples, both exactly on it."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax import analytic
from gsjax.geometry import sample_surface
from gsjax.mesh import Mesh

_PROJECTIONS = 6  # each brings a point nearer to the surface by the error of the distance function, a few percent


def mesh(spacing: float) -> Mesh:
    """The whole surface by surface nets: one vertex in every grid cell that it crosses, moved onto it.

    Args:
        spacing: Edge of a grid cell, world units. Edges of the solids are cut by at most that much.

    Returns:
        The mesh with the albedo as colours.
    """
    low, high = np.array(analytic.BOUNDS)
    axes = [np.arange(a, b + spacing, spacing, dtype=np.float32) for a, b in zip(low, high, strict=True)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = np.asarray(_distance_all(corners.reshape(-1, 3))).reshape(corners.shape[:3]) < 0
    crossed, faces = _surface_nets(inside)
    vertices = _project_all(corners[tuple(crossed.T)] + np.float32(spacing / 2))
    return Mesh(np.asarray(vertices), faces, np.rint(255 * np.asarray(_albedo_all(vertices))).astype(np.uint8))


def samples(surface: Mesh, is_table: bool, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over the solids, or over the upper side of the table.

    Args:
        surface: A mesh of the scene (`mesh`), which says where.
        is_table: The table's points instead of the solids'.
        count: How many.
        seed: Of the draw.

    Returns:
        `[count, 3]` float32 points on the surface, world, and their unit normals.
    """
    centroids = surface.vertices[surface.faces].mean(axis=1)
    on_table = np.asarray(_label_all(centroids)) == analytic.GROUND_LABEL
    wanted = on_table & (centroids[:, 2] > -1e-3) if is_table else ~on_table
    drawn, _ = sample_surface(Mesh(surface.vertices, surface.faces[wanted], surface.colors), count, seed)
    points = _project_all(drawn.astype(np.float32))
    return np.asarray(points), np.asarray(_normal_all(points))


def project(point: Array) -> Array:
    """`[3]` point of the surface near a `[3]` point: down the gradient of the distance."""
    return jax.lax.fori_loop(
        0, _PROJECTIONS, lambda _, p: p - analytic.scene_sdf(p) * analytic.normal(p), jnp.asarray(point)
    )


def _surface_nets(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells with corners on both sides, `[V, 3]` their lowest corner; and the triangles `[F, 3]` that join them.

    Every grid edge whose ends lie on two sides is pierced by one quad between the four cells around it.
    """
    cells = tuple(n - 1 for n in inside.shape)
    corners = [
        inside[i : cells[0] + i, j : cells[1] + j, k : cells[2] + k] for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    crossed = np.any(corners, axis=0) & ~np.all(corners, axis=0)
    index = np.full(cells, -1, np.int32)
    index[crossed] = np.arange(crossed.sum())
    quads = []
    for axis in range(3):
        start, end = (np.moveaxis(inside, axis, 0)[s, 1:-1, 1:-1] for s in (slice(-1), slice(1, None)))
        around = np.moveaxis(index, axis, 0)
        quad = np.stack([around[:, :-1, :-1], around[:, 1:, :-1], around[:, 1:, 1:], around[:, :-1, 1:]], axis=-1)
        # With axis 0, 1, 2 to the front the other two stand in right-, left- and right-handed order.
        outwards = start if axis != 1 else end
        pierced = start != end
        quads.append(np.where(outwards[pierced][:, None], quad[pierced], quad[pierced][:, ::-1]))
    quads = np.concatenate(quads)
    return np.argwhere(crossed), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


_distance_all = jax.jit(jax.vmap(analytic.scene_sdf))
_project_all = jax.jit(jax.vmap(project))
_normal_all = jax.jit(jax.vmap(analytic.normal))
_label_all = jax.jit(jax.vmap(analytic.label))
_albedo_all = jax.jit(jax.vmap(analytic.albedo))
