import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import one_gaussian

from gsjax.gaussians import Gaussians
from gsjax.meshing import density_field

# Compiled whole: op by op every shape would compile a dozen programs.
kernels, density, density_gradient = map(
    jax.jit, (density_field.kernels, density_field.density, density_field.density_gradient)
)
along_ray = jax.jit(density_field.along_ray)
value_and_gradients = jax.jit(jax.value_and_grad(lambda p, gaussians: density(p, kernels(gaussians)), argnums=(0, 1)))


def random_gaussians(count, seed=0, log_scale=-1.0, spread=0.5):
    rng = np.random.default_rng(seed)
    return Gaussians(
        means=jnp.asarray(rng.normal(size=(count, 3)), jnp.float32),
        quats=jnp.asarray(rng.normal(size=(count, 4)), jnp.float32),
        log_scales=jnp.asarray(log_scale + spread * rng.normal(size=(count, 3)), jnp.float32),
        logit_opacities=jnp.asarray(rng.normal(size=count), jnp.float32),
        sh_dc=jnp.zeros((count, 1, 3), jnp.float32),
        sh_rest=jnp.zeros((count, 0, 3), jnp.float32),
    )


def density_in_numpy(point, gaussians):
    """Eq. 1 with explicit inverse covariances, float64."""
    total = 0.0
    columns = gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities
    for mean, quat, log_scale, logit in zip(*(np.asarray(column, np.float64) for column in columns), strict=True):
        axes = Rotation.from_quat(quat[[1, 2, 3, 0]]).as_matrix()
        covariance = axes @ np.diag(np.exp(2 * log_scale)) @ axes.T
        offset = point - mean
        total += np.exp(-0.5 * offset @ np.linalg.solve(covariance, offset)) / (1 + np.exp(-logit))
    return total


def test_density_is_the_papers_sum_and_its_gradient_that_of_finite_differences():
    gaussians = random_gaussians(16)
    points = np.random.default_rng(1).normal(size=(20, 3)).astype(np.float32)
    field = kernels(gaussians)
    densities = jax.vmap(density, (0, None))(jnp.asarray(points), field)
    expected = [density_in_numpy(p.astype(np.float64), gaussians) for p in points]
    np.testing.assert_allclose(densities, expected, rtol=2e-4, atol=1e-7)
    point, step = np.array([0.2, -0.1, 0.3]), 1e-5
    expected = [
        (density_in_numpy(point + step * axis, gaussians) - density_in_numpy(point - step * axis, gaussians))
        / (2 * step)
        for axis in np.eye(3)
    ]
    np.testing.assert_allclose(density_gradient(jnp.asarray(point, jnp.float32), field), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    "log_scales",
    [(-1.0, -1.0, -40.0), (-40.0, -40.0, -40.0), (-200.0, 0.0, 0.0), (90.0, 90.0, 90.0), (88.0, -40.0, 0.0)],
    ids=["flat", "collapsed", "exp underflows", "exp overflows", "needle"],
)
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (0.3, 0.2, 0.1), (1e6, -1e6, 1e6)])
def test_extreme_gaussians_give_finite_values_and_gradients(log_scales, point):
    gaussians, p = one_gaussian(log_scales), jnp.asarray(point, jnp.float32)
    value, (by_point, by_gaussian) = value_and_gradients(p, gaussians)
    assert 0 <= float(value) <= 0.8 + 1e-6
    closed = density_gradient(p, kernels(gaussians))
    for leaf in [closed, by_point, *jax.tree.leaves(by_gaussian)]:
        assert bool(jnp.all(jnp.isfinite(leaf)))
    np.testing.assert_allclose(closed, by_point, rtol=1e-4, atol=1e-6)
    direction = jnp.asarray([0.6, 0.0, 0.8], jnp.float32)
    profile = along_ray(p, direction, kernels(gaussians))
    spread = density_field.deviation_along(direction, density_field.take(kernels(gaussians), 0))
    for leaf in [*jax.tree.leaves(profile), spread, density_field.profile_density(jnp.float32(1e6), profile)]:
        assert bool(jnp.all(jnp.isfinite(leaf)))


def test_profile_along_a_ray_is_the_density_there():
    field = kernels(random_gaussians(16))
    rng = np.random.default_rng(4)
    for _ in range(2):
        origin = jnp.asarray(rng.normal(size=3), jnp.float32)
        direction = rng.normal(size=3)
        direction = jnp.asarray(direction / np.linalg.norm(direction), jnp.float32)
        distances = jnp.linspace(-3, 3, 50, dtype=jnp.float32)
        profile = along_ray(origin, direction, field)
        densities = jax.vmap(density_field.profile_density, (0, None))(distances, profile)
        points = origin[None, :] + distances[:, None] * direction[None, :]
        expected = jax.vmap(density, (0, None))(points, field)
        np.testing.assert_allclose(densities, expected, rtol=1e-4, atol=1e-6)
    upright = kernels(one_gaussian(np.log([1.0, 1.0, 0.1])))
    spread = density_field.deviation_along(jnp.asarray([0.6, 0.0, 0.8]), density_field.take(upright, 0))
    assert float(spread) == pytest.approx(np.sqrt(0.36 + 0.64 * 0.01), rel=1e-5), "of the Gaussian itself"
