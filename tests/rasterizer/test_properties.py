"""What must hold for every scene: the place of the world does not matter, and a batch is its members."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import cloud, evaluate, relative_errors
from scipy.spatial.transform import Rotation
from tolerances import assert_close


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.integers(0, 2**31 - 1))
def test_moving_world_and_camera_together_changes_nothing(seed):
    scene, rng = cloud(seed=seed), np.random.default_rng(seed)
    turn, axes = Rotation.from_quat(rng.normal(size=4)), Rotation.from_quat(scene.quats, scalar_first=True)
    rotation = turn.as_matrix()
    shift = rng.uniform(-2, 2, 3)
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = rotation.T, -rotation.T @ shift
    moved = replace(
        scene,
        means=jnp.asarray(np.asarray(scene.means) @ rotation.T + shift, jnp.float32),
        quats=jnp.asarray((turn * axes).as_quat(scalar_first=True), jnp.float32),
        viewmats=jnp.asarray(np.asarray(scene.viewmats) @ back, jnp.float32),
    )
    image, alphas, _, gradient = evaluate(scene, "xla")
    moved_image, moved_alphas, _, moved_gradient = evaluate(moved, "xla")
    # A pixel may sit on the alpha cut in one frame and not in the other.
    for a, b in ((moved_image, image), (moved_alphas, alphas)):
        difference = np.abs(a - b)
        assert np.quantile(difference, 0.995) < 2e-5
        assert difference.max() < 0.01
    np.testing.assert_allclose(moved_gradient.colors, gradient.colors, atol=0.02)
    turned_back = np.asarray(moved_gradient.means) @ rotation
    assert np.linalg.norm(turned_back - gradient.means) < 1e-2 * np.linalg.norm(gradient.means)


# `test_native_calls` shows the same of the native loops.
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
