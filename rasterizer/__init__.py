"""A differentiable Gaussian rasterizer in JAX: arrays in, images out."""

from rasterizer.api import rasterization
from rasterizer.binning import TileGrid, TilePairs, count_pairs
from rasterizer.capacity import capacity_bucket, count_capacity
from rasterizer.compositing import Front
from rasterizer.covariances import quat_scale_to_covar_preci
from rasterizer.engines import Backend, bin_splats, blend, default_tile_size, lists_by_itself, prepare
from rasterizer.ewa import DepthMode, Projection
from rasterizer.features import blended_depth, camera_normals, depth_channels, median_depth
from rasterizer.gsplat import (
    fully_fused_projection,
    isect_offset_encode,
    isect_tiles,
    proj,
    rasterize_to_pixels,
    world_to_cam,
)
from rasterizer.harmonics import (
    spherical_harmonics,
    spherical_harmonics_l0,
    spherical_harmonics_l1_plus,
    upper_bands,
)
from rasterizer.projection import project
from rasterizer.rules import GSPLAT, GSPLAT_1_5, INRIA, SMOOTH, Rules
from rasterizer.updates import Moments, adam, all_finite

__all__ = [
    "GSPLAT",
    "GSPLAT_1_5",
    "INRIA",
    "SMOOTH",
    "Backend",
    "DepthMode",
    "Front",
    "Moments",
    "Projection",
    "Rules",
    "TileGrid",
    "TilePairs",
    "adam",
    "all_finite",
    "bin_splats",
    "blend",
    "blended_depth",
    "camera_normals",
    "capacity_bucket",
    "count_capacity",
    "count_pairs",
    "default_tile_size",
    "depth_channels",
    "fully_fused_projection",
    "isect_offset_encode",
    "isect_tiles",
    "lists_by_itself",
    "median_depth",
    "prepare",
    "proj",
    "project",
    "quat_scale_to_covar_preci",
    "rasterization",
    "rasterize_to_pixels",
    "spherical_harmonics",
    "spherical_harmonics_l0",
    "spherical_harmonics_l1_plus",
    "upper_bands",
    "world_to_cam",
]
