from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.special import expit, xlogy
from small_scenes import camera_at, cloud
from tolerances import assert_close

from gsjax.gaussians import Gaussians
from gsjax.metrics.images import ssim
from gsjax.rendering import View
from gsjax.training.terms import losses
from gsjax.training.terms.losses import Batch

RNG = np.random.default_rng(0)
IMAGE, TARGET = RNG.random((12, 14, 3)), RNG.random((12, 14, 3))
ALPHAS, MATTE = RNG.random((12, 14)), RNG.random((12, 14))
VALID = RNG.random((12, 14)) > 0.3


def view_of(colors, alphas=ALPHAS, visible=None):
    visible = (
        None if visible is None else SimpleNamespace(projection=SimpleNamespace(visible=jnp.asarray(visible)[None]))
    )
    return View(jnp.asarray(colors), jnp.asarray(alphas), None, visible)


def batch_of(image=TARGET, valid=VALID, matte=None):
    return Batch(None, jnp.asarray(image), jnp.asarray(valid), None if matte is None else jnp.asarray(matte), None)


def of_logits(logits) -> Gaussians:
    return Gaussians(**{**cloud(len(logits)).__dict__, "logit_opacities": jnp.asarray(logits)})


def test_l1_and_alpha_are_means_over_valid_pixels(x64):
    batch = batch_of(matte=MATTE)
    assert_close(losses.l1(None, view_of(IMAGE), batch), np.abs(IMAGE - TARGET)[VALID].mean())
    gradient = jax.grad(lambda colors: losses.l1(None, view_of(colors), batch))(jnp.asarray(IMAGE))
    assert_close(gradient, np.sign(IMAGE - TARGET) * VALID[..., None] / (3 * VALID.sum()))
    assert_close(losses.alpha(None, view_of(IMAGE), batch), np.abs(ALPHAS - MATTE)[VALID].mean())
    gradient = jax.grad(lambda alphas: losses.alpha(None, view_of(IMAGE, alphas), batch))(jnp.asarray(ALPHAS))
    assert_close(gradient, np.sign(ALPHAS - MATTE) * VALID / VALID.sum())


def test_dssim_is_one_minus_ssim_and_differentiable(x64):
    expected = 1 - jax.jit(ssim)(jnp.asarray(IMAGE), jnp.asarray(TARGET), jnp.asarray(VALID))
    dssim = jax.jit(lambda colors: losses.dssim(None, view_of(colors), batch_of()))
    assert_close(dssim(jnp.asarray(IMAGE)), expected)
    check_grads(dssim, (jnp.asarray(IMAGE),), order=1, modes=["rev"])


def test_photos_without_a_valid_pixel_ask_for_nothing():
    nothing = batch_of(valid=np.zeros_like(VALID), matte=MATTE)
    for term, expected in ((losses.l1, 0.0), (losses.alpha, 0.0), (losses.dssim, 1.0)):
        assert float(term(None, view_of(IMAGE), nothing)) == expected


def test_what_covers_the_sky_is_a_mean_over_valid_pixels_with_a_gradient_in_the_sky_alone(x64):
    is_sky = RNG.random((12, 14)) > 0.5
    batch = replace(batch_of(), sky=jnp.asarray(is_sky))

    def sky(alphas):
        return losses.sky(None, view_of(IMAGE, alphas), batch)

    assert_close(sky(jnp.asarray(ALPHAS)), (ALPHAS * is_sky)[VALID].sum() / VALID.sum())
    assert_close(jax.grad(sky)(jnp.asarray(ALPHAS)), (VALID & is_sky) / VALID.sum())
    nothing = replace(batch, valid=jnp.zeros((12, 14), bool))
    assert losses.sky(None, view_of(IMAGE), nothing) == 0


def test_coverage_is_the_light_that_falls_through_where_there_is_a_normal(x64):
    normals = RNG.normal(size=(12, 14, 3)) * (RNG.random((12, 14, 1)) > 0.4)
    surface = VALID & np.any(normals, -1)
    batch = replace(batch_of(), normals=jnp.asarray(normals))
    value, gradient = jax.value_and_grad(lambda a: losses.coverage(None, view_of(IMAGE, a), batch))(jnp.asarray(ALPHAS))
    assert_close(value, 1 - ALPHAS[surface].mean())
    assert_close(gradient, np.where(surface, -1 / surface.sum(), 0))
    nowhere = replace(batch, normals=jnp.zeros((12, 14, 3)))
    gradient = jax.grad(lambda a: losses.coverage(None, view_of(IMAGE, a), nowhere))(jnp.asarray(ALPHAS))
    assert losses.coverage(None, view_of(IMAGE), nowhere) == 0 and not np.any(gradient)


