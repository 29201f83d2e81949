"""Photos on an arc around a few points, so many degrees apart."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from gsjax.planning import sparse_views
from gsjax.planning.sparse_views import (
    FAR_APART,
    FEW,
    FEWEST,
    LEFT_OUT,
    SHORTEST,
    SMOOTH,
    Decision,
    Gain,
    angle_between_photos,
    for_sparse_views,
    is_tried,
    regularize,
)
from gsjax.scene import Frame, Scene, Tracks
from gsjax.settings import Model, Phase, Schedule, Settings, Weights
from gsjax.training.plan import plan

PHOTOS, POINTS, AWAY = 6, 50, 1e4  # so far away that all points have the same angles
SHORT_PHASES = Phase("coarse", SHORTEST // 2), Phase("surface", SHORTEST // 4, Weights(depth_normal=0.3))
PHASES = replace(SHORT_PHASES[0], steps=SHORTEST), SHORT_PHASES[1]
SETTINGS = Settings(schedule=Schedule(phases=PHASES, sparse_views=True), model=Model(max_gaussians=1000))
PLAN = plan(SETTINGS)


def never(*_):
    pytest.fail("no validation run is needed")


def arc(degrees, *, held_out=(), alone=0):
    """Every photo sees every point but the last `alone`, which the first photo has for itself."""
    turns = np.radians(degrees) * np.arange(PHOTOS)
    viewmats = np.tile(np.eye(4, dtype=np.float32), (PHOTOS, 1, 1))
    viewmats[:, :2, 3] = -AWAY * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    unread, K = (lambda: pytest.fail("no pixels")), np.eye(3, dtype=np.float32)
    frames = tuple(Frame(f"{i}.jpg", viewmats[i], K, 10, 10, unread, i in held_out) for i in range(PHOTOS))
    point_ids = [np.arange(POINTS - (alone if i else 0), dtype=np.int32) for i in range(PHOTOS)]
    photo = np.repeat(np.arange(PHOTOS, dtype=np.int32), [len(each) for each in point_ids])
    point = np.concatenate(point_ids)
    tracks = Tracks(tuple(f.name for f in frames), photo, point, np.zeros((len(point), 2), np.float32))
    points = np.random.default_rng(0).normal(size=(POINTS, 3)).astype(np.float32)
    return Scene(Path("arc"), "colmap", frames, points, np.zeros((POINTS, 3), np.uint8), tracks=lambda: tracks)


@pytest.mark.parametrize("sampled", [POINTS, 10])
def test_the_angle_is_that_to_the_nearest_photo_that_is_trained_on(monkeypatch, sampled):
    monkeypatch.setattr(sparse_views, "POINTS", sampled)
    assert angle_between_photos(arc(12.0)) == pytest.approx(12.0, abs=0.02)
    assert angle_between_photos(arc(12.0, held_out=(1, 3, 5), alone=7)) == pytest.approx(24.0, abs=0.02)


def test_regularized_a_run_has_fewer_gaussians_and_a_term_where_a_phase_has_none():
    regularized_plan = regularize(PLAN)
    assert regularized_plan.max_gaussians == 500
    assert (regularized_plan.stereo_points, PLAN.stereo_points) == (55, 0), "one for nine Gaussians"
    weights = [{each.name: each.weight for each in phase.terms} for phase in regularized_plan.phases]
    assert [each["depth_normal"] for each in weights] == [SMOOTH["depth_normal"], 0.3]
    assert [phase.dropout for phase in regularized_plan.phases] == [LEFT_OUT, LEFT_OUT]
    assert len(regularized_plan.phases[0].terms) == len(PLAN.phases[0].terms) + 1
    assert regularize(regularized_plan, may_lower=False) == regularized_plan, "a run that goes on is the same"


@pytest.mark.parametrize("degrees", [FAR_APART - 1, FAR_APART + 1])
@pytest.mark.parametrize("validate", [None, never], ids=["without validation", "in a short run"])
def test_the_angle_decides_without_validation(degrees, validate):
    """A run that begins in another's checkpoint has no beginning to try, and a short one no time."""
    settings = SETTINGS.replace(schedule={"phases": SHORT_PHASES}) if validate else SETTINGS
    final_plan, decision = for_sparse_views(plan(settings), arc(degrees), settings.schedule, validate=validate)
    assert final_plan == (regularize(plan(settings)) if decision else plan(settings))
    assert (decision is not None) == (degrees > FAR_APART)
    if decision is not None:
        assert decision == Decision(PHOTOS, pytest.approx(degrees, abs=0.02), None, None, held_back=True)
        line = f"{PHOTOS} photos {degrees:.0f} degrees apart: sparse-view regularization with 500 Gaussians"
        assert decision.line(final_plan).startswith(line)


