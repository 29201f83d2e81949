"""Coloured triangles as a binary PLY."""

import numpy as np

from gsjax.mesh import Mesh
from gsjax.similarity import loses_in_float32


def encode_ply(mesh: Mesh) -> bytes:
    """The file: vertices with their colours, then faces. Positions are double where float would lose their place."""
    kind, stored = ("double", "<f8") if loses_in_float32(mesh.vertices) else ("float", "<f4")
    vertices = np.empty(mesh.num_vertices, [("position", stored, 3), ("color", "u1", 3)])
    vertices["position"], vertices["color"] = mesh.vertices, mesh.colors
    faces = np.empty(mesh.num_faces, [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property {kind} {axis}" for axis in "xyz"),
        *(f"property uchar {channel}" for channel in ("red", "green", "blue")),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    return "\n".join(header).encode() + vertices.tobytes() + faces.tobytes()
