"""OBJ files. They are read line by line: millions of lines take little more memory than the numbers in them.

A face's index of 1 means the first vertex, and -1 the last before that face; polygons are fans of triangles.
"""

import math
import os
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.files import atomic_path, read_bytes
from gsjax.io.packages import require
from gsjax.meshing.atlas import TexturedMesh
from gsjax.meshing.files.mtl import Material, read_materials
from gsjax.meshing.files.named_files import NamedFiles
from gsjax.meshing.files.parts import Part, clamp_places, split_corners, without_unused
from gsjax.scene.colors import shares, to_bytes
from gsjax.scene.georeference import Place
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import loses_in_float32, spread

_NO_COLOR = float("nan")  # of a vertex among others that have one
_NO_PLACE = 0  # Of indices, which count from 1.
_DIGITS = 9  # Significant ones of a coordinate in text: no float32 is rounded.
_MATERIAL = """newmtl surface
Ka 0 0 0
Kd 1 1 1
Ks 0 0 0
illum 1
map_Kd {picture}
"""


@dataclass
class _Content:
    """The numbers of a file, row after row."""

    positions: array = field(default_factory=lambda: array("d"))  # three a vertex
    colors: array = field(default_factory=lambda: array("f"))  # likewise, or none where no vertex has one
    places: array = field(default_factory=lambda: array("d"))  # two a place in a texture
    corners: array = field(default_factory=lambda: array("i"))  # three vertices a triangle, counted from 1
    corner_places: array = field(default_factory=lambda: array("i"))  # their places, or none where no face has any
    materials: list[tuple[str, int]] = field(default_factory=list)  # and from which triangle on each is used
    libraries: list[str] = field(default_factory=list)  # files of materials


