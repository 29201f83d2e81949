"""Meshes out of Gaussians: reconstruction, cleaning, files, pictures. Open3D and trimesh load where they are used."""

from gsjax.meshing.cleaning import CleaningReport, clean
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.meshing.extract import extract_mesh
from gsjax.meshing.pictures import depth_of_mesh, headlight, normal_colors, render_mesh, vertex_colors

__all__ = [
    "CleaningReport",
    "clean",
    "depth_of_mesh",
    "extract_mesh",
    "headlight",
    "normal_colors",
    "read_mesh",
    "render_mesh",
    "vertex_colors",
    "write_mesh",
]
