from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree
from small_scenes import discs, one_gaussian

from gsjax import gaussians as gs
from gsjax.errors import InputError
from gsjax.meshing import density_field, level_set
from gsjax.meshing.neighborhood import nearest_table
from gsjax.rendering import gallery
from gsjax.scene import cameras
from gsjax.scene.cameras import Camera


def kernel(scales, opacity):
    return jax.jit(density_field.kernels)(one_gaussian(np.log(scales), opacity=opacity))


def march(field, hit, direction, level=0.3):
    direction = np.asarray(direction, np.float32) / np.linalg.norm(direction)
    return march_ray(field, jnp.asarray(hit, jnp.float32), jnp.asarray(direction), level=level)


march_ray = jax.jit(density_field.march_ray)


@pytest.mark.parametrize(("level", "off_peak"), [(0.1, -0.1), (0.3, 0.0), (0.5, 0.15)])
def test_crossing_of_one_gaussian_in_closed_form(level, off_peak):
    # alpha exp(-z^2 / 2 s^2) = level at z = -s sqrt(2 ln(alpha / level)), entering along +z.
    point, normal, crossed = march(kernel((1.0, 1.0, 0.2), 0.9), (0, 0, off_peak), (0, 0, 1), level)
    assert bool(crossed)
    np.testing.assert_allclose(point, [0, 0, -0.2 * np.sqrt(2 * np.log(0.9 / level))], atol=2e-4)
    np.testing.assert_allclose(normal, [0, 0, -1], atol=1e-5)


def test_oblique_ray_ends_on_the_level_with_the_gradients_normal():
    field = kernel((1.0, 0.5, 0.2), 0.9)
    point, normal, crossed = march(field, (0.1, 0.2, 0.05), (1, 1, 2))
    assert bool(crossed)
    assert float(density_field.density(point, field)) == pytest.approx(0.3, abs=2e-3)
    expected = np.asarray(point) / np.array([1.0, 0.25, 0.04])  # Sigma^-1 x
    np.testing.assert_allclose(normal, expected / np.linalg.norm(expected), atol=1e-4)


def test_too_soft_and_already_inside_are_no_crossings():
    assert not bool(march(kernel((1.0, 1.0, 0.2), 0.25), (0, 0, 0), (0, 0, 1))[2])
    wide_over_narrow = density_field.Kernels(
        means=jnp.zeros((2, 3), jnp.float32),
        whitening=jnp.stack([10 * jnp.eye(3, dtype=jnp.float32), 0.01 * jnp.eye(3, dtype=jnp.float32)]),
        opacities=jnp.asarray([0.9, 0.9], jnp.float32),
    )
    assert not bool(march(wide_over_narrow, (0, 0, 0), (0, 0, 1))[2])


@pytest.mark.parametrize("scales", [(1e-30, 1e-30, 1e-30), (1e30, 1e30, 1e30), (1.0, 1.0, 1e-30)])
def test_extreme_kernels_march_to_finite_numbers(scales):
    for part in march(kernel(scales, 0.9), (1e-3, 0, 0), (0, 0, 1)):
        assert bool(jnp.all(jnp.isfinite(part)))


def test_ball_gives_points_on_the_sphere_with_outward_normals(ball):
    surface = level_set.surface_points(ball.gaussians, *ball.views, most=5000)
    radii = np.linalg.norm(surface.points, axis=1)
    # A disc of thickness s meets the level within s sqrt(2 ln(sum / level)) of its plane.
    assert np.abs(radii - 1).max() < 0.02
    assert np.quantile(np.sum(surface.normals * surface.points / radii[:, None], -1), 0.01) > 0.9
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=1e-5)
    assert surface.report["crossing_share"] > 0.9
    assert surface.report["flipped_share"] < 0.01
    assert np.all(surface.colors == [255, 128, 0])
    camera, pictures = ball.cameras[3], list(ball.pictures)[3:4]
    surface = level_set.surface_points(ball.gaussians, [camera], pictures, most=500)
    points = surface.points
    assert np.all(np.sum(surface.normals * (np.asarray(cameras.center(camera)) - points), -1) >= 0)
    landed = jax.vmap(cameras.project, (0, None))(points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3], camera)
    np.testing.assert_allclose(landed % 1, 0.5, atol=2e-3, err_msg="rays pass the centres of pixels")


