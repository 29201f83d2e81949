"""What gsplat's calls rely on besides: leading dimensions, absolute gradients, packed rows, harmonics in two parts."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import BACKENDS, cloud, evaluate, in_float64, loss, render, smooth
from tolerances import assert_close

import rasterizer
from rasterizer import GSPLAT, _reference, project
from rasterizer.packed_rows import pack_rows

SCENE = cloud(30, cameras=2)
SIZE = SCENE.width, SCENE.height
TILE = 16
TILES = -(-SCENE.width // TILE), -(-SCENE.height // TILE)
# Engines share all of this: one shows it, the others by night.
ENGINES = [b if b == "native" else pytest.param(b, marks=pytest.mark.long) for b in BACKENDS if b != "reference"]


def stacked(scenes):
    """Scenes of one shape as one with a leading dimension."""
    return jax.tree.map(lambda *x: jnp.stack(x), *scenes)


def weighted(image, alphas):
    """Of one scene, the sum that `scenes.loss` takes."""
    rng = np.random.default_rng(3)
    w_image, w_alpha = (jnp.asarray(rng.normal(size=x.shape), x.dtype) for x in (image, alphas))
    return jnp.sum(w_image * image) + jnp.sum(w_alpha * alphas)


@pytest.mark.parametrize("backend", ENGINES)
def test_leading_dimensions_are_the_scenes_one_by_one_in_value_and_gradient(backend):
    scenes = [cloud(seed=seed) for seed in (0, 1)]
    both = jax.tree.map(lambda x: x[None], stacked(scenes))  # [1, 2, ...]: two leading dimensions

    def of_both(both):
        image, alphas, info = render(both, backend=backend, capacity=2048)
        return sum(weighted(image[0, i], alphas[0, i]) for i in range(2)), (image, alphas, info)

    (_, (image, alphas, info)), gradient = jax.jit(jax.value_and_grad(of_both, has_aux=True))(both)
    assert info["radii"].shape == (1, 2, 1, 40, 2)
    for i, scene in enumerate(scenes):
        *expected, _, expected_gradient = evaluate(scene, backend)
        assert_close([image[0, i], alphas[0, i]], expected)
        alone = jax.tree.map(lambda x, i=i: x[0, i], gradient)
        assert_close(alone, expected_gradient, kind="gradient")


def test_what_has_no_leading_dimensions_is_shared_and_other_ones_are_refused():
    s = cloud(cameras=2, sh_degree=1)
    two = stacked([s, replace(s, means=s.means[::-1])])
    shared = replace(s, means=two.means, quats=two.quats, scales=two.scales, opacities=two.opacities)
    options = {"sh_degree": 1, "capacity": 2048}
    assert_close(render(shared, **options)[0], render(two, **options)[0])
    with pytest.raises(ValueError, match=r"opacities.shape=\(3, 40\), expected the leading dimensions of means"):
        render(replace(shared, opacities=jnp.ones((3, 40))), **options)
    with pytest.raises(ValueError, match=r"means.shape=\(0, 40, 3\) holds no scene"):
        render(replace(shared, means=shared.means[:0]), **options)


def sum_of_absolutes(scene):
    """`[1, N, 2]` float64, of the dense reference: the gradient of every pixel's own loss to the 2D means, absolute."""
    s = in_float64(scene)
    splats = project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height)

    def of_pixels(means2d):
        moved = splats._replace(means2d=means2d)
        image, left, _ = _reference.composite(moved, s.opacities[None], s.colors[None], s.width, s.height, GSPLAT)
        rng = np.random.default_rng(3)
        w_image, w_alpha = (jnp.asarray(rng.normal(size=x.shape)) for x in (image, left))
        return (jnp.sum(w_image * image, -1) + w_alpha[..., 0] * (1 - left[..., 0])).ravel()

    by_pixel = jax.jit(jax.jacrev(of_pixels))(splats.means2d)
    return np.abs(by_pixel).sum(0), np.asarray(by_pixel).sum(0)


