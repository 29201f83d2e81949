"""What a call may ask for beside colours: antialiasing, median depth, normals, covariances, masks, many channels."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    BACKENDS,
    GAUSSIAN_FIELDS,
    OWN,
    cloud,
    evaluate,
    in_float64,
    relative_errors,
    render,
    single,
    with_odd_one,
)
from tolerances import assert_close

import rasterizer
from rasterizer import GSPLAT

TILE = 16
SCENE = cloud(cameras=2)
OTHERS = [each for each in BACKENDS if each not in (OWN, "reference")]


@partial(jax.jit, static_argnames=("backend", "options"))
def outputs(scene, extra, backend, options=()):
    """Image, alphas, info and the gradient of a weighted sum of all images that were asked for."""

    def weighted(scene, extra):
        image, alphas, info = render(scene, backend=backend, capacity=4096, tile_size=TILE, **extra, **dict(options))
        images = [image, alphas, *(info[name] for name in ("normals", "median_depths") if name in info)]
        rng = np.random.default_rng(5)
        total = sum(jnp.sum(x * jnp.asarray(rng.normal(size=x.shape), x.dtype)) for x in images)
        return total, (image, alphas, info)

    (_, rest), gradient = jax.value_and_grad(weighted, argnums=0, has_aux=True)(scene, extra)
    return *rest, gradient


EVERYTHING = (
    ("rasterize_mode", "antialiased"),
    ("render_mode", "RGB+ED"),
    ("sh_degree", 1),
    ("return_median_depth", True),
    ("return_normals", True),
)
OF_ALL = cloud(cameras=2, channels=5, sh_degree=1)
OF_ALL = replace(OF_ALL, backgrounds=jnp.pad(OF_ALL.backgrounds, ((0, 0), (0, 1)), constant_values=0.5))


def with_masks():
    masks = np.random.default_rng(0).uniform(size=(2, 2, 3)) < 0.5
    return masks, masks.repeat(TILE, 1).repeat(TILE, 2)[:, : SCENE.height, : SCENE.width]


@pytest.mark.device
@pytest.mark.parametrize("backend", [OWN, *(pytest.param(x, marks=pytest.mark.long) for x in OTHERS)])
@pytest.mark.parametrize("depth_mode", ["plane", pytest.param("center", marks=pytest.mark.long)])
def test_everything_at_once_equals_the_reference(backend, depth_mode):
    """Harmonics, many channels, two cameras, expected depth, antialiasing, masks, medians and normals."""
    extra, options = {"masks": jnp.asarray(with_masks()[0])}, (*EVERYTHING, ("depth_mode", depth_mode))
    image, alphas, info, gradient = outputs(OF_ALL, extra, backend, options)
    expected_image, expected_alphas, expected_info, expected = outputs(OF_ALL, extra, "reference", options)
    assert not info["overflowed"] and float(np.max(expected_alphas)) > 0.1
    assert_close((image, alphas), (expected_image, expected_alphas))
    assert_close(info["normals"], expected_info["normals"])
    assert_close(info["median_depths"], expected_info["median_depths"])
    for field, error in relative_errors(gradient, expected).items():
        assert error < 1e-4, (field, error)


def composited(scene, camera=0, rules=GSPLAT):
    """Weights [N, H, W] in order of depth, with that order: alpha compositing written out in float64."""
    info = render(scene, capacity=4096)[2]
    means2d, conics, depths, visible = (np.asarray(info[k][camera], np.float64) for k in
                                        ("means2d", "conics", "depths", "visible"))  # fmt: skip
    order = np.argsort(np.where(visible > 0, depths, np.inf), kind="stable")
    y, x = np.mgrid[: scene.height, : scene.width] + 0.5
    left, weights, stopped = np.ones((scene.height, scene.width)), [], np.zeros((scene.height, scene.width), bool)
    for n in order:
        dx, dy = means2d[n, 0] - x, means2d[n, 1] - y
        a, b, c = conics[n]
        alpha = float(scene.opacities[n]) * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy)
        alpha = np.where((alpha >= rules.alpha_min) & (visible[n] > 0), np.minimum(alpha, rules.alpha_max), 0)
        stopped |= left * (1 - alpha) <= rules.transmittance_min
        weights.append(np.where(stopped, 0, alpha * left))
        left = np.where(stopped, left, left * (1 - alpha))
    return np.array(weights), order, depths


def test_median_depth_is_where_the_light_falls_to_one_half():
    info = render(SCENE, capacity=4096, return_median_depth=True, depth_mode="plane")[2]
    for camera in range(2):
        weights, order, depths = composited(SCENE, camera)
        before = 1 - (np.cumsum(weights, 0) - weights)
        counts = (weights > 0) & (before > 0.5)
        last = np.where(counts.any(0), len(order) - 1 - counts[::-1].argmax(0), -1)
        expected = np.where(last >= 0, depths[order[last]], 0)
        means2d, slopes = (np.asarray(info[name][camera], np.float64)[order[last]] for name in ("means2d", "slopes"))
        y, x = np.mgrid[: SCENE.height, : SCENE.width] + 0.5
        offset = np.where(last >= 0, np.sum(slopes * (np.stack([x, y], -1) - means2d), -1), 0)
        assert np.abs(offset).max() > 0.1
        assert np.any(last < 0) and np.any(1 - weights.sum(0) > 0.5) and np.any(1 - weights.sum(0) < 0.5)
        assert_close(info["median_depths"][camera, ..., 0], expected + offset)


def test_the_gradient_of_a_median_depth_goes_to_its_one_splat():
    def pixel(means):
        info = render(replace(SCENE, means=means), return_median_depth=True, capacity=4096)[2]
        return info["median_depths"][0, 14, 18, 0]

    gradient = np.asarray(jax.grad(pixel)(SCENE.means))
    rows = np.flatnonzero(gradient.any(-1))
    assert len(rows) == 1
    # Depth is the third row of the camera matrix.
    np.testing.assert_allclose(gradient[rows[0]], SCENE.viewmats[0, 2, :3], rtol=1e-6)


def test_normals_are_the_smallest_axes_facing_the_camera():
    # A disc tilted by 30 degrees about x; the same turned over; and no turn of a ball.
    c, s = np.cos(np.pi / 12), np.sin(np.pi / 12)
    quats = jnp.asarray([[c, s, 0, 0], [0, 0, c, s], [0, 0, 0, 0]], jnp.float32)
    scales = jnp.asarray([[0.5, 0.5, 0.001], [0.5, 0.5, 0.001], [0.3, 0.3, 0.3]], jnp.float32)
    means, visible = jnp.asarray([[0.0, 0, 2]] * 3, jnp.float32), jnp.ones((1, 3), bool)

    @jax.jit
    @partial(jax.grad, has_aux=True)
    def gradient_and_normals(quats):
        normals = rasterizer.camera_normals(means, quats, scales, jnp.eye(4)[None], visible)
        return jnp.sum(normals), normals

    gradient, normals = gradient_and_normals(quats)
    assert_close(normals[0, 0], np.array([0, 0.5, -np.sqrt(0.75)]))
    assert normals[0, 1, 2] < 0
    assert_close(np.linalg.norm(normals, axis=-1), np.ones((1, 3), np.float32))
    assert np.isfinite(gradient).all()


def test_normals_against_finite_differences(x64):
    scene = in_float64(SCENE)

    @jax.jit
    def total(quats):
        normals = rasterizer.camera_normals(scene.means, quats, scene.scales, scene.viewmats, jnp.ones((2, 40), bool))
        return jnp.sum(normals * jnp.asarray(np.random.default_rng(1).normal(size=(2, 40, 3))))

    direction = jnp.asarray(np.random.default_rng(2).normal(size=scene.quats.shape))
    step = 1e-6
    expected = (total(scene.quats + step * direction) - total(scene.quats - step * direction)) / (2 * step)
    np.testing.assert_allclose(jnp.sum(jax.jit(jax.grad(total))(scene.quats) * direction), expected, rtol=1e-7)


def test_antialiasing_keeps_the_energy_of_what_is_smaller_than_a_pixel():
    # 0.1 px wide: blurred to sqrt(0.01 + 0.3) px.
    small = single(scale=(0.0125, 0.0125, 0.0125), size=17, opacity=0.9)
    energy = 0.9 * 2 * np.pi * 0.1**2
    rules = replace(GSPLAT, alpha_min=1e-6)
    _, fair, info = render(small, capacity=256, rasterize_mode="antialiased", rules=rules)
    np.testing.assert_allclose(info["compensations"], 0.01 / 0.31, rtol=1e-5)
    np.testing.assert_allclose(fair.sum(), energy, rtol=0.02)
    # What it dims below the cut, 0.0032 of 1/255, is nowhere.
    faint = replace(small, opacities=jnp.full(1, 0.1))
    assert not render(faint, capacity=256, rasterize_mode="antialiased")[2]["visible"].any()
    # Large splats are left alone: 6.4^2 / (6.4^2 + 0.3) is 0.9927.
    large = render(replace(small, scales=jnp.full((1, 3), 0.8)), capacity=256, rasterize_mode="antialiased")[2]
    np.testing.assert_allclose(large["compensations"], 0.9927, atol=1e-4)


ODD = with_odd_one(cloud(), means=(0.1, -0.1, 2.0), opacities=0.7)


@jax.jit
def drawn_by_covariances(covars, opacities):
    """Gradients to covariances and means, and the image and what is visible in it."""

    def loss(covars, means):
        image, _, info = rasterizer.rasterization(
            means, None, None, opacities, ODD.colors, ODD.viewmats, ODD.Ks, ODD.width, ODD.height,
            covars=covars, capacity=4096,
        )  # fmt: skip
        return jnp.sum(image**2), (image, info["visible"])

    return jax.grad(loss, argnums=(0, 1), has_aux=True)(covars, ODD.means)


def covariances():
    return rasterizer.quat_scale_to_covar_preci(ODD.quats, ODD.scales, compute_preci=False)[0]


def test_covariances_in_place_of_quats_and_scales():
    (gradient, _), (image, _) = drawn_by_covariances(covariances(), ODD.opacities)
    expected = evaluate(replace(ODD, backgrounds=jnp.zeros((1, 3))), "reference")[0]
    assert_close(image, expected, rtol=1e-4, atol=1e-4, why="products of float32 covariances")
    # Only the upper triangle is read.
    lower = np.tril(np.ones((3, 3)), -1) > 0
    changed = covariances() + 7 * jnp.asarray(lower, jnp.float32)[None]
    np.testing.assert_array_equal(drawn_by_covariances(changed, ODD.opacities)[1][0], image)
    gradient = np.asarray(gradient)
    assert np.isfinite(gradient).all() and gradient[:, ~lower].any() and not gradient[:, lower].any()


ODD_COVARIANCES = {
    "zero": np.zeros((3, 3)),
    "rank one": np.outer([1, 2, -1], [1, 2, -1]) * 0.01,
    "not positive": -np.eye(3),
    "indefinite": np.diag([1.0, -1.0, 0.5]),
    "NaN": np.full((3, 3), np.nan),
    "infinite": np.full((3, 3), np.inf),
    "huge": np.eye(3) * 1e30,
}


def test_odd_covariances_are_drawn_or_hidden_but_never_disturb():
    covars, unseen = covariances(), ODD.opacities.at[-1].set(0.0)
    expected, (expected_image, _) = drawn_by_covariances(covars, unseen)
    for name, covar in ODD_COVARIANCES.items():
        odd = covars.at[-1].set(jnp.asarray(covar, jnp.float32))
        gradients, (image, visible) = drawn_by_covariances(odd, ODD.opacities)
        assert np.isfinite(image).all() and all(np.isfinite(each).all() for each in gradients), name
        assert bool(visible[0, -1]) == (name in ("zero", "rank one"))
        if not visible[0, -1]:
            np.testing.assert_array_equal(image, expected_image)
            for ours, without in zip(gradients, expected, strict=True):
                np.testing.assert_array_equal(ours[:-1], without[:-1])


@pytest.mark.parametrize("backend", ["native", *(pytest.param(x, marks=pytest.mark.long) for x in OTHERS)])
def test_a_masked_tile_is_background_and_the_rest_keeps_its_bits(backend):
    masks, is_drawn = with_masks()
    # One program for both: in another one the same sums may be taken in another order.
    options = (*EVERYTHING, ("depth_mode", "plane"))

    def with_its(masks):
        return outputs(OF_ALL, {"masks": jnp.asarray(masks)}, backend, options)

    image, alphas, _, _ = with_its(np.ones((2, 2, 3), bool))
    masked_image, masked_alphas, _, gradient = with_its(masks)
    background = np.broadcast_to(np.asarray(OF_ALL.backgrounds)[:, None, None], image.shape)
    np.testing.assert_array_equal(masked_image, np.where(is_drawn[..., None], image, background))
    np.testing.assert_array_equal(masked_alphas, np.where(is_drawn[..., None], alphas, 0))
    nothing = with_its(np.zeros((2, 2, 3), bool))[3]
    for field in GAUSSIAN_FIELDS:
        assert np.any(getattr(gradient, field))
        np.testing.assert_array_equal(getattr(nothing, field), 0)
