"""One compiled step per phase: render, lose, update, accumulate."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

import rasterizer
from gsjax import render, targets
from gsjax.effects import model
from gsjax.effects.model import NO_EFFECTS, Effects
from gsjax.gaussians import Gaussians
from gsjax.numerics import masked_mean
from gsjax.render import Surroundings, View
from gsjax.settings import Weights
from gsjax.targets import Batch, Target
from gsjax.training import optimizers
from gsjax.training.growth.rules import Rule
from gsjax.training.state import TrainState
from gsjax.training.terms import multi_view
from gsjax.training.terms.losses import NEEDS_DEPTH, NEEDS_NEIGHBOR, NEEDS_SURROUNDINGS, TERMS


class Metrics(NamedTuple):
    """What a step reports."""

    loss: Array
    psnr: Array  # of the view that was trained on, before the update
    needed: Array  # pair capacity that the view needed, or its neighbour where that is more
    overflowed: Array  # the capacity was too short: the state was left as it was
    terms: dict[str, Array]


class _Free(NamedTuple):
    """What the objective is differentiated to; what is None is not."""

    gaussians: Gaussians
    probe: Array | None  # of the rule of density control
    numbers: dict[str, Any] | None  # of the effects


TrainStep = Callable[[TrainState, Target, Array], tuple[TrainState, Metrics]]
"""(state, what one view shows, random key) -> (state, metrics). The state is donated."""

Background = Callable[[Array], Array]
"""key -> `[3]` colour under the images of this step."""

BACKGROUNDS: dict[str, Background] = {
    "white": lambda key: jnp.ones(3, jnp.float32),
    "black": lambda key: jnp.zeros(3, jnp.float32),
    "random": lambda key: jax.random.uniform(key, (3,), jnp.float32),
}


def active_terms(weights: Weights) -> dict[str, float]:
    """The terms of non-zero weight; only these are compiled."""
    return {name: weight for name, weight in weights.__dict__.items() if weight != 0}


def make_train_step(
    optimizer: optax.GradientTransformation,
    weights: Weights,
    *,
    capacity: int,
    background: Background,
    sh_every: int,
    rule: Rule | None,
    depth_mode: render.DepthReading = "plane",
    effects: Effects = NO_EFFECTS,
    extent: float = 1.0,
) -> TrainStep:
    """The compiled step of one phase.

    Args:
        optimizer: Over `Gaussians`.
        weights: Of the loss terms.
        capacity: Of the pair buffer. A view that needs more leaves the state untouched and says so.
        background: Colour under the images.
        sh_every: Steps between the bands of the SH ramp.
        rule: Of density control, whose statistics are gathered; None: none are.
        depth_mode: What a splat's depth is, see `gsjax.render.view`.
        effects: Those that stand between the render and the photos; the state and the targets must be made for them.
        extent: Camera extent, scene units: what a term on the density measures errors in, and a rule distances. The
            state must hold the table of the nearest that such a term reads.

    Returns:
        A `TrainStep`.
    """
    terms = active_terms(weights)
    with_depth = not NEEDS_DEPTH.isdisjoint(terms)
    with_neighbor = not NEEDS_NEIGHBOR.isdisjoint(terms)
    with_surroundings = not NEEDS_SURROUNDINGS.isdisjoint(terms)

    def objective(
        free: _Free,
        batch: Batch,
        color: Array,
        active_degree: Array,
        beside: Batch | None,
        surroundings: Surroundings | None,
    ):
        gaussians, probe, numbers = free
        batch = replace(batch, camera=model.aimed(effects, numbers, batch.camera, batch.photo))
        view = render.view(
            gaussians,
            batch.camera,
            capacity=capacity,
            background=model.behind(effects, numbers, batch.camera, color),
            active_degree=active_degree,
            with_depth=with_depth,
            depth_mode=depth_mode,
            **({rule.probes: probe} if rule else {}),
        )
        view = model.photographed(effects, numbers, view, batch, color)
        batch, added = model.trusted(effects, numbers, view, batch)
        pairs = view.splats.pairs
        if beside is not None:
            beside = replace(beside, camera=model.aimed(effects, numbers, beside.camera, beside.photo))
            neighbor = multi_view.rendered(gaussians, beside, capacity, depth_mode)
            view, pairs = view._replace(neighbor=neighbor), _of_both(pairs, neighbor.pairs)
        view = view._replace(surroundings=surroundings)
        total, losses, mse = weighed(terms, rule, gaussians, view, batch)
        total = total if added is None else total + added
        return total, (losses, mse, view.splats.projection, pairs)

    @partial(jax.jit, donate_argnums=0)
    def train_step(state: TrainState, target: Target, key: Array):
        color = background(jax.random.fold_in(key, state.step))
        batch = targets.batch(target, color)
        active_degree = state.step // sh_every
        probe = jnp.zeros((state.gaussians.num_gaussians, 2), jnp.float32) if rule else None
        beside = targets.batch(target.beside, color) if with_neighbor and target.beside else None
        surroundings = None
        if with_surroundings:
            drawing = jax.random.fold_in(jax.random.fold_in(key, state.step), 2)
            surroundings = Surroundings(state.nearest, drawing, extent)
        free = _Free(state.gaussians, probe, None if state.effects is None else state.effects.numbers)
        (total, (losses, mse, projection, pairs)), gradients = jax.value_and_grad(objective, has_aux=True)(
            free, batch, color, active_degree, beside, surroundings
        )
        gaussians, opt_state = optimizers.apply_gradients(
            optimizer, state.gaussians, state.opt_state, gradients.gaussians
        )
        statistics = state.statistics
        if rule:
            seen = in_photo(projection, target.size)
            distances = jnp.where(seen, projection.depths[0], 0) / extent
            statistics = rule.accumulate(statistics, gradients.probe, seen, distances, target.size)
        looks = model.updated(effects, state.effects, gradients.numbers)
        proposed = TrainState(gaussians, opt_state, statistics, state.step + 1, looks, state.nearest)
        # A full buffer means a wrong image: the state stays, the host makes room and repeats the step.
        state = jax.tree.map(lambda old, new: jnp.where(pairs.overflowed, old, new), state, proposed)
        return state, Metrics(total, in_decibels(mse), pairs.needed, pairs.overflowed, losses)

    return train_step


def weighed(
    terms: dict[str, float], rule: Rule | None, gaussians: Gaussians, view: View, batch: Batch
) -> tuple[Any, dict[str, Array], Array]:
    """The weighted sum of the terms, with what a rule adds for its probe; each of them; the mean squared error."""
    losses = {name: TERMS[name](gaussians, view, batch) for name in terms}
    total = sum(weight * losses[name] for name, weight in terms.items())
    if rule:
        total += rule.probed(view, batch)
    mse = masked_mean(jnp.mean(jnp.square(jnp.clip(view.colors, 0, 1) - batch.image), -1), batch.valid)
    return total, losses, mse


def in_decibels(mse: Array) -> Array:
    """PSNR of a mean squared error of colours in 0..1."""
    return -10 * jnp.log10(jnp.maximum(mse, 1e-10))


def _of_both(pairs: rasterizer.TilePairs, others: rasterizer.TilePairs) -> rasterizer.TilePairs:
    """The lists of one view with the need of the longer lists of two."""
    return pairs._replace(
        needed=jnp.maximum(pairs.needed, others.needed), overflowed=pairs.overflowed | others.overflowed
    )


def in_photo(projection: rasterizer.Projection, size: Array) -> Array:
    """`[N]` bool: what shows in a photo of `[2]` width and height, not only in the padding beside it."""
    reaches = projection.means2d[0] - projection.extents[0] < size.astype(jnp.float32)[None]
    return projection.visible[0] & jnp.all(reaches, axis=-1)
