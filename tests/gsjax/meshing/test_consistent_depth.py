"""Which depth views agree about: a wall before five cameras, and lumps before it that some of them show."""

import numpy as np
import pytest

from gsjax.meshing.consistent_depth import AGREEING, SAME_AS_STEREO, consistent_pictures
from gsjax.rendering.coarse_depths import coarse_depth
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera

WALL, NEARER = 4.0, 3.0  # camera z of the wall, and of the lumps
WIDTH, HEIGHT, FOCAL = 60, 30, 40.0
APART = 0.5  # 7 degrees between two neighbours, seen from the wall
LUMP = (-0.2, 0.2)  # x and y of a square lump


def camera(x):
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[0, 3] = -x
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]], np.float32)
    return Camera(viewmat, K, WIDTH, HEIGHT)


def places(x, z):
    """`[H, W]` x and y of the pixels of the camera at x, on the plane at z."""
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return x + (columns - WIDTH / 2) / FOCAL * z, (rows - HEIGHT / 2) / FOCAL * z


def picture(x, lump=False):
    depth = np.full((HEIGHT, WIDTH), WALL, np.float32)
    if lump:
        depth[in_lump(x)] = NEARER
    return Picture(np.zeros((HEIGHT, WIDTH, 3), np.float32), depth, np.full((HEIGHT, WIDTH), 0.9, np.float32))


def in_lump(x):
    across, up = places(x, NEARER)
    return (LUMP[0] < across) & (across < LUMP[1]) & (LUMP[0] < up) & (up < LUMP[1])


def agreed(xs, pictures, stereo=None, *, counts=False):
    cameras = [camera(x) for x in xs]
    coarse_views = list(map(coarse_depth, cameras, pictures))
    return list(consistent_pictures(cameras, pictures, coarse_views, stereo or {}, stereo_counts=counts))


XS = APART * np.arange(-2, 3)


def test_depth_that_two_others_show_stays_as_it_is_and_what_fewer_see_goes():
    before = [picture(x) for x in XS]
    for x, old, new in zip(XS, before, agreed(XS, before), strict=True):
        across, _ = places(x, WALL)
        half = WIDTH / 2 / FOCAL * WALL
        others = sum((np.abs(across - other) < half).astype(int) for other in XS if other != x)
        np.testing.assert_array_equal(new.depth, np.where(others >= AGREEING, old.depth, 0))
        np.testing.assert_array_equal(new.alphas, old.alphas)


def test_a_lump_that_others_look_through_goes():
    """Three of five views that show it are half of the four others: too few."""
    pictures = [picture(x, lump=index < 3) for index, x in enumerate(XS)]
    results = agreed(XS, pictures)
    for x, old, new in zip(XS[:3], pictures, results, strict=False):
        assert old.depth[in_lump(x)].max() == NEARER
        assert not new.depth[in_lump(x)].any()
    middle = places(0.0, WALL)[0]
    beside = (np.abs(middle) > 1) & (np.abs(middle) < 2)
    np.testing.assert_array_equal(results[2].depth[beside], WALL)


def test_a_lump_that_all_show_stays():
    pictures = [picture(x, lump=True) for x in XS]
    for x, new in zip(XS, agreed(XS, pictures), strict=True):
        inner = in_lump(x) & in_lump(x + 2.0 * NEARER / FOCAL) & in_lump(x - 2.0 * NEARER / FOCAL)
        assert inner.any()
        np.testing.assert_array_equal(new.depth[inner], NEARER)


@pytest.mark.parametrize("counts", [True, False])
def test_stereo_depth_that_contradicts_the_rendered_one_takes_its_place_or_removes_it(counts):
    """Known at half the size in the left half of the middle view: all others show the wall behind it."""
    depth = np.zeros((HEIGHT // 2, WIDTH // 2), np.float32)
    depth[:, : WIDTH // 4] = NEARER
    result = agreed(XS, [picture(x) for x in XS], {2: depth}, counts=counts)[2]
    left, right = np.s_[:, : WIDTH // 2], np.s_[:, WIDTH // 2 + 1 :]
    np.testing.assert_array_equal(result.depth[left], NEARER if counts else 0)
    np.testing.assert_array_equal(result.alphas[left], np.float32(1 if counts else 0.9))
    np.testing.assert_array_equal(result.depth[right], WALL)
    np.testing.assert_array_equal(result.alphas[right], np.float32(0.9))


@pytest.mark.parametrize(("off", "stays"), [(-0.8, True), (1.2, False), (-1.2, False)])
def test_stereo_depth_confirms_what_no_other_view_shows(off, stays):
    stereo = np.full((HEIGHT, WIDTH), WALL, np.float32)
    rendered = picture(XS[0])
    rendered = rendered._replace(depth=rendered.depth * np.float32(1 + off * SAME_AS_STEREO))
    (result,) = agreed(XS[:1], [rendered], {0: stereo})
    np.testing.assert_array_equal(result.depth, rendered.depth if stays else 0)
