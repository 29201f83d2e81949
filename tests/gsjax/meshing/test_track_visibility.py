"""Photos of a wall in four parts: as it is, gone, behind a lump, and moved back; each part is told from the others."""

from pathlib import Path

import numpy as np
import pytest
from meshes import mesh_of

from gsjax.meshing.cleaning import concatenate_meshes
from gsjax.meshing.regions import Box
from gsjax.meshing.track_visibility import SAME_SURFACE, track_rays, track_visibility
from gsjax.scene import Pixels, Scene, Tracks, frame_of

AWAY, PHOTOS = 10.0, 4
PARTS = {"met": 40, "nothing": 30, "before": 20, "behind": 10}  # points that lie in each quarter of the wall


def rectangle(x, z, y=(-2, 2)):
    """Two triangles that face the cameras, which look along +z."""
    return mesh_of([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]], [[0, 2, 1], [0, 3, 2]])


def wall(*, lump=0.5, moved=0.5):
    """From x = -4 to 4; the second quarter is missing."""
    lumps = rectangle((0.5, 1.5), AWAY - lump)  # It hides the points, which lie in the middle of their quarter.
    return concatenate_meshes(
        [rectangle((-4, -2), AWAY), rectangle((0, 2), AWAY), lumps, rectangle((2, 4), AWAY + moved)]
    )


def photographed(off=0.0):
    """The wall's points in photos side by side; 20 points are 50 pixels off in each, 20 were matched in two photos."""
    rng = np.random.default_rng(0)
    middles = np.repeat([-3.0, -1, 1, 3], list(PARTS.values()))
    x = np.r_[middles, np.full(40, -1.0)] + rng.uniform(-0.05, 0.05, 140)
    points = np.stack([x, rng.uniform(-1, 1, 140), np.full(140, AWAY)], -1)
    K, frames, observations = np.array([[100.0, 0, 100], [0, 100, 100], [0, 0, 1]], np.float32), [], []
    for index in range(PHOTOS):
        viewmat = np.eye(4, dtype=np.float32)
        viewmat[0, 3] = 0.1 * index
        frames.append(frame_of(f"{index}.png", viewmat, K, Pixels(np.zeros((200, 200, 3), np.uint8))))
        ids = np.arange(140 if index < 2 else 120)
        rays = (points[ids, :2] + viewmat[:2, 3]) / AWAY + rng.normal(0, 0.005, (len(ids), 2))
        rays[100:120] += 0.5
        observations.append((np.full(len(ids), index), ids, rays))
    photo, point, rays = (np.concatenate(column) for column in zip(*observations, strict=True))
    names = tuple(frame.name for frame in frames)
    tracks = Tracks(names, photo.astype(np.int32), point.astype(np.int32), rays.astype(np.float32))
    return Scene(
        Path("wall"), "colmap", tuple(frames), points.astype(np.float32), np.zeros((140, 3), np.uint8),
        tracks=lambda: tracks,
    )  # fmt: skip


@pytest.fixture(scope="module")
def lines():
    return track_rays(photographed())


def test_lines_are_those_of_tracks_that_fit(lines):
    """A few of the 400 observations are left out as the worst of a normal distribution's."""
    assert 0.97 * PHOTOS * 100 < len(lines) <= PHOTOS * 100
    np.testing.assert_allclose(np.unique(lines.origins[:, 0]), -0.1 * np.arange(PHOTOS)[::-1], atol=1e-6)
    assert not len(track_rays(Scene(Path("bare"), "colmap", (), np.zeros((0, 3)), np.zeros((0, 3)))))


def test_each_kind_of_miss_is_counted_as_it_is(lines):
    quarter = np.searchsorted([-2, 0, 2], lines.points[:, 0])
    shares = np.bincount(quarter, minlength=4) / len(lines)
    assert track_visibility(wall(), lines) == pytest.approx(dict(zip(PARTS, shares, strict=True)), abs=1e-12)


def test_what_lies_within_the_tolerance_is_met(lines):
    near, there = AWAY * SAME_SURFACE * 0.9, lines.within([Box([0, -3, 0], [4, 3, 20])])
    assert 0 < len(there) < len(lines)
    assert track_visibility(wall(lump=near, moved=near), there)["met"] == 1
    assert track_visibility(wall(), there)["met"] == 0
