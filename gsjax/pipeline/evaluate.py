"""Scores of a run: held-out images, and geometry wherever there is truth beside the images."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.effects.alignment import align as aligned_camera
from gsjax.measures import geometry
from gsjax.mesh import Mesh
from gsjax.meshing.closest import closest_on_mesh
from gsjax.meshing.export import read_mesh
from gsjax.networks.lpips import STANDARD, lpips_measures
from gsjax.pipeline.mesh import mesh as extract
from gsjax.place import Place
from gsjax.planning.effects import appearances_of_tracks
from gsjax.runs.photography import Photography
from gsjax.runs.result import open_result, scene_of_run
from gsjax.runs.run import Run
from gsjax.scoring.images import score_images
from gsjax.scoring.surfaces import LENGTHS, score_mesh_views, score_surface


def evaluate(
    run: str | Path,
    *,
    mesh: str | Path | None = None,
    lpips: Sequence[str | Path] = (),
    three_ways: bool = False,
    aligned: bool = False,
    zooms: Sequence[float] = (),
) -> dict[str, Any]:
    """Score a finished run on its held-out views and, where its data set brings truth, its geometry.

    Args:
        run: Run folder.
        mesh: Mesh to score against the true surface. None: `RUN/mesh.ply`, extracted now if it is absent.
        lpips: Files of weights, see `gsjax.networks.lpips.lpips_measures`.
        three_ways: Score pictures in all ways of `score_images` even if the run simulated no effects.
        aligned: Score pictures from the poses that fit the photos best too, even if the run moved no cameras.
        zooms: Score pictures at so many times the size of training as well: at 0.5 against photos of half the size.

    Returns:
        What `score_images` tells of the held-out views and what the files of weights allow, at least `lpips_vgg_3dgs`
        (None without held-out views or without weights), `gaussians`, `train_seconds`, `steps`; for every zoom
        `psnr_zoom_0.5` and `ssim_zoom_0.5` (with that number); with true
        normals `normal_error_deg` and `normal_error_median_deg` of the rendered depth over object pixels and
        `normal_error_all_deg` over all surface pixels; with true depth `depth_error` (mean absolute, object pixels,
        scene units), both in held-out views; with true surface points what `score_mesh` returns, and the same errors of
        the mesh's own depth as `mesh_normal_error_deg` and so on, in `floor` those of the true mesh.

    Raises:
        InputError: The run, its data set, the mesh or the weights cannot be read.
    """
    run, measures = Path(run), lpips_measures(lpips)
    result, folder = open_result(run), Run.open(run)
    background, scene, found = folder.settings["background"], scene_of_run(run), folder.photography
    similarity = scene.similarity
    zoomed = {zoom: scene_of_run(run, zoom=zoom).held_out_frames for zoom in zooms}  # Refused before hours of scoring.
    given = None if mesh is None else read_mesh(mesh)
    if three_ways and not found.looks:
        found = found._replace(looks=appearances_of_tracks(scene))
    figures = score_images(
        result.gaussians,
        scene.held_out_frames,
        background,
        measures=measures,
        found=found.with_near(scene.frames),
        align=aligned_camera if aligned or found.moves else None,
    )
    figures.setdefault(STANDARD, None)
    for zoom, frames in zoomed.items():
        plain = Photography(background=found.background)
        scores = score_images(result.gaussians, frames, background, found=plain)
        figures |= {f"{name}_zoom_{zoom:g}": scores[name] for name in ("psnr", "ssim")}
    figures |= {
        "gaussians": result.gaussians.num_gaussians,
        "train_seconds": folder.manifest.get("train_seconds"),
        "steps": folder.manifest.get("steps"),
    }
    truth = scene.truth
    if truth is None:
        return figures
    surface = score_surface(result.gaussians, scene.held_out_frames, truth, result.depth_mode)
    if truth.points is not None and truth.point_normals is not None:
        own = run / "mesh.ply"
        if given is None and not own.exists():
            extract(run, own)
        scored = similarity.mesh_to_local(read_mesh(own) if given is None else given)
        true = None if truth.mesh is None else similarity.mesh_to_local(_in_world(read_mesh(truth.mesh), scene.place))
        surface |= score_mesh(scored, truth.points, truth.point_normals, true)
        surface |= score_mesh_views(scored, scene.held_out_frames, truth)
        if true is not None:
            surface["floor"] |= score_mesh_views(true, scene.held_out_frames, truth)
    return figures | similarity.figures_to_world(surface, LENGTHS)


def _in_world(mesh: Mesh, place: Place) -> Mesh:
    return replace(mesh, vertices=place.points_to_world(mesh.vertices))


def score_mesh(mesh: Mesh, seen_points: np.ndarray, seen_normals: np.ndarray, true_mesh: Mesh | None) -> dict[str, Any]:
    """How far a mesh is from the true surface: from its triangles where they are known, else from its points.

    Args:
        mesh: The prediction.
        seen_points: `[P, 3]` points of the true surface that cameras saw, world.
        seen_normals: `[P, 3]` its normals there.
        true_mesh: The true triangles, where they are known.

    Returns:
        `chamfer`, `accuracy`, `completeness`, `fscore`, `normal_consistency` and the rest that
        `gsjax.measures.geometry.compare_to_surface` tells; `distances`, "point to surface" or, without true triangles,
        "point to point"; with true triangles also `floor`: the same scores of the true mesh itself.

    Raises:
        InputError: Nothing of the mesh lies where cameras saw something.
    """
    if true_mesh is None:
        return geometry.compare_to_truth(mesh, seen_points, seen_normals) | {"distances": "point to point"}
    found, floor = (
        geometry.compare_to_surface(each, true_mesh, seen_points, seen_normals, closest_on_mesh)
        for each in (mesh, true_mesh)
    )
    return found | {"distances": "point to surface", "floor": floor}
