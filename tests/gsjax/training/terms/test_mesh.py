from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import square
from tolerances import assert_close

from gsjax.rendering import BoundMesh
from gsjax.training.terms.mesh import neighboring_faces, normal_consistency


@jax.jit
@jax.value_and_grad
def with_slope(*mesh):
    return normal_consistency(None, SimpleNamespace(mesh=BoundMesh(*mesh)), None)


def consistency(vertices, faces):
    return with_slope(np.float32(vertices), faces, neighboring_faces(faces))[0]


def by_numpy(vertices, faces):
    """Every pair of triangles with two common corners, the slow way."""
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosines = [
        normals[i] @ normals[j] for i in range(len(faces)) for j in range(i) if len(set(faces[i]) & set(faces[j])) == 2
    ]
    return np.mean(1 - np.array(cosines))


def test_normal_consistency_is_the_mean_over_neighbours_and_zero_on_a_plane():
    bumpy = square(3, height=0.4 * np.random.default_rng(0).normal(size=(4, 4)))
    vertices, faces = bumpy.vertices, bumpy.faces
    assert_close(consistency(vertices, faces), by_numpy(vertices, faces))
    assert by_numpy(vertices, faces) > 0.05
    flat = vertices * [1, 1, 0] @ np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    assert float(jnp.abs(consistency(flat.astype(np.float32), faces))) < 1e-6


@pytest.mark.parametrize("place", [[0, 0, 0], [0.5, 0, 0]])
def test_a_collapsed_triangle_says_nothing_and_leaves_gradients_finite(place):
    # Beside a square of two triangles, a third hangs on its side (0, 1) with its tip on that side's line.
    square = np.array([[0, 0, 0], [1, 0, 0.1], [1, 1, 0], [0, 1, 0.2]], np.float32)
    vertices = np.r_[square, [place]].astype(np.float32)
    vertices[4, 2] = 0.1 * place[0]
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 0, 4]], np.int32)
    assert len(neighboring_faces(faces)) == 2
    value, slope = with_slope(vertices, faces, neighboring_faces(faces))
    alone, expected = with_slope(square, faces[:2], neighboring_faces(faces[:2]))
    assert_close(value, 0.5 * alone)  # the mean is over one pair more
    assert_close(slope[:4], 0.5 * expected, kind="gradient")
    assert not np.any(slope[4])


def test_repeated_corners_folded_and_crowded_edges_are_counted_once():
    faces = np.array([[0, 1, 2], [0, 0, 1], [1, 0, 3], [1, 0, 4], [0, 1, 5]], np.int32)
    pairs = neighboring_faces(faces)
    assert [sorted(pair) for pair in np.asarray(pairs).tolist()] == [[0, 2]]
    same_way = neighboring_faces(np.array([[0, 1, 2], [0, 1, 3]], np.int32))  # inconsistent: normals cannot be compared
    assert same_way.shape == (0, 2)
    assert float(consistency(np.eye(3), np.array([[0, 1, 2]], np.int32))) == 0
