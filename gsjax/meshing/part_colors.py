"""Colours that a mesh file gives to parts or to faces, as colours of vertices."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gsjax.colors import srgb_to_linear
from gsjax.meshing import glb
from gsjax.meshing.libraries import load_trimesh

Part = Any  # trimesh.Trimesh
_GREY = 128  # of what has no colour


def parts_of(scene) -> list[Part]:
    """The meshes of a `trimesh.Scene`, each where its node places it; those that stand there already are its own."""
    parts = []
    for part in scene.geometry.values():
        part.metadata.pop("_ply_raw", None)  # All of the file once more.
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        if not hasattr(part, "faces"):
            continue
        if not np.array_equal(transform, np.eye(4)):
            part = part.copy()
            part.apply_transform(transform)
        parts.append(part)
    return parts


def has_picture(part: Part) -> bool:
    """Whether a part has a texture, and places in it."""
    return part.visual.kind == "texture" and part.visual.uv is not None and picture_of(part) is not None


def picture_of(part: Part) -> Any:
    """The picture of a part's material, as Pillow has it; None of none."""
    material = getattr(part.visual, "material", None)
    return getattr(material, "baseColorTexture", None) or getattr(material, "image", None)


def picture_pixels(part: Part) -> np.ndarray:
    """`[H, W, 3]` uint8, the picture of a part's material, in glTF times the light of its factor."""
    pixels = np.asarray(picture_of(part).convert("RGB"))
    factor = getattr(part.visual.material, "baseColorFactor", None)
    if factor is None or (np.asarray(factor)[:3] == 255).all():
        return pixels
    return glb.srgb_bytes(srgb_to_linear(pixels / np.float32(255)) * (np.asarray(factor)[:3] / np.float32(255)))


def merge_parts(parts: Sequence[Part], *, linear: bool) -> Part:
    """The parts as one mesh with colours of vertices; vertices between faces of other colours are doubled.

    Args:
        parts: At least one.
        linear: Whether colours of vertices and materials are light, as in glTF, and not sRGB.
    """
    parts = [_split_by_face_colors(part) for part in parts]
    vertices = np.concatenate([np.asarray(part.vertices) for part in parts])
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = np.concatenate([np.asarray(part.faces) + start for part, start in zip(parts, starts, strict=True)])
    colors = np.concatenate([_colors(part, linear) for part in parts])
    return load_trimesh().Trimesh(vertices, faces, vertex_colors=colors, process=False)


def sample_texture(part: Part) -> np.ndarray:
    """`[V, 3]` uint8, the texture at each vertex."""
    picture = picture_pixels(part)
    uvs = np.asarray(part.visual.uv, np.float64) * [1, -1] + [0, 1]  # trimesh counts from below.
    columns, rows = np.floor(uvs.astype(np.float32) % 1 * picture.shape[1::-1]).astype(np.int64).T
    return picture[np.minimum(rows, len(picture) - 1), np.minimum(columns, picture.shape[1] - 1)]


def _colors(part: Part, linear: bool) -> np.ndarray:
    if part.visual.kind == "vertex":
        return _srgb(np.asarray(part.visual.vertex_colors)[:, :3], linear)
    if has_picture(part):
        return sample_texture(part)
    material = getattr(part.visual, "material", None)
    color = getattr(material, "baseColorFactor", None)
    color = getattr(material, "diffuse", None) if color is None else color
    if color is None:
        color = np.full(3, 255 if linear and material is not None else _GREY, np.uint8)
    colors = np.tile(np.asarray(color)[:3], (len(part.vertices), 1))
    beside = getattr(part.visual, "vertex_attributes", {}).get("color")
    if beside is not None:  # Of a GLB's part, which trimesh keeps beside its material, as they are stored.
        colors = colors * (beside[:, :3] / (1 if beside.dtype.kind == "f" else np.iinfo(beside.dtype).max))
    return _srgb(colors, linear and material is not None)


def _srgb(colors: np.ndarray, linear: bool) -> np.ndarray:
    return glb.srgb_bytes(colors / 255) if linear else colors.astype(np.uint8)


def _split_by_face_colors(part: Part) -> Part:
    """The same mesh with colours of vertices, where it has colours of faces."""
    if part.visual.kind != "face":
        return part
    faces = np.asarray(part.faces)
    colors = np.repeat(np.asarray(part.visual.face_colors)[:, :3].astype(np.int64), 3, axis=0)
    pairs, corners = np.unique(np.column_stack([faces.ravel(), colors]), axis=0, return_inverse=True)
    vertices = np.asarray(part.vertices)[pairs[:, 0]]
    return load_trimesh().Trimesh(
        vertices, corners.reshape(-1, 3), vertex_colors=pairs[:, 1:].astype(np.uint8), process=False
    )
