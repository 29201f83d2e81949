import numpy as np
import pytest
from small_scenes import camera_at, cloud
from tolerances import assert_close

import rasterizer
from gsjax.gaussians import opacities, scales
from gsjax.rendering import MIN_COVERAGE, gallery

BACKGROUND = np.array([0.1, 0.9, 0.4])
CAMERAS = [camera_at((0.0, 0.0, 0.0), size=(24, 20)), camera_at((0.5, 0.0, 0.0), (0.0, 0.0, 4.0), size=(32, 16))]


@pytest.fixture(scope="module")
def scene_and_pictures():
    scene = cloud(30)
    return scene, list(gallery.pictures(scene, CAMERAS, BACKGROUND, with_owners=True))


def reference(scene, camera, **options):
    """Colours and expected depth of the dense backend."""
    shape = scene.means, scene.quats, scales(scene), opacities(scene)
    cameras = camera.viewmat[None], camera.K[None], camera.width, camera.height
    how = {"sh_degree": 1, "render_mode": "RGB+ED", "backend": "reference", **options}
    return rasterizer.rasterization(*shape, np.concatenate([scene.sh_dc, scene.sh_rest], 1), *cameras, **how)


def test_a_picture_has_its_cameras_size_and_content(scene_and_pictures):
    scene, pictures = scene_and_pictures
    assert [picture.colors.shape for picture in pictures] == [(20, 24, 3), (16, 32, 3)]
    picture = pictures[0]
    image, alphas, _ = reference(scene, CAMERAS[0], depth_mode="plane")
    image, alphas = np.asarray(image[0], np.float64), np.asarray(alphas[0, ..., 0], np.float64)
    assert_close(picture.alphas, alphas)
    assert_close(picture.colors, np.clip(image[..., :3] + (1 - alphas[..., None]) * BACKGROUND, 0, 1))
    assert_close(picture.depth, np.where(alphas > MIN_COVERAGE, image[..., 3], 0))
    for each in pictures:
        assert all(isinstance(part, np.ndarray) for part in each)
        assert [part.dtype for part in each] == 3 * [np.float32] + [np.int32]


def test_owners_are_the_medians_of_the_reference(scene_and_pictures):
    scene, pictures = scene_and_pictures
    owners = pictures[0].owners
    *_, info = reference(scene, CAMERAS[0], return_median_depth=True)
    depths = np.where(owners >= 0, np.asarray(info["depths"])[0, owners], 0)
    assert (owners >= 0).any() and (owners < 0).any()
    np.testing.assert_allclose(depths, info["median_depths"][0, ..., 0], rtol=1e-6)


def test_masked_pictures_show_nothing_where_the_photo_does_not_count(scene_and_pictures):
    valid = np.random.default_rng(0).random((20, 24)) > 0.4
    first, second = gallery.mask_pictures(iter(scene_and_pictures[1]), iter([valid, None]))
    for before, after, nothing in zip(scene_and_pictures[1][0], first, (0, 0, 0, -1), strict=True):
        assert after.dtype == before.dtype and (before[~valid] != nothing).any()
        np.testing.assert_array_equal(after[valid], before[valid])
        assert (after[~valid] == nothing).all()
    assert second is scene_and_pictures[1][1]
