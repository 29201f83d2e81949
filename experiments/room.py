"""How far is a mesh of bare photos from what a depth sensor measured?

    python experiments/room.py RUN_OR_MESH ... [--room DIR] [--place FILE]

RUN is the folder of `gsjax scan` (both its meshes are scored), or that of a run with a `mesh.ply`; a mesh file is in
the folder of its run, whose `cameras.json` says from where the photos were taken. DIR (default: ../shared/data/room)
holds the truth: `truth_mesh.ply` in metres, and `poses.json`, camera to world by the photos' names.

The mesh is aligned with the truth by the similarity between the cameras' places, robust to a fifth of them being wrong,
then by ICP with scale. Accuracy is the median distance of the mesh to the truth, of what is in the truth's box and in
front of its cameras, completeness that of the truth to the mesh; F is at 3, 5 and 10 cm; the normal error is the mean
angle between the triangles of the mesh and the nearest of the truth, whichever side they face. The last two rows are
the floor: the truth against itself drawn anew, and the truth after it was misplaced as the first mesh was and aligned.

`--place` writes the truth where the first mesh's run has the room. `gsjax texture RUN --mesh FILE` paints it, and
`gsjax eval RUN --mesh` then scores what the run's photos gain on the sensor's own surface.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.report import tables
from gsjax.scene.meshes import Mesh

CENTIMETRES = (3, 5, 10)
NEAR, FAR = 0.4, 3.4  # metres in front of a camera, between which the sensor of the room measures
HALF_FIELD = (300 / 585, 220 / 585)  # tangents of what it sees to the side and up
MARGIN = 0.05  # metres around the truth's box
INLIER = 0.1  # metres between two places of one camera
WITHIN, FARTHEST = 0.05, 0.3  # metres: points so near always count in ICP, those farther never
ROUNDS, TRIALS = 100, 500
AT_REST = 1e-4  # metres by which a round moves the truth's points at the most, from which ICP is done
TRUTH_POINTS, DENSE_TRUTH, MESH_POINTS, DENSE_MESH = 60_000, 400_000, 200_000, 800_000


class Alignment(NamedTuple):
    """x -> scale * rotation @ x + shift, in metres of the truth."""

    scale: float
    rotation: np.ndarray  # [3, 3]
    shift: np.ndarray  # [3]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """`[P, 3]` points moved."""
        return self.scale * points @ self.rotation.T + self.shift

    def back(self, points: np.ndarray) -> np.ndarray:
        """`[P, 3]` points moved the other way."""
        return (points - self.shift) @ self.rotation / self.scale


class Truth(NamedTuple):
    """What a sensor measured."""

    mesh: Mesh
    poses: dict[str, np.ndarray]  # photo's stem -> [4, 4] camera to world


def read_truth(room: str | Path) -> Truth:
    """The truth of a room.

    Raises:
        InputError: A file is missing or damaged.
    """
    from gsjax.io import json_files
    from gsjax.meshing.export import read_mesh

    poses = json_files.read(Path(room) / "poses.json", {"poses": {str: [[float, 4], 4]}})["poses"]
    mesh = read_mesh(Path(room) / "truth_mesh.ply")
    return Truth(mesh, {Path(name).stem: np.array(pose) for name, pose in poses.items()})


def meshes_of(source: str | Path) -> list[Path]:
    """The mesh files that an argument means.

    Raises:
        InputError: It is no mesh, and holds none.
    """
    path = Path(source)
    if path.is_file():
        return [path]
    files = [file for file in (path / "mesh.ply", path / "run/mesh.ply", path / "refined/mesh.ply") if file.is_file()]
    if not files:
        raise InputError(f"{source}: neither a mesh nor a folder of a run with a mesh.ply")
    return files


def similarity(points: np.ndarray, targets: np.ndarray) -> Alignment:
    """The similarity with the least squares from `[P, 3]` points to `[P, 3]` targets (Umeyama 1991)."""
    middle, goal = points.mean(0), targets.mean(0)
    left, spread, right = np.linalg.svd((targets - goal).T @ (points - middle) / len(points))
    signs = np.array([1, 1, np.sign(np.linalg.det(left @ right))])
    rotation = left * signs @ right
    scale = float(spread @ signs / (points - middle).var(0).sum())
    return Alignment(scale, rotation, goal - scale * rotation @ middle)


def camera_alignment(run: Path, truth: Truth) -> Alignment:
    """From a run's world to the truth's, by where the photos were taken.

    Raises:
        InputError: The run has no cameras of the truth's names, or too few at the right places.
    """
    from gsjax.runs.records import read_views
    from gsjax.scene.cameras import viewmat_center

    centers = {Path(view["name"]).stem: viewmat_center(np.array(view["viewmat"])) for view in read_views(run)}
    names = [name for name in centers if name in truth.poses]
    if len(names) < 4:
        raise InputError(f"{run}: {len(names)} of its photos are the truth's; it takes 4 to align them")
    ours, theirs = np.stack([centers[n] for n in names]), np.stack([truth.poses[n][:3, 3] for n in names])
    rng, best = np.random.default_rng(0), np.zeros(len(names), bool)
    for _ in range(TRIALS):
        some = rng.choice(len(names), 4, replace=False)
        within = np.linalg.norm(similarity(ours[some], theirs[some])(ours) - theirs, axis=1) < INLIER
        best = within if within.sum() > best.sum() else best
    if best.sum() < 4:
        raise InputError(f"{run}: its cameras do not match the truth's to {100 * INLIER:g} cm")
    return similarity(ours[best], theirs[best])


def icp(mesh: Mesh, start: Alignment, targets: np.ndarray) -> Alignment:
    """An alignment improved until it rests: nearest points of the mesh to each of `[P, 3]` of the truth, with scale."""
    from scipy.spatial import KDTree

    from gsjax.metrics.geometry import sample_surface

    points, alignment = sample_surface(mesh, DENSE_MESH, 0)[0], start
    tree = KDTree(points)
    for _ in range(ROUNDS):
        distances, nearest = tree.query(alignment.back(targets), workers=-1)
        distances = distances * alignment.scale
        near = (distances < max(WITHIN, 2 * float(np.median(distances)))) & (distances < FARTHEST)
        if near.sum() < 4:
            raise InputError("the mesh is nowhere near the truth after its cameras were aligned")
        before, alignment = alignment, similarity(points[np.asarray(nearest)[near]], targets[near])
        if np.abs(alignment(before.back(targets)) - targets).max() < AT_REST:
            break
    return alignment


def scores(mesh: Mesh, truth: Truth, *, seed: int = 1) -> dict[str, float]:
    """Distances, F-scores and normal error of a mesh that is where the truth is; see above."""
    from gsjax.metrics.geometry import nearest, sample_surface

    true_points, true_normals = sample_surface(truth.mesh, DENSE_TRUTH, 0)
    points, normals = sample_surface(mesh, MESH_POINTS, seed)
    low, high = truth.mesh.vertices.min(0) - MARGIN, truth.mesh.vertices.max(0) + MARGIN
    counted = ((points > low) & (points < high)).all(1) & _measured(points, truth)
    to_truth, there = nearest(points[counted], true_points)
    to_mesh, _ = nearest(sample_surface(truth.mesh, TRUTH_POINTS, 2)[0], sample_surface(mesh, DENSE_MESH, 3)[0])
    cosines = np.abs(np.sum(normals[counted] * true_normals[there], -1))
    figures = {"accuracy_cm": 100 * float(np.median(to_truth)), "completeness_cm": 100 * float(np.median(to_mesh))}
    for limit in CENTIMETRES:
        precision, recall = ((distances < limit / 100).mean() for distances in (to_truth, to_mesh))
        figures[f"F{limit}"] = float(2 * precision * recall / max(precision + recall, 1e-12))
    return figures | {"normal_error_deg": float(np.degrees(np.arccos(np.minimum(cosines, 1))).mean())}


def _measured(points: np.ndarray, truth: Truth) -> np.ndarray:
    """`[P]` bool: in the sensor's field and range from one of the truth's cameras at least."""
    in_view = np.zeros(len(points), bool)
    for pose in truth.poses.values():
        x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
        ahead = (z > NEAR) & (z < FAR)
        in_view |= ahead & (np.abs(x) < HALF_FIELD[0] * z) & (np.abs(y) < HALF_FIELD[1] * z)
    return in_view


def moved(mesh: Mesh, by: Alignment) -> Mesh:
    """A mesh after an alignment."""
    return Mesh(by(mesh.vertices.astype(np.float64)), mesh.faces, mesh.colors)


def run(sources: Sequence[str], room: str, place: str | None = None) -> dict[str, dict[str, float]]:
    """The scores of all meshes by their file, and of the floor; the truth where the first mesh is goes to `place`.

    Raises:
        InputError: The truth or a mesh cannot be read or aligned.
    """
    from gsjax.meshing.export import read_mesh, write_mesh
    from gsjax.metrics.geometry import sample_surface

    truth = read_truth(room)
    targets = sample_surface(truth.mesh, TRUTH_POINTS, 2)[0]
    figures: dict[str, dict[str, float]] = {}
    misplaced = truth.mesh
    for file in tqdm([file for each in sources for file in meshes_of(each)], desc="meshes", unit="mesh", leave=False):
        mesh, start = read_mesh(file), camera_alignment(file.parent, truth)
        aligned = icp(mesh, start, targets)
        if not figures:
            in_run = Mesh(aligned.back(truth.mesh.vertices), truth.mesh.faces, truth.mesh.colors)
            misplaced = moved(in_run, start)
            if place:
                write_mesh(place, in_run)
        figures[str(file)] = scores(moved(mesh, aligned), truth)
    again = icp(misplaced, Alignment(1.0, np.eye(3), np.zeros(3)), targets)
    floors = {"floor: drawn anew": truth.mesh, "floor: aligned anew": moved(misplaced, again)}
    return figures | {name: scores(mesh, truth, seed=4) for name, mesh in floors.items()}


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", metavar="RUN_OR_MESH")
    parser.add_argument("--room", metavar="DIR", default=str(Path(__file__).parents[2] / "shared/data/room"))
    parser.add_argument("--place", metavar="FILE", help="also write the truth where the first mesh is")
    arguments = parser.parse_args()
    print(tables.compare(run(arguments.meshes, arguments.room, arguments.place)))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
