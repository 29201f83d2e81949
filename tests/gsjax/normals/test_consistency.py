"""The gate on a ball above ground, whose depth and normals are known in every view."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tolerances import assert_close

from gsjax.normals.consistency import LONGEST, View, full_size, judge_maps, share_compared, stride_of, thinned_view
from gsjax.normals.fitted_depth import sparse_depth
from gsjax.scene.cameras import look_at

WIDTH, HEIGHT = 64, 48
K = np.array([[70.0, 0, 31.5], [0, 72.0, 24.5], [0, 0, 1]])
BALL, RADIUS = np.array([0.0, 0.0, 1.0]), 0.8


def rays_of(width=WIDTH, height=HEIGHT, K=K):
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)


def seen_from(eye, rays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth, normals in the camera, and the viewmat."""
    viewmat = look_at(np.array(eye), np.array([0, 0, 0.5]), np.array([0.0, 0, 1])).astype(np.float64)
    center, directions = -viewmat[:3, :3].T @ viewmat[:3, 3], rays @ viewmat[:3, :3]
    along, squared = directions @ (BALL - center), np.sum(directions**2, -1)
    root = along**2 - squared * ((center - BALL) @ (center - BALL) - RADIUS**2)
    on_ball = root > 0
    down = directions[..., 2] < -1e-3
    ground = np.where(down, -center[2] / np.where(down, directions[..., 2], -1), 0)
    depth = np.where(on_ball, (along - np.sqrt(np.maximum(root, 0))) / squared, ground)
    normals = np.where(on_ball[..., None], (center + directions * depth[..., None] - BALL) / RADIUS, [0, 0, 1])
    return depth, np.where((depth > 0)[..., None], normals @ viewmat[:3, :3].T, 0), viewmat


def ring(count=10):
    angles = 2 * np.pi * np.arange(count) / count
    eyes = [(4 * np.cos(a), 4 * np.sin(a), 2.0 + 0.5 * (i % 2)) for i, a in enumerate(angles)]
    rays = rays_of()
    return [View(n.astype(np.float32), d.astype(np.float32), v, K) for d, n, v in (seen_from(e, rays) for e in eyes)]


VIEWS = ring()
FACING = -rays_of() / np.linalg.norm(rays_of(), axis=-1, keepdims=True)


def with_maps(maps):
    return [view._replace(normals=np.float32(normals)) for view, normals in zip(VIEWS, maps, strict=True)]


def blob(rng):
    """`[H, W]` bool, a fifth of the pixels."""
    field = gaussian_filter(rng.normal(size=(HEIGHT, WIDTH)), 6.0, mode="wrap")
    return field > np.quantile(field, 0.8)


def test_true_normals_are_kept():
    photos, verdict = judge_maps(VIEWS)
    assert verdict.is_accepted and verdict.rejected == () and verdict.share > 0.95
    assert verdict.evidence is not None and verdict.evidence > 0.95
    assert all(np.all(one.confidence[~np.any(v.normals, -1)] == 0) for one, v in zip(photos, VIEWS, strict=True))


def test_maps_that_only_face_their_cameras_and_of_random_directions_are_rejected():
    photos, verdict = judge_maps(with_maps([FACING] * len(VIEWS)))
    assert not verdict.is_accepted and verdict.share == 0 and abs(verdict.evidence or 1) < 0.1
    assert not any(one.confidence.any() for one in photos)
    rng = np.random.default_rng(0)
    noise = [rng.normal(size=(HEIGHT, WIDTH, 3)) for _ in VIEWS]
    _, verdict = judge_maps(with_maps([n / np.linalg.norm(n, axis=-1, keepdims=True) for n in noise]))
    assert not verdict.is_accepted and (verdict.evidence or 1) < 0


def test_a_fifth_of_every_map_made_wrong_is_found():
    rng = np.random.default_rng(1)
    wrong = [blob(rng) & np.any(view.normals, -1) for view in VIEWS]
    directions = rng.normal(size=(len(VIEWS), 3))
    directions *= -np.sign(directions[:, 2:]) / np.linalg.norm(directions, axis=-1, keepdims=True)
    maps = [np.where(w[..., None], d, v.normals) for w, d, v in zip(wrong, directions, VIEWS, strict=True)]
    photos, verdict = judge_maps(with_maps(maps))
    angles = [np.degrees(np.arccos(np.clip(v.normals @ d, -1, 1))) for v, d in zip(VIEWS, directions, strict=True)]
    confidence = np.stack([one.confidence for one in photos])
    clearly = np.stack(wrong) & (np.stack(angles) > 30)
    right = ~np.stack(wrong) & np.stack([np.any(v.normals, -1) for v in VIEWS])
    assert verdict.is_accepted and confidence[clearly].mean() < 0.1 and confidence[right].mean() > 0.85


