"""Floaters: Gaussians in the air that one view alone shows, and that other views look through.

Training puts a Gaussian right before a camera where that makes one photo better and no other photo disagrees. Nothing
says how far away it is, so it is no part of a surface.
"""

from collections.abc import Iterable

import numpy as np

from gsjax.gaussians import Gaussians, covariances
from gsjax.rendering.shown_depths import SAME_SURFACE, ShownDepth, depths_at

SUPPORTING = 2  # Views that show a Gaussian where it is: fewer do not tell how far away it is.
LOOKING_THROUGH = 2  # Views that show what is behind a Gaussian: one may be wrong.
NEAR = 0.3  # Of the median depth of a view: nearer than that, what this view alone shows hangs before its camera.
DEVIATIONS = 3.0  # A Gaussian reaches so many of its standard deviations towards a camera, and away from it.


def are_floaters(gaussians: Gaussians, views: Iterable[ShownDepth]) -> np.ndarray:
    """Which Gaussians hang in the air.

    A view *supports* a Gaussian if the depth that it shows at the Gaussian's mean is the Gaussian's own, up to
    `SAME_SURFACE` of it and `DEVIATIONS`; it *looks through* the Gaussian if that depth is greater. A floater has fewer
    than `SUPPORTING` views, and either `LOOKING_THROUGH` and more that look through it, or one that has it nearer than
    `NEAR` of the median depth that it shows. What is hidden behind a surface has neither, and is none.

    Args:
        gaussians: N of them; what is not finite is no floater.
        views: Depths that these Gaussians show, see `gsjax.rendering.shown_depths`; looked at one by one.

    Returns:
        `[N]` bool, numpy.
    """
    means, shapes = np.asarray(gaussians.means, np.float64), np.asarray(covariances(gaussians), np.float64)
    usable = np.isfinite(means).all(axis=1) & np.isfinite(shapes).all(axis=(1, 2))
    means, shapes = means[usable], shapes[usable]
    supporting, through = np.zeros((2, len(means)), np.int32)
    hangs_near = np.zeros(len(means), bool)
    for view in views:
        if not view.depth.any():
            continue
        forward = np.asarray(view.camera.viewmat, np.float64)[2, :3]
        depths, shown = depths_at(means, view)
        thickness = np.sqrt(np.maximum(shapes @ forward @ forward, 0))
        margin = SAME_SURFACE * shown + DEVIATIONS * thickness
        supports = (shown > 0) & (np.abs(depths - shown) <= margin)
        supporting += supports
        through += (shown > 0) & (depths < shown - margin)
        hangs_near |= supports & (depths < NEAR * np.median(view.depth[view.depth > 0]))
    found = np.zeros(len(usable), bool)
    found[usable] = (supporting < SUPPORTING) & ((through >= LOOKING_THROUGH) | hangs_near)
    return found
