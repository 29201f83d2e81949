import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.scene import cameras

CAMERA = camera_at((1.0, -2.0, 0.5), (0.3, 0.2, 6.0))


def test_world_to_camera_is_the_rigid_matrix_and_projection_the_pinhole_formula():
    point = np.array([0.4, 0.1, 5.0])
    expected = np.asarray(CAMERA.viewmat, np.float64) @ [*point, 1.0]
    assert_close(cameras.world_to_camera(jnp.asarray(point, jnp.float32), CAMERA), expected[:3])
    assert_close(cameras.center(CAMERA), np.array([1.0, -2.0, 0.5]))
    homogeneous = np.asarray(CAMERA.K, np.float64) @ point
    assert_close(cameras.project(jnp.asarray(point, jnp.float32), CAMERA), homogeneous[:2] / homogeneous[2])


def test_pixel_rays_pass_the_pixel_centres():
    project = jax.vmap(jax.vmap(cameras.project, (0, None)), (0, None))
    pixels = project(3.0 * cameras.pixel_rays(CAMERA), CAMERA)
    x, y = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    assert_close(pixels, np.stack([x, y], -1))


def test_points_land_on_the_pixels_that_they_were_taken_from():
    size = CAMERA.height, CAMERA.width
    depth = np.random.default_rng(0).uniform(1, 9, size).astype(np.float32)
    viewmat = np.asarray(CAMERA.viewmat, np.float64)
    world = (np.asarray(cameras.unproject(jnp.asarray(depth), CAMERA)) - viewmat[:3, 3]) @ viewmat[:3, :3]
    landed = cameras.landing(world, viewmat, np.asarray(CAMERA.K), size)
    assert landed.inside.all()
    assert_close(landed.depths.astype(np.float32), depth)
    rows, columns = np.indices(size)
    assert (landed.rows == rows).all() and (landed.columns == columns).all()

    center = np.asarray(cameras.center(CAMERA))
    behind, beside = 2 * center - world, world + 40 * viewmat[0, :3]
    for points in (behind, beside, center):
        landed = cameras.landing(points, viewmat, np.asarray(CAMERA.K), size)
        assert not landed.inside.any() and not landed.rows.any() and not landed.columns.any()


@pytest.mark.parametrize("z", [0.0, -1e-9, 1e-9, -3.0])
def test_on_and_behind_the_camera_plane_all_is_finite(z):
    value, gradient = jax.jit(jax.value_and_grad(lambda p: cameras.project(p, CAMERA).sum()))(
        jnp.asarray([0.3, 0.2, z], jnp.float32)
    )
    assert bool(jnp.isfinite(value)) and bool(jnp.isfinite(gradient).all())
    assert float(gradient[2]) == 0


def test_a_camera_sees_its_target_in_the_middle_and_up_above():
    eye, target, up = np.array([3.0, -2.0, 1.5]), np.array([0.2, 0.1, 0.3]), np.array([0.0, 0.0, 4.0])
    viewmat = cameras.look_at(eye, target, up).astype(np.float64)
    np.testing.assert_allclose(viewmat @ [*target, 1], [0, 0, np.linalg.norm(eye - target), 1], atol=1e-6)
    np.testing.assert_allclose(viewmat @ [*eye, 1], [0, 0, 0, 1], atol=1e-6)
    above = viewmat @ [*(target + 0.1 * up), 1]
    assert above[1] < 0  # y points down
    np.testing.assert_allclose(above[0], 0, atol=1e-6)
