"""The Gaussians that training starts from."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gsjax.gaussians import DEAD_LOGIT, Gaussians, PixelFilter, rgb_to_sh
from gsjax.scene import Frame
from gsjax.scene.cameras import viewmat_center

AROUND = 9
"""Nearest points, its own among them, whose principal axes a Gaussian starts with."""

SHELLS = (1.5, 3.0, 6.0)
"""Radii of the spheres of far points, in that of the smallest one that holds all cameras and most of the cloud."""


def far_points(points: np.ndarray, frames: Sequence[Frame], count: int) -> np.ndarray:
    """Points on three spheres around cameras and cloud, where a photo has them in view, for backgrounds.

    What is far behind a subject is seldom matched. Gaussians that are in front of it, before the cameras on the
    other side, are then made to show it, and those cameras look through them as through fog. Of `count` points on all
    spheres those that no photo sees are left out.
    """
    eyes = np.stack([viewmat_center(frame.viewmat) for frame in frames])
    middle = np.median(points, axis=0)
    cloud, cameras = (np.linalg.norm(each - middle, axis=1) for each in (points, eyes))
    radius = max(float(np.quantile(cloud, 0.9)), float(cameras.max()))
    # A Fibonacci lattice: even, without poles.
    turn = np.arange(count // len(SHELLS)) + 0.5
    height, around = 1 - 2 * turn / max(len(turn), 1), np.pi * (1 + 5**0.5) * turn
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(around), ring * np.sin(around), height], axis=-1)
    far = np.concatenate([middle + shell * radius * directions for shell in SHELLS])
    return far[np.any([_shows(frame, far) for frame in frames], axis=0)].astype(np.float32)


def _shows(frame: Frame, points: np.ndarray) -> np.ndarray:
    """`[P]` bool: which points project into the photo."""
    u, v, z = ((points @ frame.viewmat[:3, :3].T + frame.viewmat[:3, 3]) @ frame.K.T).T
    ahead = np.where(z > 0, z, np.inf)
    return (z > 0) & (u >= 0) & (u < frame.width * ahead) & (v >= 0) & (v < frame.height * ahead)


def from_points(
    points: Float[np.ndarray, "P 3"],
    colors: UInt8[np.ndarray, "P 3"] | Float[np.ndarray, "P 3"],
    *,
    capacity: int,
    sh_degree: int = 3,
    opacity: float = 0.1,
    pixel_filter: PixelFilter = "classic",
) -> Gaussians:
    """Isotropic Gaussians at the points, as 3DGS starts (its create_from_pcd), in a buffer of fixed capacity.

    A sphere looks the same however its axes are, but training stretches it along them. So they are those of the points
    around it, not of the world as in 3DGS: a scene that is turned trains as it did before.

    Args:
        points: World positions; if P exceeds the capacity, every P / capacity-th is taken.
        colors: Of the points; floats are 0..1.
        capacity: Rows of the buffer. Those beyond the points are dead.
        sh_degree: Degree of the harmonics, zero above the constant band.
        opacity: Of every Gaussian.
        pixel_filter: How they are to be drawn.

    Returns:
        Float32 Gaussians; a scale is the root mean square distance to the 3 nearest other points, at least 3e-4. The
        axes are the principal ones of the `AROUND` nearest points.
    """
    if len(points) > capacity:
        indices = np.linspace(0, len(points) - 1, capacity).astype(int)
        points, colors = points[indices], colors[indices]
    colors = colors / 255.0 if colors.dtype == np.uint8 else colors
    count = len(points)
    distances, near = (array.reshape(count, -1) for array in KDTree(points).query(points, k=min(AROUND, count)))
    others = distances[:, 1:4]
    spacing = np.sqrt(np.maximum((others**2).mean(1), 1e-7)) if count > 1 else np.full(count, 0.01)

    def buffer(values, fill=0.0):
        rows = np.full((capacity, *np.shape(values)[1:]), fill, np.float32)
        rows[:count] = values
        return jnp.asarray(rows)

    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (capacity, 1))
    quats[:count] = _principal_axes(points[near])
    return Gaussians(
        means=buffer(points),
        quats=jnp.asarray(quats),
        log_scales=buffer(np.repeat(np.log(spacing)[:, None], 3, 1)),
        logit_opacities=buffer(np.full(count, np.log(opacity / (1 - opacity))), DEAD_LOGIT),
        sh_dc=buffer(rgb_to_sh(colors)[:, None, :]),
        sh_rest=jnp.zeros((capacity, (sh_degree + 1) ** 2 - 1, 3), jnp.float32),
        pixel_filter=pixel_filter,
    )


def _principal_axes(clouds: np.ndarray) -> np.ndarray:
    """`[P, 4]` quaternions (w, x, y, z) of the principal axes, shortest first, of `[P, K, 3]` points each."""
    offsets = clouds.astype(np.float64) - clouds.mean(axis=1, keepdims=True, dtype=np.float64)
    axes = np.linalg.eigh(offsets.swapaxes(1, 2) @ offsets).eigenvectors
    axes[..., 2] *= np.sign(np.linalg.det(axes))[:, None]
    return Rotation.from_matrix(axes).as_quat(scalar_first=True)