@pytest.mark.parametrize("backend", ENGINES)
def test_absolute_gradients_are_those_of_every_pixel_alone(backend):
    scene = replace(smooth(), backgrounds=jnp.zeros((1, 2), jnp.float32))
    with jax.enable_x64(True):
        expected, plain = sum_of_absolutes(scene)
    assert np.all(expected >= np.abs(plain)) and np.any(expected > 1.5 * np.abs(plain))

    @jax.jit
    @partial(jax.grad, argnums=(0, 1))
    def gradients(scene, zeros):
        return loss(scene, backend=backend, capacity=64, absgrad=zeros)[0]

    of_scene, absolute = gradients(scene, jnp.zeros((1, 4, 2)))
    assert_close(absolute, expected, kind="gradient")
    # Whatever is passed, nothing depends on it.
    assert_close(gradients(scene, jnp.ones((1, 4, 2))), (of_scene, absolute))


@pytest.mark.parametrize(
    ("value", "backend", "message"),
    [
        (True, "xla", r"absgrad=True: pass zeros of shape \(2, 30, 2\), whose gradient is what gsplat writes"),
        (np.zeros((30, 2)), "xla", r"absgrad=\[30, 2\]: pass zeros of shape \(2, 30, 2\)"),
        (np.zeros((2, 30, 2)), "reference", "absgrad needs a tile backend"),
    ],
)
def test_absolute_gradients_need_zeros_of_their_shape_and_tiles(value, backend, message):
    with pytest.raises(ValueError, match=message):
        render(SCENE, absgrad=value, backend=backend, capacity=2048)


def test_small_splats_are_clipped_by_their_radius():
    def radii(limit):
        s = SCENE
        cameras = s.viewmats, s.Ks, *SIZE
        return np.ceil(project(s.means, s.quats, s.scales, s.opacities, *cameras, radius_clip=limit).extents)

    all_radii, limit = radii(0.0), 4.0
    small = np.all(all_radii <= limit, -1)
    assert np.any(all_radii[small] > 0) and not small.all()
    np.testing.assert_array_equal(radii(limit), np.where(small[..., None], 0, all_radii))


@jax.jit
def packed_and_dense():
    """Two scenes in two cameras, both ways, through room for 100 rows."""
    both = jax.tree.map(lambda x: jnp.stack([x, x[::-1]]), (SCENE.means, SCENE.quats, SCENE.scales))
    cameras = jax.tree.map(lambda x: jnp.stack([x, x]), (SCENE.viewmats, SCENE.Ks))
    projected = partial(
        rasterizer.fully_fused_projection, both[0], None, both[1], both[2], *cameras, *SIZE,
        calc_compensations=True, near_plane=2.5,
    )  # fmt: skip
    return projected(packed=True, capacity=100), projected()


def test_packed_rows_are_the_rows_that_show():
    (batch, camera, gaussian, indptr, *packed), dense = packed_and_dense()
    shown = np.asarray(dense[0] > 0).all(-1)
    expected_ids, count = np.nonzero(shown), shown.sum()
    assert 0 < count < 100
    for ids, expected in zip((batch, camera, gaussian), expected_ids, strict=True):
        np.testing.assert_array_equal(ids[:count], expected)
        np.testing.assert_array_equal(ids[count:], -1)
    np.testing.assert_array_equal(indptr, np.append(0, np.cumsum(shown.reshape(4, 30).sum(-1))))
    for rows, full in zip(packed, dense, strict=True):
        np.testing.assert_array_equal(rows[:count], np.asarray(full)[expected_ids])
        np.testing.assert_array_equal(rows[count:], 0)
    # Without a number of rows, they are counted.
    *ids, indptr, counted = pack_rows(jnp.asarray(shown), (dense[2],), None)
    np.testing.assert_array_equal(counted, np.asarray(dense[2])[expected_ids])
    *ids, indptr, counted = pack_rows(jnp.zeros((3, 0), bool), (jnp.zeros((3, 0, 2)),), None)
    assert indptr.tolist() == [0, 0, 0, 0] and counted.shape == (0, 2) and all(each.shape == (0,) for each in ids)


