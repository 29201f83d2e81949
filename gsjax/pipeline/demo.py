"""The embedded default: a scene of our own, known exactly, trained with and without the normal term and compared."""

from pathlib import Path
from typing import Any

import rasterizer
from gsjax import config, pipeline
from gsjax.colors import to_bytes
from gsjax.errors import InputError
from gsjax.io import analytic_scene, json_files
from gsjax.io.files import make_folder
from gsjax.io.machine import machine, versions
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh
from gsjax.render import gallery
from gsjax.report.panels import draw_panels
from gsjax.report.pictures import mesh_picture, normal_picture, surface_picture
from gsjax.runs.result import Result, open_result
from gsjax.settings import DEMO, Settings

NUM_VIEWS, SIZE = 48, (192, 192)
SURFACE_POINTS = 60_000  # More bring the meshes no nearer.
SHOWN_VIEW = 1  # Of the held-out ones.
REPORTED = ("psnr", "ssim", "normal_error_deg", "normal_error_median_deg", "normal_error_all_deg", "chamfer",
            "accuracy", "completeness", "fscore_quarter", "fscore_half", "fscore", "normal_consistency",
            "gaussians")  # fmt: skip


def run(out: str | Path = "runs/demo") -> dict[str, Any]:
    """Make the scene, train both variants for the same steps, the first of them once, mesh, score, and draw.

    The true normals of the scene play the part of the monocular ones.

    Args:
        out: Folder for the scene, both runs, `report.json` and `comparison.png`; absent or empty.

    Returns:
        The report: figures of `vanilla` and `surface`, and of the true mesh as their `floor`; path of the surface
        `mesh`, `machine`, `versions`.

    Raises:
        InputError: The folder is in use or cannot be written.
    """
    out = Path(out)
    if out.is_dir() and any(out.iterdir()):
        raise InputError(f"{out}: this folder is not empty; remove it, or choose another with --out")
    make_folder(out)
    rasterizer.prepare()
    scene = analytic_scene.write(out / "scene", num_views=NUM_VIEWS, size=SIZE)
    report: dict[str, Any] = {}
    for name, vanilla, earlier in (("vanilla", True, None), ("surface", False, out / "vanilla")):
        settings = {**DEMO, "vanilla": vanilla, "normals": str(scene / "normals")}
        print(f"demo: training the {name} variant")
        trained = pipeline.train(scene, out / name, config.parse(Settings, settings), earlier=earlier)
        pipeline.mesh(out / name, out / name / "mesh.ply", points=SURFACE_POINTS)
        figures = pipeline.evaluate(out / name)
        report[name] = {key: figures[key] for key in REPORTED} | {"seconds": trained["train_seconds"]}
        report["floor"] = {key: value for key, value in figures["floor"].items() if key in REPORTED}
    picture = _comparison(scene, open_result(out / "vanilla"), open_result(out / "surface"), out)
    report |= {
        "mesh": str(out / "surface" / "mesh.ply"),
        "picture": str(picture),
        "machine": machine(),
        "versions": versions(),
    }
    json_files.write(out / "report.json", report)
    return report


def _comparison(scene: Path, vanilla: Result, surface: Result, out: Path) -> Path:
    """comparison.png: photo and render, normals before, after and true, and both meshes, of one held-out view."""
    loaded = load_scene(scene)
    frame, truth = loaded.held_out_frames[SHOWN_VIEW], loaded.truth
    index, local = surface.names.index(frame.name), surface.similarity.mesh_to_local
    camera = surface.cameras[index]
    before, after = (
        next(gallery.pictures(r.gaussians, [camera], r.background, r.depth_mode)) for r in (vanilla, surface)
    )

    assert truth is not None, "the demo writes its own truth"
    panels = {
        "held-out photo": frame.pixels().image,
        "normals, vanilla": surface_picture(before.depth, camera),
        "normals, with the SDF term": surface_picture(after.depth, camera),
        "normals, true": normal_picture(truth.normals[frame.name]()),
        "render, with the SDF term": to_bytes(after.colors),
        "mesh, vanilla": mesh_picture(local(read_mesh(out / "vanilla" / "mesh.ply")), camera),
        "mesh, with the SDF term": mesh_picture(local(read_mesh(out / "surface" / "mesh.ply")), camera),
    }
    return draw_panels(panels, out / "comparison.png")
