"""OBJ files: trimesh reads them. What it would read wrong is refused, and what it leaves out is reported.

A face's index of 1 means the first vertex, and -1 the last before that face; polygons are fans of triangles.
"""

import math
import os
import re
import warnings
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io.files import atomic_path, read_bytes
from gsjax.io.machine import require_memory
from gsjax.io.packages import require
from gsjax.meshing.atlas import TexturedMesh
from gsjax.meshing.files.named_files import NamedFiles
from gsjax.meshing.files.parts import GREY, Part, from_above
from gsjax.scene.colors import shares, to_bytes
from gsjax.scene.georeference import Place
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import loses_in_float32, spread

_DIGITS = 9  # Significant ones of a coordinate in text: no float32 is rounded.
_COPIES = 13  # Bytes for each of a file, while trimesh reads it: the most of three measured files.
_MATERIAL = """newmtl surface
Ka 0 0 0
Kd 1 1 1
Ks 0 0 0
illum 1
map_Kd {picture}
"""


def _without_comment(match: re.Match[str]) -> str:
    """Return nothing for a comment behind numbers, and what may be part of a name as it is."""
    line = match.string.rfind("\n", 0, match.start()) + 1
    return "" if match.string.startswith(("v ", "vt ", "f "), line) else match[0]


_CLEANED = (  # What trimesh would read wrong, and its replacement.
    (r"\t|\\\r?\n", " "),  # A backslash continues a line.
    (r"\r?\n *", "\n"),
    (r"\n#.*", ""),
    (r" #.*", _without_comment),
    (r"//-?\d+|/(?=[ \n])", ""),  # Normals without places in a texture would be read as places after faces with these.
)


def read_obj(path: Path, named: NamedFiles) -> list[Part]:
    """The triangles of an .obj by their materials: with a texture, with colours of vertices, or of their material's.

    Raises:
        InputError: It cannot be read, or lists faces that trimesh would take for other ones.
        ValueError, LookupError, TypeError: It is damaged.
    """
    content = read_bytes(path)
    require_memory(f"{path}: an OBJ of {len(content) / 2**30:.3g} GiB", _COPIES * len(content))
    text = "\n" + content.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "surrogateescape") + "\n"
    for pattern, replacement in _CLEANED:
        text = re.sub(pattern, replacement, text)
    if wrong := re.search(r"\nf.*[ /]-?0+[ /\n]|\nf(?: +\S+){0,2} *\n", text):
        raise InputError(f"{path}: {wrong[0].strip()!r} is no face: three corners or more, counted from 1")
    if (relative := re.search(r"\nf.*[ /]-", text)) and re.search(r"\nvt? ", text[relative.end() :]):
        raise InputError(f"{path}: has vertices behind faces that count from the last; save it with indices from 1")
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "string or file could not be read")  # Else the rest of the file is left out.
        loaded = list(require("trimesh").exchange.obj.load_obj(StringIO(text), named).get("geometry", {}).values())
    parts = [_part(each, named) for each in loaded]
    triangles = sum(len(line.split()) - 3 for line in re.findall(r"\nf.*", text))
    if triangles != (count := sum(len(part.faces) for part in parts)):
        raise InputError(f"{path}: lists faces of {triangles} triangles, of which {count} can be read")
    colored = any("vertex_colors" in each for each in loaded)
    if not colored and re.search(r"\nv(?: +\S+){6}", text):
        named.report_missing("colours of vertices", "are not those of all vertices")
    pairs = zip(loaded, parts, strict=True)
    textured = [each["visual"].material.name for each, part in pairs if part.texture is not None]
    _report_unread(text, textured, named, colored=colored)
    return parts


def _part(loaded: dict[str, Any], named: NamedFiles) -> Part:
    """The triangles of one material."""
    vertices, faces = loaded["vertices"], require("trimesh").geometry.triangulate_quads(loaded["faces"])
    material, uvs = getattr(loaded["visual"], "material", None), getattr(loaded["visual"], "uv", None)
    texture = named.pixels(getattr(material, "image", None))
    if uvs is not None and texture is not None:
        return Part(vertices, faces, np.full(vertices.shape, GREY, np.uint8), from_above(uvs), texture)
    if "vertex_colors" in loaded:
        return Part(vertices, faces, to_bytes(shares(loaded["vertex_colors"])))
    color = getattr(material, "kwargs", {}).get("kd", GREY / 255)
    return Part(vertices, faces, np.broadcast_to(to_bytes(np.array(color, np.float64)), vertices.shape))


def _report_unread(text: str, textured: Sequence[str], named: NamedFiles, *, colored: bool) -> None:
    """Report each file, material and picture that the file lists and that gives no colours.

    The materials `textured` have their pictures. Where vertices are `colored`, no material needs to be there.
    """
    libraries, used = re.findall(r"\nmtllib (.*)", text), set(re.findall(r"\nusemtl (.*)", text))
    for library in libraries[1:]:
        named.report_missing(library, "is not read after the first")
    materials = named.text(libraries[0]) if libraries else ""
    blocks = {block.split("\n")[0].strip(): block for block in re.split(r"(?i)(?:^|\n)\s*newmtl\s", materials)[1:]}
    for name in sorted(used - blocks.keys()) if not colored and (materials or not libraries) else ():
        named.report_missing(name, "is in none of its files of materials")
    for name in sorted(blocks.keys() - set(textured)):
        maps = re.findall(r"(?mi)^\s*map_k([dae])\s+(.*\S)", blocks[name])
        for picture in [picture for _, picture in sorted(maps, key=lambda each: each[0] not in "dD")][:1]:
            if name in used:
                named.report_picture(picture)
            elif not textured:
                named.report_missing(picture, "belongs to a material of no triangle")


def encode_obj(mesh: Mesh, _: Place) -> bytes:
    """Return a mesh with vertex colours as the text of an OBJ."""
    surface = require("trimesh").Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False)
    size = spread(mesh.vertices) or 1.0
    return surface.export(file_type="obj", digits=max(_DIGITS, _DIGITS - math.floor(math.log10(size)))).encode()


def write_textured_obj(path: Path, textured: TexturedMesh) -> None:
    """Write an OBJ with vertices as in the mesh and places in the texture apart, its MTL and its PNG."""
    from PIL import Image

    mesh, atlas = textured.mesh, textured.atlas
    material, picture = path.with_suffix(".mtl"), path.with_suffix(".png")
    corners = np.stack([mesh.faces, atlas.faces], axis=-1).reshape(-1, 6) + 1
    # Left in the opposite order: when the .obj appears, what it names is there.
    with atomic_path(path) as obj, atomic_path(material) as mtl, atomic_path(picture) as png:
        Image.fromarray(np.ascontiguousarray(textured.texture)).save(png)
        mtl.write_bytes(os.fsencode(_MATERIAL.format(picture=picture.name)))
        with obj.open("w", encoding="utf-8", errors="surrogateescape") as file:  # As names of files are.
            file.write(f"mtllib {material.name}\nusemtl surface\n")
            digits = " ".join([f"%.{17 if loses_in_float32(mesh.vertices) else _DIGITS}g"] * 3)
            np.savetxt(file, np.hstack([mesh.vertices, mesh.colors / 255.0]), f"v {digits} %.4f %.4f %.4f")
            np.savetxt(file, atlas.uvs * [1.0, -1.0] + [0.0, 1.0], "vt %.9g %.9g")
            np.savetxt(file, corners, "f %d/%d %d/%d %d/%d")
