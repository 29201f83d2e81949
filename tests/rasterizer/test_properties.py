"""What must hold on every engine: two runs have the same bits, and a batch is its members."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scenes import cloud, evaluate, relative_errors
from tolerances import assert_close


# `pipeline/test_own_loop.py` shows the same of the native loops.
@pytest.mark.long
@pytest.mark.parametrize("backend", ["xla", "pallas"])
def test_two_runs_give_the_same_bits_and_a_batch_of_cameras_is_its_cameras_with_their_gradients(backend):
    scene = cloud(cameras=2)
    cameras = {name: getattr(scene, name)[:, None] for name in ("viewmats", "Ks", "backgrounds")}

    def with_camera(camera):
        return evaluate(replace(scene, **camera), backend)

    image, alphas, _, gradient = jax.vmap(with_camera)(cameras)
    for i in range(2):
        alone = {k: v[i] for k, v in cameras.items()}
        expected_image, expected_alphas, _, expected_gradient = expected = with_camera(alone)
        # Lists have rubbish at their end.
        jax.tree.map(np.testing.assert_array_equal, with_camera(alone)[::3], expected[::3])
        assert_close(image[i], expected_image)
        assert_close(alphas[i], expected_alphas)
        for field, error in relative_errors(jax.tree.map(lambda x, i=i: x[i], gradient), expected_gradient).items():
            assert error < 1e-4, (field, error)
