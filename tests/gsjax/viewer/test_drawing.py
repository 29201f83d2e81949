"""Pictures of the page: those of the renderer, however many pairs a view needs."""

import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.normals.from_depth import depth_normals
from gsjax.rendering import backdrop, gallery
from gsjax.scene.colors import to_bytes
from gsjax.viewer import drawing
from gsjax.viewer.drawing import Drawer, bare_background
from gsjax.viewer.page_camera import camera_of, page_camera
from gsjax.viewer.pictures import COLOR, DEPTH, KINDS, NORMALS, Pictures
from gsjax.viewer.subject import Subject

SCENE, BACKGROUND = cloud(30), np.array([0.1, 0.9, 0.4], np.float32)
SIZE = 32, 32
POSES = [((0.0, 0.0, 0.0), (0.0, 0.0, 4.0)), ((1.0, -0.4, 1.0), (0.0, 0.0, 4.0))]


def camera(index):
    """As a page tells it."""
    return camera_of(page_camera(camera_at(*POSES[index], size=SIZE)), SIZE)


@pytest.fixture(scope="module")
def rendered():
    """What `gsjax.rendering` shows from both."""
    return list(gallery.pictures(SCENE, [camera(0), camera(1)], BACKGROUND))


@pytest.fixture(scope="module")
def drawer():
    return Drawer()


@pytest.mark.parametrize("index", [0, 1])
def test_a_known_pose_shows_the_renderers_picture_and_another_pose_another(drawer, rendered, index):
    plain = drawer.draw(SCENE, camera(index), BACKGROUND)
    whole = drawer.draw(SCENE, camera(index), BACKGROUND, with_surface=True)
    assert plain.depth is None and plain.normals is None
    assert_close(plain.colors, rendered[index].colors)
    assert_close(whole.colors, rendered[index].colors)
    assert_close(whole.depth, rendered[index].depth)
    assert_close(whole.normals, np.asarray(depth_normals(whole.depth, camera(index))))
    assert np.abs(plain.colors - rendered[1 - index].colors).max() > 0.1


def test_a_sky_stands_behind_the_gaussians_and_where_there_are_none(drawer):
    sky = np.random.default_rng(0).normal(0, 0.3, (4, 3)).astype(np.float32)
    seen = np.clip(np.asarray(backdrop.color_behind(jnp.asarray(sky), camera(0))), 0, 1)
    assert seen.std(axis=(0, 1)).max() > 0.02
    assert_close(bare_background(sky, camera(0)), seen)
    np.testing.assert_array_equal(bare_background(BACKGROUND, camera(0)), np.broadcast_to(BACKGROUND, seen.shape))
    (expected,) = gallery.pictures(SCENE, [camera(0)], sky)
    assert_close(Drawer().draw(SCENE, camera(0), sky).colors, expected.colors)


def test_a_view_that_needs_more_pairs_is_drawn_again_with_more(rendered, monkeypatch):
    """The first buffer is made for a view of nothing, and too short for this one."""
    rooms, enough = [], drawing._room

    def room(needed, size):
        rooms.append(needed)
        return enough(needed, size) if needed else 8

    monkeypatch.setattr(drawing, "_needed", lambda *_: 0)
    monkeypatch.setattr(drawing, "_room", room)
    drawer = Drawer()
    for _ in range(2):
        assert_close(drawer.draw(SCENE, camera(0), BACKGROUND).colors, rendered[0].colors)
        assert rooms[0] == 0 and rooms[1] > 8 and len(rooms) == 2, "the second time it is known"


def test_a_view_of_nothing_is_the_background(drawer):
    away = camera_of(page_camera(camera_at((0.0, 0.0, 0.0), (0.0, 0.0, -4.0), size=SIZE)), SIZE)
    shown = drawer.draw(SCENE, away, BACKGROUND, with_surface=True)
    np.testing.assert_array_equal(shown.colors, np.broadcast_to(BACKGROUND, (32, 32, 3)))
    assert not shown.depth.any() and not shown.normals.any()


def test_a_view_without_room_is_one_line(monkeypatch):
    monkeypatch.setattr(drawing, "_needed", lambda *_: np.iinfo(np.int32).max)
    with pytest.raises(InputError, match="there is no room for what this view shows at 32x32; step back"):
        Drawer().draw(SCENE, camera(0), BACKGROUND)


def test_every_kind_is_the_picture_that_its_name_says():
    at = camera_at(*POSES[0], size=SIZE)
    (picture,) = gallery.pictures(SCENE, [at], BACKGROUND)
    pictures = Pictures(Subject("s", at, np.zeros(3), np.array([0.0, -1, 0]), 4.0, background=BACKGROUND))
    drawn = {kind: pictures.draw(kind, SCENE, at) for kind in KINDS}
    assert all(image.shape == (32, 32, 3) and image.dtype == np.uint8 for image in drawn.values())
    np.testing.assert_allclose(drawn[COLOR].astype(int), to_bytes(picture.colors).astype(int), atol=1)
    nothing = picture.depth == 0
    assert nothing.any() and not nothing.all()
    assert (drawn[DEPTH][nothing] == 0).all() and (drawn[DEPTH][~nothing] > 0).all()
    assert (drawn[NORMALS][nothing] == 255).all() and (drawn[NORMALS][~nothing] < 255).any()
