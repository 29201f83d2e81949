"""What callers hand over for an array: lists and numbers are served, what is no array is named in one line."""

import jax
import jax.numpy as jnp
import numpy as np
from scenes import cloud

from rasterizer import rasterization
from rasterizer.arrays import takes_arrays

SCENE = cloud()
ARRAYS = {name: np.asarray(getattr(SCENE, name)) for name in ("means", "quats", "scales", "opacities", "colors")}
ARRAYS |= {"viewmats": np.asarray(SCENE.viewmats), "Ks": np.asarray(SCENE.Ks)}


def image(**changes):
    return rasterization(**{**ARRAYS, **changes}, width=SCENE.width, height=SCENE.height, capacity=2048)[0]


def test_lists_are_arrays_and_a_number_is_the_background_of_every_channel():
    lists = {name: array.tolist() for name, array in ARRAYS.items()}
    behind = jnp.full((len(ARRAYS["viewmats"]), ARRAYS["colors"].shape[-1]), 0.25)
    np.testing.assert_array_equal(image(**lists, backgrounds=0.25), image(backgrounds=behind))


def test_all_arrays_come_in_one_float_dtype_but_masks_and_indices():
    @takes_arrays
    def dtypes(means: jnp.ndarray, scales: jnp.ndarray, masks: jnp.ndarray | None = None):
        return means.dtype, scales.dtype, None if masks is None else masks.dtype

    assert dtypes([[1, 2, 3]], np.ones((1, 3), np.float16), [True]) == (np.float32, np.float32, np.bool_)
    assert dtypes(jnp.ones(3, jnp.bfloat16), np.ones(3, np.int32)) == (np.float32, np.float32, None)
    assert dtypes(np.ones(3), np.ones(3, np.float32)) == (np.float64, np.float32, None)  # jax reads both as float32
    assert dtypes(1, 2) == (np.float32, np.float32, None)
    with jax.enable_x64(True):
        assert dtypes(np.ones(3), np.ones(3, np.float32)) == (np.float64, np.float64, None)
        assert dtypes(np.ones(3, np.float32), np.ones(3)) == (np.float32, np.float32, None)
