"""Stereo depth completed by planes: depth near the plane of its segment moves there, and gaps are filled from it.

A gap is filled only where another photo shows the same surface and no photo sees through it. This is done in rounds:
what other photos show of a gap lets planes be fitted to segments that have too little depth of their own.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsjax.io.parallel_map import parallel_map
from gsjax.scene.meshes import unit_or_zero
from gsjax.stereo.planes import inverse_of, local_planes, photo_segments, segment_planes
from gsjax.stereo.views import View

ROUNDS = 2
ON_PLANE = 0.01  # of the inverse depth, up to which stereo depth moves to its segment's plane,
OFF_PLANE = 0.02  # and from which it is dropped: at an outline a window takes the nearer surface's depth
SAME_DEPTH = 0.01  # of the inverse depth, between photos that show one surface
SAME_PIXEL = 1.0  # pixels, by which that difference moves a pixel in the other photo at the most
SAME_ANGLE = 25.0  # degrees, between the normals of two photos that show one surface
BEHIND = 0.04  # of the depth, by which what a photo shows behind a surface contradicts it


class CompletedDepth(NamedTuple):
    """The surface that a photo shows."""

    depth: np.ndarray  # [H, W] float64 camera z, scene units; 0 where it is unknown
    normals: np.ndarray  # [H, W, 3] float32 unit, in the camera's frame, towards it; 0 where depth is unknown


class _Surface(NamedTuple):
    view: View
    planes: np.ndarray  # [H, W, 3] of depth and of segments; 0 where there is none
    normals: np.ndarray  # [H, W, 3] of these planes
    stereo: np.ndarray  # [H, W] inverse depth by stereo alone; 0 where it is unknown


def complete(
    views: Sequence[View], depths: Sequence[np.ndarray], near: Sequence[Sequence[int]]
) -> list[CompletedDepth]:
    """Complete the depth `[H, W]` of photos by planes.

    Depth is known where another photo confirms it; `near` has the indices of those that each is compared with.
    """
    stereo = list(map(inverse_of, depths))
    segments = list(parallel_map(lambda view: photo_segments(view.color), views))
    completed = _complete_once(views, segments, depths, stereo, near)
    for _ in range(ROUNDS - 1):
        current = [each.depth for each in completed]
        filled = [_filled(index, views, current, near[index]) for index in range(len(views))]
        completed = _complete_once(views, segments, filled, stereo, near)
    return completed


def _filled(index: int, views: Sequence[View], depths: Sequence[np.ndarray], others: Sequence[int]) -> np.ndarray:
    """The depth of a photo, and where there is none that of the nearest surface that other photos show there."""
    view, depth = views[index], depths[index]
    nearest = np.full(view.gray.shape, np.inf)
    for other in others:
        row, column, z, inside = view.landing(views[other].lift(depths[other]))
        np.minimum.at(nearest, (row[inside], column[inside]), z[inside])
    return np.where((depth == 0) & np.isfinite(nearest) & view.usable, nearest, depth)


def _complete_once(
    views: Sequence[View],
    segments: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    stereo: Sequence[np.ndarray],
    near: Sequence[Sequence[int]],
) -> list[CompletedDepth]:
    def surface_of(index: int) -> _Surface:
        rng = np.random.default_rng(index)  # One for each photo, as threads take turns.
        planes = _completed_planes(views[index], segments[index], depths[index], rng)
        return _Surface(views[index], planes, plane_normals(planes, views[index]), stereo[index])

    surfaces = list(parallel_map(surface_of, range(len(views))))
    others_of = [[surfaces[other] for other in each] for each in near]
    return list(parallel_map(lambda index: _checked(surfaces[index], others_of[index]), range(len(views))))


def _checked(surface: _Surface, others: Sequence[_Surface]) -> CompletedDepth:
    """What other photos confirm of a surface and none contradicts."""
    confirmed = np.zeros(surface.planes.shape[:2], bool)
    contradicted = np.zeros_like(confirmed)
    for other in others:
        same, behind = _compare(surface, other)
        confirmed |= same
        contradicted |= behind
    is_known = confirmed & ~contradicted
    depth = inverse_of(np.where(is_known, surface.planes[..., 0], 0))
    return CompletedDepth(depth, np.where(is_known[..., None], surface.normals, 0).astype(np.float32))


def _completed_planes(view: View, labels: np.ndarray, depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`[H, W, 3]` map of planes of the depth and of the photo's segments."""
    own = local_planes(depth)
    segments = segment_planes(view, labels, own, rng)
    has_plane = segments[..., 0] > 0
    apart = np.abs(own[..., 0] - segments[..., 0])
    is_kept = (depth > 0) & ~(has_plane & (apart > OFF_PLANE * segments[..., 0]))
    takes_plane = has_plane & np.where(is_kept, apart < ON_PLANE * segments[..., 0], (depth == 0) & view.usable)
    return np.where(takes_plane[..., None], segments, own * is_kept[..., None])


