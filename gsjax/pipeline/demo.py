"""The built-in scene, known exactly, trained with and without the surface terms and compared."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import rasterizer
from gsjax import config, pipeline
from gsjax.io import analytic_scene, json_files
from gsjax.io.files import make_folder, require_empty
from gsjax.io.machine import machine, versions
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh
from gsjax.presets import DEMO
from gsjax.rendering import gallery
from gsjax.report.figures import draw_panels
from gsjax.report.pictures import difference_picture, mesh_picture, normal_picture, surface_picture
from gsjax.runs.result import Result, open_result
from gsjax.scene.colors import to_bytes

NUM_VIEWS, SIZE = 48, (192, 192)
SURFACE_POINTS = 60_000  # A quarter of the usual: a third less time, and meshes 4 % further from the truth.
PICTURE_VIEW = 1  # Of the held-out ones.
ERROR_GAIN = 8  # A difference of 32 of 255 is black.
REPORTED = ("psnr", "ssim", "normal_error_deg", "normal_error_median_deg", "normal_error_all_deg", "chamfer",
            "accuracy", "completeness", "fscore_quarter", "fscore_half", "fscore", "normal_consistency",
            "gaussians")  # fmt: skip


def run(out: str | Path = "runs/demo") -> dict[str, Any]:
    """Make the scene, train both variants for the same steps, the first of them once, mesh, score, and draw.

    The surface terms are those of `gsjax.presets.DEMO`. R reads the true normals of the scene, not monocular ones.

    Args:
        out: Folder for the scene, both runs, `report.json` and `comparison.png`; absent or empty.

    Returns:
        The report: figures of `vanilla` and `surface`, and of the true mesh as their `floor`; path of the surface
        `mesh`, `machine`, `versions`.

    Raises:
        InputError: The folder is in use or cannot be written.
    """
    out = Path(out)
    require_empty(out)
    make_folder(out)
    rasterizer.prepare()
    scene = analytic_scene.write_built_in_scene(out / "scene", num_views=NUM_VIEWS, size=SIZE)
    vanilla, surface = out / "vanilla", out / "surface"
    _train(scene, vanilla)
    _train(scene, surface, warm_start=vanilla)
    with ThreadPoolExecutor(2) as pool:  # One leaves cores idle.
        scored = dict(zip(("vanilla", "surface"), pool.map(_mesh_and_score, (vanilla, surface)), strict=True))
    picture = _comparison(scene, open_result(vanilla), open_result(surface), out)
    report = {
        **{each: _reported(figures) | {"seconds": figures["train_seconds"]} for each, figures in scored.items()},
        "floor": _reported(scored["surface"]["floor"]),
        "mesh": str(surface / "mesh.ply"),
        "picture": str(picture),
        "machine": machine(),
        "versions": versions(),
    }
    json_files.write(out / "report.json", report)
    return report


def _train(scene: Path, run: Path, *, warm_start: Path | None = None) -> None:
    """The variant that the folder is named for."""
    print(f"demo: training the {run.name} variant")
    settings = config.merge(
        DEMO, {"schedule": {"vanilla": run.name == "vanilla"}, "supervision": {"normals": str(scene / "normals")}}
    )
    pipeline.train(scene, run, settings, warm_start=warm_start)


def _mesh_and_score(run: Path) -> dict[str, Any]:
    pipeline.mesh(run, run / "mesh.ply", points=SURFACE_POINTS)
    return pipeline.evaluate(run)


def _reported(figures: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in figures.items() if key in REPORTED}


def _comparison(scene: Path, vanilla: Result, surface: Result, out: Path) -> Path:
    """comparison.png: photo, render, its error, normals before, after and true, both meshes, of one held-out view."""
    loaded = load_scene(scene)
    frame, truth = loaded.held_out_frames[PICTURE_VIEW], loaded.truth
    index, local = surface.names.index(frame.name), surface.similarity.mesh_to_local
    camera = surface.cameras[index]
    before, after = (
        next(gallery.pictures(r.gaussians, [camera], r.background, r.depth_mode)) for r in (vanilla, surface)
    )

    assert truth is not None, "the demo writes its own truth"
    photo, render = frame.pixels().image, to_bytes(after.colors)
    panels = {
        f"photo {frame.name}, held out": photo,
        "normals, vanilla": surface_picture(before.depth, camera),
        "normals, surface terms": surface_picture(after.depth, camera),
        "normals, true": normal_picture(truth.normals[frame.name]()),
        "render, surface terms": render,
        "mesh, vanilla": mesh_picture(local(read_mesh(out / "vanilla" / "mesh.ply")), camera),
        "mesh, surface terms": mesh_picture(local(read_mesh(out / "surface" / "mesh.ply")), camera),
        f"error of the render, {ERROR_GAIN} times": difference_picture(photo, render, ERROR_GAIN),
    }
    return draw_panels(panels, out / "comparison.png")
