"""A compiled render leaves the process: exported, read back and called."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest
from jax import export
from scenes import cloud, evaluate
from tolerances import assert_close

SCENE = cloud()


def image_and_gradient(means, backend):
    image, _, _, gradient = evaluate(replace(SCENE, means=means), backend)
    return image, gradient.means


MEANS = jax.ShapeDtypeStruct(SCENE.means.shape, np.float32)


def test_jnp_is_exported_and_read_back_with_its_gradient():
    exported = export.export(jax.jit(partial(image_and_gradient, backend="xla")))(MEANS)
    read_back = export.deserialize(exported.serialize())
    (image, gradient), (expected, slopes) = read_back.call(SCENE.means), image_and_gradient(SCENE.means, "xla")
    assert_close(image, expected)
    assert_close(gradient, slopes, kind="gradient")


def test_calls_into_the_loops_of_this_process_are_refused():
    with pytest.raises(ValueError, match="rasterizer_"):
        export.export(jax.jit(partial(image_and_gradient, backend="native")))(MEANS)
