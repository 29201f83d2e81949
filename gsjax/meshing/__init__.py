"""Meshes out of Gaussians: reconstruction, cleaning, files, pictures. Open3D and trimesh load where they are used."""
