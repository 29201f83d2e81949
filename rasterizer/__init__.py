"""A differentiable Gaussian rasterizer in JAX: arrays in, images out."""

from rasterizer.api import TILE_SIZE, blend, capacity_bucket, rasterization
from rasterizer.binning import TileGrid, TilePairs, bin_splats, count_pairs
from rasterizer.harmonics import spherical_harmonics
from rasterizer.projection import Projection, project
from rasterizer.rules import GSPLAT, INRIA, Rules

__all__ = [
    "GSPLAT",
    "INRIA",
    "Projection",
    "TILE_SIZE",
    "Rules",
    "TileGrid",
    "TilePairs",
    "bin_splats",
    "blend",
    "capacity_bucket",
    "count_pairs",
    "project",
    "rasterization",
    "spherical_harmonics",
]
