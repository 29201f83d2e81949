"""How far a surface is from the truth: distances to points and to triangles, and angles between normals.

Distances are in scene units, in float64. Nearest neighbours are exact.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from gsjax.errors import InputError, NoSurfaceError
from gsjax.scene.meshes import Mesh, face_area_vectors, face_normals, unit_or_zero

THRESHOLD_SHARE = 0.01  # Of the diagonal of the truth's box: the F-score's default threshold.
REACH_SHARE = 0.99  # Of the points that cameras saw, those that have another one within reach.

SCORES = ("chamfer", "accuracy", "completeness", "precision", "recall", "fscore", "fscore_quarter", "fscore_half",
          "fscore_double", "normal_consistency", "outward_share", "threshold")  # fmt: skip
"""The scores of `compare_to_truth` and `compare_to_surface`."""

Closest = Callable[[Mesh, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""(mesh, `[P, 3]` queries) -> `[P, 3]` nearest points of its surface and `[P]` the triangles that they are on."""


def sample_surface(mesh: Mesh, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """`[count, 3]` points spread evenly over the area, and the unit normals `[count, 3]` of their triangles."""
    areas = face_area_vectors(mesh)
    weights = np.linalg.norm(areas, axis=1)
    if not weights.sum() > 0:
        raise NoSurfaceError(f"cannot sample a mesh without area ({mesh.num_faces} faces)")
    rng = np.random.default_rng(seed)
    faces = rng.choice(mesh.num_faces, count, p=weights / weights.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float64)[mesh.faces[faces]], 1, 0)
    return a + u * (b - a) + v * (c - a), unit_or_zero(areas[faces])


def compare_to_truth(
    mesh: Mesh,
    truth_points: np.ndarray,
    truth_normals: np.ndarray,
    *,
    threshold: float | None = None,
    samples: int = 100_000,
) -> dict[str, float]:
    """Distances and normals of a mesh against surface samples of the truth, for a truth that is nothing but points.

    Distances are between points, so they never fall below the gaps of the samples: the true surface itself does not
    score 0. Where the truth is a mesh, `compare_to_surface` has no such floor.

    The truth has samples only where cameras saw something. What the mesh says elsewhere is neither right nor wrong, so
    its surface counts only inside the axis-aligned box of the truth samples, grown by the threshold on every side.

    Args:
        mesh: The prediction.
        truth_points: `[Q, 3]` world.
        truth_normals: `[Q, 3]` world.
        threshold: Of the F-score, scene units. None: 1 % of the diagonal of the box of the truth samples.
        samples: Points drawn on the mesh near the box.

    Returns:
        `chamfer` (mean of the next two), `accuracy`, `completeness`, `precision`, `recall` and `fscore` at the
        threshold, `fscore_quarter`, `fscore_half` and `fscore_double` at so much of it, `normal_consistency`,
        `outward_share` (of the mesh's samples, those whose normal has the sign of the nearest true one) and
        `threshold`.

    Raises:
        NoSurfaceError: No surface of the mesh is in the box.
    """
    low, high, threshold = _box(truth_points, threshold)
    points, normals = _samples_in_box(mesh, low, high, samples)
    to_truth, there = nearest(points, truth_points)
    to_mesh, back = nearest(truth_points, points)
    cosines = _cosines(normals, truth_normals[there]), _cosines(truth_normals, normals[back])
    return _scores(to_truth, to_mesh, *cosines, threshold)


def compare_to_surface(
    mesh: Mesh,
    truth: Mesh,
    seen_points: np.ndarray,
    seen_normals: np.ndarray,
    closest: Closest,
    *,
    threshold: float | None = None,
    samples: int = 100_000,
) -> dict[str, float]:
    """Distances and normals of a mesh against true triangles, point to surface both ways: what is true scores 0.

    Completeness and recall: from every true point that cameras saw to the triangles of the mesh. Accuracy and
    precision: from samples of the mesh to the true triangles, of those samples whose nearest true point was seen, which
    is one that has a seen point within reach (`REACH_SHARE` of the seen points have another one so near), and that are
    in the box of the seen points, grown by the threshold. So the underside of the ground, what is in it, and the
    world beyond count neither for nor against.

    Args:
        mesh: The prediction.
        truth: The whole true surface, seen or not.
        seen_points: `[Q, 3]` points of it that cameras saw, spread evenly, world.
        seen_normals: `[Q, 3]` its normals there.
        closest: Finds nearest points of a surface: `gsjax.meshing.ray_queries.closest_on_mesh`.
        threshold: Of the F-score, scene units. None: 1 % of the diagonal of the box of the seen points.
        samples: Points drawn on the mesh near the box.

    Returns:
        As of `compare_to_truth`; normals are those of the triangles, and `seen_normals`.

    Raises:
        NoSurfaceError: No surface of the mesh is in the box, or none of it where cameras saw something.
    """
    low, high, threshold = _box(seen_points, threshold)
    mesh, truth = _with_area(mesh), _with_area(truth)
    points, normals = _samples_in_box(mesh, low, high, samples)
    feet, there = closest(truth, points)
    is_visible = nearest(feet, seen_points)[0] <= _reach(seen_points)
    if not is_visible.any():
        raise NoSurfaceError(f"no surface of the mesh ({mesh.num_faces} faces) is where cameras saw the truth")
    touched, back = closest(mesh, seen_points)
    return _scores(
        np.linalg.norm(points - feet, axis=1)[is_visible],
        np.linalg.norm(seen_points - touched, axis=1),
        _cosines(normals, face_normals(truth)[there])[is_visible],
        _cosines(seen_normals, face_normals(mesh)[back]),
        threshold,
    )


