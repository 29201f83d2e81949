"""Which points a training starts with, where photos agree about depth."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.planning import start
from gsjax.settings import Model, Settings
from gsjax.stereo import StereoPoints, depths_of_photos
from gsjax.training.plan import plan

WALL = wall(3, num_points=100)
DEPTHS = depths_of_photos(WALL)
PLAN = plan(Settings(model=Model(stereo_points=50, max_gaussians=900)))


def fake_points(scene, count):
    return StereoPoints(np.ones((count, 3), np.float32), np.full((count, 3), 7, np.uint8), f"{count} more")


def test_points_come_after_the_scenes_own_and_are_half_of_the_budget_at_most(monkeypatch):
    monkeypatch.setattr(start, "stereo_points", fake_points)
    more, lines = start.with_stereo_points(WALL, PLAN, lambda: DEPTHS)
    assert lines == ("50 more",)
    np.testing.assert_array_equal(more.points, np.concatenate([WALL.points, np.ones((50, 3), np.float32)]))
    np.testing.assert_array_equal(more.point_colors[100:], np.full((50, 3), 7, np.uint8))
    assert more.points.dtype == np.float32 and more.point_colors.dtype == np.uint8
    assert replace(more, points=WALL.points, point_colors=WALL.point_colors) == WALL, "tracks keep their numbers"
    more, _ = start.with_stereo_points(WALL, replace(PLAN, stereo_points=500), lambda: DEPTHS)
    assert len(more.points) - len(WALL.points) == 450


@pytest.mark.parametrize(
    ("scene", "changes"),
    [(WALL, {"stereo_points": 0}), (WALL, {"max_gaussians": 199}), (replace(WALL, tracks=None), {})],
    ids=["not asked for", "the cloud fills half of the budget", "points of another origin"],
)
def test_nothing_is_looked_for(scene, changes):
    planned = replace(PLAN, **changes)
    assert start.with_stereo_points(scene, planned, lambda: pytest.fail("was looked for")) == (scene, ())
