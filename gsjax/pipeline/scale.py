"""The unit of a data set or a run by a known length between the surface points of two pixels."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io import georeference_files, json_files
from gsjax.io.files import replaced_files
from gsjax.io.gaussian_files import load_gaussians
from gsjax.io.locks import lock_folder
from gsjax.io.ply import write_gaussians
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh, read_textured, write_mesh, write_textured
from gsjax.runs import is_run
from gsjax.runs.photo_effects import POSES
from gsjax.runs.pixel_to_point import Pixel, points_of_run, points_of_scene
from gsjax.runs.run import Run
from gsjax.scene import Scene
from gsjax.scene.cameras import viewmat_centers
from gsjax.scene.georeference import LARGEST, Place, turn_upright, up_of_cameras
from gsjax.scene.similarity import Similarity

MESHES = "mesh.ply", "mesh.glb"
SAME = 1e-5  # relative: a distance that is measured again, in float32


def scale(source: str | Path, between: Sequence[Pixel], metres: float | None = None) -> dict[str, Any]:
    """Measure between two points of the surface, and make their distance a known one.

    In a data set a point is as far away as the triangulated point that the photo shows nearest to its pixel; in a run,
    as far away as the rendered depth. With `metres` the world of a data set is from then on in metres, and upright by
    its cameras unless it is known to be upright: `place.json` in it says so, and no other file of it changes. A run
    keeps its axes, and its files (Gaussians, cameras, meshes) are written anew in metres.

    Args:
        source: Folder of a data set, or of a finished run.
        between: Two pixels, in one photo or in two.
        metres: What their distance really is. None: it is only measured.

    Returns:
        `distance` before; `unit` of it, "metre" or "scene unit"; `factor`, what all lengths were multiplied by, None
        where nothing was changed: no change was requested, or it is in metres and so long already.

    Raises:
        InputError: There is no such photo or pixel, nothing is seen there, or the source cannot be read or written.
    """
    source = Path(source)
    first, second = between
    if metres is not None and not 1 / LARGEST < metres < LARGEST:
        raise InputError(f"is: {metres:g} m is no length of a scene")
    scene = None if is_run(source) else load_scene(source)
    point_at, place = (
        (points_of_run(source), Run.open(source).place) if scene is None else (points_of_scene(scene), scene.place)
    )
    distance = float(np.linalg.norm(point_at(first) - point_at(second)))
    report = {"distance": distance, "unit": "metre" if place.is_known else "scene unit", "factor": None}
    if metres is None or (place.is_known and abs(distance / metres - 1) < SAME):
        return report
    if not distance > 0:
        raise InputError(f"between: {first} and {second} show one point; two are needed for a length")
    factor = metres / distance
    scaled = place.rescale(factor, f"{metres:g} m between {first} and {second}")
    if scene is None:
        _rescale_run(source, factor, scaled)
    else:
        georeference_files.write_place(source, _upright(scaled, scene))
    return report | {"factor": factor}


def _upright(place: Place, scene: Scene) -> Place:
    """Turn a place that is not known to be upright so that its cameras are level."""
    if place.up is not None:
        return place
    viewmats = np.stack([scene.similarity.viewmat_to_world(frame.viewmat) for frame in scene.frames])
    up, _ = up_of_cameras(viewmats)
    return place.turned(turn_upright(up))


def _rescale_run(folder: Path, factor: float, place: Place) -> None:
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
            poses = json_files.read(folder / POSES)
            for move in poses["photos"].values():
                move["shift"] = [factor * side for side in move["shift"]]
            json_files.write(new / POSES, poses)
        for name in MESHES:
            if (folder / name).exists():
                _write_stretched_mesh(folder / name, new / name, factor, place)


def _write_stretched_mesh(old: Path, new: Path, factor: float, place: Place) -> None:
    textured = read_textured(old)
    mesh = read_mesh(old) if textured is None else textured.mesh
    mesh = replace(mesh, vertices=factor * mesh.vertices)
    if textured is None:
        write_mesh(new, mesh, place)
    else:
        write_textured(new, replace(textured, mesh=mesh), place)
