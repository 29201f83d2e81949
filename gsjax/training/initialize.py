"""The Gaussians that training starts from."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from gsjax.gaussians import Gaussians, PixelFilter, rgb_to_sh

DEAD_LOGIT = -30.0
"""Log-odds of a free row of the buffer: under every alpha cut, so never drawn and without gradient."""


def from_points(
    points: np.ndarray,
    colors: np.ndarray,
    *,
    capacity: int,
    sh_degree: int,
    opacity: float = 0.1,
    pixel_filter: PixelFilter = "classic",
) -> Gaussians:
    """Isotropic Gaussians at the points, as 3DGS starts (its create_from_pcd), in a buffer of fixed capacity.

    Args:
        points: `[P, 3]` world positions; if P exceeds the capacity, every P / capacity-th is taken.
        colors: `[P, 3]` uint8 or 0..1 float.
        capacity: Rows of the buffer. Those beyond the points are dead.
        sh_degree: Degree of the harmonics, zero above the constant band.
        opacity: Of every Gaussian.
        pixel_filter: How they are to be drawn.

    Returns:
        Float32 Gaussians; a scale is the root mean square distance to the 3 nearest other points, at least 3e-4.
    """
    if len(points) > capacity:
        chosen = np.linspace(0, len(points) - 1, capacity).astype(int)
        points, colors = points[chosen], colors[chosen]
    colors = colors / 255.0 if colors.dtype == np.uint8 else colors
    count = len(points)
    neighbors = min(4, count)
    distances = KDTree(points).query(points, k=neighbors)[0].reshape(count, neighbors)[:, 1:]
    spacing = np.sqrt(np.maximum((distances**2).mean(1), 1e-7)) if neighbors > 1 else np.full(count, 0.01)

    def buffer(values, fill=0.0):
        rows = np.full((capacity, *np.shape(values)[1:]), fill, np.float32)
        rows[:count] = values
        return jnp.asarray(rows)

    identity = np.tile(np.array([1, 0, 0, 0], np.float32), (capacity, 1))
    return Gaussians(
        means=buffer(points),
        quats=jnp.asarray(identity),
        log_scales=buffer(np.repeat(np.log(spacing)[:, None], 3, 1)),
        logit_opacities=buffer(np.full(count, np.log(opacity / (1 - opacity))), DEAD_LOGIT),
        sh_dc=buffer(rgb_to_sh(colors)[:, None, :]),
        sh_rest=jnp.zeros((capacity, (sh_degree + 1) ** 2 - 1, 3), jnp.float32),
        pixel_filter=pixel_filter,
    )
