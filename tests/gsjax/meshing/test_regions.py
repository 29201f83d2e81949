import numpy as np

from gsjax.meshing import regions
from gsjax.meshing.regions import Box, Region

UNIT = Box((-1, -1, -1), (1, 1, 1))


def test_a_region_leaves_its_inner_box_out():
    far = Region(UNIT.scaled(4), without=UNIT)
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.01, 0, 0], [4.0, 4, 4], [4.01, 0, 0]])
    assert far.contains(points).tolist() == [False, False, True, True, False]
    # A rim outwards, and inwards too: what lies beside the border shapes the surface at the border.
    assert far.grown(0.1).contains(points).tolist() == [False, True, True, True, True]


def test_the_robust_box_ignores_a_few_strays():
    points = np.random.default_rng(0).uniform(-1, 1, (10_000, 3))
    points[:20] = 1000
    box = regions.robust_box(points)
    assert np.all(box.low < -1) and np.all(box.low > -1.5)
    assert np.all(box.high > 1) and np.all(box.high < 1.5)


def test_points_in_a_plane_or_in_one_place_have_a_box():
    flat = np.random.default_rng(0).uniform(-1, 1, (100, 3)) * [1, 1, 0]
    assert regions.robust_box(flat).contains(flat).mean() > 0.9
    assert regions.robust_box(np.full((5, 3), 7.0)).contains(np.full((1, 3), 7.0)).all()


def test_an_even_spread_is_one_region_and_a_long_tail_a_background_of_its_own():
    rng = np.random.default_rng(0)
    even = rng.uniform([-1, -2, 0], [1, 2, 0.5], (10_000, 3))
    boxes = regions.near_and_far(even)
    assert set(boxes) == {"foreground"} and boxes["foreground"].contains(even).all()
    near, far = rng.uniform(-1, 1, (9_000, 3)), rng.uniform(-4, 4, (1_000, 3))
    points = np.concatenate([near, far])
    boxes = regions.near_and_far(points)
    assert set(boxes) == {"foreground", "background"}
    inside, outside = (region.contains(points) for region in boxes.values())
    assert inside[:9_000].all()
    assert outside.sum() > 700
    assert not np.any(inside & outside)
    np.testing.assert_allclose(
        boxes["background"].box.longest, regions.BACKGROUND_FACTOR * boxes["foreground"].box.longest
    )
    assert regions.Crop(foreground_only=True).regions(points)["foreground"].corners() == boxes["foreground"].corners()
