"""Depth that photos of a painted wall tell of each other, where it is known; and photos that tell nothing."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import SIZE, wall
from tolerances import assert_close

from gsjax.scene import Scene, with_pixels
from gsjax.stereo import depths_of_photos, stereo_points, views
from gsjax.stereo.depths import FEWEST_CHECKED, Evidence, evidence
from gsjax.stereo.views import stereo_views

AWAY = 3.0  # from the cameras to the wall


def painted(scene: Scene) -> Scene:
    """The wall in a pattern as fine as its photos show."""
    rng = np.random.default_rng(0)
    waves = rng.normal(size=(12, 2))
    waves *= rng.uniform(6, 25, (12, 1)) / np.linalg.norm(waves, axis=1, keepdims=True)
    phases = rng.uniform(0, 2 * np.pi, (12, 3))

    def photo(index, pixels):
        frame = scene.frames[index]
        x, y = np.meshgrid(np.arange(frame.width) + 0.5, np.arange(frame.height) + 0.5)
        places = np.stack([x, y], axis=-1) - frame.K[:2, 2]
        places = places / frame.K[0, 0] * frame.viewmat[2, 3] - frame.viewmat[:2, 3]
        values = np.sin((places @ waves.T)[..., None] + phases).sum(axis=2)
        return pixels._replace(image=np.clip(128 + 20 * values, 0, 255).astype(np.uint8))

    return change_photos(scene, photo)


def change_photos(scene: Scene, change) -> Scene:
    """The scene with every photo's pixels changed by `change(index, pixels)`."""
    return replace(
        scene, frames=tuple(with_pixels(frame, change(i, frame.pixels())) for i, frame in enumerate(scene.frames))
    )


WALL = painted(wall(5))


def exposed(index, pixels):
    return pixels._replace(image=(pixels.image * [0.5, 1.0, 0.7, 0.9, 0.4][index] + 20).astype(np.uint8))


def noise(index, pixels):
    return pixels._replace(image=np.random.default_rng(index).integers(0, 256, pixels.image.shape).astype(np.uint8))


@pytest.fixture(scope="module")
def wall_depths():
    return depths_of_photos(WALL)


def test_points_lie_on_the_wall_in_its_colours_whatever_the_exposures():
    scene = change_photos(WALL, exposed)
    result = stereo_points(depths_of_photos(scene), 500)
    assert 100 < len(result.points) <= 500
    off = np.abs(result.points[:, 2])
    assert np.median(off) < 0.005 * AWAY and off.max() < 0.03 * AWAY
    assert np.ptp(result.points[:, 0]) > 2.5 and np.ptp(result.points[:, 1]) > 1.8, "all over what the photos show"
    brightest = np.max([frame.pixels().image.max(axis=(0, 1)) for frame in scene.frames], axis=0)
    assert result.colors.dtype == np.uint8 and (result.colors <= brightest).all()
    assert result.line == f"{len(result.points):,} more points of multi-view consistent depth"


def test_a_photo_far_larger_than_the_sweep_is_told_by_a_smaller_copy(monkeypatch):
    monkeypatch.setattr(views, "SIDE", SIZE[0] // 2)
    view = stereo_views(WALL)[0]
    assert view.gray.shape == (SIZE[1] // 2, SIZE[0] // 2)
    landed = view.landing(WALL.points[view.matched])
    assert_close(landed.depths, np.full(len(view.matched), AWAY), rtol=1e-6, atol=0, why="poses are float32")
    assert landed.inside.all()
    assert np.abs(stereo_points(depths_of_photos(WALL), 200).points[:, 2]).max() < 0.03 * AWAY


def test_every_photo_tells_the_depth_of_the_wall(wall_depths):
    assert [each.view.name for each in wall_depths.accepted] == [frame.name for frame in WALL.frames]
    assert wall_depths.line.startswith("5 of 5 photos; 100% of")
    for each in wall_depths.accepted:
        is_confident = each.depth > 0
        assert is_confident.shape == SIZE[::-1] and 0.3 < is_confident.mean() < 1
        assert np.abs(each.depth[is_confident] - AWAY).max() < 0.03 * AWAY
        assert not each.normals[~is_confident].any()
        assert np.quantile(each.normals[is_confident] @ [0, 0, -1], 0.05) > np.cos(np.radians(10))
    assert depths_of_photos(WALL, 3).compared == 3


@pytest.mark.parametrize(
    "nothing",
    [
        replace(WALL, tracks=None),
        replace(WALL, frames=WALL.frames[:1]),
        replace(WALL, frames=()),
        change_photos(WALL, noise),
        replace(WALL, frames=tuple(replace(frame, held_out=True) for frame in WALL.frames)),
        change_photos(WALL, lambda _, pixels: pixels._replace(image=np.full_like(pixels.image, 90))),
        change_photos(WALL, lambda _, pixels: pixels._replace(valid=np.zeros(pixels.image.shape[:2], np.uint8))),
        replace(WALL, frames=tuple(replace(frame, name=f"other{frame.name}") for frame in WALL.frames)),
    ],
    ids=["no tracks", "one photo", "no photo", "noise", "all held out", "grey", "masked", "never matched"],
)
def test_where_there_is_nothing_to_compare_nothing_is_found(nothing):
    assert not depths_of_photos(nothing).accepted


@pytest.mark.parametrize("mask", ["matte", "valid"])
def test_masked_pixels_have_no_say(mask, wall_depths):
    half = np.full(SIZE[::-1], 255, np.uint8)
    half[:, : SIZE[0] // 2] = 0
    masked = change_photos(WALL, lambda _, pixels: pixels._replace(**{mask: half}))
    result, whole = (stereo_points(depths, 500) for depths in (depths_of_photos(masked), wall_depths))
    assert result.points[:, 0].min() > whole.points[:, 0].min() + 0.5


def test_a_photo_with_a_wrong_pose_spoils_nothing():
    turned = WALL.frames[2].viewmat.copy()
    turned[0, 3] += 0.4
    frames = tuple(replace(f, viewmat=turned) if i == 2 else f for i, f in enumerate(WALL.frames))
    result = stereo_points(depths_of_photos(replace(WALL, frames=frames)), 500)
    assert np.quantile(np.abs(result.points[:, 2]), 0.95) < 0.03 * AWAY


def test_matched_points_judge_a_photo():
    view = stereo_views(WALL)[0]
    wholly = np.full(view.gray.shape, AWAY)
    correct = evidence(view, wholly, WALL.points)
    assert correct == Evidence(len(view.matched), len(view.matched)) and correct.is_good
    wrong = evidence(view, wholly * 1.05, WALL.points)
    assert wrong == Evidence(0, len(view.matched)) and not wrong.is_good
    assert Evidence(0, FEWEST_CHECKED - 1).is_good and not Evidence(15, FEWEST_CHECKED).is_good
    assert Evidence(16, FEWEST_CHECKED).is_good
