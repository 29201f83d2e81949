"""Photometric vertex refinement: every vertex moves along its normal to where the photos that see it match best.

Gaussians are blended in the order of their centres, so that what they paint seems to be above them: the best fit is
too deep, and a mesh made from it as well (docs/meshes.md). The photos have no such bias. Plane sweeping does the same
for depth maps (Collins 1996); here the mesh gives visibility, normals and neighbours.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import cg
from tqdm import tqdm

from gsjax.io.parallel_map import parallel_map
from gsjax.meshing.connectivity import edge_table
from gsjax.meshing.ray_queries import Cast, ray_caster
from gsjax.scene import Frame
from gsjax.scene.meshes import Mesh, vertex_normals

LEAST_VIEWS = 3  # Two photos agree somewhere by chance.
MOST_VIEWS = 100  # More add little; spread over the capture.
STEEPEST = 0.3  # Cosine between normal and ray under which a photo shows a vertex too slanted.
BORDER = 2.0  # Pixels from a photo's edge within which nothing is read.
ROUNDS = 3
STEP = 0.25  # Between two offsets that are tried, pixels as the photos see the vertex.
REACH = 6  # Steps to either side in the first round, half of the last in the next, at least 3.
STIFFNESS = 10.0  # Of the differences between neighbours, in median evidence.
GRAY = 1 / 255  # A disagreement that changes by less than its square over a step is no evidence.


def refine_on_photos(mesh: Mesh, frames: Sequence[Frame]) -> tuple[Mesh, dict[str, float]]:
    """Move the vertices along their normals to where the photos match.

    A vertex that fewer than three photos see, or that has no texture, follows its neighbours. Photos may be lighter or
    darker than each other by a gain a channel. Masked pixels and those outside a matte are ignored.

    Args:
        mesh: Whose faces look outwards. Near the surface: within `reach` steps, 1.5 pixels.
        frames: Photos with their cameras; read one by one, once and once more a round. Beyond its matte a photo shows
            something else, or nothing.

    Returns:
        The mesh with moved vertices, and `seen_share` (of the vertices, in three photos and more), `moved_px` (of
        these, root mean square), and the photos' root mean square disagreement over them, `before` and `after`, 0..255.

    Raises:
        InputError: A photo cannot be read, or Open3D not be loaded.
    """
    indices = np.unique(np.linspace(0, len(frames) - 1, min(MOST_VIEWS, len(frames))).astype(int))
    frames = [frames[index] for index in indices]
    differences = _laplacian(mesh)
    with tqdm(total=(ROUNDS + 2) * len(frames), desc="refine on photos", unit="view", delay=3.0) as bar:
        survey = _survey(mesh, frames, np.zeros((1, mesh.num_vertices)), None, bar)
        is_seen, before, moved = survey.views >= LEAST_VIEWS, survey.variance[0], np.zeros(mesh.num_vertices)
        moved_mesh, reach = mesh, REACH
        for _ in range(ROUNDS if is_seen.any() else 0):
            steps = STEP * np.arange(-reach, reach + 1)
            survey = _survey(moved_mesh, frames, steps[:, None] * survey.pixel, survey.mean, bar)
            way = _agreed(survey, steps, differences)
            offsets = (way * survey.pixel)[:, None] * vertex_normals(moved_mesh)
            moved_mesh = replace(moved_mesh, vertices=(moved_mesh.vertices + offsets).astype(np.float32))
            moved, reach = moved + way, max(reach // 2, 3)
        after = _survey(moved_mesh, frames, np.zeros((1, mesh.num_vertices)), survey.mean, bar).variance[0]
    return moved_mesh, {
        "seen_share": float(is_seen.mean()),
        "moved_px": _root_mean_square(moved[is_seen]),
        "before": 255 * _root_mean_square(np.sqrt(before[is_seen])),
        "after": 255 * _root_mean_square(np.sqrt(after[is_seen])),
    }


class _Survey(NamedTuple):
    """What the photos say of V vertices at H offsets."""

    variance: np.ndarray  # [H, V] of the colours, mean over channels; 0 where too few photos see the vertex
    mean: np.ndarray  # [V, 3] colour at offset 0
    pixel: np.ndarray  # [V] scene units that a pixel covers at the vertex, mean over the photos
    views: np.ndarray  # [V] photos that see it


def _survey(mesh: Mesh, frames: Sequence[Frame], offsets: np.ndarray, mean: np.ndarray | None, bar: tqdm) -> _Survey:
    """Read every vertex at `offsets` `[H, V]` along its normal, scene units, in every photo that sees it.

    The photos' gains are fitted to the `mean` colours `[V, 3]`; None: photos are taken as they are.
    """
    normals, cast = vertex_normals(mesh), ray_caster(mesh)
    vertices = mesh.vertices.astype(np.float64)
    edges = np.linalg.norm(vertices[mesh.faces[:, 0]] - vertices[mesh.faces[:, 1]], axis=1)
    thick = float(np.median(edges)) if len(edges) else 0.0
    middle = int(np.abs(offsets).max(axis=1).argmin())
    count, size = len(offsets), len(vertices)
    # Differences to what the colours are about: their squares leave float32 digits to subtract.
    about = np.full((size, 3), 0.5, np.float32) if mean is None else mean
    weight, pixel, views = np.zeros(size), np.zeros(size), np.zeros(size, np.int32)
    total, squares = np.zeros((count, size, 3), np.float32), np.zeros((count, size), np.float32)

    def observations(frame: Frame) -> tuple[np.ndarray, ...]:
        """Ids, their cosines, pixels in scene units, and `[H, n, 3]` colours less what they are about."""
        ids, cosine, distance = _visible(vertices, normals, frame, cast, thick)
        image, *masks = frame.pixels()
        for mask in masks:
            if mask is None or not len(ids):
                continue
            x, y = _projected(vertices[ids], frame)
            usable = mask[y.astype(int), x.astype(int)] > 127
            ids, cosine, distance = ids[usable], cosine[usable], distance[usable]
        points = vertices[ids] + offsets[:, ids, None] * normals[ids]
        colors = _read(image, *_projected(points, frame)).astype(np.float32) / 255
        if mean is not None:
            colors *= _gains(colors[middle], mean[ids], cosine)
        return ids, cosine, distance / np.sqrt(frame.K[0, 0] * frame.K[1, 1]), colors - about[ids]

    for ids, cosine, footprint, colors in parallel_map(observations, frames):
        bar.update()
        share = cosine.astype(np.float32)
        total[:, ids] += share[:, None] * colors
        squares[:, ids] += share * np.sum(colors * colors, axis=-1)
        weight[ids] += cosine
        pixel[ids] += cosine * footprint
        views[ids] += 1
    safe = np.where(weight > 0, weight, 1)
    average = total / safe[:, None]
    variance = np.where(views >= LEAST_VIEWS, (squares / safe - np.sum(average * average, axis=-1)) / 3, 0)
    return _Survey(np.maximum(variance, 0), about + average[middle], pixel / safe, views)


def _visible(
    vertices: np.ndarray, normals: np.ndarray, frame: Frame, cast: Cast, thick: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids of the vertices that a photo sees, the cosines between normal and ray there, and their distances."""
    rotation, translation = frame.viewmat[:3, :3].astype(np.float64), frame.viewmat[:3, 3].astype(np.float64)
    towards = -rotation.T @ translation - vertices
    distance = np.linalg.norm(towards, axis=1)
    towards = towards / np.where(distance > 0, distance, 1)[:, None]
    cosine = np.sum(towards * normals, axis=1)
    ids = np.nonzero((cosine > STEEPEST) & (vertices @ rotation[2] + translation[2] > 0))[0]
    x, y = _projected(vertices[ids], frame)
    inside = (x > BORDER) & (x < frame.width - BORDER) & (y > BORDER) & (y < frame.height - BORDER)
    ids = ids[inside]
    # From a little above the surface, so that the ray does not meet the triangles around its vertex.
    hits = cast(vertices[ids] + thick * towards[ids], towards[ids])
    ids = ids[hits.distances > distance[ids] - 2 * thick]
    return ids, cosine[ids], distance[ids]


