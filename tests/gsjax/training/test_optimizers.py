import jax
import jax.numpy as jnp
import numpy as np
from small_scenes import cloud
from tolerances import assert_close

from gsjax.settings import COLOR_RATE, MEANS_FINAL, OPACITY_RATE, Rates
from gsjax.training.optimizers import apply_gradients, make_optimizer

EXTENT, STEPS = 2.5, 9
SCENE = cloud(6)
SIGNS = jax.tree.map(lambda x: jnp.asarray(np.sign(np.random.default_rng(x.ndim).normal(size=x.shape)), x.dtype), SCENE)


def stepped(rates, count):
    """The scene after steps of constant gradients, beginning with no step; and the last state of the optimizer."""
    optimizer, scenes = make_optimizer(rates, EXTENT, STEPS), [SCENE]
    state = optimizer.init(SCENE)
    step = jax.jit(lambda scene, state: apply_gradients(scene, state, optimizer, SIGNS, jnp.bool_(False)))
    for _ in range(count):
        scene, state = step(scenes[-1], state)
        scenes.append(scene)
    return scenes, state


def test_every_field_moves_by_its_rate_and_that_of_the_means_falls_log_linearly_and_then_stays():
    # From zero moments Adam's first step is the rate times the sign; under a constant gradient it stays the rate.
    scenes, _ = stepped(Rates(), STEPS + 3)
    rates = {
        "means": Rates().means * EXTENT,
        "quats": Rates().quats,
        "log_scales": Rates().scales,
        "logit_opacities": OPACITY_RATE,
        "sh_dc": COLOR_RATE,
        "sh_rest": Rates().sh_rest,
    }
    for name, rate in rates.items():
        change = getattr(scenes[1], name) - getattr(SCENE, name)
        expected = -rate * np.asarray(getattr(SIGNS, name))
        assert_close(change, expected, rtol=2e-3, atol=1e-6, why="float32 difference of values about 1")
    positions = np.stack([np.asarray(scene.means, np.float64) for scene in scenes])
    moved = -np.diff(positions, axis=0) * np.asarray(SIGNS.means)
    share = np.minimum(np.arange(STEPS + 3) / STEPS, 1)
    expected = EXTENT * Rates().means * (MEANS_FINAL / Rates().means) ** share
    np.testing.assert_allclose(moved.mean((1, 2)), expected, rtol=0.02, atol=2e-7)


def test_the_other_rates_fall_in_the_last_third_where_they_are_asked_to():
    rates = make_optimizer(Rates(final_share=0.1), EXTENT, STEPS).rates
    falling = np.array([[rates[name](step) for name in ("log_scales", "sh_dc")] for step in range(12)])
    share = 0.1 ** (np.clip(np.arange(12) - 6, 0, 3) / 3)
    np.testing.assert_allclose(falling, share[:, None] * [Rates().scales, COLOR_RATE], rtol=1e-5)
