from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import camera_at, cloud, in_float64, intrinsics, make, single
from tolerances import assert_close

from rasterizer import GSPLAT, INRIA, project


@pytest.fixture(scope="module")
def project_scene():
    def run(scene, **options):
        s = scene
        return project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height, **options)

    return jax.jit(run, static_argnames=("eps2d", "rules"))


def rotation_of(quat):
    w, x, y, z = np.asarray(quat, np.float64) / np.linalg.norm(quat)
    # From the definition, q v q*, basis vector by basis vector.
    u, columns = np.array([x, y, z]), []
    for v in np.eye(3):
        columns.append(v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v)))
    return np.stack(columns, -1)


def ewa(scene, eps2d=0.3):
    """Float64 numpy: means2d, depths and 2D covariances of a scene's first camera, from the textbook's matrices."""
    viewmat, K = np.asarray(scene.viewmats[0], np.float64), np.asarray(scene.Ks[0], np.float64)
    means, covariances, depths = [], [], []
    for mean, quat, scale in zip(scene.means, scene.quats, scene.scales, strict=True):
        x, y, z = viewmat[:3, :3] @ np.asarray(mean, np.float64) + viewmat[:3, 3]
        half_x, half_y = scene.width / (2 * K[0, 0]), scene.height / (2 * K[1, 1])
        slope_x = np.clip(x / z, -K[0, 2] / K[0, 0] - 0.3 * half_x, (scene.width - K[0, 2]) / K[0, 0] + 0.3 * half_x)
        slope_y = np.clip(y / z, -K[1, 2] / K[1, 1] - 0.3 * half_y, (scene.height - K[1, 2]) / K[1, 1] + 0.3 * half_y)
        J = np.array([[K[0, 0] / z, 0, -K[0, 0] * slope_x / z], [0, K[1, 1] / z, -K[1, 1] * slope_y / z]])
        M = J @ viewmat[:3, :3] @ rotation_of(quat) @ np.diag(np.asarray(scale, np.float64))
        means.append([K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]])
        covariances.append(M @ M.T + eps2d * np.eye(2))
        depths.append(z)
    return np.array(means), np.array(depths), np.array(covariances)


def as_matrix(conics):
    return np.asarray(conics, np.float64)[..., [0, 1, 1, 2]].reshape(*conics.shape[:-1], 2, 2)


def test_one_gaussian_on_the_axis_by_hand(project_scene):
    # Focal 16, depth 2, sigma 0.1 and 0.05: 0.8 and 0.4 px, variances 0.64 and 0.16, each + 0.3.
    p = project_scene(single(scale=(0.1, 0.05, 7.0), opacity=0.8))
    assert_close(p.means2d, np.array([[[8.0, 8.0]]]))
    assert_close(p.depths, np.array([[2.0]]))
    assert_close(p.conics, np.array([[[1 / 0.94, 0.0, 1 / 0.46]]]))
    # 0.8 exp(-s^2 / 2) = 1 / 255.
    assert_close(p.extents, np.sqrt(2 * np.log(0.8 * 255)) * np.sqrt([[[0.94, 0.46]]]))
    assert p.visible.all()


@pytest.mark.parametrize("seed", [0, 1])
def test_conic_is_the_inverse_of_the_ewa_covariance(project_scene, seed):
    scene = cloud(40, seed=seed)
    p = project_scene(scene)
    means2d, depths, covariances = ewa(scene)
    assert_close(p.means2d[0], means2d, rtol=1e-5, atol=1e-4, why="pixels, off-image ones are hundreds")
    assert_close(p.depths[0], depths)
    identity = as_matrix(p.conics[0]) @ covariances
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(2), identity.shape), atol=1e-4)


