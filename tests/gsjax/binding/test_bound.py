import itertools
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import mesh_of
from scipy.spatial.transform import Rotation
from small_scenes import camera_at
from tolerances import assert_close

from gsjax import gaussians as free_gaussians
from gsjax import rendering
from gsjax.binding import bound as bound_gaussians
from gsjax.binding.bound import LAYOUTS, bind, to_gaussians, to_mesh
from gsjax.binding.editing import with_vertices
from gsjax.gaussians import SH_C0
from gsjax.scene.meshes import Mesh
from gsjax.training.initialize import DEAD_LOGIT

THICKNESS = 0.003
means, covariances, opacities = map(
    jax.jit, (bound_gaussians.means, bound_gaussians.covariances, bound_gaussians.opacities)
)
TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 3**0.5 / 2, 0]])  # equilateral, edge 1, normal +z


def crumpled(seed=0) -> Mesh:
    """Eight triangles in all directions, in front of a camera at the origin."""
    rng = np.random.default_rng(seed)
    every = np.array(list(itertools.combinations(range(9), 3)))
    return mesh_of(rng.uniform([-1, -1, 3.5], [1, 1, 4.5], (9, 3)), rng.choice(every, 8, replace=False))


def trained(mesh, per_triangle=4, seed=1):
    """Bound Gaussians of which no field is as it was at the start."""
    start = bind(mesh, per_triangle=per_triangle, thickness=THICKNESS, sh_degree=1)
    rng = np.random.default_rng(seed)
    parts = {
        name: jnp.asarray(np.asarray(value) + 0.3 * rng.normal(size=value.shape), jnp.float32)
        for name, value in start.__dict__.items()
        if name in ("log_scales", "rotations", "logit_opacities", "sh_dc", "sh_rest")
    }
    return replace(start, **parts)


# --- layouts


def test_barycentric_coordinates_sum_to_one_and_are_symmetric():
    radii = {1: 0.28868, 3: 0.18301, 4: 0.14434, 6: 0.13397}
    for per_triangle, (places, radius) in LAYOUTS.items():
        assert places.shape == (per_triangle, 3) and np.all(places > 0)
        np.testing.assert_allclose(places.sum(axis=1), 1, rtol=1e-15)
        turned = np.roll(places, 1, axis=1)
        assert {tuple(np.round(p, 12)) for p in places} == {tuple(np.round(p, 12)) for p in turned}
        assert radius == pytest.approx(radii[per_triangle], abs=5e-6)


def test_one_equilateral_triangle_has_its_closed_form():
    angle, s1, s2 = 0.4, 0.2, 0.05
    bound = replace(
        bind(mesh_of(TRIANGLE, [[0, 1, 2]]), per_triangle=1, thickness=THICKNESS),
        log_scales=jnp.log(jnp.asarray([[s1, s2]], jnp.float32)),
        rotations=jnp.asarray([[3 * np.cos(angle), 3 * np.sin(angle)]], jnp.float32),  # of any length
    )
    assert_close(means(bound)[0], TRIANGLE.mean(axis=0))
    # The first axis starts along v0 - v1 = -x; with the normal +z, it turns from there to z x (-x) = -y.
    r1, r2 = np.array([-np.cos(angle), -np.sin(angle), 0]), np.array([np.sin(angle), -np.cos(angle), 0])
    expected = s1**2 * np.outer(r1, r1) + s2**2 * np.outer(r2, r2) + THICKNESS**2 * np.diag([0, 0, 1])
    assert_close(covariances(bound)[0], expected)
    start = bind(mesh_of(2 * TRIANGLE, [[0, 1, 2]]), per_triangle=1, thickness=THICKNESS, opacity=0.7)
    assert_close(jnp.exp(start.log_scales), np.full((1, 2), 2 / (2 * 3**0.5)))
    assert_close(opacities(start), np.array([0.7]))


def test_colors_are_the_barycentric_mean_and_come_back_to_the_vertices():
    mesh = mesh_of(TRIANGLE, [[0, 1, 2]], [[255, 0, 0], [0, 255, 0], [0, 0, 255]])
    bound = bind(mesh, per_triangle=3, thickness=THICKNESS)
    assert_close(bound.sh_dc[:, 0] * SH_C0 + 0.5, LAYOUTS[3][0])
    # Weights 1/2, 1/4, 1/4 of (1/2, 1/4, 1/4), (1/4, 1/2, 1/4), (1/4, 1/4, 1/2).
    share = np.rint(255 * np.array([0.375, 0.3125, 0.3125]))
    np.testing.assert_array_equal(to_mesh(bound).colors, [np.roll(share, k) for k in range(3)])


# --- moving


def test_a_moved_mesh_takes_its_gaussians_along():
    mesh, scale = crumpled(), 2.5
    turn, shift = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([3.0, -1, 0.5])
    before = trained(mesh)
    after = replace(with_vertices(before, scale * mesh.vertices @ turn.T + shift), thickness=scale * THICKNESS)
    assert_close(
        means(after), scale * np.asarray(means(before), np.float64) @ turn.T + shift, atol=1e-5, rtol=1e-5,
        why="positions of size 10 in float32",
    )  # fmt: skip
    expected = scale**2 * turn @ np.asarray(covariances(before), np.float64) @ turn.T
    assert_close(covariances(after), expected, rtol=1e-4, atol=1e-5, why="edges are differences of float32 positions")


