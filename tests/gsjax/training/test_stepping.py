from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed

from gsjax.errors import InputError
from gsjax.scene import batches
from gsjax.training import stepping
from gsjax.training.optimizers import unless
from gsjax.training.step import BACKGROUNDS, Metrics, guarded_step


@pytest.fixture(scope="module")
def frames():
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    return photographed(cloud(50, seed=5), cameras, with_mattes=True)


def test_an_epoch_shows_every_view_once_in_an_order_of_its_own():
    epochs = [[stepping.view_order(7, 10 * epoch + i, 10) for i in range(10)] for epoch in range(4)]
    assert all(sorted(order) == list(range(10)) for order in epochs)
    assert len({tuple(order) for order in epochs}) == 4
    assert epochs[2] == [stepping.view_order(7, 20 + i, 10) for i in range(10)]  # of (seed, step) alone
    assert epochs[0] != [stepping.view_order(8, i, 10) for i in range(10)]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Toy:
    """A state that remembers which photos it saw, in which order."""

    step: jax.Array
    memory: jax.Array


def toy_program(look):
    """The compiled step of `look(state, target, color, key)` -> gradient, pairs needed and whether these overflow."""

    def differentiate(state, target, color, key):
        gradient, needed, overflowed = look(state, target, color, key)
        return gradient, Metrics(color[0], color[0], needed, jnp.asarray(overflowed), {}), None

    def update(state, gradient, statistics, skipped):
        return unless(skipped, state, Toy(state.step + 1, state.memory * 0.9 + gradient))

    return jax.jit(guarded_step(differentiate, update, BACKGROUNDS["white"]))


def toy_steps(data, capacity, **how):
    """`advance` over a step that needs more and more where it sees one of the three photos, and little elsewhere."""

    def compiled(capacity):
        def look(state, target, color, key):
            needed = jnp.where(target.camera.viewmat[0, 3] > 0.5, target.size[0] << (state.step - 38), 32)
            return jax.random.uniform(key) + target.camera.viewmat[0, 3], needed, needed > capacity

        return toy_program(look)

    records, values = [], {}

    def after(step, state, metrics, capacity):
        records.append((step, capacity, int(metrics.needed)))
        if how.get("looks", lambda step: True)(step):
            values[step] = float(state.memory)
        return state

    state = Toy(jnp.int32(40), jnp.float32(0))
    end, length = stepping.advance(compiled, after, state, data, (0, 9), seed=1, capacity=capacity, **how)
    assert length == records[-1][1]
    return float(end.memory), int(end.step), records, values


def test_a_flag_that_is_read_a_step_late_changes_no_bit(frames):
    """Two steps overflow, and the next photo would fit: the step that was begun with it must leave no trace."""
    data = batches.read_batches(frames)
    photo_code, step, records, values = toy_steps(data, 64)
    assert step == 49 and [each[0] for each in records] == list(range(1, 10))
    assert sorted({capacity for _, capacity, _ in records}) == [4096, 12288], "at the first step and a later one"
    for looks in (lambda step: False, lambda step: step % 3 == 0):
        again = toy_steps(data, 64, looks=looks)
        assert again[:3] == (photo_code, step, records)
        assert again[3] == {step: value for step, value in values.items() if looks(step)}


def test_a_full_device_is_sent_its_photos_one_by_one(frames, monkeypatch, caplog):
    data, fed = batches.read_batches(frames), []
    expected = toy_steps(data, 1 << 16)

    def feed(data, seed, view_share):
        target = stepping.one_view(data, seed, 0.0)

        def of_step(step):
            fed.append(view_share)
            if view_share and step == 2:
                raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes")
            return target(step)

        return of_step

    monkeypatch.setattr(batches, "device_room", lambda share: 1e9 * share)
    assert toy_steps(data, 1 << 16, feed=feed) == expected
    assert fed == [0.5] * 3 + [0.0] * 7
    (record,) = caplog.records
    assert record.message.startswith("the device is full")


@pytest.mark.parametrize("looks", [None, lambda step: step % 2 == 0])
def test_a_step_that_is_not_finite_is_not_taken_nor_is_the_one_that_was_begun_after_it(frames, looks):
    """Also where a state is looked at now and then, so that the next step is begun before the flag is read."""
    data, records, explanations = batches.read_batches(frames), [], []

    def compiled(capacity):
        return toy_program(lambda state, *_: (jnp.where(state.step == 44, jnp.nan, 1.0), 32, False))

    def after(step, state, metrics, capacity):
        records.append((step, bool(np.isfinite(state.memory))))
        return state

    def explain(step, state, target, capacity):
        explanations.append((step, int(state.step), float(state.memory), float(target.camera.viewmat[0, 3])))
        return "the fault"

    state = Toy(jnp.int32(40), jnp.float32(0))
    with pytest.raises(InputError, match="^step 5, the fault; training stops before it and keeps what it saved$"):
        how = {"seed": 1, "capacity": 64, "looks": looks, "explain": explain}
        stepping.advance(compiled, after, state, data, (0, 9), **how)
    assert records == [(step, True) for step in range(1, 5)]
    memory = pytest.approx(1 + 0.9 + 0.9**2 + 0.9**3)
    assert explanations == [(4, 44, memory, float(data.views[stepping.view_order(1, 4, 3)].camera.viewmat[0, 3]))]
