"""A differentiable Gaussian rasterizer in JAX: arrays in, images out."""

from rasterizer.api import rasterization
from rasterizer.binning import TileGrid, TilePairs, bin_splats, count_pairs
from rasterizer.capacity import capacity_bucket
from rasterizer.covariances import quat_scale_to_covar_preci
from rasterizer.engines import blend, default_tile_size
from rasterizer.harmonics import spherical_harmonics
from rasterizer.normals import camera_normals
from rasterizer.projection import Projection, project
from rasterizer.rules import GSPLAT, INRIA, Rules

__all__ = [
    "GSPLAT",
    "INRIA",
    "Projection",
    "Rules",
    "TileGrid",
    "TilePairs",
    "bin_splats",
    "blend",
    "camera_normals",
    "capacity_bucket",
    "count_pairs",
    "project",
    "quat_scale_to_covar_preci",
    "rasterization",
    "spherical_harmonics",
    "default_tile_size",
]
