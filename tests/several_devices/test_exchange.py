"""The exchange among four devices: what arrives, and what comes back."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from tolerances import assert_close

import rasterizer
from gsjax.training.sharded import layout as sharding

SLOTS, COLUMNS = 3, 2


def swapped(rows):
    """`[D * V, K, W]`, each device's buffers after the other's -> `[D * V * K, W]`, what each received."""
    mesh = sharding.mesh_of(jax.devices()[:4])
    exchange = partial(rasterizer.exchange, axis_name=sharding.AXIS)
    by_device = sharding.BY_ROWS
    return jax.shard_map(exchange, mesh=mesh, in_specs=by_device, out_specs=by_device, check_vma=False)(rows)


def test_what_a_device_packs_for_a_view_comes_to_that_views_device():
    rows = jnp.arange(16 * SLOTS * COLUMNS, dtype=jnp.float32).reshape(16, SLOTS, COLUMNS)
    expected = np.asarray(rows).reshape(4, 4, SLOTS, COLUMNS).swapaxes(0, 1).reshape(-1, COLUMNS)
    assert_close(jax.jit(swapped)(rows), expected)


def test_gradients_come_back_the_same_way():
    rows, there = (jax.random.normal(key, (16, SLOTS, COLUMNS)) for key in jax.random.split(jax.random.key(0)))
    gradient = jax.jit(jax.grad(lambda rows: jnp.sum(swapped(rows) * there.reshape(-1, COLUMNS))))(rows)
    expected = np.asarray(there).reshape(4, 4, SLOTS, COLUMNS).swapaxes(0, 1).reshape(16, SLOTS, COLUMNS)
    assert_close(gradient, expected)
