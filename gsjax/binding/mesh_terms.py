"""Terms that keep a mesh smooth while its vertices are trained, and the neighbourhoods that they read."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.numerics import safe_divide, safe_normalize


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MeshGraph:
    """Who is next to whom in a mesh."""

    face_pairs: Array  # [P, 2] int32 triangles with a common edge that they run along in opposite directions
    edges: Array  # [E, 2] int32 vertex ids, smaller first, each edge once


def mesh_graph(faces: np.ndarray) -> MeshGraph:
    """The neighbourhoods of `[F, 3]` faces.

    At an edge of more than two triangles, one pair is taken. Triangles with a corner twice have no neighbours.
    """
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    owners = np.repeat(np.arange(len(faces)), 3)
    distinct = np.repeat(np.all(np.diff(np.sort(faces, axis=1), axis=1) > 0, axis=1), 3)
    directed, owners = directed[distinct], owners[distinct]
    base = int(faces.max(initial=0)) + 1
    keys = directed.min(axis=1) * base + directed.max(axis=1)
    is_forward = directed[:, 0] < directed[:, 1]
    _, forward, backward = np.intersect1d(keys[is_forward], keys[~is_forward], return_indices=True)
    pairs = np.stack([owners[is_forward][forward], owners[~is_forward][backward]], axis=-1)
    every = np.unique(keys)
    return MeshGraph(
        jnp.asarray(pairs, jnp.int32), jnp.asarray(np.stack([every // base, every % base], axis=-1), jnp.int32)
    )


def normal_consistency(vertices: Array, faces: Array, graph: MeshGraph) -> Array:
    """Mean of 1 - cos between the normals of neighbouring triangles (0 on a plane, 2 on a fold); 0 without neighbours.

    A pair with a collapsed triangle says nothing and has no gradient.
    """
    a, b, c = jnp.moveaxis(vertices[faces], 1, 0)
    # Relative to the edges: the guard in `safe_normalize` is absolute, and triangles are of any size.
    normals = safe_normalize(jnp.cross(safe_normalize(b - a, 1e-20), safe_normalize(c - a, 1e-20)), 1e-10)
    first, second = jnp.moveaxis(normals[graph.face_pairs], 1, 0)
    lengths = jax.lax.stop_gradient(jnp.sum(first * first, -1) * jnp.sum(second * second, -1))
    return jnp.sum(lengths - jnp.sum(first * second, axis=-1)) / max(graph.face_pairs.shape[0], 1)


def laplacian(vertices: Array, graph: MeshGraph) -> Array:
    """Mean squared distance of a vertex from the mean of its neighbours, in mean squared edges (uniform weights)."""
    ends = jnp.concatenate([graph.edges, graph.edges[:, ::-1]])
    count = vertices.shape[0]
    total = jax.ops.segment_sum(vertices[ends[:, 1]], ends[:, 0], count)
    degree = jax.ops.segment_sum(jnp.ones(len(ends), vertices.dtype), ends[:, 0], count)[:, None]
    offsets = jnp.where(degree > 0, total / jnp.maximum(degree, 1) - vertices, 0)
    steps = jnp.diff(vertices[graph.edges], axis=1)[:, 0]
    size = jax.lax.stop_gradient(jnp.sum(steps * steps)) / max(graph.edges.shape[0], 1)
    return safe_divide(jnp.mean(jnp.sum(offsets * offsets, axis=-1)), size, size > 0)