def test_one_photo_that_is_wrong_whole_is_named_and_the_others_stay():
    maps = [view.normals for view in VIEWS]
    maps[3] = np.where(np.any(maps[3], -1, keepdims=True), [0.8, 0, -0.6], 0)
    photos, verdict = judge_maps(with_maps(maps))
    assert verdict.is_accepted and verdict.rejected == (3,) and verdict.note == "1 of 10 photos rejected"
    assert not photos[3].confidence.any() and min(one.mean_confidence for i, one in enumerate(photos) if i != 3) > 0.85


def test_without_depth_or_others_nothing_is_judged_and_all_stays():
    blind = [view._replace(depth=0 * view.depth) for view in VIEWS]
    for views in (VIEWS[:1], blind):
        photos, verdict = judge_maps(views)
        assert verdict.is_accepted and verdict.evidence is None and "cannot be judged" in verdict.note
        assert_close(verdict.share, 1.0)
        assert np.all(photos[0].confidence == np.any(VIEWS[0].normals, -1))


@pytest.mark.parametrize(("full", "has_depth"), [(4, True), (4, False), (6, False)])
def test_maps_that_are_mostly_empty_are_rejected_where_the_others_cannot_be_judged_too(full, has_depth):
    """As those of a network for depth are, where most photos do not fit; without depth no other judges the rest."""
    views = [
        view._replace(depth=view.depth * has_depth, normals=view.normals * (index < full))
        for index, view in enumerate(VIEWS)
    ]
    photos, verdict = judge_maps(views)
    assert verdict.is_accepted == (full == 6) and f"{10 - full} of 10 have no normals" in verdict.note
    if not has_depth:
        assert verdict.evidence is None
        assert_close(verdict.share, float(verdict.is_accepted))
        assert any(one.confidence.any() for one in photos) == verdict.is_accepted


def test_every_photo_is_told_how_far_its_normals_are_from_those_of_its_neighbours():
    """One photo's are turned by 12 degrees; the medians of the others hardly notice."""
    photos, _ = judge_maps(VIEWS)
    assert max(one.apart for one in photos) < 1
    maps = [view.normals for view in VIEWS]
    axis = np.cross(maps[3], [0.3, -0.5, 0.8])
    axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    angle = np.radians(12.0)
    maps[3] = np.cos(angle) * maps[3] + np.sin(angle) * np.cross(axis, maps[3])
    photos, _ = judge_maps(with_maps(maps))
    assert abs(photos[3].apart - 12) < 1
    assert max(one.apart for index, one in enumerate(photos) if index != 3) < 4
    assert judge_maps(VIEWS[:1])[0][0].apart is None


def test_photos_are_compared_as_often_as_their_normals_agree():
    assert_close([share_compared(apart) for apart in (None, 15, 17.5, 60)], [1.0, 1.0, 0.75, 0.0])


@pytest.mark.parametrize("size", [(257, 129), (100, 128)])
def test_a_view_at_its_working_size_sees_the_same_places(size):
    width, height = size
    large = K * np.array([[width / WIDTH], [height / HEIGHT], [1]])
    depth, normals, viewmat = seen_from((4.0, 0.5, 2.0), rays_of(width, height, large))
    view = thinned_view(np.rint(127 * normals).astype(np.int8), depth, viewmat, large)
    small_height, small_width = view.depth.shape
    assert max(view.depth.shape) <= LONGEST and (stride_of((height, width)) > 1) == (max(size) > LONGEST)
    again, _, _ = seen_from((4.0, 0.5, 2.0), rays_of(small_width, small_height, view.K))
    assert_close(view.depth, again)
    assert full_size(view.depth, (height, width)).shape == (height, width)
    inner = full_size(view.depth, (height, width))[-20:-10, 10:20]
    assert np.median(np.abs(inner / depth[-20:-10, 10:20] - 1)) < 0.02


def test_depth_between_points_of_a_plane_is_the_planes_and_at_an_edge_there_is_none():
    rng = np.random.default_rng(0)
    rays = rays_of()
    normal = np.array([0.4, -0.3, -1])
    plane = 3 * normal[2] / (rays @ normal)
    y, x = rng.integers(0, HEIGHT, 400), rng.integers(0, WIDTH, 400)
    depth = sparse_depth(rays[y, x, :2], plane[y, x], K, (HEIGHT, WIDTH))
    assert (depth > 0).mean() > 0.9
    assert np.abs(depth / plane - 1)[depth > 0].max() < 2e-3
    stepped = np.where(np.arange(WIDTH) < 32, plane, 2 * plane)
    depth = sparse_depth(rays[y, x, :2], stepped[y, x], K, (HEIGHT, WIDTH))
    off = np.minimum(np.abs(depth / plane - 1), np.abs(depth / (2 * plane) - 1))[depth > 0]
    assert (depth[:, 31:33] > 0).mean() < 0.5 and (depth[:, :26] > 0).mean() > 0.8 and np.quantile(off, 0.97) < 0.02
    assert not sparse_depth(rays[y, x, :2][:10], plane[y, x][:10], K, (HEIGHT, WIDTH)).any()
