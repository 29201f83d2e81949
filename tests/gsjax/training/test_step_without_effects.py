"""What is off is absent: a step without effects is the program of a step that never heard of them."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import pytest
from small_scenes import camera_at, cloud, photographed

import rasterizer
from gsjax import rendering
from gsjax.metrics.images import mse
from gsjax.scene import batches
from gsjax.settings import Rates, Weights
from gsjax.training import optimizers
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import TrainState, initial_state
from gsjax.training.step import BACKGROUNDS, Metrics, in_photo, make_train_step
from gsjax.training.terms import needs, weigh_terms

OPTIMIZER = make_optimizer(Rates(means=2e-3), 1.0, 200)
ADDRESS = re.compile(r"0x[0-9a-f]+")  # Of functions, in the text of a program.
PHOTOS, ENTROPY = (weigh_terms(Weights(alpha=0.0, entropy=entropy)) for entropy in (0.0, 0.1))


def simple_train_step(optimizer, terms, *, capacity, background, sh_every, rule, depth_mode="plane", extent=1.0):
    with_depth = "depth" in needs(terms)

    def objective(gaussians, probe, state, batch, color):
        view = rendering.render(
            gaussians,
            batch.camera,
            capacity=capacity,
            background=color,
            active_degree=state.step // sh_every,
            with_depth=with_depth,
            depth_mode=depth_mode,
            **({rule.probes: probe} if rule else {}),
        )
        losses = {each.name: each.term.loss(gaussians, view, batch) for each in terms}
        total = sum(each.weight * losses[each.name] for each in terms)
        if rule:
            total += rule.probe_loss(view, batch)
        error = mse(jnp.clip(view.colors, 0, 1), batch.image, batch.valid)
        return total, (losses, error, view.splats.projection, view.splats.pairs)

    @partial(jax.jit, donate_argnums=0)
    def train_step(state, target, key):
        color = background(jax.random.fold_in(key, state.step))
        batch = batches.decode(target, color)
        probe = jnp.zeros((state.gaussians.num_gaussians, 2), jnp.float32) if rule else None
        gradient = jax.value_and_grad(objective, argnums=(0, 1) if rule else (0,), has_aux=True)
        (total, (losses, error, projection, pairs)), gradients = gradient(state.gaussians, probe, state, batch, color)
        psnr = -10 * jnp.log10(jnp.maximum(error, 1e-10))
        statistics = state.statistics
        if rule:
            is_visible = in_photo(projection, target.size)
            distances = jnp.where(is_visible, projection.depths[0], 0) / extent
            statistics = rule.accumulate(statistics, gradients[1], is_visible, distances, target.size)
        finite = rasterizer.all_finite((total, gradients))
        skipped = pairs.overflowed | ~finite
        moved = optimizers.apply_gradients(state.gaussians, state.opt_state, optimizer, gradients[0], skipped)
        others = optimizers.unless(skipped, (state.statistics, state.step), (statistics, state.step + 1))
        state = TrainState(*moved, *others)
        return state, Metrics(total, psnr, pairs.needed, pairs.overflowed, losses, finite)

    return train_step


@pytest.mark.parametrize(("rule", "terms"), [("adc", PHOTOS), ("error", PHOTOS), (None, ENTROPY)])
def test_a_step_without_effects_is_that_of_a_program_that_never_heard_of_them(rule, terms):
    """Nor of Gaussians that are left out."""
    camera = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), size=(32, 32))
    (target,) = batches.read_batches(photographed(cloud(200, seed=5), [camera])).views
    state = initial_state(cloud(180, capacity=200, seed=1), OPTIMIZER, DENSIFICATION_RULES[rule or "adc"])
    how = {
        "capacity": 8192,
        "background": BACKGROUNDS["black"],
        "sh_every": 2,
        "rule": rule and DENSIFICATION_RULES[rule],
    }

    def program(step) -> str:
        return ADDRESS.sub("", str(jax.make_jaxpr(step)(state, target, jax.random.key(0))))

    ours, theirs = make_train_step(OPTIMIZER, terms, dropout=0.0, **how), simple_train_step(OPTIMIZER, terms, **how)
    assert program(ours) == program(theirs)