@pytest.mark.parametrize("backend", ENGINES)
def test_packed_rows_make_the_image_of_the_front_door_in_value_and_gradient(backend):
    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def through_packed_rows(s):
        _, camera_ids, gaussian_ids, _, radii, means2d, depths, conics, _ = rasterizer.fully_fused_projection(
            s.means, None, s.quats, s.scales, s.viewmats, s.Ks, *SIZE, opacities=s.opacities, packed=True, capacity=39
        )
        image_ids = {"packed": True, "n_images": 1, "image_ids": camera_ids, "gaussian_ids": gaussian_ids}
        _, ids, splats = rasterizer.isect_tiles(means2d, radii, depths, TILE, *TILES, capacity=512, **image_ids)
        offsets = rasterizer.isect_offset_encode(ids, 1, *TILES)
        shown = rasterizer.rasterize_to_pixels(
            means2d, conics, s.colors[gaussian_ids], s.opacities[gaussian_ids], *SIZE, TILE, offsets, splats,
            s.backgrounds, packed=True, backend=backend,
        )  # fmt: skip
        return weighted(*shown), shown

    scene = cloud()
    (_, shown), gradient = through_packed_rows(scene)
    *expected, _, expected_gradient = evaluate(scene, backend)
    assert_close(list(shown), expected)
    assert_close(gradient, expected_gradient, kind="gradient")


def test_packed_rows_say_of_which_image_they_are():
    with pytest.raises(ValueError, match="packed=True needs image_ids"):
        rasterizer.isect_tiles(jnp.ones((3, 2)), jnp.ones((3, 2), jnp.int32), jnp.ones(3), TILE, *TILES, packed=True)


def test_harmonics_in_two_parts_are_the_whole(x64):
    rng = np.random.default_rng(0)
    sh0, shN, means = (jnp.asarray(rng.normal(size=shape)) for shape in ((30, 1, 2), (30, 8, 2), (2, 30, 3)))
    viewmats = jnp.stack([in_float64(SCENE).viewmats] * 2)
    weights = jnp.asarray(rng.normal(size=(2, 2, 30, 2)))
    batch, camera, gaussian = (jnp.asarray(ids) for ids in rng.integers(0, [[2], [2], [30]], (3, 50)))

    def parts(sh0, shN, means, viewmats):
        others = rasterizer.spherical_harmonics_l1_plus(2, means, viewmats, shN)
        return jnp.sum(weights * (rasterizer.spherical_harmonics_l0(sh0)[None, None] + others)), others

    def whole(sh0, shN, means, viewmats):
        centers = -jnp.einsum("bcji,bcj->bci", viewmats[..., :3, :3], viewmats[..., :3, 3])
        dirs = means[:, None] - centers[:, :, None]
        values = rasterizer.spherical_harmonics(2, dirs, jnp.concatenate([sh0, shN], 1)[None, None])
        return jnp.sum(weights * values), values

    arguments = sh0, shN, means, viewmats
    (_, others), split = jax.jit(jax.value_and_grad(parts, range(4), has_aux=True))(*arguments)
    (_, values), full = jax.jit(jax.value_and_grad(whole, range(4), has_aux=True))(*arguments)
    assert_close(np.asarray(others) + 0.28209479177387814 * np.asarray(sh0)[:, 0], np.asarray(values))
    assert_close(split, full, kind="gradient")

    @jax.jit
    def packed(shN, means, viewmats):
        rows = shN[gaussian]
        return rasterizer.spherical_harmonics_l1_plus(2, means, viewmats, rows, None, batch, camera, gaussian)

    assert_close(packed(shN, means, viewmats), others[batch, camera, gaussian])
    nothing = rasterizer.spherical_harmonics_l1_plus(0, means, viewmats, shN[:, :0])
    np.testing.assert_array_equal(nothing, np.zeros((2, 2, 30, 2)))
    with pytest.raises(ValueError, match="given together"):
        rasterizer.spherical_harmonics_l1_plus(2, means, viewmats, shN, camera_ids=camera)
