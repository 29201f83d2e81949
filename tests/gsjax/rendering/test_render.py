from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, plane
from tolerances import assert_close

import rasterizer
from gsjax import rendering
from gsjax.gaussians import opacities, scales
from rasterizer import _reference

CAMERA = camera_at((0.4, -0.3, 0.2), (0.1, 0.1, 4.0))
CAPACITY = 2048
BACKGROUND = jnp.asarray([0.2, 0.7, 0.4], jnp.float32)
ALIVE = 40
SCENE = cloud(ALIVE, capacity=48, sh_degree=2)


@partial(jax.jit, static_argnames=("depth_mode", "with_axes"))
def render_view(gaussians, active_degree=2, camera=CAMERA, background=BACKGROUND, **options):
    how = {"capacity": CAPACITY, "background": background, "active_degree": active_degree, "with_depth": True}
    return rendering.render(gaussians, camera, **how, **options)


def dense_reference(gaussians, sh_degree=2, **options):
    shape = gaussians.means, gaussians.quats, scales(gaussians), opacities(gaussians)
    cameras = CAMERA.viewmat[None], CAMERA.K[None], CAMERA.width, CAMERA.height
    how = {"sh_degree": sh_degree, "render_mode": "RGB+D", "backend": "reference", "depth_mode": "plane", **options}
    colors = jnp.concatenate([gaussians.sh_dc, gaussians.sh_rest], 1)
    image, alphas, _ = rasterizer.rasterization(*shape, colors, *cameras, **how)
    return np.asarray(image[0], np.float64), np.asarray(alphas[0, ..., 0], np.float64)


@pytest.mark.parametrize(("depth_mode", "degree"), [("plane", 2), ("center", 1)])
def test_a_view_equals_the_dense_reference(depth_mode, degree):
    """A degree below that of the Gaussians truncates their harmonics."""
    image, alphas = dense_reference(SCENE, sh_degree=degree, depth_mode=depth_mode)
    view = render_view(SCENE, degree, depth_mode=depth_mode)
    assert not bool(view.splats.pairs.overflowed)
    assert_close(view.alphas, alphas)
    assert_close(view.colors, image[..., :3] + (1 - alphas[..., None]) * np.asarray(BACKGROUND))
    covered = alphas > rendering.MIN_COVERAGE
    assert 0.1 < covered.mean() < 0.9
    assert_close(view.depth, np.where(covered, image[..., 3] / np.where(covered, alphas, 1), 0))
    assert_close(view.raw_depth, image[..., 3])


def in_front_of_reference(gaussians):
    shape = gaussians.means, gaussians.quats, scales(gaussians), opacities(gaussians)
    size = CAMERA.width, CAMERA.height
    splats = rasterizer.project(*shape, CAMERA.viewmat[None], CAMERA.K[None], *size, depth_mode="plane")
    features = jnp.stack([jnp.ones_like(splats.depths), splats.depths], -1)  # the last one is made a plane
    front = rendering.IN_FRONT["front"]._replace(channels=2)
    image, _, _ = _reference.composite(splats, shape[3][None], features, *size, rasterizer.GSPLAT, front)
    is_covered = image[0, ..., 0] > rendering.MIN_COVERAGE
    return jnp.where(is_covered, image[0, ..., 1], 0) / jnp.where(is_covered, image[0, ..., 0], 1)


def test_depth_in_front_is_the_references():
    view = render_view(SCENE, depth_mode="front")
    assert_close(view.depth, jax.jit(in_front_of_reference)(SCENE))
    assert float(jnp.abs(view.depth - render_view(SCENE).depth).max()) > 0.01


def test_the_mip_filter_is_the_antialiased_reference_and_absent_where_it_is_not_asked_for():
    filtered = replace(SCENE, pixel_filter="mip")
    image, alphas = dense_reference(SCENE, eps2d=0.1, rasterize_mode="antialiased")
    view = render_view(filtered)
    assert_close(view.alphas, alphas)
    assert_close(view.colors, image[..., :3] + (1 - alphas[..., None]) * np.asarray(BACKGROUND))
    assert float(jnp.abs(view.alphas - render_view(SCENE).alphas).max()) > 0.01
    assert int(jax.jit(rendering.needed_capacity)(filtered, CAMERA)) == int(view.splats.pairs.needed)
    assert render_view(SCENE).splats.projection.compensations is None


