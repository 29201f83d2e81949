"""Scores of a run: held-out images, and geometry wherever there is truth with the images."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gsjax.effects.alignment import align as aligned_camera
from gsjax.errors import NoSurfaceError
from gsjax.meshing.export import read_mesh, read_textured
from gsjax.meshing.pictures import shading_of
from gsjax.meshing.ray_queries import closest_on_mesh
from gsjax.metrics import geometry
from gsjax.metrics.lpips import STANDARD, lpips_measures
from gsjax.metrics.mesh_photos import score_appearance
from gsjax.metrics.photos import score_images
from gsjax.metrics.truth_maps import LENGTHS, score_mesh_views, score_surface
from gsjax.pipeline.mesh import mesh as extract
from gsjax.planning.effects import appearances_of_tracks
from gsjax.runs.photo_effects import PhotoEffects
from gsjax.runs.result import Result, open_result, scene_of_run
from gsjax.runs.run import Run
from gsjax.scene import Frame, Scene, Truth
from gsjax.scene.meshes import Mesh


def evaluate(
    run: str | Path,
    *,
    mesh: str | Path | None = None,
    lpips: Sequence[str | Path] = (),
    three_ways: bool = False,
    aligned: bool = False,
    zooms: Sequence[float] = (),
    scene_folder: str | Path | None = None,
) -> dict[str, Any]:
    """Score a finished run on its held-out views and, where its data set has truth, its geometry.

    Args:
        run: Run folder.
        mesh: Mesh to score against the true surface, and by its texture or, without one, its vertex colours against the
            held-out photos. None: `RUN/mesh.ply` against the true surface alone, extracted now if it is absent.
        lpips: Files of weights, see `gsjax.metrics.lpips.lpips_measures`.
        three_ways: Score pictures in all ways of `score_images` even if the run simulated no effects.
        aligned: Score pictures from the poses that fit the photos best too, even if the run moved no cameras.
        zooms: Score pictures at so many times the size of training as well: at 0.5 against photos of half the size.
        scene_folder: Where the data set is, if it was moved since the training. None: where it was.

    Returns:
        What `score_images` reports of the held-out views and what the files of weights allow, at least `lpips_vgg_3dgs`
        (None without held-out views or without weights), `gaussians`, `train_seconds`, `steps`; for every zoom
        `psnr_zoom_0.5` and `ssim_zoom_0.5` (with that number); of a `mesh` what
        `gsjax.metrics.mesh_photos.score_appearance` reports; with true normals `normal_error_deg` and
        `normal_error_median_deg` of the rendered depth over object pixels and `normal_error_all_deg` over all surface
        pixels; with true depth `depth_error` (mean absolute, object pixels, scene units), both in held-out views; with
        true surface points `gsjax.metrics.geometry.SCORES` of the mesh, the same errors of its own depth as
        `mesh_normal_error_deg` and so on, and `distances`, "point to surface" or, without true triangles, "point to
        point"; with true triangles `floor`: the same scores of the true mesh itself. The scores of a mesh without
        surface where cameras saw the truth, as of a poor run, are None, and a line on stderr says so.

    Raises:
        InputError: The run, its data set, the mesh or the weights cannot be read.
    """
    run, measures = Path(run), lpips_measures(lpips)
    result, folder = open_result(run), Run.open(run)
    background, effects = folder.settings["model"]["background"], folder.photo_effects
    scene = scene_of_run(run, scene=scene_folder)
    # Refused before hours of scoring.
    zoomed = {zoom: scene_of_run(run, zoom=zoom, scene=scene_folder).held_out_frames for zoom in zooms}
    local_mesh = None if mesh is None else scene.similarity.mesh_to_local(read_mesh(mesh))
    if three_ways and not effects.appearances:
        effects = effects._replace(appearances=appearances_of_tracks(scene))
    near = effects.with_near_appearances(scene.frames)
    figures = score_images(
        result.gaussians,
        scene.held_out_frames,
        background,
        measures=measures,
        photo_effects=near,
        align=aligned_camera if aligned or effects.moves else None,
        depth_mode=result.depth_mode,  # as the surface is read: one program draws both
    )
    figures.setdefault(STANDARD, None)
    plain = PhotoEffects(background=effects.background)
    for zoom, frames in zoomed.items():
        scores = score_images(result.gaussians, frames, background, photo_effects=plain)
        figures |= {f"{name}_zoom_{zoom:g}": scores[name] for name in ("psnr", "ssim")}
    if local_mesh is not None:
        shading = shading_of(read_textured(mesh))
        figures |= score_appearance(local_mesh, shading, result.gaussians, scene.held_out_frames, background, near)
    figures["gaussians"] = result.gaussians.num_gaussians
    figures |= {name: folder.manifest.get(name) for name in ("train_seconds", "steps")}
    return figures if scene.truth is None else figures | _surface_scores(run, result, scene, local_mesh)


def _surface_scores(run: Path, result: Result, scene: Scene, local_mesh: Mesh | None) -> dict[str, Any]:
    """Of the rendered depth and, where the true surface is known, of the mesh, or else of the run's own."""
    truth, similarity = scene.truth, scene.similarity
    assert truth is not None, "only what has a truth is scored by it"
    surface = score_surface(result.gaussians, scene.held_out_frames, truth, result.depth_mode)
    if truth.points is not None and truth.point_normals is not None:
        true = None
        if truth.mesh is not None:
            true = read_mesh(truth.mesh)
            true = similarity.mesh_to_local(replace(true, vertices=scene.place.points_to_world(true.vertices)))
        score = partial(_score_mesh, frames=scene.held_out_frames, truth=truth, true_mesh=true)
        try:
            surface |= score(similarity.mesh_to_local(_own_mesh(run)) if local_mesh is None else local_mesh)
        except NoSurfaceError as fault:
            print(f"{run}: its mesh is not scored: {fault}", file=sys.stderr)
            surface |= dict.fromkeys((*geometry.SCORES, *(f"mesh_{name}" for name in surface)))
        surface["distances"] = "point to point" if true is None else "point to surface"
        if true is not None:
            surface["floor"] = score(true)
    return similarity.figures_to_world(surface, LENGTHS)


def _own_mesh(run: Path) -> Mesh:
    """The run's mesh, which is extracted now if it is absent."""
    file = run / "mesh.ply"
    if not file.exists():
        extract(run, file)
    return read_mesh(file)


def _score_mesh(mesh: Mesh, frames: tuple[Frame, ...], truth: Truth, true_mesh: Mesh | None) -> dict[str, Any]:
    """Distances from the true triangles, or without them from the points; and errors of the depth in these frames."""
    assert truth.points is not None and truth.point_normals is not None, "nothing else is scored here"
    if true_mesh is None:
        scores = geometry.compare_to_truth(mesh, truth.points, truth.point_normals)
    else:
        scores = geometry.compare_to_surface(mesh, true_mesh, truth.points, truth.point_normals, closest_on_mesh)
    return scores | score_mesh_views(mesh, frames, truth)
