"""Splats brought together for another device must draw the same picture as where they came from."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from small_scenes import camera_at, cloud
from tolerances import assert_close

import rasterizer
from gsjax import rendering

COUNT, ROOM, PAIRS = 40, 64, 4096
CAMERA = camera_at()
AWAY = camera_at((0.0, 0.0, 9.0), (0.0, 0.0, 12.0))  # sees none of them


@partial(jax.jit, static_argnames="depth_mode")
def projected(gaussians, camera, depth_mode):
    scene = rendering.drawable(gaussians)
    return *rendering.projected(scene, camera, depth_mode), rendering.colors(scene, camera)


def drawn(projection, opacities, colors, camera):
    splats = rendering.binned(projection, opacities, camera, PAIRS)
    view = rendering.view_splats(splats, colors, jnp.ones(3), reading="plane")
    return view.colors, view.depth


def directly(gaussians, camera, depth_mode):
    return drawn(*projected(gaussians, camera, depth_mode), camera)


def by_mail(gaussians, camera, depth_mode):
    packed = rasterizer.pack(*projected(gaussians, camera, depth_mode), ROOM)
    return drawn(*rasterizer.unpack(packed.rows, with_slopes=depth_mode == "plane"), camera)


def test_packed_splats_draw_the_same_picture_with_the_same_gradients():
    gaussians = cloud(COUNT, capacity=50, seed=2)
    keys = jax.random.split(jax.random.key(0))
    weights = jax.random.normal(keys[0], (24, 32, 3)), jax.random.normal(keys[1], (24, 32))

    def weighed(road, gaussians):
        images = road(gaussians, CAMERA, "plane")
        return sum(jnp.sum(image * weight) for image, weight in zip(images, weights, strict=True)), images

    both = [jax.jit(jax.grad(lambda g, road=road: weighed(road, g), has_aux=True)) for road in (directly, by_mail)]
    (gradients, images), (mailed_gradients, mailed) = (each(gaussians) for each in both)
    assert_close(mailed, images)
    assert_close(mailed_gradients, gradients, kind="gradient")


def test_where_nobody_shows_nothing_is_packed_and_nobody_arrives():
    packed = rasterizer.pack(*projected(cloud(COUNT), AWAY, "center"), ROOM)
    assert int(packed.needed) == 0 and not packed.overflowed
    assert not np.any(packed.rows) and np.all(np.asarray(packed.ids) == COUNT)
    projection, _, _ = rasterizer.unpack(packed.rows, with_slopes=False)
    assert not np.any(projection.visible)


def test_ids_are_those_of_the_visible_in_their_order():
    gaussians = cloud(COUNT, seed=2)
    gaussians = replace(gaussians, logit_opacities=gaussians.logit_opacities.at[::3].set(-20.0))
    projection, *rest = projected(gaussians, CAMERA, "center")
    packed = rasterizer.pack(projection, *rest, ROOM)
    visible = np.flatnonzero(projection.visible[0])
    assert 0 < len(visible) < COUNT
    np.testing.assert_array_equal(packed.ids, np.pad(visible, (0, ROOM - len(visible)), constant_values=COUNT))
    arrived, opacities, colors = rasterizer.unpack(packed.rows, with_slopes=False)
    np.testing.assert_array_equal(arrived.visible[0], np.arange(ROOM) < len(visible))
    for field in ("means2d", "depths", "conics", "extents"):
        of_visible = np.asarray(getattr(projection, field))[0, visible]
        np.testing.assert_array_equal(getattr(arrived, field)[0, : len(visible)], of_visible)
    for part, whole in zip((opacities, colors), rest, strict=True):
        np.testing.assert_array_equal(part[: len(visible)], np.asarray(whole)[visible])


def test_a_buffer_that_is_too_short_says_what_it_needs():
    splats = projected(cloud(COUNT, seed=2), CAMERA, "center")
    needed = int(rasterizer.pack(*splats, ROOM).needed)
    for capacity, overflows in ((needed - 1, True), (needed, False)):
        packed = rasterizer.pack(*splats, capacity)
        assert (int(packed.needed), bool(packed.overflowed)) == (needed, overflows)
