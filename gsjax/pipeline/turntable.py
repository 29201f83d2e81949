"""Pictures of any mesh file from a circle around it."""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.machine import require_memory
from gsjax.meshing.export import read_mesh, read_textured
from gsjax.meshing.pictures import texture_colors, vertex_colors
from gsjax.meshing.turntable import check_suffix, write_turntable
from gsjax.meshing.turntable import turntable as pictures_around
from gsjax.runs.outputs import require_apart
from gsjax.similarity import of_points

MOST_FRAMES, MOST_SIZE = 3600, 4096
BYTES = 6  # a pixel: the pictures, and the copies of them that are written


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
    require_apart(out, mesh)
    for name, value, most in (("frames", frames, MOST_FRAMES), ("size", size, MOST_SIZE)):
        if not 1 <= value <= most:
            raise InputError(f"--{name} {value} is not between 1 and {most}")
    require_memory(f"--frames {frames} --size {size}", BYTES * frames * size**2)
    if not (np.any(up) and np.isfinite(up).all()):
        raise InputError(f"--up {' '.join(f'{axis:g}' for axis in up)} is no direction")
    textured = read_textured(mesh)
    surface = read_mesh(mesh) if textured is None else textured.mesh
    shading = vertex_colors if textured is None else texture_colors(textured)
    surface = of_points(surface.vertices).mesh_to_local(surface)
    pictures = pictures_around(surface, frames=frames, size=size, up=np.asarray(up), shading=shading)
    write_turntable(out, list(pictures))
    return Path(out)
