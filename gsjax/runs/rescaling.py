"""A finished run in another unit: what it computes with stays, what its files say is multiplied."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from gsjax.io import georeference_files, json_files
from gsjax.io.files import replaced_files
from gsjax.io.gaussian_files import load_gaussians
from gsjax.io.locks import lock_folder
from gsjax.io.ply import write_gaussians
from gsjax.meshing.export import read_mesh, read_textured, write_mesh, write_textured
from gsjax.runs.photo_effects import POSES
from gsjax.runs.run import Run
from gsjax.scene.cameras import viewmat_centers
from gsjax.scene.georeference import Place
from gsjax.scene.similarity import Similarity

MESHES = "mesh.ply", "mesh.glb"


def rescale_run(folder: Path, factor: float, place: Place) -> None:
    """Writes the files of a run with all lengths `factor` times as long, and what that makes of their world.

    Checkpoints are in the run's own coordinates, which stay: a resumed run has the same numbers. `gaussians.ply`,
    `cameras.json`, `poses.json`, meshes, `manifest.json` and `place.json` change together (`gsjax.io.files`).

    Raises:
        InputError: It is no finished run, another process works in it, or a file cannot be read or written.
    """
    run = Run.open(folder)
    center = tuple(factor * side for side in run.similarity.center)
    similarity = Similarity(run.similarity.scale / factor, center)
    gaussians = load_gaussians(folder)
    means = factor * np.asarray(gaussians.means, np.float64)
    log_scales = np.asarray(gaussians.log_scales) + np.float32(np.log(factor))
    viewmats = np.array([view["viewmat"] for view in run.views], np.float64).reshape(-1, 4, 4)
    viewmats[:, :3, 3] *= factor
    views = [{**view, "viewmat": viewmat} for view, viewmat in zip(run.views, viewmats, strict=True)]
    with lock_folder(folder), replaced_files(folder) as new:
        json_files.write(new / "manifest.json", {**run.manifest, "similarity": asdict(similarity)})
        json_files.write(new / georeference_files.FILE, place.record())
        json_files.write(new / "cameras.json", views)
        stretched_gaussians = replace(gaussians, means=means, log_scales=log_scales)
        write_gaussians(new / "gaussians.ply", stretched_gaussians, place, cameras=viewmat_centers(viewmats))
        if (folder / POSES).exists():
            json_files.write(new / POSES, _stretched_moves(json_files.read(folder / POSES), factor))
        for name in MESHES:
            if (folder / name).exists():
                _write_stretched_mesh(folder / name, new / name, factor, place)


def _stretched_moves(poses: dict, factor: float) -> dict:
    photos = poses["photos"].items()
    return {
        **poses,
        "photos": {name: {**move, "shift": [factor * side for side in move["shift"]]} for name, move in photos},
    }


def _write_stretched_mesh(old: Path, new: Path, factor: float, place: Place) -> None:
    textured = read_textured(old)
    mesh = read_mesh(old) if textured is None else textured.mesh
    mesh = replace(mesh, vertices=factor * mesh.vertices)
    if textured is None:
        write_mesh(new, mesh, place)
    else:
        write_textured(new, replace(textured, mesh=mesh), place)
