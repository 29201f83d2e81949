"""The error against a photo, where its value is known."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.cameras import Camera
from gsjax.scene import Pixels
from gsjax.viewer.photo_error import UNKNOWN, error_picture, nearest_photo, photo_colors, seen_by_photo

RNG = np.random.default_rng(0)
PHOTO = RNG.random((24, 32, 3)).astype(np.float32), np.ones((24, 32), np.float32)


def centred(x=0.0, z=0.0, size=(32, 24), focal=30.0):
    """A camera at (x, 0, z) that looks along z."""
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[0, 3], viewmat[2, 3] = -x, -z
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]], np.float32)
    return Camera(viewmat, K, *size)


@pytest.mark.parametrize("depth", [0.0, 1e-3, 3.0, 1e6])
def test_from_the_photos_own_place_it_is_the_photo_whatever_the_depth(depth):
    camera = camera_at((0.4, -0.3, 0.2), (0.1, 0.1, 4.0))
    seen, known = seen_by_photo(np.full((24, 32), depth, np.float32), camera, PHOTO, camera)
    # The pose is inverted and multiplied back in float64 from float32 numbers.
    np.testing.assert_allclose(seen[1:-1, 1:-1], PHOTO[0][1:-1, 1:-1], atol=1e-4)
    assert known[1:-1, 1:-1].all()


def test_beside_the_photo_a_wall_is_shifted_by_what_its_depth_says():
    shift, depth = 0.3, 2.0
    seen, known = seen_by_photo(np.full((24, 32), depth, np.float32), centred(shift), PHOTO, centred())
    pixels = 30.0 * shift / depth  # 4.5: the wall's point is so much further right in the photo.
    rows, columns = np.mgrid[0:24, 0:32].astype(float)
    inside = columns + pixels <= 31
    expected = [map_coordinates(PHOTO[0][..., c], [rows, columns + pixels], order=1) for c in range(3)]
    assert_close(seen[inside], np.stack(expected, -1)[inside])
    assert known[inside].all() and not known[columns + 0.5 + pixels > 32].any()


def test_what_has_no_depth_is_read_as_far_as_the_farthest():
    depth = np.full((24, 32), 2.0, np.float32)
    depth[:, 16:] = 0
    whole = seen_by_photo(np.full((24, 32), 2.0, np.float32), centred(0.1), PHOTO, centred())
    for part, expected in zip(seen_by_photo(depth, centred(0.1), PHOTO, centred()), whole, strict=True):
        np.testing.assert_array_equal(part, expected)


def test_nothing_is_known_behind_the_photo_beside_it_or_where_it_must_not_be_used():
    depth = np.full((24, 32), 2.0, np.float32)
    assert not seen_by_photo(depth, centred(), PHOTO, centred(z=5.0))[1].any(), "behind"
    assert not seen_by_photo(depth, centred(), PHOTO, centred(x=50.0))[1].any(), "beside"
    valid = np.ones((24, 32), np.float32)
    valid[:, :10] = 0
    known = seen_by_photo(depth, centred(), (PHOTO[0], valid), centred())[1]
    assert not known[:, :10].any() and known[:, 11:31].all()


def test_a_point_on_the_photos_camera_plane_is_unknown_and_a_number():
    seen, known = seen_by_photo(np.full((24, 32), 2.0, np.float32), centred(), PHOTO, centred(z=2.0))
    assert np.isfinite(seen).all() and not known.any()


def test_the_picture_is_black_where_both_agree_and_brighter_with_the_error():
    rendered, known = np.full((1, 5, 3), 0.5), np.array([[True] * 4 + [False]])
    seen = rendered + np.array([0.0, 1 / 6, -1 / 3, 0.5, 0.5])[None, :, None]
    picture = error_picture(rendered, seen, known)
    expected = [[0, 0, 0], [255, 0, 0], [255, 255, 0], [255, 255, 255], np.rint(255 * UNKNOWN)]
    np.testing.assert_array_equal(picture[0], expected)


def test_the_nearest_photo_is_near_in_place_and_in_direction():
    around = [camera_at((np.cos(a), 0.1, np.sin(a)), (0.0, 0.1, 0.0)) for a in np.arange(8) * np.pi / 4]
    for index, camera in enumerate(around):
        assert nearest_photo(camera, around) == index
    turned_back = camera_at((1.0, 0.1, 0.0), (2.0, 0.1, 0.0))
    assert nearest_photo(turned_back, [around[0], camera_at((1.2, 0.1, 0.0), (9.0, 0.1, 0.0))]) == 1
    assert nearest_photo(around[3], [around[0]]) == 0
    same_place = [camera_at((0, 0, 0), (np.sin(a), 0, np.cos(a))) for a in (0.0, 1.0)]
    assert nearest_photo(camera_at((0, 0, 0), (np.sin(0.8), 0, np.cos(0.8))), same_place) == 1


def test_a_photo_is_over_the_background_and_its_mask_goes_along():
    image = np.full((1, 2, 3), 255, np.uint8)
    pixels = Pixels(image, np.array([[255, 51]], np.uint8), np.array([[0, 255]], np.uint8))
    colors, valid = photo_colors(pixels, np.array([0.0, 0.5, 1.0]))
    assert_close(colors, np.array([[[1, 1, 1], [0.2, 0.6, 1.0]]]))
    np.testing.assert_array_equal(valid, [[0, 1]])
    np.testing.assert_array_equal(photo_colors(Pixels(image), np.zeros(3))[1], [[1, 1]])
