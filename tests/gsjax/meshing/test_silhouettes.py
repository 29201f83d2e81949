"""Balls before cameras: how a mesh's outline covers a matte is what circles say."""

from pathlib import Path

import numpy as np
import pytest
from meshes import ball

from gsjax.meshing import silhouettes
from gsjax.meshing.silhouettes import MOST_PHOTOS, overlap, silhouettes_of
from gsjax.scene import Pixels, Scene, frame_of
from gsjax.scene.cameras import look_at

SIZE, FOCAL, AWAY = 200, 300.0, 5.0


def outline(radius):
    """`[H, W]` bool: what a ball of that radius covers, seen from `AWAY`."""
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2) / FOCAL
    return np.hypot(x, y) < np.tan(np.arcsin(radius / AWAY))


def photos(count, valid=None, matte=True):
    """Of a ball of radius 1, from directions around it."""
    K = np.float32([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
    pixels = Pixels(np.zeros((SIZE, SIZE, 3), np.uint8), 255 * outline(1.0).astype(np.uint8) if matte else None, valid)
    eyes = AWAY * np.stack([np.cos(range(count)), np.sin(range(count)), np.zeros(count)], axis=-1)
    poses = [look_at(eye, np.zeros(3), np.array([0.0, 0, 1])).astype(np.float32) for eye in eyes]
    return tuple(frame_of(f"{index:02d}.png", pose, K, pixels) for index, pose in enumerate(poses))


def scene(frames):
    return Scene(Path("ball"), "transforms", frames, np.zeros((0, 3)), np.zeros((0, 3)))


@pytest.mark.parametrize(("radius", "half", "every"), [(0.8, False, 1), (1.0, True, 2), (1.2, True, 3)])
def test_shares_are_those_of_circles(radius, half, every, monkeypatch):
    """Of the facets' edges a pixel in some hundred falls on the other side, whether all pixels are asked or a ninth."""
    monkeypatch.setattr(silhouettes, "MOST_PIXELS", (SIZE // every + 1) ** 2)
    valid = np.where(np.arange(SIZE) < SIZE / 2, np.uint8(255), np.uint8(0)) * np.ones((SIZE, 1), np.uint8)
    usable = valid > 0 if half else np.ones((SIZE, SIZE), bool)
    mesh, matte = outline(radius) & usable, outline(1.0) & usable
    either = np.sum(mesh | matte)
    expected = [np.sum(part) / either for part in (mesh & matte, mesh & ~matte, matte & ~mesh)]
    in_photos = silhouettes_of(scene(photos(3, valid if half else None)))
    assert in_photos[0].is_object.shape == (len(range(every // 2, SIZE, every)),) * 2
    shares = overlap(ball(5, radius), in_photos)
    np.testing.assert_allclose(list(shares.values()), expected, atol=0.006)


def test_photos_are_chosen_evenly_and_all_must_have_a_matte():
    many = photos(60)
    viewmats = [outline.camera.viewmat for outline in silhouettes_of(scene(many))]
    indices = [next(i for i, frame in enumerate(many) if frame.viewmat is viewmat) for viewmat in viewmats]
    assert len(indices) == MOST_PHOTOS
    assert (indices[0], indices[-1]) == (0, 59)
    assert set(np.diff(indices)) == {2, 3}
    assert len(silhouettes_of(scene(many[:5]))) == 5
    assert silhouettes_of(scene((*many[:5], *photos(1, matte=False)))) == ()
    assert silhouettes_of(scene(())) == ()