def read_obj(path: Path, named: NamedFiles) -> list[Part]:
    """The triangles of an .obj by their materials: with a texture, with colours of vertices, or of their material's.

    Raises:
        InputError: It cannot be read, a line is none of an OBJ (its number is named), or an index is beyond its rows.
    """
    content = _content(path)
    for indices, count, what in (
        (content.corners, len(content.positions) // 3, "vertex"),
        (content.corner_places, len(content.places) // 2, "place in its texture"),
    ):
        if indices and _rows(indices, 1).max() > count:
            raise InputError(f"{path}: a triangle of it has a {what} that is not among its {count}")
    groups = _by_material(content.materials, len(content.corners) // 3)
    materials = _materials(content.libraries, named)
    parts = [_part(content, name, rows, materials, named) for name, rows in groups.items()]
    if all(part.texture is None for part in parts):
        for name, material in materials.items():
            if material.picture is not None and name.lower() not in {used.lower() for used in groups}:
                named.report_missing(material.picture, "belongs to a material of no triangle")
    return [without_unused(part) for part in parts] if len(parts) > 1 else parts


def _content(path: Path) -> _Content:
    content = _Content()
    content.materials.append(("", 0))
    for number, words in _statements(read_bytes(path).removeprefix(b"\xef\xbb\xbf")):
        try:
            if words[0] == b"v":
                _add_vertex(content, words)
            elif words[0] == b"f":
                _add_face(content, words[1:])
            elif words[0] == b"vt":
                content.places.extend((float(words[1]), float(words[2]) if len(words) > 2 else 0.0))
            elif words[0] == b"usemtl":
                content.materials.append((os.fsdecode(b" ".join(words[1:])), len(content.corners) // 3))
            elif words[0] == b"mtllib":
                content.libraries.append(os.fsdecode(b" ".join(words[1:])))
        except (ValueError, OverflowError, IndexError) as error:
            raise InputError(f"{path}, line {number}: {error}") from error
    if content.colors:
        _fill(content.colors, len(content.positions), _NO_COLOR)
    if content.corner_places:
        _fill(content.corner_places, len(content.corners), _NO_PLACE)
    return content


def _statements(text: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Number and words of each line that has some, without comments; lines that a backslash continues are one."""
    prefix = b""
    for number, line in enumerate(BytesIO(text), 1):
        if b"\\" in line and line.rstrip().endswith(b"\\"):
            prefix += line.rstrip()[:-1] + b" "
            continue
        words = (prefix + line).split()
        prefix = b""
        if b"#" in line and words[0] in (b"v", b"vt", b"f"):
            words = words[: next((at for at, word in enumerate(words) if word.startswith(b"#")), None)]
        if words:
            yield number, words


def _add_vertex(content: _Content, words: Sequence[bytes]) -> None:
    """Three coordinates, and a colour where three more numbers follow."""
    before = len(content.positions)
    content.positions.extend(map(float, words[1:4]))
    if len(content.positions) != before + 3:
        raise ValueError("a vertex does not have three coordinates")
    if len(words) > 6:
        _fill(content.colors, before, _NO_COLOR)
        content.colors.extend(map(float, words[4:7]))


def _add_face(content: _Content, corners: Sequence[bytes]) -> None:
    """A corner is a vertex, and perhaps a place in the texture behind a slash; a face has places for all or none."""
    if not corners:
        raise ValueError("a face has no corners")
    if b"/" in b"".join(corners):
        parts = [corner.split(b"/") for corner in corners]
        corners, places = [part[0] for part in parts], [part[1] if len(part) > 1 else b"" for part in parts]
        if all(places):
            _fill(content.corner_places, len(content.corners), _NO_PLACE)
            _add_fan(content.corner_places, _from_the_start(list(map(int, places)), len(content.places) // 2))
    _add_fan(content.corners, _from_the_start(list(map(int, corners)), len(content.positions) // 3))


def _add_fan(triangles: array, polygon: Sequence[int]) -> None:
    if len(polygon) == 3:
        triangles.extend(polygon)
        return
    for following, last in zip(polygon[1:], polygon[2:], strict=False):
        triangles.extend((polygon[0], following, last))


def _from_the_start(indices: list[int], count: int) -> list[int]:
    """The indices counted from 1, where there are `count` rows so far."""
    least = min(indices)
    if least == 0:
        raise ValueError("a face has an index 0; OBJ counts from 1")
    if least < -count:
        raise ValueError(f"a face has an index {least}, but only {count} come before it")
    return indices if least > 0 else [index if index > 0 else count + 1 + index for index in indices]


def _fill(values: array, length: int, value: float) -> None:
    values.extend([value] * (length - len(values)))


def _rows(values: array, width: int) -> np.ndarray:
    return np.frombuffer(values, values.typecode).reshape(-1, width) if values else np.empty((0, width))


def _by_material(materials: Sequence[tuple[str, int]], count: int) -> dict[str, np.ndarray]:
    """The rows of the triangles of each material that has some."""
    ends = [*(start for _, start in materials[1:]), count]
    runs: dict[str, list[np.ndarray]] = {}
    for (name, start), end in zip(materials, ends, strict=True):
        if end > start:
            runs.setdefault(name, []).append(np.arange(start, end))
    return {name: np.concatenate(rows) for name, rows in runs.items()}


def _materials(libraries: Sequence[str], named: NamedFiles) -> dict[str, Material]:
    """The materials of all files that are there, by name, and by name in lower case. A line may list several files."""
    files: list[Path | None] = []
    for library in libraries:
        several = [] if named.has(library) else library.split()
        files += [named.find(name) for name in (several if any(map(named.has, several)) else [library])]
    materials: dict[str, Material] = {}
    for file in files:
        materials |= {} if file is None else read_materials(file)
    return {name.lower(): material for name, material in materials.items()} | materials


def _part(content: _Content, name: str, rows: np.ndarray, materials: dict[str, Material], named: NamedFiles) -> Part:
    """The triangles `rows` of one material."""
    vertices, faces = _rows(content.positions, 3), _rows(content.corners, 3)[rows] - 1
    places, face_places = _rows(content.places, 2), _rows(content.corner_places, 3)
    material = materials.get(name) or materials.get(name.lower())
    if material is None and name and not content.colors and (materials or not content.libraries):
        named.report_missing(name, "is in none of its files of materials")
    texture = None
    if material is not None and material.picture is not None:
        if len(face_places):
            texture = named.texture(material.picture)
        else:
            named.report_missing(material.picture, "has no places for its triangles")
    color = Material.color if material is None else material.color
    if material is not None and texture is not None:
        places = np.concatenate([np.zeros((1, 2)), places * material.scale + material.origin]) * [1, -1] + [0, 1]
        if material.is_clamped:
            sides = texture.shape[1::-1]
            places = np.stack([clamp_places(places[:, axis], sides[axis]) for axis in (0, 1)], axis=1)
        vertices, faces, uvs = split_corners(vertices, faces, places, face_places[rows])
        return Part(vertices, faces, np.full(vertices.shape, color, np.uint8), uvs, texture)
    if content.colors:
        return Part(vertices, faces, to_bytes(shares(_rows(content.colors, 3))))
    return Part(vertices, faces, np.full(vertices.shape, color, np.uint8))


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
