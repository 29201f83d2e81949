import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit
from small_scenes import cloud
from tolerances import assert_close

from gsjax import gaussians as g

SCENE = cloud(7, sh_degree=2)


def test_linear_values_of_the_free_fields():
    assert_close(g.scales(SCENE), np.exp(np.asarray(SCENE.log_scales, np.float64)))
    assert_close(g.opacities(SCENE), expit(np.asarray(SCENE.logit_opacities, np.float64)))


def test_the_degree_is_read_off_the_coefficients():
    assert [cloud(3, sh_degree=degree).sh_degree for degree in (0, 3)] == [0, 3]


def test_rgb_and_its_coefficient():
    rgb = np.random.default_rng(0).random((4, 3))
    assert_close(0.5 / np.sqrt(np.pi) * g.rgb_to_sh(jnp.asarray(rgb, jnp.float32)) + 0.5, rgb)


def test_rotations_equal_scipys_whatever_the_length():
    quats = np.random.default_rng(1).normal(size=(20, 4)) * np.logspace(-6, 6, 20)[:, None]
    expected = Rotation.from_quat(quats[:, [1, 2, 3, 0]]).as_matrix()
    assert_close(g.rotation_matrices(jnp.asarray(quats, jnp.float32)), expected)


def test_a_zero_quaternion_is_the_identity_with_zero_gradient():
    zero = jnp.zeros(4, jnp.float32)
    assert_close(g.rotation_matrices(zero), np.eye(3))
    assert_close(jax.jit(jax.jacobian(g.rotation_matrices))(zero), np.zeros((3, 3, 4)))


def test_covariances_are_those_that_the_paper_prints():
    quats = np.asarray(SCENE.quats, np.float64)[:, [1, 2, 3, 0]]
    for covariance, R, log_scales in zip(
        g.covariances(SCENE),
        Rotation.from_quat(quats).as_matrix(),
        np.asarray(SCENE.log_scales, np.float64),
        strict=True,
    ):
        S = np.diag(np.exp(log_scales))
        assert_close(covariance, R @ S @ S.T @ R.T)
