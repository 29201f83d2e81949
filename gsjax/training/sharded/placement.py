"""A run on several devices: what `gsjax.training.loop.fit` hands to where its Gaussians lie."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.sharding import Mesh, NamedSharding

import rasterizer
from gsjax import rendering
from gsjax.effects.simulation import NO_EFFECTS, Effects
from gsjax.gaussians import Gaussians
from gsjax.scene.batches import Target, Targets
from gsjax.scene.cameras import Camera
from gsjax.training.capacity import STILL, rounded_capacity
from gsjax.training.loop import Placement
from gsjax.training.sharded import growth as sharded_density
from gsjax.training.sharded.layout import AXIS, BY_ROWS, EVERYWHERE, specs
from gsjax.training.sharded.step import make_sharded_step
from gsjax.training.state import TrainState
from gsjax.training.step import Metrics, TrainStep
from gsjax.training.stepping import view_order
from gsjax.training.terms import Weighed

SLOTS = 256  # splats that buffers of the exchange are multiples of


@dataclass
class Room:
    """How many splats a device may send to a view: what one program needed, the next one begins with."""

    splats: int = SLOTS

    def make(self, needed: int, headroom: float) -> None:
        """Room for `needed` splats and some to come."""
        self.splats = -(-int(needed * headroom + 1) // SLOTS) * SLOTS


def placement(mesh: Mesh, views_per_step: int) -> Placement:
    """Gaussians by rows over the devices of a mesh (`gsjax.training.sharded.layout`), so many views a step.

    Args:
        mesh: The devices; of several processes, all of them.
        views_per_step: A multiple of the devices.
    """
    room = Room()
    return Placement(
        feed=partial(_stacked_views, mesh=mesh, views_per_step=views_per_step),
        make_step=partial(_make_step, mesh=mesh, room=room),
        chosen_capacity=partial(_chosen_capacity, mesh=mesh, room=room),
        with_room_to_densify=partial(sharded_density.with_room_to_densify, mesh=mesh),
        densify=partial(sharded_density.densify, mesh=mesh),
        reset_opacities=partial(sharded_density.reset_opacities, mesh=mesh),
        cull=partial(sharded_density.cull, mesh=mesh),
        shorten=lambda state, optimizer, most: state,  # Its rows would have to move between devices.
    )


def _stacked_views(
    data: Targets, seed: int, view_share: float, *, mesh: Mesh, views_per_step: int
) -> Callable[[int], Target]:
    """A `Feed`: the views that one device would take one by one, so many at a time, each on its device.

    They are streamed: of any step, a device holds its own views and those of the next.
    """
    del view_share
    by_device = NamedSharding(mesh, BY_ROWS)

    def placed(*photos: np.ndarray) -> Array:
        stacked = np.stack(photos)
        return jax.make_array_from_callback(stacked.shape, by_device, lambda index: stacked[index])

    def stacked(step: int) -> Target:
        places = range(step * views_per_step, (step + 1) * views_per_step)
        return jax.tree.map(placed, *(data.targets[view_order(seed, place, data.num_views)] for place in places))

    ahead: dict[int, Target] = {}

    def target(step: int) -> Target:
        here = ahead.pop(step) if step in ahead else stacked(step)
        ahead.clear()
        ahead[step + 1] = stacked(step + 1)
        return here

    return target


def _make_step(
    optimizer: optax.GradientTransformation,
    terms: tuple[Weighed, ...],
    *,
    mesh: Mesh,
    room: Room,
    effects: Effects = NO_EFFECTS,
    dropout: float = 0.0,
    **options: Any,
) -> TrainStep:
    """A `TrainStep` that makes room for the exchange by itself and repeats: the state was left as it was."""
    assert not effects, "effects have numbers of photos, which are on other devices"
    assert not dropout, "every device would leave out others"

    @cache
    def compiled(splat_capacity: int):
        return make_sharded_step(optimizer, terms, mesh=mesh, splat_capacity=splat_capacity, **options)

    def train_step(state: TrainState, targets: Target, key: Array) -> tuple[TrainState, Metrics]:
        state, metrics, exchange = compiled(room.splats)(state, targets, key)
        while bool(exchange.overflowed):
            room.make(int(exchange.needed), STILL)
            state, metrics, exchange = compiled(room.splats)(state, targets, key)
        return state, metrics

    return train_step


def _chosen_capacity(gaussians: Gaussians, data: Targets, *, headroom: float, mesh: Mesh, room: Room) -> int:
    """Pair capacity that holds every view with room to grow; the exchange gets its room too."""
    viewmats, Ks = (np.stack([getattr(target, name) for target in data.targets]) for name in ("viewmat", "K"))
    pairs, splats = _largest_needs(gaussians, Camera(viewmats, Ks, *data.size), mesh=mesh)
    room.make(int(splats), headroom)
    return rounded_capacity(int(pairs), headroom)


@partial(jax.jit, static_argnames="mesh")
def _largest_needs(gaussians: Gaussians, cameras: Camera, *, mesh: Mesh) -> tuple[Array, Array]:
    """The most pairs of any view, and the most splats that any device has for one."""

    def local(gaussians: Gaussians, cameras: Camera):
        scene = rendering.drawable(gaussians)

        def needs(camera: Camera) -> tuple[Array, Array]:
            projection, _ = rendering.projected(scene, camera, "center")
            pairs = rasterizer.count_pairs(projection, rendering.tile_grid(camera))
            return jax.lax.psum(pairs, AXIS), jnp.sum(projection.visible, dtype=jnp.int32)

        pairs, splats = jax.tree.map(jnp.max, jax.lax.map(needs, cameras))
        return pairs, jax.lax.pmax(splats, AXIS)

    by_rows = specs(gaussians), EVERYWHERE
    return jax.shard_map(local, mesh=mesh, in_specs=by_rows, out_specs=EVERYWHERE, check_vma=False)(gaussians, cameras)
