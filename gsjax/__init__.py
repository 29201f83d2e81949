"""Photos to 3D Gaussians to a clean mesh, as pure functions over pytrees.

These names are the public API; `docs/api.md` lists them. What they do not name is private and may change.
"""

import importlib
from typing import Any

HOMES = {
    # Records.
    "Camera": "scene.cameras",
    "Effect": "effects.simulation",
    "Frame": "scene",
    "Gaussians": "gaussians",
    "InputError": "errors",
    "Mesh": "scene.meshes",
    "Scene": "scene",
    "Term": "training.terms",
    "TrainState": "training.state",
    "Truth": "scene",
    "View": "rendering.viewing",
    # Files.
    "load_gaussians": "io.gaussian_files",
    "load_scene": "io.scenes",
    "read_mesh": "meshing.export",
    "read_views": "io.views",
    "save_gaussians": "io.gaussian_files",
    "write_built_in_scene": "io.analytic_scene",
    "write_mesh": "meshing.export",
    # Rendering, and the paper's regulariser.
    "align_normals": "training.terms",
    "depth_sdf": "normals.sdf",
    "opacities": "gaussians",
    "pixel_rays": "scene.cameras",
    "psnr": "metrics.images",
    "render": "rendering.viewing",
    "scales": "gaussians",
    "sdf_gradient": "normals.sdf",
    "ssim": "metrics.images",
    # A training loop of one's own.
    "DENSIFICATION_RULES": "training.densification.rules",
    "adam": "training.trainer",
    "densification": "training.trainer",
    "densify": "training.trainer",
    "from_points": "training.initialize",
    "init": "training.trainer",
    "train_step": "training.trainer",
    "zero_moments": "training.optimizers",
    # What the commands do.
    "extract_mesh": "meshing.extract",
    "mesh": "pipeline.mesh",
    "preset": "presets",
    "refine": "pipeline.refine",
    "scan": "pipeline.scan",
    "train": "pipeline.train",
}

__all__ = list(HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Loads a name's module on first use: the command line answers, and sets jax's environment, before jax loads."""
    if name not in HOMES:
        raise AttributeError(f"module 'gsjax' has no attribute '{name}'")
    return getattr(importlib.import_module(f"gsjax.{HOMES[name]}"), name)
