"""Density control on several devices: decided about all Gaussians at once, carried out by rows.

Every device sees position, shape, opacity and statistics of all Gaussians for as long as a densification takes, some 60
bytes each, and comes by the rule's own code to the same decision as one device would, thresholds and ranks and random
numbers included. Then it keeps its own rows. Moments stay where they are, since newborns have none; the colours' shards
go round the devices once, and each takes what its newborns inherit. Births take the free rows in the order of their
numbers, and numbers are dealt to the devices in turn: so the counts stay as even as deaths are.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jax.sharding import Mesh

from gsjax.settings import Density
from gsjax.training import buffers, optimizers, state
from gsjax.training.growth.rules import Rule, rule_named
from gsjax.training.sharded.layout import all_rows, fetch_rows, on_shards, own_rows
from gsjax.training.state import TrainState


@partial(jax.jit, static_argnames=("mesh", "optimizer", "density", "budget", "rule"), donate_argnums=0)
def densify(
    state: TrainState,
    key: Array,
    extent: Array,
    prune_large: Array,
    *,
    mesh: Mesh,
    optimizer: optax.GradientTransformation,
    density: Density,
    budget: int,
    rule: Rule | None = None,
) -> TrainState:
    """`gsjax.training.state.densify` of a state by rows: the same Gaussians in the same rows."""
    rule = rule or rule_named(density.rule)

    def local(state: TrainState, key: Array, extent: Array, prune_large: Array) -> TrainState:
        own = state.gaussians
        outlines = all_rows(replace(own, sh_dc=own.sh_dc[:, :0], sh_rest=own.sh_rest[:, :0]))
        statistics = all_rows(state.statistics)
        count = rule.wanted_count(outlines, statistics, density, step=state.step, budget=budget)
        decided = rule.densify(
            outlines,
            statistics,
            jax.random.fold_in(key, state.step),
            density=density,
            extent=extent,
            prune_large=prune_large,
            count=count,
        )
        outlines, moved = own_rows(decided)
        colors = fetch_rows({"sh_dc": own.sh_dc, "sh_rest": own.sh_rest}, moved.source)
        # What comes from another row has moments of its own: none.
        stay = jnp.arange(own.num_gaussians, dtype=jnp.int32)
        opt_state = optimizers.rearrange_moments(optimizer, state.opt_state, stay, moved.fresh)
        statistics = rule.empty_statistics(own.num_gaussians)
        return replace(state, gaussians=replace(outlines, **colors), opt_state=opt_state, statistics=statistics)

    return on_shards(local, mesh, state, key, extent, prune_large)


@partial(jax.jit, static_argnames=("mesh", "optimizer", "limit"), donate_argnums=0)
def reset_opacities(
    sharded: TrainState, *, mesh: Mesh, optimizer: optax.GradientTransformation, limit: float
) -> TrainState:
    """`gsjax.training.state.reset_opacities` of a state by rows."""
    return on_shards(partial(state.reset_opacities, optimizer=optimizer, limit=limit), mesh, sharded)


@partial(jax.jit, static_argnames=("mesh", "optimizer", "min_opacity"), donate_argnums=0)
def cull(sharded: TrainState, *, mesh: Mesh, optimizer: optax.GradientTransformation, min_opacity: float) -> TrainState:
    """`gsjax.training.state.cull` of a state by rows."""
    return on_shards(partial(state.cull, optimizer=optimizer, min_opacity=min_opacity), mesh, sharded)


def with_room_to_densify(
    sharded: TrainState,
    optimizer: optax.GradientTransformation,
    density: Density,
    most: int,
    *,
    mesh: Mesh,
    rule: Rule | None = None,
) -> TrainState:
    """`gsjax.training.buffers.with_room_to_densify` of a state by rows; the rows stay a multiple of the devices."""

    def lengthen(sharded: TrainState, optimizer: optax.GradientTransformation, total: int) -> TrainState:
        of_shard = partial(buffers.lengthen, optimizer=optimizer, rows=-(-total // mesh.size))
        return jax.jit(partial(on_shards, of_shard, mesh))(sharded)

    return buffers.with_room_to_densify(sharded, optimizer, density, most, rule=rule, lengthen=lengthen)
