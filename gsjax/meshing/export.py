"""Meshes as files: PLY (binary), OBJ and GLB, by suffix, with vertex colours, in the data set's own coordinates.

Where float32 would lose their place, vertices are doubles in a PLY, have all digits in an OBJ, and stand about the
translation of their node in a GLB. Such vertices are read as float64, all others as float32.

A texture goes into OBJ, with an MTL and a PNG of the same name beside it, into GLB, or into USDZ, which is written
only. The textured OBJ has vertex colours too; the textured GLB has none, since glTF would multiply them with the
texture.

No axis is turned on the way out or in. glTF and USD call y "up": their viewers may show a scene whose up is another
axis lying on its side, and it is still the same numbers as the cameras' and the Gaussians'.
"""

import math
import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import ply
from gsjax.io.files import atomic_path
from gsjax.io.packages import require
from gsjax.io.place_files import state_beside
from gsjax.meshing import glb, usdz
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.glb_parts import read_glb
from gsjax.meshing.named_files import NamedFiles
from gsjax.meshing.obj import read_obj
from gsjax.meshing.parts import Part, TooOftenError, merge_parts, shown_colors, within_texture
from gsjax.meshing.ply_parts import read_ply
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import as_needed, is_float32, loses_in_float32, spread

SUFFIXES = (".ply", ".obj", ".glb")
HEADER_BYTES = 65536  # Of a PLY, at most.
DIGITS = 9  # Significant ones of a coordinate in text: no float32 is rounded.
MATERIAL = """newmtl surface
Ka 0 0 0
Kd 1 1 1
Ks 0 0 0
illum 1
map_Kd {picture}
"""


def write_mesh(path: str | Path, mesh: Mesh, place: Place = UNPLACED) -> None:
    """Writes a mesh, whole or not at all.

    Args:
        path: Its suffix says the format: .ply, .obj or .glb.
        mesh: What to write.
        place: What is known of the world that it lies in: stated in the file, or beside an OBJ.

    Raises:
        InputError: Unknown suffix, or the file cannot be written.
    """
    path = Path(path)
    suffix = supported_suffix(path)
    with atomic_path(path) as temporary:
        temporary.write_bytes(_WRITERS[suffix](mesh, place))
    if suffix == ".obj":
        state_beside(path, place)


def write_textured(path: str | Path, textured: TexturedMesh, place: Place = UNPLACED) -> None:
    """Writes a mesh with its texture, whole or not at all; of three files, the .obj that names the others comes last.

    Args:
        path: .glb, .usdz or .obj; to the latter belong a .mtl and a .png of the same name, which are replaced too.
        textured: What to write.
        place: As of `write_mesh`.

    Raises:
        InputError: Another suffix, or a file cannot be written.
    """
    path = Path(path)
    textured_writer(path)(path, textured, place)


def textured_writer(path: Path) -> Callable[[Path, TexturedMesh, Place], None]:
    """What writes textures to files of this suffix; InputError where nothing does."""
    writers = {".obj": _write_textured_obj, ".glb": _write_textured_glb, ".usdz": _write_textured_usdz}
    if path.suffix.lower() not in writers:
        raise InputError(f"{path}: meshes with a texture end in {', '.join(writers)}")
    return writers[path.suffix.lower()]


def read_mesh(path: str | Path) -> Mesh:
    """Reads a triangle mesh; its vertices have the texture's colours where it has only that, grey where no colours.

    Args:
        path: A .ply, .obj or .glb file.

    Raises:
        InputError: Unknown suffix, no such file, not readable as that format, or no triangles in it.
    """
    part = _read(Path(path))
    return Mesh(part.vertices, part.faces, shown_colors(part))


def read_textured(path: str | Path) -> TexturedMesh | None:
    """Reads a mesh with its texture, several in one picture; None where not all of the file has one.

    Args:
        path: A .ply, .obj or .glb file.

    Raises:
        InputError: As of `read_mesh`.
    """
    part = _read(Path(path))
    return None if part.texture is None else _textured(part, part.texture)


def is_mesh_file(path: Path) -> bool:
    """Whether the suffix of a file, or the header of a PLY, says that it holds a mesh and not Gaussians."""
    if path.suffix.lower() != ".ply":
        return path.suffix.lower() in SUFFIXES
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES).partition(b"end_header")[0]
    return b"element face" in header and b"f_dc_0" not in header and b"packed_position" not in header


def _textured(part: Part, texture: np.ndarray) -> TexturedMesh:
    mesh = Mesh(part.vertices, part.faces, shown_colors(part))
    every_vertex = np.arange(mesh.num_vertices, dtype=np.int32)
    atlas = Atlas(np.asarray(part.uvs, np.float32), every_vertex, part.faces, texture.shape[1], 0)
    return TexturedMesh(mesh, atlas, texture)


def glb_bytes(path: str | Path) -> bytes:
    """The file as a GLB for a browser, with its texture or its vertex colours, and unlit: photos hold their light.

    A file that is a GLB already is left as it is.

    Args:
        path: A .ply, .obj or .glb file.

    Raises:
        InputError: As of `read_mesh`.
    """
    path = Path(path)
    part = _read(path)
    if path.suffix.lower() == ".glb":
        return path.read_bytes()
    if part.texture is None:
        return glb.encode_glb(Mesh(part.vertices, part.faces, part.colors), unlit=True)
    return glb.encode_textured(_textured(part, part.texture))


