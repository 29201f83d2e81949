from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import cloud
from tolerances import assert_close

from gsjax.settings import MEANS_FINAL, Rates
from gsjax.training.optimizers import apply_gradients, make_optimizer, rearrange_moments

EXTENT, STEPS = 2.5, 8
TAKEN = jnp.bool_(False)
RATES = Rates()
SCENE = cloud(6)
SIGNS = jax.tree.map(lambda x: jnp.asarray(np.sign(np.random.default_rng(x.ndim).normal(size=x.shape)), x.dtype), SCENE)


@pytest.fixture(scope="module")
def optimizer():
    return make_optimizer(RATES, EXTENT, STEPS)


def stepped(optimizer, gradients, count):
    """Means, and everything else, after steps of constant gradients."""
    scene, state, means = SCENE, optimizer.init(SCENE), []
    step = jax.jit(lambda scene, state: apply_gradients(optimizer, scene, state, gradients, TAKEN))
    for _ in range(count):
        scene, state = step(scene, state)
        means.append(scene.means)
    return scene, state, means


def test_the_first_step_moves_every_field_by_its_rate(optimizer):
    # From zero moments Adam's first step is the rate times the sign, whatever the size of the gradient.
    gradients = jax.tree.map(lambda sign: sign * 1e-3, SIGNS)
    scene, _, _ = stepped(optimizer, gradients, 1)
    rates = {
        "means": RATES.means * EXTENT,
        "quats": RATES.quats,
        "log_scales": RATES.scales,
        "logit_opacities": RATES.opacities,
        "sh_dc": RATES.sh_dc,
        "sh_rest": RATES.sh_rest,
    }
    for name, rate in rates.items():
        change = getattr(scene, name) - getattr(SCENE, name)
        expected = -rate * np.asarray(getattr(SIGNS, name))
        assert_close(change, expected, rtol=2e-3, atol=1e-6, why="float32 difference of values about 1")


def test_the_means_rate_falls_log_linearly_and_then_stays(optimizer):
    # Under a constant gradient Adam's corrected step stays the rate itself.
    _, _, means = stepped(optimizer, SIGNS, STEPS + 3)
    positions = np.stack([np.asarray(SCENE.means), *map(np.asarray, means)]).astype(np.float64)
    moved = -np.diff(positions, axis=0) * np.asarray(SIGNS.means)
    share = np.minimum(np.arange(STEPS + 3) / STEPS, 1)
    expected = EXTENT * RATES.means * (MEANS_FINAL / RATES.means) ** share
    np.testing.assert_allclose(moved.mean((1, 2)), expected, rtol=0.02, atol=2e-7)


def test_the_other_rates_fall_in_the_last_third_where_they_are_asked_to():
    optimizer = make_optimizer(Rates(final_share=0.1), EXTENT, 9)
    scene, state = SCENE, optimizer.init(SCENE)
    step = jax.jit(lambda scene, state: apply_gradients(optimizer, scene, state, SIGNS, TAKEN))
    moved = []
    for _ in range(12):
        before = scene
        scene, state = step(scene, state)
        moved.append([np.abs(getattr(scene, name) - getattr(before, name)).mean() for name in ("log_scales", "sh_dc")])
    share = 0.1 ** (np.clip(np.arange(12) - 6, 0, 3) / 3)
    # Under a constant gradient Adam's corrected step stays the rate itself.
    np.testing.assert_allclose(moved, share[:, None] * [RATES.scales, RATES.sh_dc], rtol=0.02)


def moments(state, name):
    leaves = jax.tree.flatten_with_path(state)[0]
    return [np.asarray(leaf) for path, leaf in leaves if jax.tree_util.keystr(path).endswith(f".{name}")]


def test_gaussians_of_any_pixel_filter_are_trained_alike(optimizer):
    results = []
    for name in ("classic", "mip"):
        scene, gradients = (replace(tree, pixel_filter=name) for tree in (SCENE, SIGNS))
        scene, state = apply_gradients(optimizer, scene, optimizer.init(scene), gradients, TAKEN)
        state = rearrange_moments(optimizer, state, jnp.arange(6, dtype=jnp.int32)[::-1], jnp.zeros(6, bool))
        results.append(jax.tree.leaves((scene, state)))
        assert np.any(moments(state, "means"))
    for a, b in zip(*results, strict=True):
        np.testing.assert_array_equal(a, b)
