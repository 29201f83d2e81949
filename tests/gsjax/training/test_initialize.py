from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.gaussians import SH_C0, opacities, rotation_matrices, scales
from gsjax.planning import start
from gsjax.scene import Pixels, Scene, frame_of
from gsjax.settings import Model, Settings
from gsjax.training.buffers import with_room_to_densify
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.initialize import DEAD_LOGIT, SHELLS, far_points, from_points
from gsjax.training.optimizers import make_optimizer

RNG = np.random.default_rng(0)
POINTS, COLORS = RNG.normal(size=(20, 3)), RNG.integers(0, 256, (20, 3), dtype=np.uint8)


def test_points_become_gaussians_as_large_as_the_distances_to_the_three_nearest():
    distances = np.sort(np.linalg.norm(POINTS[:, None] - POINTS[None], axis=-1), axis=1)[:, 1:4]
    gaussians = from_points(POINTS, COLORS, capacity=20, sh_degree=2, opacity=0.3)
    assert_close(scales(gaussians), np.repeat(np.sqrt((distances**2).mean(1))[:, None], 3, 1))
    assert_close(gaussians.means, POINTS)
    assert_close(opacities(gaussians), np.full(20, 0.3))
    assert_close(gaussians.sh_dc[:, 0] * SH_C0 + 0.5, COLORS / 255)
    assert_close(gaussians.sh_rest, np.zeros((20, 8, 3)))
    assert_close(gaussians, from_points(POINTS, COLORS / 255, capacity=20, sh_degree=2, opacity=0.3))


def test_axes_follow_the_points_around_however_the_world_is_turned():
    wall = RNG.uniform(-1, 1, (60, 3)) * [1.0, 1.0, 0.01]
    colors = np.full((60, 3), 0.5)
    here = rotation_matrices(from_points(wall, colors, capacity=60, sh_degree=0).quats)
    assert_close(np.linalg.det(here), np.ones(60))
    assert np.abs(here[:, 2, 0]).min() > 0.99  # The first axis is the wall's normal.
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    there = rotation_matrices(from_points(wall @ turn.T, colors, capacity=60, sh_degree=0).quats)
    assert_close(np.abs(np.einsum("ij,njk,nik->nk", turn.astype(np.float32), here, there)), np.ones((60, 3)))


def test_rows_beyond_the_points_are_dead_and_too_many_points_are_thinned_over_their_whole_length():
    gaussians = from_points(POINTS, COLORS, capacity=32, sh_degree=1)
    assert {leaf.dtype for leaf in jax.tree.leaves(gaussians)} == {jnp.dtype("float32")}
    assert {leaf.shape[0] for leaf in jax.tree.leaves(gaussians)} == {32}
    assert_close(gaussians.logit_opacities[20:], np.full(12, DEAD_LOGIT))
    assert bool((gaussians.logit_opacities[:20] > -5).all())
    gaussians, rows = from_points(POINTS, COLORS, capacity=5, sh_degree=0), [0, 4, 9, 14, 19]
    assert_close(gaussians.means, POINTS[rows])
    assert_close(gaussians.sh_dc[:, 0] * SH_C0 + 0.5, COLORS[rows] / 255)


def test_few_or_coincident_points_get_a_usable_scale():
    for points, expected in (([[1.0, 2, 3]], 0.01), ([[0.0, 0, 0], [0, 0, 2]], 2.0), ([[1.0, 1, 1]] * 6, 1e-7**0.5)):
        gaussians = from_points(np.array(points), np.zeros((len(points), 3)), capacity=len(points), sh_degree=0)
        assert_close(scales(gaussians), np.full((len(points), 3), expected))


def test_a_run_starts_with_the_pixel_filter_of_its_settings_and_growing_keeps_it():
    scene = Scene(Path("scene"), "colmap", (), POINTS.astype(np.float32), COLORS)
    settings = Settings(model=Model(pixel_filter="mip", max_gaussians=40, sh_degree=0))
    optimizer, rule = make_optimizer(settings.rates, 1.0, 10), DENSIFICATION_RULES["adc"]
    state = start.first_state(scene, settings.model, rule, optimizer, {})
    assert state.gaussians.pixel_filter == "mip"
    roomy = with_room_to_densify(state, optimizer, settings.density, 40, rule=rule)
    assert roomy.gaussians.pixel_filter == "mip"


def photos_from(*eyes, matte=None):
    """Photos from these places towards the middle of the cloud."""
    frames = []
    for index, eye in enumerate(eyes):
        camera = camera_at(eye, np.median(POINTS, axis=0))
        pixels = Pixels(np.zeros((camera.height, camera.width, 3), np.uint8), matte)
        frames.append(frame_of(f"{index}.png", np.asarray(camera.viewmat), np.asarray(camera.K), pixels))
    return tuple(frames)


def test_far_points_lie_beyond_cameras_and_cloud_where_a_photo_looks():
    frames = photos_from((9.0, 0.5, 0.0), (0.0, 1.0, -7.0))
    middle = np.median(POINTS, axis=0)
    far = far_points(POINTS, frames, 900)
    away = np.linalg.norm(far - middle, axis=1) / np.linalg.norm(np.array([9.0, 0.5, 0.0]) - middle)
    np.testing.assert_allclose(np.unique(np.round(away, 3)), SHELLS, rtol=2e-3)
    inside = np.zeros(len(far), bool)
    for frame in frames:
        x, y, z = (far @ frame.viewmat[:3, :3].T + frame.viewmat[:3, 3]).T
        u, v = frame.K[0, 0] * x / z + frame.K[0, 2], frame.K[1, 1] * y / z + frame.K[1, 2]
        inside |= (z > 0) & (u >= 0) & (u <= frame.width) & (v >= 0) & (v <= frame.height)
    assert inside.all()


@pytest.mark.parametrize("matte", [None, np.full((24, 32), 255, np.uint8)])
def test_training_starts_with_far_points_within_its_budget_unless_photos_have_mattes(matte):
    frames = photos_from((9.0, 0.5, 0.0), (0.0, 1.0, -7.0), matte=matte)
    scene = Scene(Path("s"), "colmap", frames, POINTS.astype(np.float32), COLORS)
    for budget in (1000, 60, 12):
        points, colors = start.starting_points(scene, Model(max_gaussians=budget, far_points=900))
        far = len(far_points(POINTS, frames, budget // 10))
        assert len(points) == len(colors) == (far + min(20, budget - far) if matte is None else 20)
    for without in (Model(max_gaussians=1000), Model(far_points=900, background="white")):
        points, _ = start.starting_points(scene, without)
        np.testing.assert_array_equal(points, scene.points)
