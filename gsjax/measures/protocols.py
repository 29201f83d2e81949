"""The two protocols that published meshes are scored by, DTU and Tanks and Temples, as functions of points.

Files are the caller's business: the arguments are what the benchmarks' files hold. Numbers were checked against the
benchmarks' own evaluation code (DTU: `BaseEvalMain_web.m`, `ComputeStat_web.m` and its port `DTUeval-python`; Tanks and
Temples: `python_toolbox/evaluation/config.py`, `run.py`, `evaluation.py`).
"""

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.spatial import KDTree

from gsjax.errors import InputError
from gsjax.measures.geometry import nearest, sample_surface
from gsjax.mesh import Mesh, face_area_vectors

DTU_SPACING = 0.2  # mm: of the points of a reconstruction, after thinning.
DTU_OUTLIER = 20.0  # mm: points farther off than this are left out of the means.
DTU_MARGIN = (60.0, 120.0)  # mm below and above the mask's box in which a reconstruction counts as data at all.
DENSER = 4.0  # Points drawn on a mesh for one that is left after thinning.
TANKS_AND_TEMPLES_TAU = MappingProxyType(
    {  # metres, by scene: the distance within which a point counts as right (dTau)
        "Barn": 0.01,
        "Caterpillar": 0.005,
        "Church": 0.025,
        "Courthouse": 0.025,
        "Ignatius": 0.003,
        "Meetingroom": 0.01,
        "Truck": 0.005,
    }
)


@dataclass(frozen=True)
class ObservationMask:
    """The part of a DTU scan's space that the cameras observe (`ObsMask*_10.mat`)."""

    inside: np.ndarray  # [X, Y, Z] bool
    low: np.ndarray  # [3] mm: centre of the first voxel, the file's BB[0]
    high: np.ndarray  # [3] mm: the file's BB[1]
    voxel: float  # mm, the file's Res

    def contains(self, points: np.ndarray) -> np.ndarray:
        """`[P]` bool: in an observed voxel."""
        cells = np.rint((points - self.low) / self.voxel).astype(np.int64)
        on_grid = np.all((cells >= 0) & (cells < self.inside.shape), axis=1)
        return on_grid & self.inside[tuple(np.where(on_grid[:, None], cells, 0).T)]

    def is_near(self, points: np.ndarray) -> np.ndarray:
        """`[P]` bool: close enough to the box to count as data."""
        below, above = DTU_MARGIN
        return np.all((points >= self.low - below) & (points < self.high + above), axis=1)


@dataclass(frozen=True)
class CropVolume:
    """A prism: a polygon pushed along one axis (the `SelectionPolygonVolume` of a scene's json)."""

    axis: int  # 0, 1 or 2: the json's orthogonal_axis
    low: float  # the json's axis_min
    high: float  # the json's axis_max
    polygon: np.ndarray  # [K, 3] corners of the json's bounding_polygon; the coordinate along the axis plays no part

    def contains(self, points: np.ndarray) -> np.ndarray:
        """`[P]` bool: between the ends, and inside the polygon by the even-odd rule."""
        u_axis, v_axis = (k for k in range(3) if k != self.axis)
        u, v = points[:, u_axis], points[:, v_axis]
        inside = np.zeros(len(points), bool)
        for start, end in zip(self.polygon, np.roll(self.polygon, -1, axis=0), strict=True):
            rise = end[v_axis] - start[v_axis]
            spans = (start[v_axis] > v) != (end[v_axis] > v)
            crossing = start[u_axis] + (end[u_axis] - start[u_axis]) * (v - start[v_axis]) / (rise if rise else 1.0)
            inside ^= spans & (u < crossing)
        along = points[:, self.axis]
        return inside & (along >= self.low) & (along <= self.high)


def dtu(points: np.ndarray, truth: np.ndarray, mask: ObservationMask, plane: np.ndarray, *, seed: int = 0) -> dict:
    """Accuracy and completeness as the DTU benchmark measures them.

    The reconstruction is thinned to 0.2 mm. Accuracy is the mean distance to the scan of its points in observed voxels,
    completeness that from the scan's points above the ground plane to it; distances of 20 mm and more are left out of
    both means (they are not counted as 20). Overall is the mean of the two.

    Args:
        points: `[P, 3]` mm, of the reconstruction; `dense_points` of a mesh.
        truth: `[Q, 3]` mm, the structured-light scan (`stl*_total.ply`).
        mask: What was observed.
        plane: `[4]` (a, b, c, d): points with a x + b y + c z + d > 0 lie above the ground (`Plane*.mat`).
        seed: Of the order in which points are thinned.

    Returns:
        `accuracy`, `completeness`, `overall` in mm.

    Raises:
        InputError: No point counts in one of the directions.
    """
    kept = thin_points(points, DTU_SPACING, seed)
    kept = kept[mask.is_near(kept)]
    above = truth[truth @ plane[:3] + plane[3] > 0]
    observed = kept[mask.contains(kept)] if len(kept) else kept
    accuracy = _mean_under(DTU_OUTLIER, nearest(observed, truth)[0], "reconstructed points in the mask")
    completeness = _mean_under(DTU_OUTLIER, nearest(above, kept)[0], "scanned points above the plane")
    return {"accuracy": accuracy, "completeness": completeness, "overall": (accuracy + completeness) / 2}


