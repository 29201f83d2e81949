"""Meshes as files: PLY (binary), OBJ and GLB, by suffix, with vertex colours, in the scene's own coordinates.

No axis is turned on the way out or in. glTF calls y "up": a viewer of the GLB may show a scene whose up is another
axis lying on its side, and it is still the same numbers as the cameras' and the Gaussians'.
"""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.files import atomic_path
from gsjax.mesh import Mesh
from gsjax.meshing.libraries import load_trimesh

# Of trimesh's writers, and what keeps them from rounding float32 coordinates.
WRITERS = {".ply": {"encoding": "binary"}, ".obj": {"digits": 9}, ".glb": {}}


def write_mesh(path: str | Path, mesh: Mesh) -> None:
    """Writes a mesh, whole or not at all.

    Args:
        path: Its suffix says the format: .ply, .obj or .glb. Colours are stored as they are, 8-bit sRGB.
        mesh: What to write.

    Raises:
        InputError: Unknown suffix, or the file cannot be written.
    """
    path = Path(path)
    options = WRITERS[supported_suffix(path)]
    trimesh = load_trimesh()
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False)
    with atomic_path(path) as temporary:
        content = surface.export(file_type=supported_suffix(path)[1:], **options)
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def read_mesh(path: str | Path) -> Mesh:
    """Reads a triangle mesh; grey where the file has no vertex colours.

    Args:
        path: A .ply, .obj or .glb file.

    Raises:
        InputError: Unknown suffix, no such file, not readable as that format, or no triangles in it.
    """
    path = Path(path)
    supported_suffix(path)
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    trimesh = load_trimesh()
    try:
        surface = trimesh.load(path, force="mesh", process=False, maintain_order=True)
        vertices, faces = np.asarray(surface.vertices, np.float32), np.asarray(surface.faces, np.int32)
    except Exception as error:  # Readers raise whatever the broken bytes lead to.
        raise InputError(f"{path}: not readable as a mesh ({type(error).__name__}: {error})".splitlines()[0]) from error
    if not len(faces):
        raise InputError(f"{path}: holds no triangles")
    return Mesh(vertices, faces, _vertex_colors(surface))


def supported_suffix(path: Path) -> str:
    """The path's suffix in lower case; InputError names the supported ones where it is none of them."""
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise InputError(f"{path}: mesh files end in {', '.join(WRITERS)}")
    return suffix


def _vertex_colors(surface) -> np.ndarray:
    """`[V, 3]` uint8."""
    if surface.visual.kind == "vertex":
        return np.asarray(surface.visual.vertex_colors[:, :3], np.uint8)
    return np.full((len(surface.vertices), 3), 128, np.uint8)
