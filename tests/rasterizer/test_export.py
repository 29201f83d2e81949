"""A compiled render leaves the process: exported, read back and called."""

from dataclasses import replace

import jax
import numpy as np
from jax import export
from scenes import cloud, evaluate
from tolerances import assert_close

SCENE = cloud()


def image_and_gradient(means):
    image, _, _, gradient = evaluate(replace(SCENE, means=means), "xla")
    return image, gradient.means


def test_jnp_is_exported_and_read_back_with_its_gradient():
    means = jax.ShapeDtypeStruct(SCENE.means.shape, np.float32)
    exported = export.export(jax.jit(image_and_gradient))(means)
    read_back = export.deserialize(exported.serialize())
    (image, gradient), (expected, slopes) = read_back.call(SCENE.means), image_and_gradient(SCENE.means)
    assert_close(image, expected)
    assert_close(gradient, slopes, kind="gradient")
