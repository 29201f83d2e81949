"""The contact sheet of a run: photo, render, normals before and after the regulariser and of the maps, meshes."""

from pathlib import Path

import numpy as np

from gsjax.gaussians import Gaussians
from gsjax.io.normal_maps import map_places
from gsjax.io.ply import read_gaussians
from gsjax.meshing.export import read_mesh, read_textured
from gsjax.meshing.pictures import texture_colors
from gsjax.rendering import gallery
from gsjax.report.figures import draw_panels
from gsjax.report.pictures import mesh_picture, normal_picture, surface_picture
from gsjax.runs.normal_source import read_map
from gsjax.runs.result import Result, open_result, scene_of_run
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes


def draw_sheet(out: Path, regulariser: str = "R") -> list[str]:
    """Draws OUT/sheet.png of a run that has its meshes, and returns the titles of its panels.

    The view is the first that was trained on: held-out views have no map. What the run does not have (its map, the
    mesh of a `vanilla` run of the same seed in the same folder) has no panel.
    """
    run = out / "run"
    result, frames = open_result(run), scene_of_run(run).frames
    index = next(i for i, held_out in enumerate(result.held_out) if not held_out)
    camera, frame = result.cameras[index], frames[index]
    assert frame.name == result.names[index], "a run keeps the order of its data set"
    after = _picture(result, result.gaussians, camera)
    panels = {f"photo, {frame.name}": frame.pixels().image, "render": to_bytes(after.colors)}
    if (out / "before.ply").exists():
        before = _picture(result, read_gaussians(out / "before.ply"), camera)
        panels[f"normals before {regulariser}"] = surface_picture(before.depth, camera)
    panels[f"normals after {regulariser}"] = surface_picture(after.depth, camera)
    maps = map_places([f for f in frames if not f.held_out])
    normal_map = run / "normals" / f"{maps[frame.name]}.png"
    if normal_map.exists():
        panels["normals of the maps"] = normal_picture(read_map(normal_map, frame).astype(np.float32) / 127)
    panels[f"mesh with {regulariser}"] = mesh_picture(read_mesh(run / "mesh.ply"), camera)
    textured = read_textured(out / "textured.glb")
    assert textured is not None, "it was painted"
    panels["textured mesh"] = mesh_picture(textured.mesh, camera, texture_colors(textured))
    plain = out.with_name(f"vanilla_{out.name.rpartition('_')[2]}") / "run" / "mesh.ply"
    if plain.exists():
        panels[f"mesh without {regulariser}"] = mesh_picture(read_mesh(plain), camera)
    draw_panels(panels, out / "sheet.png", columns=min(4, len(panels)))
    return list(panels)


def _picture(result: Result, gaussians: Gaussians, camera: Camera) -> gallery.Picture:
    return next(gallery.pictures(gaussians, [camera], result.background, result.depth_mode))