def test_thickness_is_the_smallest_deviation_in_pixels_and_moves_nothing(x64):
    rng = np.random.default_rng(1)
    log_scales, depths, visible = rng.normal(-2, 1, (9, 3)), rng.uniform(1, 5, 9), np.arange(9) % 4 != 0
    depths[0] = 0.0  # Not visible: its row may hold anything harmless.
    camera = camera_at((0.0, 0, 0), (0.0, 0, 4), size=(24, 20))
    camera = replace(camera, K=jnp.asarray(camera.K, jnp.float64))
    batch = replace(batch_of(), camera=camera)
    focal = np.sqrt(float(camera.K[0, 0]) * float(camera.K[1, 1]))

    def term(log_scales, depths):
        projection = SimpleNamespace(visible=jnp.asarray(visible)[None], depths=depths[None])
        view = View(jnp.asarray(IMAGE), jnp.asarray(ALPHAS), None, SimpleNamespace(projection=projection))
        return losses.thickness(Gaussians(**{**cloud(9).__dict__, "log_scales": log_scales}), view, batch)

    smallest = np.exp(log_scales.min(1))
    value, (to_scales, to_depths) = jax.jit(jax.value_and_grad(term, (0, 1)))(log_scales, depths)
    pixels = np.where(visible, smallest * focal / np.where(visible, depths, 1), 0)
    assert_close(value, pixels.sum() / visible.sum())
    is_smallest = log_scales == log_scales.min(1, keepdims=True)
    expected = np.where(is_smallest, pixels[:, None], 0) / visible.sum()
    assert_close(to_scales, expected)
    assert_close(to_depths, np.zeros(9))


def test_entropy_is_that_of_a_coin_over_the_visible(x64):
    logits = np.array([-8.0, -2.0, 0.0, 0.5, 3.0, 11.0])
    visible = np.array([1, 0, 1, 1, 1, 1], bool)
    a = expit(logits)
    nats = -(xlogy(a, a) + xlogy(1 - a, 1 - a))

    def of(logits):
        return losses.entropy(of_logits(logits), view_of(IMAGE, visible=visible), None)

    assert_close(of(logits), nats[visible].mean())
    assert_close(jax.jit(jax.grad(of))(jnp.asarray(logits)), np.where(visible, -logits * a * (1 - a) / 5, 0))
    assert float(losses.entropy(cloud(3), view_of(IMAGE, visible=np.zeros(3, bool)), None)) == 0


@pytest.mark.parametrize("logit", [100.0, -1e30])
def test_entropy_of_a_certain_opacity_is_exactly_zero(logit):
    value, gradient = jax.value_and_grad(
        lambda logits: losses.entropy(of_logits(logits), view_of(IMAGE, visible=np.ones(2, bool)), None)
    )(jnp.full(2, logit, jnp.float32))
    assert_close((value, gradient), (np.zeros(()), np.zeros(2)), rtol=0, atol=1e-38, why="exact but for denormals")


def test_a_normal_term_counts_only_valid_covered_pixels_that_have_a_normal():
    # An estimator of constant direction: z. Where a pixel counts, 1 - |cos| is 1 - |n_z|.
    normals = RNG.normal(size=(12, 14, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[:, :4] = 0
    batch = Batch(camera_at(), None, jnp.asarray(VALID), None, jnp.asarray(normals, jnp.float32))
    term = losses.alignment_term(lambda gaussians, view, camera: jnp.broadcast_to(jnp.array([0.0, 0, -2]), (12, 14, 3)))
    counts = VALID & (ALPHAS > 0.5) & (np.arange(14) >= 4)
    assert_close(term(None, view_of(IMAGE), batch), (1 - np.abs(normals[..., 2]))[counts].mean())


def test_measured_depth_is_the_share_that_it_is_off_weighed_by_trust(x64):
    rendered, measured = RNG.uniform(1, 5, (12, 14)), RNG.uniform(1, 5, (12, 14))
    trust = RNG.random((12, 14))
    rendered[0, :4], measured[1, :4], measured[2, :3] = 0, 0, (np.nan, np.inf, -1)
    is_measured = VALID & (rendered > 0) & np.isfinite(measured) & (measured > 0)
    batch = replace(batch_of(), depth=jnp.asarray(measured), trust=jnp.asarray(trust))

    @jax.jit
    def term(rendered):
        return losses.measured_depth(None, View(None, None, rendered, None), batch)

    off = np.abs(np.log(np.where(is_measured, rendered, 1) / np.where(is_measured, measured, 1)))
    assert_close(term(jnp.asarray(rendered)), (off * trust)[is_measured].sum() / trust[is_measured].sum())
    assert np.isfinite(np.asarray(jax.grad(term)(jnp.asarray(rendered)))).all()
    inner = jnp.asarray(np.where(is_measured, rendered, 3.0))  # Where there is no depth, none may step over zero.
    check_grads(term, (inner,), order=1, modes=["rev"])
    nothing = replace(batch, depth=jnp.zeros((12, 14)))
    assert float(losses.measured_depth(None, View(None, None, inner, None), nothing)) == 0
