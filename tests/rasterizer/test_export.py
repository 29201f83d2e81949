"""A compiled render leaves the process: exported, read back and called."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from jax import export
from scenes import cloud, render
from tolerances import assert_close

SCENE = cloud()


def loss(means, backend="xla"):
    return (render(replace(SCENE, means=means), capacity=2048, backend=backend)[0] ** 2).mean()


MEANS = jax.ShapeDtypeStruct(SCENE.means.shape, np.float32)


def test_jnp_is_exported_and_read_back_with_its_gradient():
    value_and_gradient = jax.jit(jax.value_and_grad(loss))
    exported = export.export(value_and_gradient)(MEANS)
    read_back = export.deserialize(exported.serialize())
    assert_close(read_back.call(SCENE.means), value_and_gradient(SCENE.means))


def test_calls_into_the_loops_of_this_process_are_refused():
    with pytest.raises(ValueError, match="rasterizer_"):
        export.export(jax.jit(lambda means: loss(means, "native")))(MEANS)
