"""Gaussians and a camera to images; where light behind them comes from; images read between their pixels."""

from gsjax.rendering.depth import IN_FRONT, MIN_COVERAGE, DepthReading, splat_depth_mode
from gsjax.rendering.splats import (
    PIXEL_FILTERS,
    Drawable,
    drawable,
    facing_axes,
    features,
    largest_need,
    needed_capacity,
    owners,
    projected,
    splat,
    tile_grid,
)
from gsjax.rendering.viewing import BoundMesh, Neighbor, View, colors, render

__all__ = [
    "IN_FRONT",
    "MIN_COVERAGE",
    "PIXEL_FILTERS",
    "BoundMesh",
    "DepthReading",
    "Drawable",
    "Neighbor",
    "View",
    "colors",
    "drawable",
    "facing_axes",
    "features",
    "largest_need",
    "needed_capacity",
    "splat_depth_mode",
    "owners",
    "projected",
    "splat",
    "tile_grid",
    "render",
]