def test_same_points_whatever_the_chunk(ball, monkeypatch):
    a = level_set.surface_points(ball.gaussians, *ball.views, most=1000)
    monkeypatch.setattr(level_set, "CHUNK", 700)
    b = level_set.surface_points(ball.gaussians, *ball.views, most=1000)
    np.testing.assert_allclose(a.points, b.points, atol=1e-6)
    assert a.report == b.report


def test_transparent_gaussians_and_those_with_nan_do_not_make_density(ball):
    faint = replace(
        ball.gaussians,
        means=1.2 * ball.gaussians.means.at[7].set(jnp.nan),
        logit_opacities=jnp.full_like(ball.gaussians.logit_opacities, -0.5).at[7].set(3.0),
    )
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), ball.gaussians, faint)
    alone = level_set.surface_points(ball.gaussians, *ball.views, most=500)
    surface = level_set.surface_points(both, *ball.views, most=500)
    assert surface.report["kernels"] == 2000
    np.testing.assert_array_equal(surface.points, alone.points)


def test_a_wall_crosses_whatever_lies_on_it():
    """A large disc at z = 0, two units away, has 200 small ones just in front of it: too many for its neighbours."""
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[2, 3] = 2
    camera = Camera(viewmat, np.float32([[60, 0, 32], [0, 60, 32], [0, 0, 1]]), 64, 64)
    centers = np.c_[np.random.default_rng(0).uniform(-1, 1, (200, 2)), np.full(200, -0.002)]
    radii = np.r_[3.0, np.full(200, 0.03)]
    scales = jnp.asarray(np.stack([radii, radii, np.full(201, 1e-3)], -1), jnp.float32)
    wall = replace(discs(np.r_[np.zeros((1, 3)), centers], (0, 0, 1.0), 1.0), log_scales=jnp.log(scales))
    pictures = list(gallery.pictures(wall, [camera], np.zeros(3), with_owners=True))
    surface = level_set.surface_points(wall, [camera], pictures, most=4096)
    assert surface.report["rays"] == 64 * 64
    assert surface.report["crossing_share"] > 0.99
    assert np.abs(surface.points[:, 2]).max() < 0.01
    assert np.abs(surface.normals[:, 2]).min() > 0.997  # 0.9977 measured, on the rims of small discs


def test_fewer_gaussians_than_neighbours():
    assert sorted(nearest_table(KDTree(np.eye(3)), 16)[0]) == [0, 1, 2]
    assert nearest_table(KDTree(np.zeros((1, 3))), 16).tolist() == [[0]]


def test_nothing_to_see_and_nothing_there(ball):
    soft = replace(ball.gaussians, logit_opacities=jnp.full_like(ball.gaussians.logit_opacities, -9.0))
    with pytest.raises(InputError, match=r"level set is empty: none of 2020 rays.*2000 of 2000"):
        level_set.surface_points(soft, *ball.views, most=1000)
    blank = [p._replace(alphas=np.zeros_like(p.alphas)) for p in ball.pictures]
    with pytest.raises(InputError, match="no pixel of 10 views"):
        level_set.surface_points(ball.gaussians, ball.cameras, blank)
    with pytest.raises(InputError, match="none of 0 Gaussians"):
        level_set.surface_points(gs.take(ball.gaussians, np.arange(0)), *ball.views)
    camera = ball.cameras[0]
    wide = Camera(camera.viewmat, camera.K, 65, 60)
    with pytest.raises(ValueError, match="view 0"):
        level_set.surface_points(ball.gaussians, [wide, *ball.cameras[1:]], ball.pictures)