@pytest.mark.parametrize(
    ("gain", "helps"),
    [
        (Gain(0.4, 0.1), True),
        (Gain(0.4, 0.1, 0.3, 0.1), True),  # sure of the pictures, whatever depth is
        (Gain(-0.4, 0.1, -0.3, 0.1), False),
        (Gain(0.1, 0.2, 0.3, 0.1), False),  # unsure of them, sure of depth
        (Gain(-0.1, 0.2, -0.3, 0.1), True),
        (Gain(-0.1, 0.2, -0.1, 0.1), False),  # unsure of both
        (Gain(-0.1, 0.2), False),
    ],
)
def test_validation_decides_for_few_photos_by_depth_where_psnr_is_not_significant(gain, helps):
    for degrees in (4.0, FAR_APART + 1):
        final_plan, decision = for_sparse_views(PLAN, arc(degrees), SETTINGS.schedule, validate=lambda *_: gain)
        assert gain.helps == decision.held_back == helps
        assert final_plan == (regularize(PLAN) if helps else PLAN)
    line, has_depth = decision.line(final_plan), gain.depth is not None
    assert f"{gain.decibels:+.1f} +-{gain.error:.1f} dB" in line
    assert ("the error of depth" in line) == has_depth
    assert not has_depth or f"{np.exp(gain.depth):.2f} times the error of depth" in line


def test_dropout_alone_where_photos_are_neither_few_nor_far_apart(monkeypatch):
    monkeypatch.setattr(sparse_views, "FEW", PHOTOS - 1)
    long_plan = plan(SETTINGS.replace(schedule={"phases": (replace(PHASES[0], steps=3000), PHASES[1])}))
    final_plan, decision = for_sparse_views(long_plan, arc(13.0), SETTINGS.schedule, validate=never)
    assert [phase.dropout for phase in final_plan.phases] == [0.3, 0.3]
    assert replace(final_plan, phases=long_plan.phases) == long_plan, "nothing else changes"
    assert "13 degrees apart: each step leaves out 30% of the Gaussians" in decision.line(final_plan)
    again, _ = for_sparse_views(long_plan, arc(13.0), SETTINGS.schedule, before=asdict(decision))
    assert again == final_plan, "a run that resumes is the same"
    for photos, degrees, steps in ((31, 13.0, 3000), (30, 9.9, 3000), (30, 13.0, 2999), (30, None, 3000)):
        assert sparse_views.needs_dropout(30, 10.0, 3000) and not sparse_views.needs_dropout(photos, degrees, steps)


def test_many_photos_side_by_side_and_short_runs_are_not_tried():
    for degrees in (4.0, None):
        assert is_tried(FEW, degrees, SHORTEST) and not is_tried(FEW + 1, degrees, SHORTEST)
    assert is_tried(FEW + 1, FAR_APART + 1, SHORTEST)
    assert not is_tried(FEW, 4.0, SHORTEST - 1)
    assert not is_tried(FEWEST - 1, FAR_APART + 1, SHORTEST)