def supported_suffix(path: Path) -> str:
    """The path's suffix in lower case; InputError names the supported ones where it is none of them."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: mesh files end in {', '.join(SUFFIXES)}")
    return suffix


def _encoded_obj(mesh: Mesh, _: Place) -> bytes:
    surface = require("trimesh").Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False)
    size = spread(mesh.vertices) or 1.0
    return surface.export(file_type="obj", digits=max(DIGITS, DIGITS - math.floor(math.log10(size)))).encode()


_WRITERS = {".ply": ply.encode_mesh, ".obj": _encoded_obj, ".glb": glb.encode_glb}


def _write_textured_obj(path: Path, textured: TexturedMesh, place: Place) -> None:
    """Vertices as in the mesh, places in the texture apart from them. OBJ counts from 1 and v from below."""
    mesh, atlas = textured.mesh, textured.atlas
    material, picture = path.with_suffix(".mtl"), path.with_suffix(".png")
    corners = np.stack([mesh.faces, atlas.faces], axis=-1).reshape(-1, 6) + 1
    # Left in the opposite order: when the .obj appears, what it names is there.
    with atomic_path(path) as obj, atomic_path(material) as mtl, atomic_path(picture) as png:
        _image(textured.texture).save(png)
        mtl.write_bytes(os.fsencode(MATERIAL.format(picture=picture.name)))
        with obj.open("w", encoding="utf-8", errors="surrogateescape") as file:  # As names of files are.
            file.write(f"mtllib {material.name}\nusemtl surface\n")
            digits = " ".join([f"%.{17 if loses_in_float32(mesh.vertices) else DIGITS}g"] * 3)
            np.savetxt(file, np.hstack([mesh.vertices, mesh.colors / 255.0]), f"v {digits} %.4f %.4f %.4f")
            np.savetxt(file, atlas.uvs * [1.0, -1.0] + [0.0, 1.0], "vt %.9g %.9g")
            np.savetxt(file, corners, "f %d/%d %d/%d %d/%d")
    state_beside(path, place)


def _write_textured_glb(path: Path, textured: TexturedMesh, place: Place) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(glb.encode_textured(textured, place))


def _write_textured_usdz(path: Path, textured: TexturedMesh, place: Place) -> None:
    """One vertex a place in the texture, as in a GLB."""
    mesh, atlas, png = textured.mesh, textured.atlas, BytesIO()
    _image(textured.texture).save(png, "PNG")
    vertices, offset = glb.about_offset(mesh.vertices[atlas.vertices])
    places = atlas.uvs * [1.0, -1.0] + [0.0, 1.0]
    with atomic_path(path) as temporary:
        temporary.write_bytes(usdz.encode_usdz(vertices, atlas.faces, places, png.getvalue(), offset))
    state_beside(path, place)


def _image(pixels: np.ndarray):
    """The picture as Pillow has it."""
    from PIL import Image

    return Image.fromarray(np.ascontiguousarray(pixels))


def _read(path: Path) -> Part:
    """The triangles of a file as one part, its vertices as `as_needed`; InputError where it has none."""
    suffix = supported_suffix(path)
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    named = NamedFiles(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Of numbers that are none, which are looked for afterwards.
            parts = [_require_drawable(path, part) for part in _READERS[suffix](path, named) if len(part.faces)]
            if not parts:
                raise InputError(f"{path}: holds no triangles")
            part = merge_parts([_within_texture(part, named) for part in parts])
            return replace(
                part, vertices=as_needed(part.vertices.astype(np.float64)), faces=part.faces.astype(np.int32)
            )
    except InputError:
        raise
    except Exception as error:  # Readers raise whatever the broken bytes lead to.
        raise InputError(f"{path}: not readable as a mesh ({type(error).__name__}: {error})".splitlines()[0]) from error


def _require_drawable(path: Path, part: Part) -> Part:
    """The part itself; InputError where its triangles, or their places in a texture, cannot be drawn."""
    if part.vertices.shape[1:] != (3,):
        raise InputError(f"{path}: its vertices do not have three coordinates")
    if not 0 <= part.faces.min() <= part.faces.max() < len(part.vertices):
        raise InputError(f"{path}: a triangle of it has a vertex that is not among its {len(part.vertices)}")
    if not (fine := is_float32(part.vertices).all(axis=1)).all():
        raise InputError(f"{path}: {(~fine).sum()} of {len(fine)} vertices are not finite")
    if part.uvs is not None and (part.uvs.shape != (len(part.vertices), 2) or not is_float32(part.uvs).all()):
        raise InputError(f"{path}: places in its texture are no pairs of finite numbers")
    return part


def _within_texture(part: Part, named: NamedFiles) -> Part:
    """The part with places in 0..1; with colours of vertices, and a line, where its texture repeats too often."""
    try:
        return within_texture(part)
    except TooOftenError as error:
        named.report_missing("a texture", f"cannot be laid out ({error})")
        return replace(part, uvs=None, texture=None)


_READERS = {".ply": read_ply, ".obj": read_obj, ".glb": read_glb}
