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
from io import BytesIO
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import ply
from gsjax.io.files import atomic_path
from gsjax.io.place_files import state_beside
from gsjax.mesh import Mesh
from gsjax.meshing import glb, usdz
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.libraries import load_trimesh
from gsjax.meshing.named_files import NamedFiles
from gsjax.meshing.obj import read_obj
from gsjax.meshing.part_colors import has_picture, merge_parts, parts_of, picture_pixels, sample_texture
from gsjax.place import UNPLACED, Place
from gsjax.similarity import as_needed, is_float32, loses_in_float32, spread

SUFFIXES = (".ply", ".obj", ".glb")
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
    surface = _loaded(Path(path))
    return Mesh(*_triangles(surface), _vertex_colors(surface))


def read_textured(path: str | Path) -> TexturedMesh | None:
    """Reads a mesh with its texture; None where the file has none.

    Args:
        path: A .ply, .obj or .glb file.

    Raises:
        InputError: As of `read_mesh`.
    """
    surface = _loaded(Path(path))
    picture = _picture(surface)
    if picture is None:
        return None
    vertices, faces = _triangles(surface)
    atlas = Atlas(_uvs(surface), np.arange(len(vertices), dtype=np.int32), faces, picture.shape[1], 0)
    return TexturedMesh(Mesh(vertices, faces, _vertex_colors(surface)), atlas, picture)


def glb_bytes(path: str | Path) -> bytes:
    """The file as a GLB for a browser, with its texture or its vertex colours, and unlit: photos hold their light.

    A file that is a GLB already is left as it is.

    Args:
        path: A .ply, .obj or .glb file.

    Raises:
        InputError: As of `read_mesh`.
    """
    path = Path(path)
    surface = _loaded(path)
    if path.suffix.lower() == ".glb":
        return path.read_bytes()

    if _picture(surface) is None:
        return glb.encode_glb(Mesh(*_triangles(surface), _vertex_colors(surface)), unlit=True)
    surface.vertices, offset = glb.about_offset(np.asarray(surface.vertices))

    def completed(tree: dict) -> None:
        glb.mark_unlit(tree)
        glb.shift_meshes(tree, offset)

    with np.errstate(over="ignore"):  # Of what a file holds beside its triangles.
        return surface.export(file_type="glb", tree_postprocessor=completed)


def supported_suffix(path: Path) -> str:
    """The path's suffix in lower case; InputError names the supported ones where it is none of them."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: mesh files end in {', '.join(SUFFIXES)}")
    return suffix


def _encoded_obj(mesh: Mesh, _: Place) -> bytes:
    surface = load_trimesh().Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False)
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
    """One vertex a place in the texture. Unlit, as photos hold their light already."""
    mesh, atlas = textured.mesh, textured.atlas
    trimesh = load_trimesh()
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=_image(textured.texture), metallicFactor=0.0, roughnessFactor=1.0
    )
    visual = trimesh.visual.TextureVisuals(uv=atlas.uvs * [1.0, -1.0] + [0.0, 1.0], material=material)
    vertices, offset = glb.about_offset(mesh.vertices[atlas.vertices])
    surface = trimesh.Trimesh(vertices, atlas.faces, visual=visual, process=False)

    def completed(tree: dict) -> None:
        glb.mark_unlit(tree)
        glb.shift_meshes(tree, offset)
        glb.state_place(tree, place)

    with atomic_path(path) as temporary:
        temporary.write_bytes(surface.export(file_type="glb", include_normals=False, tree_postprocessor=completed))


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


def _loaded(path: Path):
    """The file as one trimesh with vertices in their order; InputError where it is none."""
    suffix = supported_suffix(path)
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    trimesh = load_trimesh()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Of numbers that are none, which are looked for afterwards.
            if suffix == ".glb" and (unread := glb.unread_part(path.read_bytes())):
                raise InputError(f"{path}: {unread}")
            named = NamedFiles(path)
            if suffix == ".obj":
                scene = trimesh.Scene(read_obj(path, named.get))
            else:
                kept = {"force": "scene", "process": False, "maintain_order": True}
                scene = trimesh.load(path, file_type=suffix[1:], resolver=named, **kept)
            surface = _as_one(path, scene)
            vertices, faces = _triangles(surface)
    except InputError:
        raise
    except Exception as error:  # Readers raise whatever the broken bytes lead to.
        raise InputError(f"{path}: not readable as a mesh ({type(error).__name__}: {error})".splitlines()[0]) from error
    if (fault := _fault(vertices, faces, np.asarray(surface.visual.uv) if has_picture(surface) else None)) is not None:
        raise InputError(f"{path}: {fault}")
    return surface


def _fault(vertices: np.ndarray, faces: np.ndarray, uvs: np.ndarray | None) -> str | None:
    """What keeps triangles, or their places in a texture, from being drawn; None: nothing."""
    if not len(faces):
        return "holds no triangles"
    if vertices.shape[1:] != (3,):
        return "its vertices do not have three coordinates"
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        return f"a triangle of it has a vertex that is not among its {len(vertices)}"
    if not (fine := is_float32(vertices).all(axis=1)).all():
        return f"{(~fine).sum()} of {len(fine)} vertices are not finite"
    if uvs is not None and (uvs.shape[1] < 2 or not is_float32(uvs).all()):
        return "places in its texture are no pairs of finite numbers"
    return None


def _as_one(path: Path, scene):
    """The parts of a file as one trimesh, with the texture where all of them have one, else with vertex colours."""
    parts, is_glb = parts_of(scene), path.suffix.lower() == ".glb"
    if not parts:
        raise InputError(f"{path}: holds no triangles")
    if all(has_picture(part) for part in parts):
        return scene.to_mesh()
    surface = parts[0]
    if is_glb and len(parts) == 1 and (colors := glb.vertex_colors(path.read_bytes())) is not None:
        surface.visual = load_trimesh().visual.ColorVisuals(surface, vertex_colors=colors)
        return surface
    if is_glb or len(parts) > 1 or surface.visual.kind in ("face", "texture"):
        return merge_parts(parts, linear=is_glb)
    if path.suffix.lower() == ".ply" and (colors := ply.read_vertex_colors(path)) is not None:
        surface.visual.vertex_colors = colors
    return surface


def _triangles(surface) -> tuple[np.ndarray, np.ndarray]:
    """`[V, 3]` vertices, float64 where float32 would lose their place, and `[F, 3]` int32 faces."""
    return as_needed(np.asarray(surface.vertices, np.float64)), np.asarray(surface.faces, np.int32)


def _vertex_colors(surface) -> np.ndarray:
    """`[V, 3]` uint8."""
    if surface.visual.kind == "vertex":
        return np.asarray(surface.visual.vertex_colors[:, :3], np.uint8)
    if has_picture(surface):
        return sample_texture(surface)
    return np.full((len(surface.vertices), 3), 128, np.uint8)


def _uvs(surface) -> np.ndarray:
    """`[V, 2]` float32 places in the texture, y down; trimesh counts from below."""
    return (np.asarray(surface.visual.uv, np.float64) * [1, -1] + [0, 1]).astype(np.float32)


def _picture(surface) -> np.ndarray | None:
    """`[H, W, 3]` uint8 texture, if there is one and every vertex has its place in it."""
    return picture_pixels(surface) if has_picture(surface) else None