def _projected(points: np.ndarray, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Pixels x and y, with centres at +0.5, of `[..., 3]` points in front of a camera."""
    x, y, z = np.moveaxis(points @ frame.viewmat[:3, :3].T.astype(np.float64) + frame.viewmat[:3, 3], -1, 0)
    K = frame.K.astype(np.float64)
    z = np.maximum(z, 1e-9)
    return K[0, 0] * x / z + K[0, 1] * y / z + K[0, 2], K[1, 1] * y / z + K[1, 2]


def _read(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`[..., C]` float32 bilinear values of an image `[H, W, C]`; the border's beyond it."""
    height, width = image.shape[:2]
    x, y = np.clip(x - 0.5, 0, width - 1), np.clip(y - 0.5, 0, height - 1)
    left, top = np.minimum(x.astype(np.int32), max(width - 2, 0)), np.minimum(y.astype(np.int32), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    a, b = (x - left)[..., None].astype(np.float32), (y - top)[..., None].astype(np.float32)
    upper = image[top, left] * (1 - a) + image[top, right] * a
    return upper * (1 - b) + (image[below, left] * (1 - a) + image[below, right] * a) * b


def _gains(colors: np.ndarray, mean: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """`[3]` factors that make a photo's colours `[n, 3]` closest to the mean photo's."""
    w = weight[:, None]
    power = np.sum(w * colors * colors, axis=0)
    return (np.sum(w * colors * mean, axis=0) / np.where(power > 0, power, 1) + (power == 0)).astype(np.float32)


def _laplacian(mesh: Mesh) -> sparse.csr_matrix:
    """`[V, V]`: a vertex' value less those of its neighbours, summed."""
    count = mesh.num_vertices
    ends = edge_table(mesh.faces).pairs
    both = np.concatenate([ends, ends[:, ::-1]])
    adjacent = sparse.csr_matrix((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count))
    return sparse.csr_matrix(sparse.csgraph.laplacian(adjacent))


def _agreed(survey: _Survey, steps: np.ndarray, differences: sparse.csr_matrix) -> np.ndarray:
    """`[V]` pixels to move: at the least disagreement where there is evidence, smooth between.

    Evidence is each vertex' own: mixed with its neighbours', it says the same of both sides of an edge.
    """
    curves = survey.variance.T
    lowest, rows = curves.argmin(axis=1), np.arange(len(curves))
    inner = np.clip(lowest, 1, len(steps) - 2)
    before, at, after = (curves[rows, inner + k] for k in (-1, 0, 1))
    bend = np.maximum(before - 2 * at + after, 0)
    # The least point of the parabola through the three.
    offsets = steps[inner] + STEP * np.clip(0.5 * (before - after) / np.maximum(bend, GRAY**4), -1, 1)
    is_evident = (survey.views >= LEAST_VIEWS) & (lowest == inner)
    typical = max(float(np.median(bend[is_evident])) if is_evident.any() else 0.0, GRAY**2)
    evidence = np.where(is_evident, np.minimum(bend / typical, 4), 0)
    system = sparse.diags(evidence + 1e-6) + STIFFNESS * differences
    way, _ = cg(system, evidence * offsets, rtol=1e-4, maxiter=300)
    return way


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
