"""Maps that the filter rejects: stereo normals, and the map's where stereo confirms them in the segment and nearby."""

import numpy as np
import pytest

from gsjax.stereo import witnessed_normals

AHEAD, ASIDE = np.int8([0, 0, -127]), np.int8([127, 0, 0])
HEIGHT, WIDTH = 60, 120
WALL, WINDOW = np.s_[:, :60], np.s_[:, 60:]
INSIDE_WALL = np.arange(WIDTH) < 50  # beyond, the outline is a segment of its own


@pytest.fixture(scope="module")
def photo():
    """A dark wall on the left, a bright window on the right."""
    color = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    color[WINDOW] = 220
    return color


def striped(normals):
    """Stereo knows every other band of ten columns."""
    has_stereo = np.arange(WIDTH) % 20 < 10
    return np.where(has_stereo[None, :, None], normals, 0).astype(np.int8), has_stereo


def test_a_wall_that_stereo_confirms_counts_and_a_window_that_it_contradicts_does_not(photo):
    surface = np.tile(AHEAD, (HEIGHT, WIDTH, 1))
    normals = surface.copy()
    normals[WINDOW] = ASIDE
    stereo, has_stereo = striped(surface)
    trusted_normals = witnessed_normals(normals, stereo, photo)
    assert (trusted_normals[:, has_stereo] == AHEAD).all()
    assert (trusted_normals[:, ~has_stereo & INSIDE_WALL] == AHEAD).all()
    assert not trusted_normals[WINDOW][:, ~has_stereo[60:]].any()


def test_far_from_what_stereo_knows_a_segment_counts_less():
    normals = np.tile(AHEAD, (HEIGHT, WIDTH, 1))
    stereo = np.where(np.arange(WIDTH)[None, :, None] < 40, normals, 0).astype(np.int8)
    trusted_normals = witnessed_normals(normals, stereo, np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    assert (trusted_normals[:, :44] == AHEAD).all() and not trusted_normals[:, 90:].any()


@pytest.mark.parametrize(("degrees", "weight"), [(14, 1), (18, 2 / 3), (22, 0)])
def test_weight_falls_with_the_angle_to_stereo(photo, degrees, weight):
    normals = np.tile(AHEAD, (HEIGHT, WIDTH, 1))
    angle = np.radians(degrees)
    turned = np.rint(127 * np.array([np.sin(angle), 0, -np.cos(angle)])).astype(np.int8)
    stereo, has_stereo = striped(np.tile(turned, (HEIGHT, WIDTH, 1)))
    lengths = np.linalg.norm(
        witnessed_normals(normals, stereo, photo)[:, ~has_stereo & INSIDE_WALL].astype(np.float32), axis=-1
    )
    assert np.abs(lengths / 127 - weight).max() < 0.05  # an eighth of a degree is lost in 8 bits


def test_stereo_at_half_the_size_and_a_map_without_normals(photo):
    stereo = np.tile(AHEAD, (HEIGHT // 2, WIDTH // 2, 1))
    stereo[:, 30:] = 0
    trusted_normals = witnessed_normals(np.zeros((HEIGHT, WIDTH, 3), np.int8), stereo, photo)
    assert (trusted_normals[WALL] == AHEAD).all() and not trusted_normals[WINDOW].any()
