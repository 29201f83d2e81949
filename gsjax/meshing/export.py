"""Meshes as files: PLY, OBJ and GLB by suffix, with vertex colours or a texture, in the data set's coordinates.

Where float32 would lose their place, vertices are doubles in a PLY, have all digits in an OBJ, and are about the
translation of their node in a GLB. Such vertices are read as float64, all others as float32.

A texture goes into OBJ, with an MTL and a PNG of the same name, into GLB, or into USDZ, which is written only. The
textured OBJ has vertex colours too; the textured GLB has none, since glTF would multiply them with the texture.

Of other programs' files one texture that does not repeat is read; several become colours of vertices. A line reports
every picture that is not read. A file that trimesh would read wrong is refused.

No axis is turned. glTF and USD call y "up": their viewers may show a scene with another up axis lying on its side.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import ply
from gsjax.io.files import atomic_path
from gsjax.io.georeference_files import state_beside
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.files import glb, obj, usdz
from gsjax.meshing.files.glb_reader import read_glb
from gsjax.meshing.files.named_files import NamedFiles
from gsjax.meshing.files.parts import Part, merge_parts
from gsjax.meshing.files.ply_reader import LONGEST_HEADER, read_ply
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import as_needed, is_float32


@dataclass(frozen=True)
class MeshFormat:
    """An entry of the table; None: not supported."""

    read: Callable[[Path, NamedFiles], list[Part]] | None = None
    encode: Callable[[Mesh, Place], bytes] | None = None
    encode_textured: Callable[[TexturedMesh, Place], bytes] | None = None
    states_place: bool = False  # within the file; else a file next to it does


FORMATS = {
    ".ply": MeshFormat(read_ply, ply.encode_mesh, states_place=True),
    ".obj": MeshFormat(obj.read_obj, obj.encode_obj),  # a textured one is three files
    ".glb": MeshFormat(read_glb, glb.encode_glb, glb.encode_textured, states_place=True),
    ".usdz": MeshFormat(encode_textured=usdz.encode_textured),
}
"""By suffix. One entry registers a format."""
SUFFIXES = tuple(suffix for suffix, each in FORMATS.items() if each.read)
TEXTURED = (".obj", *(suffix for suffix, each in FORMATS.items() if each.encode_textured))


def write_mesh(path: str | Path, mesh: Mesh, place: Place = UNPLACED) -> None:
    """Write a mesh, whole or not at all.

    Args:
        path: Its suffix says the format: .ply, .obj or .glb.
        mesh: What to write.
        place: What is known of the world that it is in: stated in the file, or next to an OBJ.

    Raises:
        InputError: Unknown suffix, or the file cannot be written.
    """
    path = Path(path)
    mesh_format = FORMATS[supported_suffix(path)]
    assert mesh_format.encode is not None
    with atomic_path(path) as temporary:
        temporary.write_bytes(mesh_format.encode(mesh, place))
    if not mesh_format.states_place:
        state_beside(path, place)


def write_textured(path: str | Path, textured: TexturedMesh, place: Place = UNPLACED) -> None:
    """Write a mesh with its texture, whole or not at all, like `write_mesh`, as .glb, .usdz or .obj.

    To an .obj belong a .mtl and a .png of the same name, which are replaced too; the .obj that names them comes last.

    Raises:
        InputError: Another suffix, or a file cannot be written.
    """
    path = Path(path)
    mesh_format = FORMATS[textured_suffix(path)]
    if mesh_format.encode_textured is None:
        obj.write_textured_obj(path, textured)
    else:
        with atomic_path(path) as temporary:
            temporary.write_bytes(mesh_format.encode_textured(textured, place))
    if not mesh_format.states_place:
        state_beside(path, place)


def read_mesh(path: str | Path) -> Mesh:
    """Read a triangle mesh; its vertices have the texture's colours where it has only that, grey where no colours.

    Args:
        path: A .ply, .obj or .glb file.

    Raises:
        InputError: Unknown suffix, no such file, not readable as that format, or no triangles in it.
    """
    part = _read(Path(path))
    return Mesh(part.vertices, part.faces, part.colors)


def read_textured(path: str | Path) -> TexturedMesh | None:
    """Read a mesh as `read_mesh` does, with its texture; None where not all of it shows the same one."""
    return _textured(_read(Path(path)))


def is_mesh_file(path: Path) -> bool:
    """Whether the suffix of a file, or the header of a PLY, says that it holds a mesh and not Gaussians."""
    if path.suffix.lower() != ".ply":
        return path.suffix.lower() in SUFFIXES
    with path.open("rb") as file:
        header = file.read(LONGEST_HEADER).partition(b"end_header")[0]
    return b"element face" in header and b"f_dc_0" not in header and b"packed_position" not in header


def glb_bytes(path: str | Path) -> bytes:
    """Return the file as a GLB for a browser, with its texture or vertex colours, and unlit: photos hold their light.

    A file that is a GLB already is left as it is. Other files are read as `read_mesh` does.
    """
    path = Path(path)
    part = _read(path)
    if path.suffix.lower() == ".glb":
        return path.read_bytes()
    textured = _textured(part)
    if textured is None:
        return glb.encode_glb(Mesh(part.vertices, part.faces, part.colors), unlit=True)
    return glb.encode_textured(textured)


def supported_suffix(path: Path, supported: Sequence[str] = SUFFIXES, what: str = "mesh files") -> str:
    """Return the path's suffix in lower case; InputError names the supported ones where it is none of them."""
    suffix = path.suffix.lower()
    if suffix not in supported:
        raise InputError(f"{path}: {what} end in {', '.join(supported)}")
    return suffix


