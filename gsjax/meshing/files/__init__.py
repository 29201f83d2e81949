"""Mesh files, one format a module: its triangles as `Part`s on the way in, its bytes on the way out."""
