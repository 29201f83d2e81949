"""What callers hand over for an array: lists and numbers are served, what is no array is named in one line."""

import jax.numpy as jnp
import numpy as np
from scenes import cloud

from rasterizer import rasterization

SCENE = cloud()
ARRAYS = {name: np.asarray(getattr(SCENE, name)) for name in ("means", "quats", "scales", "opacities", "colors")}
ARRAYS |= {"viewmats": np.asarray(SCENE.viewmats), "Ks": np.asarray(SCENE.Ks)}


def image(**changes):
    return rasterization(**{**ARRAYS, **changes}, width=SCENE.width, height=SCENE.height, capacity=2048)[0]


def test_lists_are_arrays_and_a_number_is_the_background_of_every_channel():
    lists = {name: array.tolist() for name, array in ARRAYS.items()}
    behind = jnp.full((len(ARRAYS["viewmats"]), ARRAYS["colors"].shape[-1]), 0.25)
    np.testing.assert_array_equal(image(**lists, backgrounds=0.25), image(backgrounds=behind))