def textured_suffix(path: Path) -> str:
    """Return the suffix of a file with a texture, like `supported_suffix`."""
    return supported_suffix(path, TEXTURED, "meshes with a texture")


def _textured(part: Part) -> TexturedMesh | None:
    if part.texture is None:
        return None
    mesh = Mesh(part.vertices, part.faces, part.colors)
    every_vertex = np.arange(mesh.num_vertices, dtype=np.int32)
    atlas = Atlas(np.asarray(part.uvs, np.float32), every_vertex, part.faces, part.texture.shape[1], 0)
    return TexturedMesh(mesh, atlas, part.texture)


def _read(path: Path) -> Part:
    """Return the triangles of a file as one part, its vertices as `as_needed`; InputError where it has none."""
    read = FORMATS[supported_suffix(path)].read
    assert read is not None
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    named = NamedFiles(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Numbers that are not finite are refused below.
            parts = [_require_drawable(path, part) for part in read(path, named) if len(part.faces)]
            if not parts:
                raise InputError(f"{path}: holds no triangles")
            part = merge_parts(path, parts)
            return replace(part, vertices=as_needed(part.vertices.astype(np.float64)))
    except InputError:
        raise
    except Exception as error:  # Readers raise whatever the broken bytes lead to.
        raise InputError(f"{path}: not readable as a mesh ({type(error).__name__}: {error})".splitlines()[0]) from error


def _require_drawable(path: Path, part: Part) -> Part:
    """Return the part; InputError where its triangles, or their places in a texture, cannot be drawn."""
    if part.vertices.shape[1:] != (3,):
        raise InputError(f"{path}: its vertices do not have three coordinates")
    if not 0 <= part.faces.min() <= part.faces.max() < len(part.vertices):
        raise InputError(f"{path}: a triangle of it has a vertex that is not among its {len(part.vertices)}")
    if not (fine := is_float32(part.vertices).all(axis=1)).all():
        raise InputError(f"{path}: {(~fine).sum()} of {len(fine)} vertices are not finite")
    if part.uvs is not None and (part.uvs.shape != (len(part.vertices), 2) or not is_float32(part.uvs).all()):
        raise InputError(f"{path}: places in its texture are no pairs of finite numbers")
    return part