def test_a_stretched_triangle_stretches_its_gaussians_as_its_plane():
    before = trained(mesh_of(TRIANGLE, [[0, 1, 2]]))
    sheared = np.array([[1.7, 0.6, 0], [0.0, 0.8, 0], [0, 0, 1]])
    after = with_vertices(before, TRIANGLE @ sheared.T)
    expected = sheared @ np.asarray(covariances(before), np.float64) @ sheared.T
    assert_close(covariances(after), expected)
    with pytest.raises(ValueError, match=r"\(2, 3\) for a mesh of \(3, 3\)"):
        with_vertices(before, TRIANGLE[:2])


def test_a_triangle_that_collapses_in_an_edit_keeps_the_shape_of_its_gaussians():
    before = trained(mesh_of(TRIANGLE, [[0, 1, 2]]))
    after = with_vertices(before, TRIANGLE * [1, 0, 1])
    assert_close(jnp.sort(after.log_scales), jnp.sort(before.log_scales))


# --- gradients


def objective(bound):
    """A number that every mean and covariance moves."""
    weights = np.random.default_rng(3).normal(size=(bound.num_gaussians, 12))
    dtype = bound.vertices.dtype
    parts = jnp.concatenate([means(bound), 30 * covariances(bound).reshape(-1, 9)], axis=-1)
    return jnp.sum(jnp.asarray(weights, dtype) * parts * opacities(bound)[:, None])


@partial(jax.jit, static_argnames="of")
def gradient(bound, of=objective):
    return jax.grad(lambda parameters: of(replace(parameters, faces=bound.faces)))(replace(bound, faces=None))


def test_the_gradient_is_the_finite_difference(x64):
    single = trained(crumpled())
    bound = jax.tree.map(lambda leaf: leaf.astype(jnp.float64) if leaf.dtype == jnp.float32 else leaf, single)
    gradients = gradient(bound)
    rng = np.random.default_rng(0)
    value = jax.jit(objective)
    for name in ("vertices", "log_scales", "rotations", "logit_opacities"):
        here = getattr(bound, name)
        direction = rng.normal(size=here.shape)
        ahead, behind = (value(replace(bound, **{name: here + step * direction})) for step in (1e-6, -1e-6))
        slope = np.sum(np.asarray(getattr(gradients, name)) * direction)
        assert abs(slope) > 1e-3
        np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, rtol=1e-6)


HOPELESS = {
    "all corners in one place": [[5.0, 5, 5]] * 3,
    "two corners in one place": [[5.0, 5, 5], [5, 5, 5], [6, 5, 5]],
    "corners on a line": [[5.0, 5, 5], [6, 5, 5], [7, 5, 5]],
    "nearly on a line": [[5.0, 5, 5], [6, 5, 5], [7, 5, 5 + 1e-7]],
    "tiny": [[0.0, 0, 0], [1e-30, 0, 0], [0, 1e-30, 0]],
}


BEHIND = [[0.0, 0, -5], [1, 0, -5], [0, 1, -5]]  # of the camera: a sound triangle that is not seen


def with_ninth(corners):
    mesh = crumpled()
    return trained(mesh_of(np.r_[mesh.vertices, corners], np.r_[mesh.faces, [[9, 10, 11]]]))


@pytest.mark.parametrize("corners", HOPELESS.values(), ids=HOPELESS)
def test_a_collapsed_triangle_is_finite_is_not_drawn_and_leaves_the_others_alone(corners):
    unseen, collapsed = with_ninth(BEHIND), with_ninth(corners)
    values = means(collapsed), covariances(collapsed), opacities(collapsed), to_gaussians(collapsed)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((values, gradient(collapsed))))
    if corners != HOPELESS["tiny"]:
        assert np.all(np.asarray(opacities(collapsed))[-4:] == 0)
        assert np.all(to_gaussians(collapsed).logit_opacities[-4:] == DEAD_LOGIT)
    assert_close(render_bound(collapsed).colors, render_bound(unseen).colors)
    expected, gradients = gradient(unseen, brightness), gradient(collapsed, brightness)
    for name in ("vertices", "log_scales", "rotations", "logit_opacities", "sh_dc"):
        assert float(jnp.abs(getattr(expected, name)).max()) > 0
    assert_close(gradients, expected, kind="gradient")  # both zero for the ninth


CAMERA = camera_at(size=(24, 24))


@jax.jit
def render_bound(bound):
    return rendering.render(bound, CAMERA, capacity=4096, background=jnp.zeros(3, jnp.float32))


def brightness(bound):
    weights = np.random.default_rng(5).uniform(size=(24, 24, 3))
    return jnp.sum(render_bound(bound).colors * jnp.asarray(weights, jnp.float32))


def test_a_rotation_of_zero_is_none_and_has_no_gradient():
    bound = trained(crumpled())
    zero = replace(bound, rotations=bound.rotations.at[0].set(0.0))
    plain = replace(bound, rotations=bound.rotations.at[0].set(jnp.asarray([1.0, 0.0], jnp.float32)))
    assert_close(covariances(zero), covariances(plain))
    turned = gradient(zero).rotations
    assert not np.any(turned[0]) and bool(jnp.isfinite(turned).all()) and float(jnp.abs(turned[1:]).max()) > 0


# --- drawing and writing


def test_the_same_picture_is_drawn_from_the_mesh_and_from_the_file():
    bound = with_ninth(BEHIND)
    gaussians = jax.tree.map(jnp.asarray, to_gaussians(bound))
    assert int(jax.jit(rendering.needed_capacity)(bound, CAMERA)) <= 4096
    assert float(render_bound(bound).alphas.max()) > 0.5
    assert_close(render_bound(bound).colors, render_bound(gaussians).colors)
    rebuilt = free_gaussians.rotation_matrices(gaussians.quats) * free_gaussians.scales(gaussians)[:, None]
    assert_close(covariances(bound), np.einsum("gik,gjk->gij", rebuilt, rebuilt))
