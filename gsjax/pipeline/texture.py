"""A mesh file and the Gaussians it came from to a mesh with a texture; any mesh file to a turntable."""

from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.meshing.export import read_mesh, read_textured, textured_writer, write_textured
from gsjax.meshing.pictures import texture_colors, vertex_colors
from gsjax.meshing.texture import texture_mesh
from gsjax.meshing.texture_size import texture_side
from gsjax.meshing.turntable import check_suffix, write_turntable
from gsjax.meshing.turntable import turntable as pictures_around
from gsjax.pipeline.result import open_result, training_pictures

SIZES = (64, 8192)  # Browsers hold no larger texture.
MOST_CHOSEN = 4096


def texture(
    source: str | Path, mesh: str | Path, out: str | Path, *, size: int | None = None, scene: str | Path | None = None
) -> dict[str, Any]:
    """Paint a mesh with what the Gaussians show in the training views, where the photos are not masked.

    Args:
        source: Run folder, or a file of Gaussians.
        mesh: .ply, .obj or .glb in the same coordinates.
        out: .glb, or .obj with .mtl and .png beside it.
        size: Side of the texture, texels. None: as many as the photos tell apart, 4096 at most
            (`gsjax.meshing.texture_size`).
        scene: Data set whose cameras to use with a file. None: cameras around the Gaussians, or within them.

    Returns:
        A report of plain numbers: `vertices`, `faces`, `size` and what `texture_mesh` says.

    Raises:
        InputError: A file cannot be read or written, or the texture is too small for the mesh.
    """
    textured_writer(Path(out))
    if size is not None and not SIZES[0] <= size <= SIZES[1]:
        raise InputError(f"--size {size} is not between {SIZES[0]} and {SIZES[1]}")
    surface = read_mesh(mesh)
    result = open_result(source, scene=scene)
    cameras, pictures = training_pictures(result, result.gaussians, np.zeros(3, np.float32))
    side = size or texture_side(surface, cameras, least=SIZES[0], most=MOST_CHOSEN)
    textured, report = texture_mesh(surface, cameras, pictures, size=side)
    write_textured(out, textured)
    return {"vertices": surface.num_vertices, "faces": surface.num_faces, "size": side, **report}


def turntable(
    mesh: str | Path,
    out: str | Path,
    *,
    frames: int = 36,
    size: int = 512,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> Path:
    """Draw any mesh file from a circle around it, with its texture or vertex colours; no display is needed.

    Args:
        mesh: .ply, .obj or .glb.
        out: .gif that turns, or .png with the pictures side by side.
        frames: Pictures in a full turn.
        size: Side of each, pixels.
        up: Direction of the world that points up.

    Returns:
        `out`.

    Raises:
        InputError: The mesh cannot be read, the pictures cannot be written, or an option is out of range.
    """
    check_suffix(out)
    for name, value in (("frames", frames), ("size", size)):
        if value < 1:
            raise InputError(f"--{name} {value} is below 1")
    if not np.any(up):
        raise InputError("--up 0 0 0 is no direction")
    textured = read_textured(mesh)
    surface = read_mesh(mesh) if textured is None else textured.mesh
    shading = vertex_colors if textured is None else texture_colors(textured)
    pictures = pictures_around(surface, frames=frames, size=size, up=np.asarray(up), shading=shading)
    write_turntable(out, list(pictures))
    return Path(out)