def tanks_and_temples(
    points: np.ndarray, truth: np.ndarray, tau: float, *, crop: CropVolume, to_truth: np.ndarray
) -> dict:
    """Precision, recall and F-score as the Tanks and Temples benchmark measures them.

    Both sets are cropped and then thinned to one mean point per voxel of tau / 2. A distance counts where it is under
    tau. The registration is an argument: the benchmark aligns the camera paths and refines that by ICP.

    Args:
        points: `[P, 3]` of the reconstruction; of a mesh, `vertices_and_centers`.
        truth: `[Q, 3]` metres, the laser scan.
        tau: The scene's threshold, metres (`TANKS_AND_TEMPLES_TAU`).
        crop: The part of the scan that counts, in the scan's frame.
        to_truth: `[4, 4]` similarity from the reconstruction's frame to the scan's.

    Returns:
        `precision`, `recall`, `fscore`, all 0 where a set is empty after cropping (as the benchmark has it), and `tau`.
    """
    placed = points @ to_truth[:3, :3].T + to_truth[:3, 3]
    ours, theirs = (voxel_means(p[crop.contains(p)], tau / 2) for p in (placed, truth))
    if not len(ours) or not len(theirs):
        return {"precision": 0.0, "recall": 0.0, "fscore": 0.0, "tau": tau}
    precision = float((nearest(ours, theirs)[0] < tau).mean())
    recall = float((nearest(theirs, ours)[0] < tau).mean())
    score = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    return {"precision": precision, "recall": recall, "fscore": score, "tau": tau}


def dense_points(mesh: Mesh, spacing: float = DTU_SPACING, *, seed: int = 0) -> np.ndarray:
    """`[P, 3]` the mesh's vertices and points drawn on it, four for every square of side `spacing`, for `dtu`."""
    area = float(np.linalg.norm(face_area_vectors(mesh), axis=1).sum())
    drawn = sample_surface(mesh, max(round(DENSER * area / spacing**2), 1), seed)[0]
    return np.concatenate([mesh.vertices.astype(np.float64), drawn])


def vertices_and_centers(mesh: Mesh) -> np.ndarray:
    """`[V + F, 3]` the mesh's vertices and the centroids of its triangles, for `tanks_and_temples`."""
    vertices = mesh.vertices.astype(np.float64)
    return np.concatenate([vertices, vertices[mesh.faces].mean(axis=1)])


def thin_points(points: np.ndarray, spacing: float, seed: int) -> np.ndarray:
    """A part of `[P, 3]` points, no two of them within `spacing`, and every other within it of one that stays."""
    shuffled = np.random.default_rng(seed).permutation(points)
    tree, stays = KDTree(shuffled), np.ones(len(shuffled), bool)
    for start in range(0, len(shuffled), 65_536):
        around = tree.query_ball_point(shuffled[start : start + 65_536], spacing, workers=-1)
        for index, close in enumerate(around, start):
            if stays[index]:
                stays[close] = False
                stays[index] = True
    return shuffled[stays]


def voxel_means(points: np.ndarray, voxel: float) -> np.ndarray:
    """`[Q, 3]` mean of the `[P, 3]` points in every occupied voxel; the grid begins half a voxel before the lowest."""
    if not len(points):
        return points
    cells = np.floor((points - (points.min(axis=0) - voxel / 2)) / voxel).astype(np.int64)
    spans = cells.max(axis=0) + 1
    _, owner, counts = np.unique(
        (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2], return_inverse=True, return_counts=True
    )
    sums = np.stack([np.bincount(owner, points[:, k]) for k in range(3)], axis=1)
    return sums / counts[:, None]


def _mean_under(limit: float, distances: np.ndarray, what: str) -> float:
    counted = distances[distances < limit]
    if not len(counted):
        raise InputError(f"none of the {len(distances)} {what} lies within {limit} mm of the other set")
    return float(counted.mean())
