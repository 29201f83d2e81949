"""What photos near a held-out one tell of its exposure."""

from dataclasses import replace

import numpy as np
import pytest

from gsjax.effects.appearance import NEAR_PHOTOS, Appearance, as_near_photos
from gsjax.scene import Pixels, frame_of
from gsjax.scene.cameras import look_at

ROUND = np.linspace(0, 2 * np.pi, 24, endpoint=False)
HELD_OUT = range(0, 24, 5)
PIXELS = Pixels(np.zeros((4, 6, 3), np.uint8))


def frame_from(eye, name, *, towards=None, held_out=False):
    """A photo from a place, along a direction, else towards the origin."""
    target = np.zeros(3) if towards is None else np.add(eye, towards)
    viewmat = look_at(np.asarray(eye, float), target, up=np.array([0.0, 0.0, 1.0]))
    return frame_of(name, viewmat, np.eye(3, dtype=np.float32), PIXELS, held_out=held_out)


def ring():
    """Cameras all round, exposed for what they look at: brighter on one side."""
    eyes = np.stack([3 * np.cos(ROUND), 3 * np.sin(ROUND), np.ones_like(ROUND)], -1)
    frames = [frame_from(eye, f"{i:02}", held_out=i in HELD_OUT) for i, eye in enumerate(eyes)]
    gains = 0.3 * np.cos(ROUND)[:, None] * np.array([1.0, 0.8, -0.5])
    return frames, {f.name: Appearance(tuple(g.tolist()), (-0.1, 0.02)) for f, g in zip(frames, gains, strict=True)}


def test_gains_that_follow_the_cameras_are_told_by_their_neighbours():
    frames, looks = ring()
    estimates = as_near_photos(frames, looks)
    assert list(estimates) == [f"{i:02}" for i in HELD_OUT]
    off = [np.abs(np.subtract(look.log_gains, looks[name].log_gains)).max() for name, look in estimates.items()]
    assert max(off) < 0.03 < 0.1 < np.mean([np.abs(looks[name].log_gains).max() for name in estimates])
    assert {look.falloff for look in estimates.values()} == {(-0.1, 0.02)}


def test_neither_the_unit_of_the_scene_nor_gains_of_held_out_photos_matter():
    frames, looks = ring()
    unit = np.float32([[1, 1, 1, 1e3]] * 3 + [[1] * 4])
    grown = [replace(frame, viewmat=frame.viewmat * unit) for frame in frames]
    other = {f.name: looks[f.name]._replace(log_gains=(9.0, 9.0, 9.0)) if f.held_out else looks[f.name] for f in frames}
    estimates, expected = as_near_photos(grown, other), as_near_photos(frames, looks)
    for name, look in expected.items():
        np.testing.assert_allclose(estimates[name].log_gains, look.log_gains, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, NEAR_PHOTOS])
def test_few_photos_and_photos_that_all_stand_in_one_place(count):
    """What is nearest of fewer than three is all of them; without a spread distances are those of the axes."""
    place = frame_from((0, -3, 0), "held", held_out=True)
    frames = [replace(place, name=f"{i}", held_out=False) for i in range(count)]
    looks = {f"{i}": Appearance((0.1 * i, 0.0, -0.1 * i), (0.0, 0.0)) for i in range(count)}
    estimates = as_near_photos([*frames, place], looks | {"held": Appearance((5.0,) * 3, (0.0, 0.0))})
    np.testing.assert_allclose(estimates["held"].log_gains, np.mean([look.log_gains for look in looks.values()], 0))


def test_photos_that_look_the_same_way_tell_more_than_nearer_ones_that_look_the_other_way():
    """Of a photo through a window those of a wall behind it are nearer neighbours than those through the window."""
    window, wall = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
    turns = np.radians([0.0, 120.0, 240.0])
    eyes = np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=-1)
    frames = [frame_from(0.1 * eye, f"wall{i}", towards=wall) for i, eye in enumerate(eyes)]
    frames += [frame_from(0.25 * eye, f"window{i}", towards=window) for i, eye in enumerate(eyes)]
    looks = {each.name: Appearance((-1.0,) * 3 if "window" in each.name else (1.0,) * 3, (0.0, 0.0)) for each in frames}
    held_out_frame = frame_from(np.zeros(3), "held", towards=window, held_out=True)
    estimates = as_near_photos([*frames, held_out_frame], looks | {"held": Appearance((0.0,) * 3, (0.0, 0.0))})
    assert estimates["held"].log_gains == pytest.approx((-1.0,) * 3)
