"""Bound and free Gaussians as one scene: drawn, written, read again, edited."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import mesh_of
from small_scenes import camera_at, cloud
from tolerances import assert_close

from gsjax import rendering
from gsjax.binding.bound import bind, covariances, means, to_gaussians, to_mesh
from gsjax.binding.editing import rebound, with_vertices
from gsjax.binding.mixed_gaussians import all_gaussians, with_free
from gsjax.errors import InputError
from gsjax.gaussians import take

CAMERA = camera_at(size=(24, 24))
WEIGHTS = np.random.default_rng(5).uniform(size=(24, 24, 3)).astype(np.float32)


def tetrahedron():
    corners = np.array([[0, 0, -1.0], [1, 0, 0.6], [-0.6, 0.9, 0.5], [-0.5, -0.9, 0.6]]) + [0, 0, 4.0]
    return mesh_of(corners, [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])


def bound_at():
    return bind(tetrahedron(), per_triangle=3, thickness=0.004, sh_degree=1, opacity=0.8)


def on_a_triangle():
    """Three free Gaussians, the first with mean and axes of a bound one: drawn at the very same depth."""
    free = replace(cloud(3, seed=3), pixel_filter="mip")
    twin = take(to_gaussians(bound_at()), slice(1))
    twin = replace(twin, log_scales=twin.log_scales + np.float32(0.2))
    return jax.tree.map(lambda one, all_: jnp.asarray(all_).at[:1].set(one), twin, free)


FREE = {
    "some": cloud(3, seed=1),
    "exactly on a triangle": on_a_triangle(),
    "turned by nothing": replace(cloud(3, seed=2), quats=jnp.zeros((3, 4), jnp.float32)),
}


@jax.jit
def draw(gaussians, faces=None):
    """The picture, and the gradient of its weighted sum to everything but the faces of bound Gaussians."""

    def brightness(parameters):
        whole = parameters
        if faces is not None:
            whole = replace(parameters, bound=replace(parameters.bound, faces=faces))
        colors = rendering.render(whole, CAMERA, capacity=4096, background=jnp.zeros(3, jnp.float32)).colors
        return jnp.sum(colors * WEIGHTS), colors

    gradient, colors = jax.grad(brightness, has_aux=True)(gaussians)
    return colors, gradient


@pytest.mark.parametrize("free", FREE.values(), ids=FREE)
def test_a_scene_looks_and_pulls_like_the_same_gaussians_without_a_mesh(free):
    mixed = with_free(bound_at(), free)
    plain = jax.tree.map(jnp.asarray, all_gaussians(mixed))
    assert (mixed.num_gaussians, mixed.num_free, plain.num_gaussians) == (15, 3, 15)
    colors, pulls = draw(replace(mixed, bound=replace(mixed.bound, faces=None)), mixed.bound.faces)
    expected_colors, expected = draw(plain)
    assert_close(colors, expected_colors)
    for name in ("means", "log_scales", "quats", "logit_opacities", "sh_dc", "sh_rest"):
        assert_close(getattr(pulls.free, name), getattr(expected, name)[12:], kind="gradient")
    assert np.all(np.abs(pulls.free.means).max(axis=1) > 1e-3), "each of the free ones is seen"
    for name in ("logit_opacities", "sh_dc", "sh_rest"):
        assert_close(getattr(pulls.bound, name), getattr(expected, name)[:12], kind="gradient")


def test_every_gaussian_may_have_an_sh_degree_of_its_own():
    scene, degrees = rendering.drawable(FREE["some"]), jnp.array([0, 1, 0], jnp.int32)
    colors = jax.jit(rendering.colors)
    flat, full = (colors(scene, CAMERA, jnp.int32(degree)) for degree in (0, 1))
    assert float(jnp.abs(flat - full).min(axis=1).max()) > 1e-3
    np.testing.assert_array_equal(colors(scene, CAMERA, degrees), jnp.where(degrees[:, None] > 0, full, flat))


def test_mesh_and_gaussians_as_they_are_written_are_the_scene_again_and_can_be_edited():
    before = with_free(bound_at(), on_a_triangle())
    mesh = to_mesh(before.bound)
    after = rebound(mesh, all_gaussians(before))
    assert (after.bound.per_triangle, after.num_free) == (3, 3)
    jax.tree.map(np.testing.assert_array_equal, after.free, before.free)
    assert after.bound.thickness == pytest.approx(0.004) and after.bound.pixel_filter == "mip"
    assert_close([of(after.bound) for of in (means, covariances)], [of(before.bound) for of in (means, covariances)])
    for name in ("logit_opacities", "sh_dc", "sh_rest", "faces"):
        np.testing.assert_array_equal(getattr(after.bound, name), getattr(before.bound, name))
    moved = replace(after, bound=with_vertices(after.bound, mesh.vertices + [1.0, 0, 0]))
    gaussians = all_gaussians(moved)
    bound_rows = after.bound.num_gaussians
    assert_close(gaussians.means[:bound_rows], np.asarray(means(before.bound)) + [1.0, 0, 0])
    np.testing.assert_array_equal(gaussians.means[bound_rows:], before.free.means)
    with pytest.raises(InputError, match="Gaussians are not 1, 3, 4 or 6 to each of 4 triangles"):
        rebound(mesh, take(all_gaussians(before), slice(1, None)))
    with pytest.raises(InputError, match="one is .* units from its place there"):
        rebound(replace(mesh, faces=mesh.faces[::-1]), to_gaussians(before.bound))
