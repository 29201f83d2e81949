"""Where photos agree about depth: points that a run starts with, what supervises it, and what a resumed one reads."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.planning import depth_supervision as module
from gsjax.planning import start
from gsjax.planning.depth_supervision import stereo_supervision
from gsjax.settings import Model, Settings, Supervision
from gsjax.stereo import PhotoDepths, StereoMap, StereoPoints, depths_of_photos, write_stereo_maps
from gsjax.training.plan import plan

SCENE = wall(3)
DEPTH = np.zeros((36, 48), np.float32)
DEPTH[:, 24:] = 3.0
NORMALS = np.zeros((36, 48, 3), np.int8)
NORMALS[:, 24:] = [0, 0, -127]
MAPS = {SCENE.frames[0].name: StereoMap(DEPTH, NORMALS)}
WITH_STEREO = Supervision(stereo_weight=0.3)


@pytest.fixture
def swept(monkeypatch):
    """Stereo that finds `MAPS`, and a list of the calls."""
    calls = []

    def depths(scene, most):
        calls.append(most)
        return PhotoDepths((), 3)

    monkeypatch.setattr(module, "depths_of_photos", depths)
    monkeypatch.setattr(module, "stereo_maps", lambda _: MAPS)
    return calls


def test_depth_is_that_of_the_photo_at_its_size_and_nothing_elsewhere(swept):
    supervision = stereo_supervision(SCENE, WITH_STEREO, None)
    assert swept == [100]
    depths = supervision.depths(SCENE.frames)
    assert depths is not None
    for scale in (1, 2):
        (depth, trust), *others = depths(scale)
        assert depth.shape == trust.shape == (72 // scale, 96 // scale)
        is_known = np.arange(96 // scale) >= 48 // scale
        np.testing.assert_array_equal(depth, np.broadcast_to(3 * is_known, depth.shape))
        np.testing.assert_array_equal(trust, np.broadcast_to(255 * is_known, depth.shape))
        assert len(others) == 2 and not any(each.any() for pair in others for each in pair)
    np.testing.assert_array_equal(supervision.normals[SCENE.frames[0].name], NORMALS)


@pytest.mark.parametrize(
    ("requested", "vanilla"),
    [(Supervision(), False), (WITH_STEREO, True), (replace(WITH_STEREO, normals="folder", depth="depth"), False)],
    ids=["not asked for", "vanilla", "maps of both are given"],
)
def test_nothing_is_compared_where_nothing_asks_for_it(swept, requested, vanilla):
    supervision = stereo_supervision(SCENE, requested, None, vanilla=vanilla)
    assert not swept and not supervision.maps and supervision.depths(SCENE.frames) is None


def test_a_resumed_run_reads_its_own_maps_or_has_none_and_compares_nothing(swept, tmp_path):
    assert not stereo_supervision(SCENE, WITH_STEREO, tmp_path).maps
    write_stereo_maps(tmp_path, MAPS)
    supervision = stereo_supervision(SCENE, WITH_STEREO, tmp_path)
    assert not swept and list(supervision.maps) == list(MAPS)
    np.testing.assert_array_equal(supervision.maps[SCENE.frames[0].name].depth, DEPTH)


def fake_points(scene, count):
    return StereoPoints(np.ones((count, 3), np.float32), np.full((count, 3), 7, np.uint8), f"{count} more")


def test_points_come_after_the_scenes_own_and_are_half_of_the_budget_at_most(monkeypatch):
    scene = wall(3, num_points=100)
    depths, planned = depths_of_photos(scene), plan(Settings(model=Model(stereo_points=50, max_gaussians=900)))
    monkeypatch.setattr(start, "stereo_points", fake_points)
    more, lines = start.with_stereo_points(scene, planned, lambda: depths)
    assert lines == ("50 more",)
    np.testing.assert_array_equal(more.points, np.concatenate([scene.points, np.ones((50, 3), np.float32)]))
    np.testing.assert_array_equal(more.point_colors[100:], np.full((50, 3), 7, np.uint8))
    assert more.points.dtype == np.float32 and more.point_colors.dtype == np.uint8
    assert replace(more, points=scene.points, point_colors=scene.point_colors) == scene, "tracks keep their numbers"
    more, _ = start.with_stereo_points(scene, replace(planned, stereo_points=500), lambda: depths)
    assert len(more.points) - len(scene.points) == 450