def _compare(surface: _Surface, other: _Surface) -> tuple[np.ndarray, np.ndarray]:
    """`[H, W]` bool: where another photo shows the same surface, and where its stereo shows one behind."""
    view, theirs = surface.view, other.view
    turn = theirs.viewmat[:3, :3] @ view.viewmat[:3, :3].T
    shift = theirs.K @ (theirs.viewmat[:3, 3] - turn @ view.viewmat[:3, 3])
    rows, columns = np.nonzero(surface.planes[..., 0] > 0)
    inverse = surface.planes[rows, columns, 0]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=-1)
    there = pixels @ (theirs.K @ turn @ np.linalg.inv(view.K)).T + inverse[:, None] * shift
    ahead = there[:, 2] > 0.05  # Their depth, as a share of ours.
    x, y = (there[:, :2] / np.where(ahead, there[:, 2], 1)[:, None]).T
    height, width = theirs.gray.shape
    inside = np.flatnonzero(ahead & (x >= 0) & (x < width) & (y >= 0) & (y < height))
    rows, columns, inverse, x, y = (each[inside] for each in (rows, columns, inverse, x, y))
    column, row = x.astype(int), y.astype(int)
    expected = inverse / there[inside, 2]
    value, slope_x, slope_y = other.planes[row, column].T
    inverse_there = value + slope_x * (x - column - 0.5) + slope_y * (y - row - 0.5)
    apart = np.abs(inverse_there - expected)
    along = np.hypot(shift[0] - x * shift[2], shift[1] - y * shift[2])
    same = (value > 0) & (apart < SAME_DEPTH * expected) & (apart / expected * inverse * along < SAME_PIXEL)
    turned = surface.normals[rows[same], columns[same]] @ turn.T
    cosine = np.sum(turned * other.normals[row[same], column[same]], axis=-1)
    same[same] = cosine > np.cos(np.radians(SAME_ANGLE))
    stereo = other.stereo[row, column]
    maps = np.zeros((2, *surface.planes.shape[:2]), bool)
    maps[0, rows, columns] = same
    maps[1, rows, columns] = (stereo > 0) & (stereo < expected * (1 - BEHIND))
    return maps[0], maps[1]


def plane_normals(planes: np.ndarray, view: View) -> np.ndarray:
    """`[H, W, 3]` unit normals, in the camera's frame and towards it, of a map of planes; 0 where there is none.

    For points P of a plane n.P = h, inverse depth is n.(ray / h), hence n / h follows from its value and slopes.
    """
    height, width = planes.shape[:2]
    x, y = np.meshgrid(np.arange(width) + 0.5 - view.K[0, 2], np.arange(height) + 0.5 - view.K[1, 2])
    value, slope_x, slope_y = np.moveaxis(planes, -1, 0)
    away = np.stack([view.K[0, 0] * slope_x, view.K[1, 1] * slope_y, value - x * slope_x - y * slope_y], axis=-1)
    return unit_or_zero(-away) * (value > 0)[..., None]