def test_a_new_degree_pose_or_background_does_not_recompile(monkeypatch):
    render_view(SCENE, 0, CAMERA, BACKGROUND)
    monkeypatch.setattr(rendering, "render", None)  # called where a program is traced
    render_view(SCENE, 1, CAMERA, BACKGROUND)
    render_view(SCENE, 3, camera_at((0.0, 0.0, 0.5), focal=40.0), 1 - BACKGROUND)
    with pytest.raises(TypeError, match="not callable"):
        render_view(SCENE, 0, camera_at(size=(33, 24)), BACKGROUND)


def test_dead_rows_are_invisible_and_have_no_gradient():
    other = cloud(48, sh_degree=2, seed=5)  # all alive, elsewhere
    dead = np.arange(48) >= ALIVE
    parts = {
        name: jnp.where(dead.reshape(-1, *[1] * (rows.ndim - 1)), getattr(other, name), rows)
        for name, rows in vars(SCENE).items()
        if name not in ("logit_opacities", "pixel_filter")
    }
    view, changed = render_view(SCENE), render_view(replace(SCENE, **parts))
    assert_close((view.colors, view.alphas, view.depth), (changed.colors, changed.alphas, changed.depth))
    gradient = jax.jit(jax.grad(lambda g: jnp.sum(render_view(g).colors ** 2)))(SCENE)
    for leaf in jax.tree.leaves(gradient):
        assert bool(jnp.isfinite(leaf).all())
        assert float(jnp.abs(leaf[:ALIVE]).max()) > 0
        np.testing.assert_array_equal(leaf[ALIVE:], np.zeros_like(leaf[ALIVE:]))


def test_depth_is_zero_where_little_is_covered():
    faint = plane((0.0, 0.0, -1.0))
    faint = replace(faint, logit_opacities=jnp.full_like(faint.logit_opacities, -3.5))
    view = render_view(faint, 0, camera_at())
    assert 0.01 < float(view.alphas.min()) <= float(view.alphas.max()) < rendering.MIN_COVERAGE
    assert not np.any(view.depth)


def test_axes_and_further_channels_are_composited_beside_colours_and_depth():
    values = 0.1 * jnp.arange(96, dtype=jnp.float32).reshape(48, 2)
    plain, view = render_view(SCENE), render_view(SCENE, extra=values, with_axes=True)
    assert plain.axes is None and plain.extra is None

    @jax.jit
    def apart(splats):
        hidden = ~splats.projection.visible[0][:, None]
        axes = rendering.facing_axes(rendering.drawable(SCENE), CAMERA, splats.projection)
        # Nothing enters from a row that is not visible.
        return [rendering.features(splats, jnp.where(hidden, jnp.nan, each))[0] for each in (axes, values)]

    assert_close([view.axes, view.extra], apart(plain.splats))
    assert_close((view.colors, view.alphas, view.depth), (plain.colors, plain.alphas, plain.depth))


def test_the_gradient_of_a_probe_is_what_a_gaussian_adds_to_the_pixels():
    in_pixels = jnp.zeros((CAMERA.height, CAMERA.width, 2), jnp.float32).at[5:20, 3:30].set(1)

    @jax.jit
    def probed(zeros):
        view = render_view(SCENE, depth_mode="front", probes=zeros)
        return jnp.sum(view.probes * in_pixels), view

    gradient, view = jax.grad(probed, has_aux=True)(jnp.zeros((48, 2), jnp.float32))
    weights = render_view(SCENE, extra=jnp.eye(48, dtype=jnp.float32)).extra
    added = jnp.sum(weights[5:20, 3:30], (0, 1))
    assert float(added.max()) > 1 and not np.any(view.probes)
    assert_close(gradient, jnp.stack([added, added], -1), kind="gradient")


def test_the_capacity_that_a_view_needs_is_counted_before_it_is_rendered():
    needed = int(jax.jit(rendering.needed_capacity)(SCENE, CAMERA))
    pairs = render_view(SCENE).splats.pairs
    assert int(pairs.needed) == needed < CAPACITY and not bool(pairs.overflowed)
    assert bool(jax.jit(rendering.splat, static_argnums=2)(SCENE, CAMERA, needed - 1).pairs.overflowed)
