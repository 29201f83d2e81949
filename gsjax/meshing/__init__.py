"""Meshes out of Gaussians: reconstruction, cleaning, files, pictures. Open3D and trimesh load where they are used."""

from typing import Any

__all__ = ["read_mesh", "write_mesh"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Loads what reads and writes files on first use: the table of methods is read without jax."""
    if name not in __all__:
        raise AttributeError(f"module 'gsjax.meshing' has no attribute '{name}'")
    from gsjax.meshing import export

    return getattr(export, name)
