"""The compiled step on several devices: Gaussians by rows, views by device.

Every device projects its own Gaussians into every view of the step; the splats that show there change places, so that
each device bins and blends its own view and loses on it; the gradients go back the same way, and every device updates
its own rows.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jax.sharding import Mesh

import rasterizer
from gsjax import rendering
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.metrics.images import in_decibels
from gsjax.scene import batches
from gsjax.scene.batches import Target
from gsjax.scene.cameras import Camera
from gsjax.training import optimizers
from gsjax.training.growth.rules import Rule
from gsjax.training.sharded.layout import AXIS, BY_ROWS, EVERYWHERE, specs
from gsjax.training.state import TrainState
from gsjax.training.step import Background, Metrics, Outcome, guarded_step, in_photo, weighted_loss
from gsjax.training.terms import Weighed, needs


class Exchange(NamedTuple):
    """What the exchange of a step reports."""

    needed: Array  # [] int32 the most splats that a device had for one view
    overflowed: Array  # the capacity was too short: the state was left as it was


ShardedStep = Callable[[TrainState, Target, Array], tuple[TrainState, Metrics, Exchange]]
"""(state by rows, `[V]` stacked targets by device, random key) -> (state, metrics, exchange). The state is donated."""


class _Seen(NamedTuple):
    """What one round tells beside the gradients: one view a device."""

    total: Array
    losses: dict[str, Array]
    psnr: Array
    pairs: Array  # needed
    splats: Array  # needed, by this device for any of the views


def make_sharded_step(
    optimizer: optax.GradientTransformation,
    terms: Sequence[Weighed],
    *,
    mesh: Mesh,
    splat_capacity: int,
    capacity: int,
    background: Background,
    sh_every: int,
    rule: Rule | None,
    depth_mode: rendering.DepthReading = "plane",
    extent: float = 1.0,
) -> ShardedStep:
    """The compiled step of one phase over V views, a multiple of the D devices: the mean of the V losses is descended.

    Value, gradients and growth statistics are those of one device that takes the same views one by one, to float32's
    rounding. Every device takes V / D of them in turn.

    Args:
        optimizer: Over `Gaussians`; it treats rows alike and by themselves.
        terms: Of the loss; none may need a neighbour.
        mesh: The devices, see `gsjax.training.sharded.layout`.
        splat_capacity: The most splats that one device sends to one view.
        capacity: Of a view's pair buffer. A step that needs more of either leaves the state untouched and says so.
        background: Colour under the images, one for all views of a step.
        sh_every: Steps between the bands of the SH ramp.
        rule: Of density control, whose statistics are gathered; None: none are.
        depth_mode: What a splat's depth is, see `gsjax.rendering`.
        extent: Camera extent, scene units.

    Returns:
        A `ShardedStep`. Its loss, terms and PSNR are means over the views, `needed` are the largest.
    """
    needed = needs(terms)
    reading = depth_mode if "depth" in needed else None
    splat_depth = rendering.splat_depth_mode(reading)
    with_axes, with_shapes = "axes" in needed, "gaussians" in needed
    after_axes = 6 if with_axes else 3  # columns of an exchanged row's features, of which colours are the first
    unpack = partial(rasterizer.unpack, with_slopes=splat_depth == "plane")

    def objective(free: tuple[Gaussians, Array | None], target: Target, color: Array, active_degree: Array):
        gaussians, probe = free
        batch = batches.batch(target, color)
        scene = rendering.drawable(gaussians)

        @jax.checkpoint
        def pack(camera: Camera) -> rasterizer.Packed:
            projection, opacities = rendering.projected(scene, camera, splat_depth)
            features = [rendering.colors(scene, camera, active_degree)]
            if with_axes:
                features.append(rendering.facing_axes(scene, camera, projection))
            if with_shapes:
                features.append(_shapes(gaussians))
            return rasterizer.pack(projection, opacities, jnp.concatenate(features, -1), splat_capacity)

        # One view after the other: no array has a row for every Gaussian and every view.
        packed = jax.lax.map(pack, jax.tree.map(partial(jax.lax.all_gather, axis_name=AXIS), batch.camera))
        rows = packed.rows if rule is None else _probed(rule, packed.rows, probe)
        projection, opacities, features = unpack(rasterizer.exchange(rows, AXIS))
        splats = rendering.binned(projection, opacities, batch.camera, capacity)
        extra = features[:, -2:] if rule and rule.probes == "extra" else None
        axes = features[:, 3:after_axes] if with_axes else None
        view = rendering.view_splats(splats, features[:, :3], color, reading=reading, extra=extra, axes=axes)
        shown = _shaped(features[:, after_axes : after_axes + 11]) if with_shapes else _Undeclared()
        total, losses, mse = weighted_loss(terms, rule, shown, view, batch)  # pyright: ignore[reportArgumentType]
        assert splats.pairs is not None, "a capacity is given"
        return total, (_Seen(total, losses, in_decibels(mse), splats.pairs.needed, jnp.max(packed.needed)), packed)

    def counted(rule: Rule, statistics: Any, shares: Array, packed: rasterizer.Packed, sizes: Array):
        """The statistics after all devices' views, one after the other: `shares` `[D, K, 2]` gradients to the probe."""

        def one_view(statistics, of_view):
            shares, rows, ids, size = of_view
            projection, _, _ = unpack(rows)
            seen = in_photo(projection, size)
            distances = jnp.where(seen, projection.depths[0], 0) / extent
            count = jax.tree.leaves(statistics)[0].shape[0]

            def by_row(slots: Array) -> Array:
                return jnp.zeros((count, *slots.shape[1:]), slots.dtype).at[ids].set(slots, mode="drop")

            return rule.accumulate(statistics, by_row(shares), by_row(seen), by_row(distances), size), None

        return jax.lax.scan(one_view, statistics, (shares, packed.rows, packed.ids, sizes))[0]

    def differentiate(state: TrainState, targets: Target, color: Array, key: Array) -> tuple[Gaussians, Outcome]:
        del key
        probe = jnp.zeros((mesh.size, splat_capacity, 2), jnp.float32) if rule else None

        def one_round(carry, target: Target):
            gradients, statistics = carry
            (gradient, shares), (seen, packed) = jax.grad(objective, has_aux=True)(
                (state.gaussians, probe), target, color, state.step // sh_every
            )
            if rule:
                statistics = counted(rule, statistics, shares, packed, jax.lax.all_gather(target.size, AXIS))
            return (jax.tree.map(jnp.add, gradients, gradient), statistics), seen

        start = jax.tree.map(jnp.zeros_like, state.gaussians), state.statistics
        (gradients, statistics), seen = jax.lax.scan(one_round, start, targets)
        num_views = mesh.size * seen.total.shape[0]
        pairs, splats = (jax.lax.pmax(jnp.max(needed), AXIS) for needed in (seen.pairs, seen.splats))
        total, losses, psnr = jax.tree.map(lambda each: jax.lax.pmean(jnp.mean(each), AXIS), seen[:3])
        metrics = Metrics(total, psnr, pairs, pairs > capacity, losses)
        exchange = Exchange(splats, splats > splat_capacity)
        outcome = Outcome(metrics, metrics.overflowed | exchange.overflowed, (statistics, exchange))
        return jax.tree.map(lambda total: total / num_views, gradients), outcome

    def update(state: TrainState, gradients: Gaussians, outcome: Outcome, targets: Target) -> TrainState:
        del targets
        gaussians, opt_state = optimizers.apply_gradients(optimizer, state.gaussians, state.opt_state, gradients)
        return TrainState(gaussians, opt_state, outcome.seen[0], state.step + 1)

    def on_all(flag: Array) -> Array:
        return jax.lax.pmin(flag.astype(jnp.int32), AXIS) > 0

    step = guarded_step(differentiate, update, background, on_all)

    def local_step(state: TrainState, targets: Target, key: Array) -> tuple[TrainState, Metrics, Exchange]:
        state, outcome = step(state, targets, key)
        return state, outcome.metrics, outcome.seen[1]

    @partial(jax.jit, donate_argnums=0)
    def train_step(state: TrainState, targets: Target, key: Array):
        by_rows = specs(state)
        return jax.shard_map(
            local_step,
            mesh=mesh,
            in_specs=(by_rows, BY_ROWS, EVERYWHERE),
            out_specs=(by_rows, EVERYWHERE, EVERYWHERE),
            check_vma=False,
        )(state, targets, key)

    return train_step


class _Undeclared:
    """Stands for Gaussians where no term said that it needs them: those of other devices are not at hand."""

    def __getattr__(self, name: str) -> Any:
        raise InputError(f"a term of the loss reads gaussians.{name}: on several devices its needs have to name them")


def _probed(rule: Rule, rows: Array, probe: Array) -> Array:
    """`[D, K, W]` rows with the probe where `gsjax.rendering` has it: in the means, or as two channels more."""
    if rule.probes == "extra":
        return jnp.concatenate([rows, probe], -1)
    return rows.at[..., :2].add(probe)


def _shapes(gaussians: Gaussians) -> Array:
    """`[N, 11]` what terms on Gaussians read of them: all but colours."""
    parts = gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities[:, None]
    return jnp.concatenate(parts, -1)


def _shaped(shapes: Array) -> Gaussians:
    """The Gaussians of `_shapes`, without colours."""
    means, quats, log_scales, logits = jnp.split(shapes, [3, 7, 10], -1)
    no_colors = jnp.zeros((len(shapes), 0, 3), shapes.dtype)
    return Gaussians(means, quats, log_scales, logits[:, 0], no_colors, no_colors)
