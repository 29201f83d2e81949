"""Meshes out of Gaussians: reconstruction, cleaning, files, pictures. Open3D and trimesh load where they are used."""

from gsjax.meshing.cleaning import CleaningReport, clean
from gsjax.meshing.export import read_mesh, read_textured, write_mesh, write_textured
from gsjax.meshing.extract import extract_mesh
from gsjax.meshing.pictures import depth_of_mesh, headlight, normal_colors, render_mesh, vertex_colors
from gsjax.meshing.texture import texture_mesh

__all__ = [
    "CleaningReport",
    "clean",
    "depth_of_mesh",
    "extract_mesh",
    "headlight",
    "normal_colors",
    "read_mesh",
    "read_textured",
    "render_mesh",
    "texture_mesh",
    "vertex_colors",
    "write_mesh",
    "write_textured",
]
