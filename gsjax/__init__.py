"""Photos to 3D Gaussians to a clean mesh, as pure functions over pytrees.

The records are re-exported here; the functions are in the modules that name their subject (`gsjax.cameras`,
`gsjax.render`, ...), what the command line does in `gsjax.pipeline`, files in `gsjax.io`, meshes in `gsjax.meshing`.
"""

import importlib
from typing import Any

_HOMES = {
    "Camera": "cameras",
    "Frame": "scene",
    "Gaussians": "gaussians",
    "InputError": "errors",
    "Mesh": "mesh",
    "Scene": "scene",
    "Truth": "scene",
    "load_gaussians": "io.gaussian_files",
    "save_gaussians": "io.gaussian_files",
}

__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Loads a record's module on first use: the command line answers, and sets jax's environment, before jax loads."""
    if name not in _HOMES:
        raise AttributeError(f"module 'gsjax' has no attribute '{name}'")
    return getattr(importlib.import_module(f"gsjax.{_HOMES[name]}"), name)
