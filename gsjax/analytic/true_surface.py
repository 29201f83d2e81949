"""The surface of the analytic scene as a mesh and as evenly spread samples, both exactly on it."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.analytic import solids
from gsjax.metrics.geometry import sample_surface
from gsjax.scene.colors import to_bytes
from gsjax.scene.meshes import Mesh

_PROJECTIONS = 6  # one suffices where the distance is exact
_ON_SURFACE = 1e-4  # world units


def mesh(spacing: float) -> Mesh:
    """The whole surface by surface nets: one vertex in every grid cell that it crosses, moved onto it.

    Edges of the solids are cut by at most the `spacing` of the grid, world units. Colours are the albedo.
    """
    low, high = np.array(solids.BOUNDS)
    axes = [np.arange(a, b + spacing, spacing, dtype=np.float32) for a, b in zip(low, high, strict=True)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = np.asarray(_distance_all(corners.reshape(-1, 3))).reshape(corners.shape[:3]) < 0
    starts, faces = _surface_nets(inside)
    vertices = solids.in_blocks(_project_all, (low + spacing * starts).astype(np.float32))
    return Mesh(vertices, faces, to_bytes(solids.in_blocks(_albedo_all, vertices)))


def sample_points(
    surface: Mesh, num_solids: int, num_table: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points spread evenly over the solids of a mesh of the scene, and others over the upper side of the table.

    Returns:
        `[P, 3]` float32 points in random order, world, their unit normals, and `[P]` bool: on the table. P falls short
        of the numbers drawn by the few points in narrow corners that do not come to rest on the surface.
    """
    centroids = surface.vertices[surface.faces].mean(axis=1)
    on_table = solids.in_blocks(solids.label_all, centroids) == solids.GROUND_LABEL
    samples = []
    for faces, count in ((~on_table, num_solids), (on_table & (centroids[:, 2] > -1e-3), num_table)):
        part = Mesh(surface.vertices, surface.faces[faces], surface.colors)
        samples.append(sample_surface(part, count, seed))
    starts, facing = (np.concatenate(each).astype(np.float32) for each in zip(*samples, strict=True))
    points = solids.in_blocks(_project_all, starts)
    normals = solids.in_blocks(solids.normal_all, points + np.float32(solids.BEFORE) * facing)
    at_rest = np.flatnonzero(np.abs(_distance_all(points)) < _ON_SURFACE)
    order = np.random.default_rng(seed).permutation(at_rest)
    return points[order], normals[order], order >= num_solids


def _project_all(points: np.ndarray | Array) -> Array:
    """`[P, 3]` points of the surface near `[P, 3]` points: down the gradient of the distance."""
    moved = jnp.asarray(points)
    for _ in range(_PROJECTIONS):
        moved = _stepped(moved, _distance_all(moved), solids.normal_all(moved))
    return moved


def _surface_nets(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells with corners on both sides as vertices, joined: every edge between the two sides is pierced by one quad.

    `inside` is `[X, Y, Z]` bool at the grid's corners.

    Returns:
        `[V, 3]` the mean of each cell's corners outside, in grid steps, and the triangles `[F, 3]`. Outside is where
        a union's distance is exact, so one step leads from there to the surface, into inner corners too.
    """
    cells = tuple(n - 1 for n in inside.shape)
    steps = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    outside = np.stack([~inside[i : cells[0] + i, j : cells[1] + j, k : cells[2] + k] for i, j, k in steps], axis=-1)
    crossed = np.any(outside, axis=-1) & ~np.all(outside, axis=-1)
    weights = outside[crossed] / outside[crossed].sum(axis=-1, keepdims=True)
    index = np.full(cells, -1, np.int32)
    index[crossed] = np.arange(crossed.sum())
    quads = []
    for axis in range(3):
        start, end = (np.moveaxis(inside, axis, 0)[s, 1:-1, 1:-1] for s in (slice(-1), slice(1, None)))
        around = np.moveaxis(index, axis, 0)
        quad = np.stack([around[:, :-1, :-1], around[:, 1:, :-1], around[:, 1:, 1:], around[:, :-1, 1:]], axis=-1)
        # With axis 0, 1, 2 to the front the other two are in right-, left- and right-handed order.
        outwards = start if axis != 1 else end
        pierced = start != end
        quads.append(np.where(outwards[pierced][:, None], quad[pierced], quad[pierced][:, ::-1]))
    quads = np.concatenate(quads)
    return np.argwhere(crossed) + weights @ steps, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


_distance_all = jax.jit(jax.vmap(solids.scene_sdf))
_stepped = jax.jit(lambda points, distances, normals: points - distances[:, None] * normals)
_albedo_all = jax.jit(jax.vmap(solids.albedo))