def normal_error_degrees(rendered: np.ndarray, true: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Angles between two normal maps `[H, W, 3]`, signed: opposite normals are 180 degrees apart.

    Of the pixels of `mask` `[H, W]` where there is a true normal. A rendered normal of zero counts as 90 degrees.

    Returns:
        `mean` and `median` in degrees and the `count` of pixels; NaN angles where the count is 0.
    """
    scored = mask & np.any(true != 0, axis=-1)
    count = int(scored.sum())
    if not count:
        return {"mean": float("nan"), "median": float("nan"), "count": 0}
    a, b = unit_or_zero(rendered[scored].astype(np.float64)), unit_or_zero(true[scored].astype(np.float64))
    angles = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))
    angles = np.where(np.any(a != 0, axis=-1), angles, 90.0)
    return {"mean": float(angles.mean()), "median": float(np.median(angles)), "count": count}


def nearest(queries: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from each `[P, 3]` query to its nearest of `[Q, 3]` points, and that point's index.

    Raises:
        InputError: One of the sets is empty.
    """
    if not len(queries) or not len(points):
        raise InputError(f"cannot compare {len(queries)} points with {len(points)}: both sets need one at least")
    distances, ids = KDTree(points).query(queries, workers=-1)
    return np.asarray(distances), np.asarray(ids)


def _box(truth_points: np.ndarray, threshold: float | None) -> tuple[np.ndarray, np.ndarray, float]:
    """The threshold, and the corners of the truth's box grown by it."""
    low, high = truth_points.min(axis=0), truth_points.max(axis=0)
    if threshold is None:
        threshold = float(THRESHOLD_SHARE * np.linalg.norm(high - low))
    return low - threshold, high + threshold, threshold


def _reach(points: np.ndarray) -> float:
    """The distance within which `REACH_SHARE` of `[P, 3]` points have another one."""
    return float(np.quantile(KDTree(points).query(points, k=2, workers=-1)[0][:, 1], REACH_SHARE))


def _with_area(mesh: Mesh) -> Mesh:
    """The mesh without triangles that have no area, hence no normal."""
    has_area = np.any(face_area_vectors(mesh) != 0, axis=1)
    return replace(mesh, faces=mesh.faces[has_area])


def _scores(
    to_truth: np.ndarray, to_mesh: np.ndarray, ours: np.ndarray, theirs: np.ndarray, threshold: float
) -> dict[str, float]:
    """All scores, of the distances and the cosines in both directions."""
    accuracy, completeness = float(to_truth.mean()), float(to_mesh.mean())
    of_distance = (accuracy + completeness) / 2, accuracy, completeness
    at_threshold = _within(to_truth, to_mesh, threshold)
    fscores = [_within(to_truth, to_mesh, factor * threshold)[2] for factor in (1 / 4, 1 / 2, 2)]
    of_normals = float((np.abs(ours).mean() + np.abs(theirs).mean()) / 2), float((ours > 0).mean())
    return dict(zip(SCORES, (*of_distance, *at_threshold, *fscores, *of_normals, threshold), strict=True))


def _within(to_truth: np.ndarray, to_mesh: np.ndarray, threshold: float) -> tuple[float, float, float]:
    """Precision, recall and F-score of the distances in both directions."""
    precision, recall = float((to_truth <= threshold).mean()), float((to_mesh <= threshold).mean())
    return precision, recall, 2 * precision * recall / max(precision + recall, 1e-300)


def _cosines(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`[P]` cosines between `[P, 3]` vectors of any length; 0 where one is zero."""
    return np.sum(unit_or_zero(a.astype(np.float64)) * unit_or_zero(b.astype(np.float64)), axis=-1)


def _samples_in_box(mesh: Mesh, low: np.ndarray, high: np.ndarray, count: int):
    """Up to `count` samples and normals of the mesh's part in the box; faces that miss the box cost no samples."""
    corners = mesh.vertices[mesh.faces]
    touches = np.all((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high), axis=1)
    if touches.any():
        points, normals = sample_surface(replace(mesh, faces=mesh.faces[touches]), count, seed=0)
        inside = np.all((points >= low) & (points <= high), axis=1)
        if inside.any():
            return points[inside], normals[inside]
    raise NoSurfaceError(f"no surface of the mesh ({mesh.num_faces} faces) is in the truth's box {low} to {high}")
