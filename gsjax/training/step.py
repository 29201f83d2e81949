"""One compiled step per phase: render, lose, update, accumulate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.sharding import Mesh

import rasterizer
from gsjax import rendering
from gsjax.effects import simulation
from gsjax.effects.simulation import NO_EFFECTS, Effects
from gsjax.gaussians import Gaussians
from gsjax.metrics.images import in_decibels, mse
from gsjax.rendering import View
from gsjax.scene import batches
from gsjax.scene.batches import Batch
from gsjax.training import data_parallel, optimizers
from gsjax.training.densification.rules import DensificationRule
from gsjax.training.dropout import leave_out
from gsjax.training.state import TrainState
from gsjax.training.terms import LossTerm, multi_view, needs

S = TypeVar("S")  # a state of training: a pytree with a field `step`
G = TypeVar("G")  # gradients to what of it is trained
T = TypeVar("T")  # what an update reads in addition to them


class Metrics(NamedTuple):
    """What a step reports."""

    loss: Array
    psnr: Array  # of the view that was trained on, before the update
    needed: Array  # pair capacity that the view needed, or its neighbour where that is more
    overflowed: Array  # the capacity was too short: the state was left as it was
    terms: dict[str, Array]
    finite: Array | bool = True  # loss and gradients are, or the state was left as it was


TrainStep = Callable[[TrainState, Batch, Array], tuple[TrainState, Metrics]]
"""(state, what one view or several stacked ones show, random key) -> (state, metrics). The state is donated."""

Background = Callable[[Array], Array]
"""key -> `[3]` colour under the images of this step."""

BACKGROUNDS: dict[str, Background] = {
    "white": lambda key: jnp.ones(3, jnp.float32),
    "black": lambda key: jnp.zeros(3, jnp.float32),
    "random": lambda key: jax.random.uniform(key, (3,), jnp.float32),
}


def guarded_step(
    differentiate: Callable[[S, Batch, Array, Array], tuple[G, Metrics, T]],
    update: Callable[[S, G, T, Array], S],
    background: Background,
) -> Callable[[S, Batch, Array], tuple[S, Metrics]]:
    """A step that leaves the state as it was where a buffer overflowed, or where loss or gradients are not finite.

    After an overflow the host makes room and repeats the step. After the other it stops.

    Args:
        differentiate: (state, target, colour under the image, key of this step) -> gradients of the loss, metrics, and
            statistics that the update reads in addition.
        update: (state, gradients, statistics, skipped) -> the state after the step, as it was where `skipped`.
        background: Colour under the images.
    """

    def step(state: S, target: Batch, key: Array) -> tuple[S, Metrics]:
        key = jax.random.fold_in(key, state.step)  # pyright: ignore[reportAttributeAccessIssue]
        gradients, metrics, statistics = differentiate(state, target, background(key), key)
        finite = rasterizer.all_finite((metrics.loss, gradients))
        skipped = metrics.overflowed | ~finite
        if target.turn is not None:  # An earlier step overflowed, which the host did not know yet.
            skipped |= state.step != target.turn  # pyright: ignore[reportAttributeAccessIssue]
        return update(state, gradients, statistics, skipped), metrics._replace(finite=finite)

    return step


class _Free(NamedTuple):
    """What the objective is differentiated to; what is None is not."""

    gaussians: Gaussians
    probe: Array | None  # of the rule of densification
    numbers: dict[str, Any] | None  # of the effects


def _free(state: TrainState) -> _Free:
    return _Free(state.gaussians, None, None if state.effects is None else state.effects.numbers)


@dataclass(frozen=True)
class _Objective:
    """The loss of one view and its gradients, as one phase has them."""

    terms: Sequence[LossTerm]
    capacity: int
    sh_every: int
    rule: DensificationRule | None
    depth_mode: rendering.DepthReading
    effects: Effects
    extent: float
    dropout: float

    def one_view(self, state: TrainState, target: Batch, color: Array, key: Array) -> tuple[_Free, Metrics, Any]:
        """Gradients of the loss of one view, its metrics, and the statistics of densification with this view."""
        return self._add_view(state.statistics, state, target, color, key)

    def several_views(self, state: TrainState, views: Batch, color: Array, key: Array) -> tuple[_Free, Metrics, Any]:
        """The same of the stacked views of all devices: means of gradients and metrics, sums of statistics."""

        def add_view(sums: tuple[_Free, Any], target: Batch):
            gradients, metrics, statistics = self._add_view(sums[1], state, target, color, key)
            return (jax.tree.map(jnp.add, sums[0], gradients._replace(probe=None)), statistics), metrics

        zeros = jax.tree.map(jnp.zeros_like, (_free(state), state.statistics))
        sums, of_views = jax.lax.scan(add_view, zeros, views)
        gradients, added = jax.lax.psum(sums, data_parallel.AXIS)
        count = of_views.loss.shape[0] * jax.lax.axis_size(data_parallel.AXIS)
        gradients = jax.tree.map(lambda total: total / count, gradients)
        statistics = jax.tree.map(jnp.add, state.statistics, added)
        return gradients, _of_all_views(of_views, self.capacity), statistics

    def _add_view(
        self, statistics: Any, state: TrainState, target: Batch, color: Array, key: Array
    ) -> tuple[_Free, Metrics, Any]:
        batch = batches.decode(target, color)
        has_neighbor = "neighbor" in needs(self.terms) and target.neighbor
        neighbor = batches.decode(target.neighbor, color) if has_neighbor else None
        probe = jnp.zeros((state.gaussians.num_gaussians, 2), jnp.float32) if self.rule else None
        (total, (losses, error, projection, pairs)), gradients = jax.value_and_grad(self._loss, has_aux=True)(
            _free(state)._replace(probe=probe), state, batch, neighbor, color, key
        )
        if self.rule:
            is_visible = in_photo(projection, target.size)
            distances = jnp.where(is_visible, projection.depths[0], 0) / self.extent
            statistics = self.rule.accumulate(statistics, gradients.probe, is_visible, distances, target.size)
        return gradients, Metrics(total, in_decibels(error), pairs.needed, pairs.overflowed, losses), statistics

    def _loss(self, free: _Free, state: TrainState, batch: Batch, neighbor: Batch | None, color: Array, key: Array):
        gaussians, probe, numbers = free
        needed, effects = needs(self.terms), self.effects
        move_camera = partial(simulation.move_camera, effects, numbers)
        batch = replace(batch, camera=move_camera(batch.camera, batch.photo))
        remaining = leave_out(gaussians, self.dropout, jax.random.fold_in(key, 3)) if self.dropout else gaussians
        view = rendering.render(
            remaining,
            batch.camera,
            capacity=self.capacity,
            background=simulation.light_behind(effects, numbers, batch.camera, color),
            active_degree=state.step // self.sh_every,
            with_depth="depth" in needed,
            depth_mode=self.depth_mode,
            with_axes="axes" in needed,
            **({self.rule.probes: probe} if self.rule else {}),
        )
        view = simulation.photograph(effects, numbers, view, batch, color)
        batch, added = simulation.mask_untrusted(effects, numbers, view, batch)
        pairs = view.splats.pairs
        if neighbor is not None:
            neighbor = replace(neighbor, camera=move_camera(neighbor.camera, neighbor.photo))
            rendered = multi_view.render_neighbor(remaining, neighbor, self.capacity, self.depth_mode)
            view = view._replace(neighbor=rendered)
            assert pairs is not None, "both views list their splats"
            longest = jnp.maximum(pairs.needed, rendered.pairs.needed)
            pairs = pairs._replace(needed=longest, overflowed=pairs.overflowed | rendered.pairs.overflowed)
        total, losses, error = weighted_loss(self.terms, self.rule, gaussians, view, batch)
        total = total if added is None else total + added
        return total, (losses, error, view.splats.projection, pairs)


def make_train_step(
    optimizer: optimizers.Optimizer,
    terms: Sequence[LossTerm],
    *,
    capacity: int,
    background: Background,
    sh_every: int,
    rule: DensificationRule | None,
    depth_mode: rendering.DepthReading = "plane",
    effects: Effects = NO_EFFECTS,
    extent: float = 1.0,
    dropout: float = 0.0,
    mesh: Mesh | None = None,
) -> TrainStep:
    """The compiled step of one phase.

    Args:
        optimizer: Over `Gaussians`.
        terms: Of the loss, see `gsjax.training.terms.weigh_terms`.
        capacity: Of the pair buffer. A view that needs more leaves the state untouched and says so.
        background: Colour under the images.
        sh_every: Steps between the bands of the SH ramp.
        rule: Of densification, whose statistics are gathered; None: none are.
        depth_mode: What a splat's depth is, see `gsjax.rendering`.
        effects: Those that are between the render and the photos; the state and the targets must be made for them.
        extent: Camera extent, scene units: what a rule measures distances in.
        dropout: Share of the Gaussians that each step leaves out, see `gsjax.training.dropout`. 0: none.
        mesh: Devices that share the views of a step, see `gsjax.training.data_parallel`. None: a step takes one view.

    Returns:
        A `TrainStep`. With a mesh it takes stacked targets and descends the mean of their losses. The loss, the terms
        and the PSNR are means over the views, `needed` is the largest.
    """
    objective = _Objective(terms, capacity, sh_every, rule, depth_mode, effects, extent, dropout)
    differentiate = objective.several_views if mesh else objective.one_view
    step = guarded_step(differentiate, partial(_update, optimizer, effects), background)
    if mesh:
        step = data_parallel.on_mesh(step, mesh)

    @partial(jax.jit, donate_argnums=0)
    def train_step(state: TrainState, target: Batch, key: Array) -> tuple[TrainState, Metrics]:
        return step(state, target, key)

    return train_step


_shared_train_step = lru_cache(maxsize=32)(make_train_step)


def kept_step(
    optimizer: optimizers.Optimizer, terms: tuple[LossTerm, ...], *, effects: Effects = NO_EFFECTS, **how: Any
) -> TrainStep:
    """`make_train_step`, the same for the same arguments: the next run of this plan finds its programs compiled.

    A term whose function is another is another argument. Effects have numbers of their run, so that steps with them
    are made anew.
    """
    if effects:
        return make_train_step(optimizer, terms, effects=effects, **how)
    return _shared_train_step(optimizer, terms, **how)


def _update(
    optimizer: optimizers.Optimizer,
    effects: Effects,
    state: TrainState,
    gradients: _Free,
    statistics: Any,
    skipped: Array,
) -> TrainState:
    gaussians, opt_state = optimizers.apply_gradients(
        state.gaussians, state.opt_state, optimizer, gradients.gaussians, skipped
    )
    before = state.statistics, state.step, state.effects
    after = statistics, state.step + 1, simulation.update_effects(effects, state.effects, gradients.numbers)
    statistics, step, looks = optimizers.unless(skipped, before, after)
    return replace(state, gaussians=gaussians, opt_state=opt_state, statistics=statistics, step=step, effects=looks)


def _of_all_views(metrics: Metrics, capacity: int) -> Metrics:
    """What a step over the views of all devices reports, from the `[K]` metrics of each view of this device."""

    def mean(values: Array) -> Array:
        return jax.lax.pmean(jnp.mean(values), data_parallel.AXIS)

    loss, psnr, terms = jax.tree.map(mean, (metrics.loss, metrics.psnr, metrics.terms))
    needed = jax.lax.pmax(jnp.max(metrics.needed), data_parallel.AXIS)
    return Metrics(loss, psnr, needed, needed > capacity, terms)


def weighted_loss(
    terms: Sequence[LossTerm], rule: DensificationRule | None, gaussians: Gaussians, view: View, batch: Batch
) -> tuple[Any, dict[str, Array], Array]:
    """The weighted sum of the terms, with what a rule adds for its probe; each of them; the mean squared error."""
    losses = {each.name: each.term.loss(gaussians, view, batch) for each in terms}
    total = sum(each.weight * losses[each.name] for each in terms)
    if rule:
        total += rule.probe_loss(view, batch)
    return total, losses, mse(jnp.clip(view.colors, 0, 1), batch.image, batch.valid)


def in_photo(projection: rasterizer.Projection, size: Array) -> Array:
    """`[N]` bool: what shows in a photo of `[2]` width and height, not only in the padding next to it."""
    reaches = projection.means2d[0] - projection.extents[0] < size.astype(jnp.float32)[None]
    return projection.visible[0] & jnp.all(reaches, axis=-1)