def test_a_needle_of_aspect_a_million_keeps_its_conic(project_scene):
    rng = np.random.default_rng(0)
    scene = cloud(40, seed=3)
    needles = replace(scene, scales=jnp.asarray(10.0 ** rng.choice([-6, 0], (40, 3)), jnp.float32))
    p = project_scene(needles)
    _, _, covariances = ewa(needles)
    assert p.visible.sum() > 20
    conics, expected = as_matrix(p.conics[0]), np.linalg.inv(covariances)
    error = np.linalg.norm(conics - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
    assert error.max() < 2e-5
    assert np.all(np.linalg.det(conics) > -1e-6 * np.linalg.norm(conics, axis=(1, 2)) ** 2)


def test_the_affine_map_is_clamped_beside_the_image(project_scene):
    # Far out the slope is held; the covariance must be that of the clamped point, not grow without bound.
    far_out = make(
        16,
        16,
        means=[[3.0 * k, -2.0 * k, 2.0] for k in range(1, 6)],
        quats=np.eye(4)[[0] * 5],
        scales=np.full((5, 3), 0.3),
        opacities=np.full(5, 0.9),
        colors=np.zeros((5, 1)),
        viewmats=[camera_at()],
        Ks=[intrinsics(16, 16)],
        backgrounds=[[0.0]],
    )
    _, _, covariances = ewa(far_out)
    assert_close(covariances, covariances[[0] * 5], rtol=1e-12, why="the oracle clamps all five to one slope")
    p = project_scene(far_out)
    expected = np.linalg.inv(covariances)[:, [0, 0, 1], [0, 1, 1]]
    assert_close(p.conics[0], expected)


def test_depth_planes_and_the_image_cull(project_scene):
    def visible(**changes):
        return bool(project_scene(single(**changes)).visible[0, 0])

    assert visible()
    assert not visible(mean=(0, 0, -2.0))
    assert not visible(mean=(0, 0, 0.0))
    assert not visible(mean=(0, 0, 0.0099999))
    assert visible(mean=(0, 0, 0.0101), scale=(1e-4,) * 3)
    assert not visible(mean=(0, 0, 2e10), scale=(1e9,) * 3)
    assert not visible(opacity=1 / 255 - 1e-6)
    assert visible(opacity=1 / 255 + 1e-6)
    # Half the image is 8 px; the extent of opacity 0.8 is 3.26 sigma = 3.16 px for a disc that faces the camera.
    assert visible(mean=((8 + 3.1) / 8, 0, 2.0), scale=(0.1, 0.1, 0))
    # Rounded up to whole pixels, as gsplat's radii are.
    assert visible(mean=((8 + 3.9) / 8, 0, 2.0), scale=(0.1, 0.1, 0))
    assert not visible(mean=((8 + 4.1) / 8, 0, 2.0), scale=(0.1, 0.1, 0))


def test_extents_of_the_two_presets(project_scene):
    faint = single(opacity=0.01)
    sigma = np.sqrt(0.94)
    assert_close(project_scene(faint, rules=GSPLAT).extents, np.full((1, 1, 2), np.sqrt(2 * np.log(2.55)) * sigma))
    assert_close(project_scene(faint, rules=INRIA).extents, np.full((1, 1, 2), 3 * sigma))


@jax.jit
def gradient_of_projection(scene):
    def total(s):
        p = project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height)
        return sum(jnp.sum(x) for x in (p.means2d, p.depths, p.conics)), p

    return jax.grad(total, has_aux=True)(scene)


@pytest.mark.parametrize(
    "mean",
    [(0, 0, 0), (1, 1, 0), (5, 0, 0.0), (0, 0, -1), (1e-3, 2, -1e-6), (1e3, 0, 1e-8), (1e4, -1e4, 0.02)],
    ids=["at the eye", "on the plane", "on the plane, beside", "behind", "just behind", "just before", "grazing"],
)
def test_gradient_is_finite_at_the_camera_plane(mean):
    scene = single(mean=tuple(map(float, mean)))
    gradient, p = gradient_of_projection(scene)
    for leaf in jax.tree.leaves((gradient, p)):
        assert np.isfinite(np.asarray(leaf)).all()
    assert not p.visible.any()


def test_several_cameras_are_the_single_ones_stacked(project_scene):
    scene = cloud(40, cameras=2)
    both = project_scene(scene)
    for c in range(2):
        alone = project_scene(replace(scene, viewmats=scene.viewmats[c : c + 1], Ks=scene.Ks[c : c + 1]))
        assert_close(jax.tree.map(lambda x, c=c: x[c : c + 1], both), alone)


def test_float32_follows_float64(project_scene):
    scene = cloud(40, seed=4)
    single_precision = project_scene(scene)
    with jax.enable_x64(True):
        double = project_scene(in_float64(scene))
    assert double.means2d.dtype == np.float64
    np.testing.assert_array_equal(single_precision.visible, double.visible)
    shown = np.asarray(double.visible)
    for name in ("means2d", "depths", "conics", "extents"):
        a, b = (np.asarray(getattr(x, name))[shown] for x in (single_precision, double))
        assert_close(a, b, rtol=2e-5, atol=2e-5, why="a handful of roundings on values up to 40")
