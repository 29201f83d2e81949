"""Planes of segments against closed forms, and depth that they complete: a grey board on a wall, and what is behind."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall
from tolerances import assert_close

from gsjax.stereo.completion import BEHIND, OFF_PLANE, ON_PLANE, complete, plane_normals
from gsjax.stereo.planes import TOLERANCE, local_planes, photo_segments, segment_planes
from gsjax.stereo.views import View, stereo_views

AWAY = 3.0
GREY = 128
VIEWS = tuple(replace(view, color=np.full_like(view.color, GREY)) for view in stereo_views(wall(4)))
HEIGHT, WIDTH = VIEWS[0].gray.shape
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH] + 0.5
HOLE = np.zeros((HEIGHT, WIDTH), bool)
HOLE[20:50, 30:66] = True


def plane_map(value, across, down):
    """The map of the plane whose inverse depth is `value` in the middle."""
    inverse = value + across * (COLUMNS - WIDTH / 2) + down * (ROWS - HEIGHT / 2)
    return np.stack([inverse, np.full_like(inverse, across), np.full_like(inverse, down)], axis=-1)


def depth_of(planes, is_known=True):
    return np.where(is_known, 1 / planes[..., 0], 0)


def test_slopes_of_a_plane_are_found_to_its_border():
    planes = plane_map(1 / AWAY, 4e-4, -3e-4)
    np.testing.assert_allclose(local_planes(depth_of(planes)), planes, rtol=0, atol=1e-6)
    holed = local_planes(depth_of(planes, ~HOLE))
    assert not holed[HOLE].any()
    np.testing.assert_allclose(holed[~HOLE], planes[~HOLE], rtol=0, atol=1e-6)


def test_normals_are_those_of_the_plane():
    """n.P = h has inverse depth n.ray / h, which is affine in the pixel."""
    view, unit = VIEWS[0], np.array([0.5, -0.3, -0.8]) / np.linalg.norm([0.5, -0.3, -0.8])
    rays = np.stack(
        [(COLUMNS - view.K[0, 2]) / view.K[0, 0], (ROWS - view.K[1, 2]) / view.K[1, 1], np.ones_like(ROWS)], -1
    )
    inverse = rays @ unit / (AWAY * unit[2])
    slopes = unit[:2] / (AWAY * unit[2]) / np.diag(view.K)[:2]
    planes = np.concatenate([inverse[..., None], np.broadcast_to(slopes, (HEIGHT, WIDTH, 2))], axis=-1)
    facing = inverse > 0
    np.testing.assert_allclose(
        plane_normals(planes, view)[facing], np.broadcast_to(unit, (facing.sum(), 3)), atol=1e-12
    )


def test_a_segment_without_texture_lies_on_the_plane_of_its_outline():
    """A fifth of what is known is wrong; two halves of other colours have planes of their own."""
    rng = np.random.default_rng(0)
    halves = np.where(COLUMNS[..., None] < WIDTH / 2, plane_map(1 / AWAY, 4e-4, 0), plane_map(0.8 / AWAY, -3e-4, 2e-4))
    color = np.where(COLUMNS[..., None] < WIDTH / 2, np.uint8(60), np.uint8(200)) * np.ones(3, np.uint8)
    view = replace(VIEWS[0], color=color, nearest=1.0, farthest=10.0)
    is_measured = ~HOLE
    noisy = halves[..., 0] * rng.uniform(1 - TOLERANCE / 3, 1 + TOLERANCE / 3, (HEIGHT, WIDTH))
    wrong = rng.random((HEIGHT, WIDTH)) < 0.2
    noisy[wrong] *= rng.uniform(1.1, 1.5, wrong.sum())
    input_planes = np.where(is_measured[..., None], np.concatenate([noisy[..., None], halves[..., 1:]], axis=-1), 0)
    result = segment_planes(view, photo_segments(view.color), input_planes, rng)
    is_known = result[..., 0] > 0
    np.testing.assert_array_equal(is_known, np.abs(COLUMNS - WIDTH / 2) > 2, "the edge between them is of neither")
    np.testing.assert_allclose(result[is_known, 0], halves[is_known, 0], rtol=TOLERANCE / 2)
    np.testing.assert_allclose(result[is_known, 1:], halves[is_known, 1:], rtol=0, atol=5e-5)


@pytest.mark.parametrize("case", ["no plane", "little depth", "one line"])
def test_a_segment_whose_depth_tells_no_plane_has_none(case):
    planes = plane_map(1 / AWAY, 0.0, 0.0)
    is_measured = np.ones((HEIGHT, WIDTH), bool)
    if case == "no plane":
        planes[..., 0] *= np.random.default_rng(0).uniform(0.7, 1.3, (HEIGHT, WIDTH))
    else:
        is_measured[:] = {"little depth": ROWS + COLUMNS < 7, "one line": np.abs(ROWS - 36) < 2}[case]
    view = replace(VIEWS[0], nearest=1.0, farthest=10.0)
    labels = photo_segments(view.color)
    assert not segment_planes(view, labels, planes * is_measured[..., None], np.random.default_rng(0)).any()


def completed(depths, views: tuple[View, ...] = VIEWS):
    return complete(
        views, depths, [[other for other in range(len(views)) if other != index] for index in range(len(views))]
    )


def seen_by_others(index, mask):
    """`[H, W]` bool: pixels whose place on the wall lies within the image, and at pixels of `mask`, of another view."""
    view = VIEWS[index]
    points = view.lift(np.full((HEIGHT, WIDTH), AWAY))
    landed = [VIEWS[other].landing(points) for other in range(len(VIEWS)) if other != index]
    return np.any([each.inside & mask[each.rows, each.columns] for each in landed], axis=0).reshape(HEIGHT, WIDTH)


def test_a_gap_that_all_photos_have_is_filled_with_the_wall():
    wall_depth = depth_of(plane_map(1 / AWAY, 0, 0), ~HOLE)
    whole = np.ones((HEIGHT, WIDTH), bool)
    for index, (depth, normals) in enumerate(completed([wall_depth] * 4)):
        np.testing.assert_array_equal(depth > 0, seen_by_others(index, whole))
        assert_close(depth[depth > 0], np.full((depth > 0).sum(), AWAY), rtol=1e-6, atol=0, why="fits")
        np.testing.assert_allclose(normals[depth > 0] @ [0, 0, -1], 1, atol=1e-6)
        assert not normals[depth == 0].any()
    (alone,) = complete(VIEWS[:1], [depth_of(plane_map(1 / AWAY, 0, 0))], [[]])
    assert not alone.depth.any() and not alone.normals.any(), "one photo confirms nothing of itself"


def test_a_gap_that_a_photo_looks_through_stays():
    """The first photo shows another colour in its hole, which lies behind the wall."""
    wall_depth = depth_of(plane_map(1 / AWAY, 0, 0), ~HOLE)
    color = np.where(HOLE[..., None], np.uint8(250), VIEWS[0].color)
    behind = np.where(HOLE, AWAY * (1 + 2 * BEHIND), AWAY)
    depth, _ = completed([behind, *[wall_depth] * 3], (replace(VIEWS[0], color=color), *VIEWS[1:]))[1]
    points = VIEWS[1].lift(np.full((HEIGHT, WIDTH), AWAY))
    row, column, _, inside = VIEWS[0].landing(points)
    seen_through = (inside & HOLE[row, column]).reshape(HEIGHT, WIDTH) & HOLE
    assert seen_through.sum() > 100 and not depth[seen_through].any()


def test_depth_near_the_plane_of_its_segment_moves_there_and_depth_off_it_goes():
    off = np.zeros((HEIGHT, WIDTH))
    off[5:10, 5:40], off[60:66, 50:90] = 0.6 * ON_PLANE, 2 * OFF_PLANE
    depth, _ = completed([AWAY * (1 - off)] * 4)[0]
    near, dropped = off == 0.6 * ON_PLANE, off == 2 * OFF_PLANE
    shared = seen_by_others(0, np.ones((HEIGHT, WIDTH), bool))
    np.testing.assert_allclose(depth[near & shared & (depth > 0)], AWAY, rtol=1e-3)
    assert (near & (depth > 0)).sum() > 50
    is_left = (depth > 0) & dropped
    assert is_left.sum() > 20
    assert np.abs(depth[is_left] / AWAY - 1).max(initial=0) < OFF_PLANE, "what is left there is the plane's"
