"""Validation runs with and without a change: what they are given, what they measure, and when they end."""

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import built_in

from gsjax.io.scenes import load_scene
from gsjax.planning import sparse_view_validation, validation
from gsjax.planning.sparse_view_validation import FEWEST_FOLDS, FOLDS, Score, gain
from gsjax.scene import Pixels, Tracks, frame_of, with_pixels
from gsjax.scene.cameras import Camera
from gsjax.settings import Model, Phase, Schedule, Settings
from gsjax.training import step

SETTINGS = Settings(
    model=Model(background="white", sh_degree=1), schedule=Schedule(phases=(Phase("vanilla", 900),), sparse_views=True)
)
FORGETFUL = 0.9  # of all Gaussians left out of every step: no way to train


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    scene = load_scene(built_in(tmp_path_factory.mktemp("data") / "scene", num_views=9, size=(48, 40)))
    return replace(scene, points=scene.points[::4], point_colors=scene.point_colors[::4], tracks=None)


@pytest.fixture
def short(monkeypatch):
    """Validation runs of twenty steps."""
    (phase,) = validation.SHORT.schedule.phases
    density = replace(validation.SHORT.density, start=5, stop=15)
    monkeypatch.setattr(
        validation, "SHORT", validation.SHORT.replace(schedule={"phases": (replace(phase, steps=20),)}, density=density)
    )


def forgetful(plan):
    return replace(plan, phases=tuple(replace(phase, dropout=FORGETFUL) for phase in plan.phases))


@pytest.mark.usefixtures("short")
def test_the_worse_way_loses_the_same_way_gains_nothing_and_runs_of_one_way_share_their_programs(scene, monkeypatch):
    """All that a program is kept by (`gsjax.training.step.kept_step`) is the same, but for the pairs' buffer."""
    original, calls = step._shared_train_step, []

    def noted(*arguments, capacity, **how):
        calls.append((arguments, tuple(how.items())))
        return original(*arguments, capacity=capacity, **how)

    monkeypatch.setattr(step, "_shared_train_step", noted)
    masked = with_pixels(scene.frames[0], scene.frames[0].pixels()._replace(valid=np.zeros((40, 48), np.uint8)))
    same = gain(replace(scene, frames=(masked, *scene.frames[1:])), SETTINGS, lambda plan: plan)
    assert same == (0.0, 0.0, None, None), "no photo of this scene has matched points"
    assert len(calls) >= 2 * FEWEST_FOLDS and len(set(calls)) == 1
    photo, point = np.divmod(np.arange(len(scene.frames) * len(scene.points)), len(scene.points))
    tracks = Tracks(tuple(f.name for f in scene.frames), photo, point, np.zeros((len(point), 2)))
    worse = gain(replace(scene, tracks=lambda: tracks), SETTINGS, forgetful)
    assert worse.decibels < -2 * worse.error < 0 and worse.depth > 0.05
    assert len(set(calls)) == 2


@pytest.fixture
def run_log(monkeypatch):
    """What validation runs are given; they score zero and 0.1 without the change, and `scores` and `offs` with it."""
    runs, scores, offs = [], [], {}

    def score(way, scene, depths, settings, matched, observe):
        runs.append((way, [f.name for f in scene.held_out_frames]))
        is_held = way is not runs[0][0]
        numbers = [int(name[:3]) for name in runs[-1][1]]
        return [Score(scores[i], offs.get(i)) if is_held else Score(0.0, 0.1) for i in numbers]

    monkeypatch.setattr(sparse_view_validation, "score_variant", score)
    monkeypatch.setattr(sparse_view_validation, "training_extent", lambda scene: 1.0)
    return runs, scores, offs


def names(count, held_out=()):
    pixels = Pixels(np.zeros((8, 8, 3), np.uint8))
    return tuple(frame_of(f"{i:03d}", np.eye(4), np.eye(3), pixels, held_out=i in held_out) for i in range(count))


def test_unsure_runs_keep_every_photo_once_in_both_ways(run_log, scene):
    runs, scores, _ = run_log
    scores += [1.0, -1.0] * 5
    result = gain(replace(scene, frames=names(10, held_out=(3,))), SETTINGS, forgetful)
    first, *_ = runs[0]
    as_it_is = [name for way, photos in runs if way is first for name in photos]
    other_way = [name for way, photos in runs if way is not first for name in photos]
    assert len(runs) == 2 * FOLDS
    assert as_it_is == other_way
    assert sorted(other_way) == [f"{i:03d}" for i in range(10) if i != 3], "held-out photos play no part"
    expected = np.delete(scores, 3)
    assert result[:2] == pytest.approx((expected.mean(), expected.std(ddof=1) / 3))
    assert result[2:] == (None, None)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("ratio", [None, 0.5, 2.0])
def test_sure_runs_end_where_depth_does_not_contradict_them(run_log, scene, sign, ratio):
    runs, scores, offs = run_log
    scores += [sign * (2 + 0.1 * (i % 3)) for i in range(10)]
    if ratio is not None:
        offs |= {i: 0.1 * ratio * (1 + 0.01 * (i % 3 - 1)) for i in range(10)}
    result = gain(replace(scene, frames=names(10)), SETTINGS, forgetful)
    contradicted = ratio == (2.0 if sign > 0 else 0.5)
    assert sign * result.decibels > 2
    assert result.is_contradicted == contradicted
    assert len(runs) == 2 * (FOLDS if contradicted else FEWEST_FOLDS)


def test_depth_counts_where_both_ways_tell_of_it(run_log, scene):
    _, scores, offs = run_log
    scores += [1.0, -1.0] * 5
    offs |= {2: 0.05, 7: 0.2, 9: 0.1}
    result = gain(replace(scene, frames=names(10)), SETTINGS, forgetful)
    logs = np.log([0.5, 2.0, 1.0])
    assert result[2:] == pytest.approx((logs.mean(), logs.std(ddof=1) / np.sqrt(3)))


def test_depth_is_off_by_what_matched_points_say():
    """A wall 2 before the camera is shown where points lie at 2 and 4; others lie behind, and beside the picture."""
    viewmat, K = np.eye(4, dtype=np.float32), np.array([[10, 0, 8], [0, 10, 8], [0, 0, 1]], np.float32)
    camera = Camera(viewmat, K, 16, 16)
    at_two = np.tile([0.1, 0.1, 2.0], (15, 1))
    at_four = np.tile([0.1, -0.1, 4.0], (16, 1))
    unseen = np.tile([0.0, 0.0, -2.0], (40, 1)), np.tile([9.0, 0.0, 1.0], (40, 1))
    wall, whole = np.full((16, 16), 2.0), np.ones((16, 16), bool)
    above = whole.copy()
    above[8:] = False  # those at two are masked

    def off(depth, *points, valid=whole):
        return sparse_view_validation.depth_error(depth, valid, camera, np.concatenate(points))

    assert off(wall, at_two, at_four, *unseen) == pytest.approx(0.5)
    assert off(wall, at_two, at_two) == sparse_view_validation.LEAST_ERROR
    assert off(np.zeros((16, 16)), at_four, at_four) == 1.0, "nothing is shown"
    assert off(wall, at_two, *unseen) is None
    assert off(wall, at_two, at_two, at_two, at_four, at_four, valid=above) == pytest.approx(0.5)
    assert off(wall, at_two, at_two, at_four, valid=above) is None
