"""Pictures of the page: those of the renderer."""

import jax.numpy as jnp
import numpy as np
from small_scenes import camera_at, cloud

from gsjax.rendering import backdrop, gallery
from gsjax.scene.colors import to_bytes
from gsjax.viewer.page_camera import camera_of, page_camera
from gsjax.viewer.pictures import COLOR, DEPTH, KINDS, NORMALS, bare_background, draw_picture

SCENE, BACKGROUND = cloud(30), np.array([0.1, 0.9, 0.4], np.float32)
SIZE = 32, 32


def camera(target=(0.0, 0.0, 4.0)):
    """As a page sends it."""
    return camera_of(page_camera(camera_at((0.0, 0.0, 0.0), target, size=SIZE)), SIZE)


def test_every_kind_is_the_picture_that_its_name_says():
    (picture,) = gallery.pictures(SCENE, [camera()], BACKGROUND)
    images = {kind: draw_picture(kind, SCENE, camera(), BACKGROUND) for kind in KINDS}
    assert all(image.shape == (32, 32, 3) and image.dtype == np.uint8 for image in images.values())
    np.testing.assert_allclose(images[COLOR].astype(int), to_bytes(picture.colors).astype(int), atol=1)
    nothing = picture.depth == 0
    assert nothing.any() and not nothing.all()
    assert (images[DEPTH][nothing] == 0).all() and (images[DEPTH][~nothing] > 0).all()
    assert (images[NORMALS][nothing] == 255).all() and (images[NORMALS][~nothing] < 255).any()


def test_a_view_of_nothing_is_the_background_and_a_sky_depends_on_the_direction():
    away = camera((0.0, 0.0, -4.0))
    bare = np.broadcast_to(to_bytes(BACKGROUND), (32, 32, 3))
    np.testing.assert_array_equal(draw_picture(COLOR, SCENE, away, BACKGROUND), bare)
    np.testing.assert_array_equal(bare_background(BACKGROUND, away), bare)
    sky = np.random.default_rng(0).normal(0, 0.3, (4, 3)).astype(np.float32)
    expected = to_bytes(np.clip(np.asarray(backdrop.color_behind(jnp.asarray(sky), away)), 0, 1))
    assert expected.std(axis=(0, 1)).max() > 5
    for image in (draw_picture(COLOR, SCENE, away, sky), bare_background(sky, away)):
        np.testing.assert_allclose(image.astype(int), expected.astype(int), atol=1)
