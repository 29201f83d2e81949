"""gsplat's names: its stages, and what its calls rely on besides.

Composed the stages are the front door; alone they are what a loop in numpy says.
"""

import struct
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import BACKENDS, cloud, evaluate, in_float64, loss, relative_errors, render, smooth
from tolerances import assert_close

import rasterizer
from rasterizer import GSPLAT, _reference, gsplat, project

TILE = 16
SCENE = cloud(cameras=2)
SIZE = SCENE.width, SCENE.height
TILES = -(-SCENE.width // TILE), -(-SCENE.height // TILE)  # x, y
# Engines share all of this: one shows it, the others by night.
ENGINES = [b if b == "native" else pytest.param(b, marks=pytest.mark.long) for b in BACKENDS if b != "reference"]


@jax.jit
@partial(jax.grad, has_aux=True)
def through_the_stages(scene):
    """The gradient of `scenes.loss`, and image and alphas of a scene, one stage after the other."""
    radii, means2d, depths, conics, _ = rasterizer.fully_fused_projection(
        scene.means, None, scene.quats, scene.scales, scene.viewmats, scene.Ks, *SIZE, opacities=scene.opacities
    )
    _, ids, splats = rasterizer.isect_tiles(means2d, radii, depths, TILE, *TILES, capacity=1024)
    offsets = rasterizer.isect_offset_encode(ids, 2, *TILES)
    colors = jnp.broadcast_to(scene.colors, (2, *scene.colors.shape))
    opacities = jnp.broadcast_to(scene.opacities, (2, *scene.opacities.shape))
    image, alphas = rasterizer.rasterize_to_pixels(
        means2d, conics, colors, opacities, *SIZE, TILE, offsets, splats, scene.backgrounds
    )
    return weighted(image, alphas), (image, alphas)


def weighted(image, alphas):
    """Of one scene, the sum that `scenes.loss` takes."""
    rng = np.random.default_rng(3)
    w_image, w_alpha = (jnp.asarray(rng.normal(size=x.shape), x.dtype) for x in (image, alphas))
    return jnp.sum(w_image * image) + jnp.sum(w_alpha * alphas)


def test_the_stages_composed_are_the_front_door_in_value_and_gradient():
    *images, _, expected = evaluate(SCENE, "native")
    gradient, outputs = through_the_stages(SCENE)
    assert_close(list(outputs), images)
    for field, error in relative_errors(gradient, expected).items():
        assert error < 1e-4, (field, error)


def test_intersections_are_those_of_a_loop():
    rng = np.random.default_rng(1)
    means2d = rng.uniform(-20, 60, (2, 12, 2)).astype(np.float32)
    radii = rng.integers(-3, 25, (2, 12, 2)).clip(0).astype(np.int32)
    depths = rng.uniform(0.1, 9, (2, 12)).astype(np.float32)
    counts, expected = np.zeros((2, 12), int), []
    for image in range(2):
        for n in range(12):
            if (radii[image, n] == 0).any():
                continue
            low = np.floor((means2d[image, n] - radii[image, n]) / TILE).clip(0, TILES)
            high = np.ceil((means2d[image, n] + radii[image, n]) / TILE).clip(0, TILES)
            for y in range(int(low[1]), int(high[1])):
                for x in range(int(low[0]), int(high[0])):
                    depth_bits = struct.unpack("I", struct.pack("f", depths[image, n]))[0]
                    tile_bits = (TILES[0] * TILES[1] - 1).bit_length()
                    tile = (image << tile_bits) | (y * TILES[0] + x)
                    expected.append(((tile << 32) | depth_bits, image * 12 + n))
                    counts[image, n] += 1
    arrays = jnp.asarray(means2d), jnp.asarray(radii), jnp.asarray(depths)
    # A roomy capacity leaves slots that hold nothing, and the offsets do not see them.
    tiles_per_gauss, padded_ids, padded_splats = rasterizer.isect_tiles(*arrays, TILE, *TILES, capacity=400)
    ids, splats = padded_ids[: len(expected)], padded_splats[: len(expected)]
    np.testing.assert_array_equal(tiles_per_gauss, counts)
    assert list(zip(np.asarray(ids).tolist(), np.asarray(splats).tolist(), strict=True)) == sorted(expected)
    assert (ids.dtype, splats.dtype, tiles_per_gauss.dtype) == (np.int64, np.int32, np.int32)
    unsorted = (x.tolist() for x in rasterizer.isect_tiles(*arrays, TILE, *TILES, sort=False)[1:])
    assert set(zip(*unsorted, strict=True)) == set(expected)
    np.testing.assert_array_equal(padded_ids[len(expected) :], gsplat.PADDING)
    np.testing.assert_array_equal(padded_splats[len(expected) :], -1)
    offsets = np.asarray(rasterizer.isect_offset_encode(padded_ids, 2, *TILES))
    for image, y, x in np.ndindex(offsets.shape):
        first = ((image << (TILES[0] * TILES[1] - 1).bit_length()) | (y * TILES[0] + x)) << 32
        assert offsets[image, y, x] == sum(key < first for key, _ in expected)


@jax.jit
def projected(scene):
    """Covariances and their inverses; what the stages make of them; and all at once, of axes and of triangles."""
    covars, precis = rasterizer.quat_scale_to_covar_preci(scene.quats, scene.scales)
    triangles, _ = rasterizer.quat_scale_to_covar_preci(scene.quats, scene.scales, triu=True)
    means, in_camera = rasterizer.world_to_cam(scene.means, covars, scene.viewmats)
    staged = means[..., 2], *rasterizer.proj(means, in_camera, scene.Ks, *SIZE)
    shapes, cameras = ((None, scene.quats, scene.scales), (triangles, None, None)), (scene.viewmats, scene.Ks)
    fused = [rasterizer.fully_fused_projection(scene.means, *shape, *cameras, *SIZE) for shape in shapes]
    return covars, precis, staged, *fused


def test_fused_and_staged_projection_agree_and_batches_are_their_members():
    covars, precis, (z, means2d, covars2d), of_axes, of_triangles = projected(SCENE)
    radii, fused_means2d, depths, conics, compensations = of_axes
    visible = np.asarray(radii > 0).all(-1)
    assert visible.any() and not visible.all() and compensations is None
    assert_close(of_triangles[3], conics, rtol=1e-4, atol=1e-5, why="a determinant from products of covariances")
    np.testing.assert_array_equal(of_triangles[0], radii)
    assert_close(fused_means2d, means2d, rtol=1e-5, atol=1e-4, why="pixels")
    assert_close(depths, z)
    blurred = np.asarray(covars2d, np.float64) + 0.3 * np.eye(2)
    inverse = np.linalg.inv(blurred)[..., [0, 0, 1], [0, 1, 1]]
    assert_close(
        np.asarray(conics)[visible], inverse[visible], rtol=1e-3, atol=1e-5, why="the oracle inverts in float32"
    )
    # Radii: 3.33 standard deviations, rounded up.
    expected = np.ceil(3.33 * np.sqrt(np.diagonal(blurred, axis1=-2, axis2=-1)))
    assert np.abs(np.asarray(radii)[visible] - expected[visible]).max() <= 1
    np.testing.assert_allclose(precis, np.linalg.inv(np.asarray(covars, np.float64)), rtol=2e-3)

    batch = jax.tree.map(lambda x: jnp.stack([x, x[::-1]]), (SCENE.means, SCENE.quats, SCENE.scales))
    both = jax.tree.map(lambda x: jnp.stack([x, x]), (SCENE.viewmats, SCENE.Ks))
    run = jax.jit(lambda means, *shape: rasterizer.fully_fused_projection(means, None, *shape, *SIZE))
    batched = run(*batch, *both)
    assert_close(batched[3][1], conics[:, ::-1])
    assert batched[0].shape == (2, 2, 40, 2)


def test_compensations_and_the_clip_of_small_radii():
    def projection(**options):
        run = partial(rasterizer.fully_fused_projection, calc_compensations=True, **options)
        gaussians = SCENE.means, None, SCENE.quats, SCENE.scales
        return jax.jit(lambda *arrays: run(*arrays, *SIZE))(*gaussians, SCENE.viewmats, SCENE.Ks)

    radii, *_, compensations = projection()
    assert np.all((np.asarray(compensations) > 0) & (np.asarray(compensations) < 1))
    limit = int(np.median(np.asarray(radii)[np.asarray(radii) > 0]))
    clipped = projection(radius_clip=limit)[0]
    np.testing.assert_array_equal(clipped, np.where((np.asarray(radii) <= limit).all(-1, keepdims=True), 0, radii))
    assert np.any(clipped > 0)


def stacked(scenes):
    """Scenes of one shape as one with a leading dimension."""
    return jax.tree.map(lambda *x: jnp.stack(x), *scenes)


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
        *expected, info_alone, expected_gradient = evaluate(scene, backend)
        assert_close([image[0, i], alphas[0, i]], expected)
        for name in ("tiles_per_gauss", "isect_offsets", "flatten_ids"):
            np.testing.assert_array_equal(info[name][0, i], info_alone[name])
        alone = jax.tree.map(lambda x, i=i: x[0, i], gradient)
        assert_close(alone, expected_gradient, kind="gradient")


def test_what_has_no_leading_dimensions_is_shared():
    s = cloud(cameras=2, sh_degree=1)
    two = stacked([s, replace(s, means=s.means[::-1])])
    shared = replace(s, means=two.means, quats=two.quats, scales=two.scales, opacities=two.opacities)
    options = {"sh_degree": 1, "capacity": 2048}
    assert_close(render(shared, **options)[0], render(two, **options)[0])


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


def test_harmonics_in_two_parts_are_the_whole(x64):
    rng = np.random.default_rng(0)
    sh0, shN, means = (jnp.asarray(rng.normal(size=shape)) for shape in ((30, 1, 2), (30, 8, 2), (2, 30, 3)))
    viewmats = jnp.stack([in_float64(SCENE).viewmats] * 2)
    others = rasterizer.spherical_harmonics_l1_plus(2, means, viewmats, shN)
    centers = -jnp.einsum("bcji,bcj->bci", viewmats[..., :3, :3], viewmats[..., :3, 3])
    dirs = means[:, None] - centers[:, :, None]
    whole = rasterizer.spherical_harmonics(2, dirs, jnp.concatenate([sh0, shN], 1)[None, None])
    assert_close(rasterizer.spherical_harmonics_l0(sh0)[None, None] + others, whole)
