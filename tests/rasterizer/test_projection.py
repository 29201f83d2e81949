import jax
import numpy as np
import pytest
from scenes import camera_at, cloud, intrinsics, make, single, textbook
from tolerances import assert_close

from rasterizer import GSPLAT, INRIA, project


@pytest.fixture(scope="module")
def project_scene():
    def run(scene, **options):
        s = scene
        return project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height, **options)

    return jax.jit(run, static_argnames=("eps2d", "rules"))


def ewa(scene, eps2d=0.3):
    """Float64: means2d, depths and blurred 2D covariances of a scene's first camera."""
    means2d, depths, joint = textbook(scene)
    return means2d, depths, joint[:, :2, :2] + eps2d * np.eye(2)


def as_matrix(conics):
    return np.asarray(conics, np.float64)[..., [0, 1, 1, 2]].reshape(*conics.shape[:-1], 2, 2)


def test_conic_is_the_inverse_of_the_ewa_covariance(project_scene):
    scene = cloud(40)
    p = project_scene(scene)
    means2d, depths, covariances = ewa(scene)
    assert_close(p.means2d[0], means2d, rtol=1e-5, atol=1e-4, why="pixels, off-image ones are hundreds")
    assert_close(p.depths[0], depths)
    identity = as_matrix(p.conics[0]) @ covariances
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(2), identity.shape), atol=1e-4)


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
