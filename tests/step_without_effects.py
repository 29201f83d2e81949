"""The compiled step of a program that never heard of effects: what one without effects must still be."""

from functools import partial

import jax
import jax.numpy as jnp

import rasterizer
from gsjax import rendering
from gsjax.metrics.images import mse
from gsjax.scene import batches
from gsjax.training import optimizers
from gsjax.training.state import TrainState
from gsjax.training.step import Metrics, in_photo
from gsjax.training.terms import needs


def make_train_step(optimizer, terms, *, capacity, background, sh_every, rule, depth_mode="plane", extent=1.0):
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
        moved = optimizers.apply_gradients(optimizer, state.gaussians, state.opt_state, gradients[0], skipped)
        others = optimizers.unless(skipped, (state.statistics, state.step), (statistics, state.step + 1))
        state = TrainState(*moved, *others)
        return state, Metrics(total, psnr, pairs.needed, pairs.overflowed, losses, finite)

    return train_step
