"""Where every triangle of a mesh is in a square texture.

Two ways of one signature: `charts` unfolds connected pieces (xatlas), `cells` gives every triangle half a square of
its own, at once whatever the size of the mesh, but with seams everywhere. `unwrap` takes charts where it can.
"""

import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.scene.meshes import Mesh, face_area_vectors

PADDING = 4  # Texels between charts.
LEAST_PADDING = 2  # Of which so many must be left where the charts are shrunk to fit.
MOST_CHARTED_FACES = 1_500_000  # A million take xatlas two minutes on 2 cores.
MOST_SECONDS = 900.0
SMALLEST_CELL = 4  # Texels; see `cells`.
SMALLEST_AREA = 1e-3  # Texels squared; a triangle below has one colour.
XATLAS_PROCESS = Path(__file__).with_name("xatlas_process.py")


@dataclass(frozen=True)
class Atlas:
    """U places in the texture, of which a vertex at a seam has several."""

    uvs: np.ndarray  # [U, 2] float32, 0..1: x to the right, y down, from the upper left corner of the picture
    vertices: np.ndarray  # [U] int32 the mesh's vertex at each place
    faces: np.ndarray  # [F, 3] int32 rows of uvs, in the order of the mesh's faces
    size: int  # side of the texture, texels
    num_charts: int  # pieces that are apart


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh and the picture on it."""

    mesh: Mesh
    atlas: Atlas
    texture: np.ndarray  # [H, W, 3] uint8 sRGB


def unwrap(mesh: Mesh, size: int) -> Atlas:
    """Charts in a square of `size` texels; cells for more than 1.5 million triangles, and where there are no charts.

    Triangles without area are welcome.

    Raises:
        InputError: The texture has no room for so many triangles.
    """
    atlas = charts(mesh, size) if mesh.num_faces <= MOST_CHARTED_FACES else None
    return cells(mesh, size) if atlas is None else atlas


def charts(mesh: Mesh, size: int) -> Atlas | None:
    """Connected pieces, unfolded with little distortion and packed about `PADDING` texels apart.

    None where xatlas is absent, crashes or takes longer than a quarter of an hour, or the texture is too small.
    """
    areas = np.linalg.norm(face_area_vectors(mesh), axis=1)
    solid = np.flatnonzero(areas > 0)
    if not len(solid):
        return None
    # xatlas compares areas with absolute bounds: the mean triangle gets area 1.
    scaled = (mesh.vertices - mesh.vertices.mean(axis=0)) / np.sqrt(areas[solid].mean())
    arrays = _unfolded(scaled.astype(np.float32), mesh.faces[solid], size)
    if arrays is None:
        return None
    extent = np.array([arrays["width"], arrays["height"]], np.float64)
    if PADDING * size / extent.max() < LEAST_PADDING:
        return None
    faces = np.zeros((mesh.num_faces, 3), np.int32)
    faces[solid] = arrays["faces"]
    laid_out = Atlas(
        uvs=(arrays["uvs"] * (extent / extent.max())).astype(np.float32),
        vertices=arrays["vertices"].astype(np.int32),
        faces=faces,
        size=size,
        num_charts=int(arrays["charts"]),
    )
    return _flat_faces_at_a_corner(laid_out, mesh)


def cells(mesh: Mesh, size: int) -> Atlas:
    """Two triangles a square cell, each as large as its neighbours' texels allow.

    Corners are on centres of texels, and the legs of the two right triangles are 3 texels shorter than the cell: what
    bilinear sampling reads inside a triangle belongs to that triangle alone. Four texels are the smallest such cell.

    Raises:
        InputError: The cells would be smaller.
    """
    per_axis = int(np.ceil(np.sqrt(np.ceil(mesh.num_faces / 2))))
    side = size // per_axis
    if side < SMALLEST_CELL:
        raise InputError(
            f"a texture of {size} px has no room for {mesh.num_faces} triangles: it takes "
            f"{SMALLEST_CELL * per_axis} px, or a mesh of at most {2 * (size // SMALLEST_CELL) ** 2} triangles"
        )
    index = np.arange(mesh.num_faces)
    rows, columns = np.divmod(index // 2, per_axis)
    lower = 0.5 + (side - 3) * np.array([[0, 0], [1, 0], [0, 1]])
    corners = np.where((index % 2 == 0)[:, None, None], lower, side - lower)
    texels = corners + side * np.stack([columns, rows], axis=-1)[:, None]
    return Atlas(
        uvs=(texels.reshape(-1, 2) / size).astype(np.float32),
        vertices=mesh.faces.reshape(-1),
        faces=np.arange(3 * mesh.num_faces, dtype=np.int32).reshape(-1, 3),
        size=size,
        num_charts=mesh.num_faces,
    )


def texel_corners(atlas: Atlas) -> np.ndarray:
    """`[F, 3, 2]` float64 corners of every triangle in texels; centres of texels are at +0.5."""
    return atlas.uvs.astype(np.float64)[atlas.faces] * atlas.size


def doubled_areas(corners: np.ndarray) -> np.ndarray:
    """`[F]` twice the signed area of triangles with corners `[F, 3, 2]`."""
    (x1, y1), (x2, y2) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return x1 * y2 - x2 * y1


def _unfolded(vertices: np.ndarray, faces: np.ndarray, size: int) -> dict[str, np.ndarray] | None:
    """What `xatlas_process.py` writes, if anything; a process of its own, as a crash of xatlas ends its process."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "mesh.npz"), Path(folder, "atlas.npz")
        np.savez(source, vertices=vertices, faces=faces.astype(np.uint32), size=size, padding=PADDING)
        command = [sys.executable, str(XATLAS_PROCESS), str(source), str(target)]
        try:
            done = subprocess.run(command, capture_output=True, timeout=MOST_SECONDS)
        except subprocess.TimeoutExpired:
            return None
        if done.returncode or not target.exists():
            return None
        with np.load(target) as arrays:
            return dict(arrays)


def _flat_faces_at_a_corner(atlas: Atlas, mesh: Mesh) -> Atlas:
    """Triangles without area in the texture are moved to one point: where a corner of theirs is painted."""
    is_flat = np.abs(doubled_areas(texel_corners(atlas))) < 2 * SMALLEST_AREA
    painted = atlas.faces[~is_flat].ravel()
    if not is_flat.any() or not len(painted):
        return atlas
    place = np.full(mesh.num_vertices, painted[0])
    place[atlas.vertices[painted]] = painted
    corners = mesh.faces[is_flat]
    points = np.repeat(place[corners[:, 0]], 3)
    faces = atlas.faces.copy()
    faces[is_flat] = len(atlas.uvs) + np.arange(corners.size, dtype=np.int32).reshape(-1, 3)
    return replace(
        atlas,
        uvs=np.concatenate([atlas.uvs, atlas.uvs[points]]),
        vertices=np.concatenate([atlas.vertices, corners.ravel()]).astype(np.int32),
        faces=faces,
    )
