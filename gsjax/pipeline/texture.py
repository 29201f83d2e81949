"""A mesh file and the Gaussians it came from to a mesh with a texture; any mesh file to a turntable."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io.temporary_files import sweep_beside
from gsjax.meshing.export import read_mesh, textured_suffix, write_textured
from gsjax.meshing.sharpening import sharpened
from gsjax.meshing.texture import texture_mesh, texture_side
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import Result, open_result, training_pictures
from gsjax.runs.run import Run

SIZES = (64, 8192)  # Browsers hold no larger texture.
MOST_CHOSEN = 4096
ROUNDS = 2  # Of sharpening; more bring noise (docs/meshes.md#texture).


def texture(
    source: str | Path, mesh: str | Path, out: str | Path, *, size: int | None = None, scene: str | Path | None = None
) -> dict[str, Any]:
    """Paint a mesh with what the Gaussians show in the training views, where the photos are not masked.

    Args:
        source: Run folder, or a file of Gaussians.
        mesh: .ply, .obj or .glb in the same coordinates.
        out: .glb, .usdz, or .obj with .mtl and .png next to it.
        size: Side of the texture, texels. None: as many as the photos resolve, 4096 at most
            (`gsjax.meshing.texture`).
        scene: Data set whose cameras to use with a file. None: cameras around the Gaussians, or within them.

    Returns:
        A report of plain numbers: `vertices`, `faces`, `size` and what `texture_mesh` says.

    Raises:
        InputError: A file cannot be read or written, or the texture is too small for the mesh.
    """
    textured_suffix(Path(out))
    require_apart(out, source, mesh, scene)
    sweep_beside(Path(out))
    if size is not None and not SIZES[0] <= size <= SIZES[1]:
        raise InputError(f"size={size} is not between {SIZES[0]} and {SIZES[1]}")
    result = open_result(source, scene=scene)
    surface = result.similarity.mesh_to_local(read_mesh(mesh))
    cameras, pictures = training_pictures(result, result.gaussians, np.zeros(3, np.float32))
    side = size or texture_side(surface, cameras, least=SIZES[0], most=MOST_CHOSEN)
    background = known_background(result)
    textured, report = texture_mesh(surface, cameras, pictures, size=side, background=background)
    for _ in range(ROUNDS):
        _, pictures = training_pictures(result, result.gaussians, np.zeros(3, np.float32))
        textured = sharpened(textured, cameras, pictures, background)
    write_textured(out, replace(textured, mesh=result.similarity.mesh_to_world(textured.mesh)), result.place)
    return {"vertices": surface.num_vertices, "faces": surface.num_faces, "size": side, **report}


def known_background(result: Result) -> np.ndarray | None:
    """What training had behind its Gaussians; None of a file, which does not say, and of a run over random colours."""
    if not result.source.is_dir():
        return None
    run = Run(result.source)
    is_random = run.settings["model"]["background"] == "random" and run.photo_effects.background is None
    return None if is_random else result.background
