"""Photos on an arc around a few points, so many degrees apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsjax.pipeline.diagnose import apart, apart_line
from gsjax.planning import sparse_views
from gsjax.planning.sparse_views import (
    FAR_APART,
    LEFT_OUT,
    SMOOTH,
    STEREO_SHARE,
    angle_between_photos,
    for_sparse_views,
)
from gsjax.scene import Frame, Scene, Tracks
from gsjax.settings import Phase, Settings, Weights
from gsjax.training.plan import plan

PHOTOS, POINTS, AWAY = 6, 50, 1e4  # so far away that all points have the same angles
SETTINGS = Settings(
    phases=(Phase("coarse", 10), Phase("surface", 10, Weights(depth_normal=0.3))), max_gaussians=1000, sparse_views=True
)
PLAN = plan(SETTINGS)


def arc(degrees, *, held_out=(), alone=0):
    """Every photo sees every point but the last `alone`, which the first photo has for itself."""
    turns = np.radians(degrees) * np.arange(PHOTOS)
    viewmats = np.tile(np.eye(4, dtype=np.float32), (PHOTOS, 1, 1))
    viewmats[:, :2, 3] = -AWAY * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    unread, K = (lambda: pytest.fail("no pixels")), np.eye(3, dtype=np.float32)
    frames = tuple(Frame(f"{i}.jpg", viewmats[i], K, 10, 10, unread, i in held_out) for i in range(PHOTOS))
    seen = [np.arange(POINTS - (alone if i else 0), dtype=np.int32) for i in range(PHOTOS)]
    photo = np.repeat(np.arange(PHOTOS, dtype=np.int32), [len(each) for each in seen])
    point = np.concatenate(seen)
    tracks = Tracks(tuple(f.name for f in frames), photo, point, np.zeros((len(point), 2), np.float32))
    points = np.random.default_rng(0).normal(size=(POINTS, 3)).astype(np.float32)
    return Scene(Path("arc"), "colmap", frames, points, np.zeros((POINTS, 3), np.uint8), tracks=lambda: tracks)


@pytest.mark.parametrize("sampled", [POINTS, 10])
def test_the_angle_is_that_to_the_nearest_photo_that_is_trained_on(monkeypatch, sampled):
    monkeypatch.setattr(sparse_views, "POINTS", sampled)
    assert angle_between_photos(arc(12.0)) == pytest.approx(12.0, abs=0.02)
    assert angle_between_photos(arc(12.0, held_out=(1, 3, 5), alone=7)) == pytest.approx(24.0, abs=0.02)


def test_what_one_photo_has_for_itself_has_no_angle():
    assert angle_between_photos(arc(12.0, alone=POINTS)) is None
    assert angle_between_photos(Scene(Path("bare"), "colmap", (), np.zeros((0, 3)), np.zeros((0, 3)))) is None


def test_photos_far_apart_get_fewer_gaussians_and_a_term_where_a_phase_has_none():
    scene = arc(FAR_APART + 1)
    held_back, [line] = for_sparse_views(PLAN, scene, SETTINGS)
    assert held_back.max_gaussians == 500
    assert held_back.stereo_points == 500 // STEREO_SHARE > 0 == PLAN.stereo_points
    assert "21 degrees" in line and "500 Gaussians instead of max_gaussians=1,000" in line
    weights = [{each.name: each.weight for each in phase.terms} for phase in held_back.phases]
    assert [each["depth_normal"] for each in weights] == [SMOOTH["depth_normal"], 0.3]
    assert [phase.dropout for phase in held_back.phases] == [LEFT_OUT, LEFT_OUT]
    assert f"each step leaves out {LEFT_OUT:.0%}" in line
    assert len(held_back.phases[0].terms) == len(PLAN.phases[0].terms) + 1
    again, _ = for_sparse_views(held_back, scene, SETTINGS, may_lower=False)
    assert again == held_back, "a run that goes on is the run that it was"


def test_another_share_and_more_points_that_are_asked_for_stay():
    asked = replace(SETTINGS, dropout=0.5, stereo_points=200)
    held_back, [line] = for_sparse_views(plan(asked), arc(FAR_APART + 1), asked)
    assert [phase.dropout for phase in held_back.phases] == [0.5, 0.5]
    assert held_back.stereo_points == 200
    assert "each step leaves out 50%" in line


@pytest.mark.parametrize(
    ("degrees", "settings"),
    [
        (FAR_APART - 1, SETTINGS),
        (FAR_APART + 1, replace(SETTINGS, sparse_views=False)),
        (FAR_APART + 1, replace(SETTINGS, vanilla=True)),
    ],
)
def test_photos_side_by_side_or_unasked_for_change_nothing(degrees, settings):
    assert for_sparse_views(PLAN, arc(degrees), settings) == (PLAN, ())


@pytest.mark.parametrize("degrees", [FAR_APART - 1, FAR_APART + 1])
def test_diagnose_says_what_training_does(degrees):
    scene = arc(degrees)
    found = apart(scene)
    assert found["sparse"] == bool(for_sparse_views(PLAN, scene, SETTINGS)[1]) == (degrees > FAR_APART)
    assert apart_line(found).startswith(f"photos: {degrees:.0f} degrees apart")
    assert (": presets hold training back" in apart_line(found)) == found["sparse"]


def test_diagnose_says_where_no_tracks_tell():
    assert apart_line(apart(arc(12.0, alone=POINTS))) == "photos: no tracks tell how far apart they stand"
