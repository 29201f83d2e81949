"""What the host does for several devices, seen on one."""

import jax
import numpy as np
from small_scenes import camera_at, cloud, photographed

from gsjax.scene import batches
from gsjax.training.sharded import layout as sharding
from gsjax.training.sharded import placement as several
from gsjax.training.sharded.step import Exchange
from gsjax.training.stepping import view_order


def test_a_step_whose_exchange_overflows_is_repeated_with_room_which_later_steps_begin_with(monkeypatch):
    taken = []

    def make_sharded_step(optimizer, weights, *, mesh, splat_capacity, **_):
        def step(state, targets, key):
            taken.append(splat_capacity)
            overflowed = splat_capacity < 300
            return state + (not overflowed), "metrics", Exchange(np.int32(300), np.bool_(overflowed))

        return step

    monkeypatch.setattr(several, "make_sharded_step", make_sharded_step)
    room = several.Room()
    step = several._make_step(None, None, mesh=None, room=room)
    assert step(0, None, None) == (1, "metrics")
    assert step(1, None, None) == (2, "metrics")
    assert taken == [several.SLOTS, 2 * several.SLOTS, 2 * several.SLOTS] and room.splats == 2 * several.SLOTS


def test_a_step_of_three_views_takes_those_that_three_steps_would_take():
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0), size=(8, 6)) for x in (-1.0, 0.0, 1.0, 2.0)]
    data = batches.read_targets(photographed(cloud(5), cameras))
    mesh = sharding.mesh_of(jax.devices()[:1])
    target = several._stacked_views(data, 7, 0.5, mesh=mesh, views_per_step=3)
    for step in (0, 1, 5):  # in turn, and after a jump as in a resumed run
        order = [view_order(7, place, 4) for place in range(3 * step, 3 * step + 3)]
        for index, stacked in zip(order, np.asarray(target(step).viewmat), strict=True):
            np.testing.assert_array_equal(stacked, data.targets[index].viewmat)
