"""The term that keeps a mesh smooth while its vertices are trained, and the pairs of triangles that it compares."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.rendering import View
from gsjax.scene.batches import Batch
from rasterizer.covariances import Vector, components, cross, dot, matrix_rows
from rasterizer.tracing import walled


def neighboring_faces(faces: np.ndarray) -> Array:
    """`[P, 2]` int32 pairs of `[F, 3]` faces with a common edge that they run along in opposite directions.

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
    return jnp.asarray(pairs, jnp.int32)


def normal_consistency(gaussians: Any, view: View, batch: Batch) -> Array:
    """Mean of 1 - cos between the normals of neighbouring triangles (0 on a plane, 2 on a fold); 0 without neighbours.

    A pair with a collapsed triangle says nothing and has no gradient.
    """
    del gaussians, batch
    assert view.mesh is not None, "only a refinement has the term"
    vertices, faces, face_pairs = view.mesh
    is_there = jnp.any(jnp.isfinite(vertices))
    normals = jnp.stack(walled(jax.checkpoint(_normals), is_there, *matrix_rows(vertices[faces])), axis=-1)
    first, second = (components(normals[face_pairs[:, i]]) for i in range(2))
    lengths = jax.lax.stop_gradient(dot(first, first) * dot(second, second))
    return jnp.sum(lengths - dot(first, second)) / max(face_pairs.shape[0], 1)


def _normals(a: Vector, b: Vector, c: Vector) -> Vector:
    """Unit normals of triangles; zero of collapsed ones."""
    # Relative to the edges: the guard in `_unit` is absolute, and triangles are of any size.
    sides = [_unit([q - p for p, q in zip(a, end, strict=True)], 1e-20) for end in (b, c)]
    return _unit(cross(*sides), 1e-10)


def _unit(v: Vector, eps: float) -> Vector:
    """`gsjax.numerics.safe_normalize` of a vector in components, which XLA's CPU loops take several times as fast."""
    squared = dot(v, v)
    usable = squared > eps
    inverse = jnp.where(usable, jax.lax.rsqrt(jnp.where(usable, squared, 1)), 0)
    return [jnp.where(usable, part, 0) * inverse for part in v]
