from dataclasses import replace

import jax
import numpy as np
import pytest
from scenes import cloud, single, textbook
from tolerances import assert_close

from rasterizer import GSPLAT, INRIA, project


@pytest.fixture(scope="module")
def project_scene():
    def run(scene, **options):
        s = scene
        return project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height, **options)

    return jax.jit(run, static_argnames=("eps2d", "rules"))


def test_conic_is_the_inverse_of_the_ewa_covariance_beside_the_image_too(project_scene):
    scene = cloud(40, cameras=2)
    scene = replace(scene, viewmats=scene.viewmats[1:], Ks=scene.Ks[1:])  # The first is at the origin, unturned.
    p = project_scene(scene)
    means2d, depths, joint = textbook(scene)
    far_beside = (np.abs(means2d / (scene.width, scene.height) - 0.5) > 0.66).any(-1)
    assert 0 < far_beside.sum() < 40, "the affine map is held there"
    assert_close(p.means2d[0], means2d, rtol=1e-5, atol=1e-4, why="pixels, off-image ones are hundreds")
    assert_close(p.depths[0], depths)
    conics = np.asarray(p.conics[0], np.float64)[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    identity = conics @ (joint[:, :2, :2] + 0.3 * np.eye(2))
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(2), identity.shape), atol=1e-4)


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
