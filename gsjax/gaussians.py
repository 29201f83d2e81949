"""The Gaussians of a scene as one pytree, and the maps from its free parameters to what a renderer needs."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

SH_C0 = 0.28209479177387814  # Y_0^0, the constant that turns an rgb into a degree-0 coefficient.

DEAD_LOGIT = -30.0
"""Log-odds of opacity of a free row of a buffer: under every alpha cut, so never drawn and without gradient."""

PixelFilter = Literal["classic", "mip"]
"""How splats meet pixels, see `gsjax.rendering.PIXEL_FILTERS`. They look right through that of their training."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, repr=False)
class Gaussians:
    """N Gaussians in world coordinates; every field is free (unconstrained) and float32.

    A field's name carries its space: `scales(g)` and `opacities(g)` give the linear values.
    """

    means: Float[Array, "N 3"]  # world positions, scene units
    quats: Float[Array, "N 4"]  # rotation, (w, x, y, z), any length but zero
    log_scales: Float[Array, "N 3"]  # natural log of the standard deviations along the axes, scene units
    logit_opacities: Float[Array, "N"]  # log-odds of the opacity
    sh_dc: Float[Array, "N 1 3"]  # degree-0 coefficients
    sh_rest: Float[Array, "N M 3"]  # coefficients of degrees 1..L, M = (L+1)^2 - 1
    pixel_filter: PixelFilter = field(default="classic", metadata={"static": True})

    @property
    def num_gaussians(self) -> int:
        """Number of rows, dead ones included where the arrays are buffers of fixed capacity."""
        return self.means.shape[0]

    @property
    def sh_degree(self) -> int:
        """Highest spherical-harmonics degree that the coefficients hold."""
        return round((self.sh_rest.shape[1] + 1) ** 0.5) - 1

    def __len__(self) -> int:
        """As `num_gaussians`."""
        return self.num_gaussians

    def __getitem__(self, index: "Array | np.ndarray | slice") -> "Gaussians":
        """The rows that a slice, integers or a boolean mask names."""
        return take(self, index)

    def alive(self) -> "Gaussians":
        """The rows that hold a Gaussian, without the free ones of a buffer. Not inside `jit`: their number is data."""
        return take(self, np.asarray(is_alive(self)))

    def __repr__(self) -> str:
        """Number, degree and filter: the arrays are long."""
        return f"Gaussians({self.num_gaussians} rows, sh_degree={self.sh_degree}, pixel_filter={self.pixel_filter!r})"


def scales(gaussians: Gaussians) -> Float[Array, "N 3"]:
    """Standard deviations along the axes, scene units."""
    return jnp.exp(gaussians.log_scales)


def opacities(gaussians: Gaussians) -> Float[Array, "N"]:
    """Opacities in (0, 1)."""
    return jax.nn.sigmoid(gaussians.logit_opacities)


def smallest_axes(gaussians: Gaussians) -> Array:
    """`[N, 3]` unit world directions of the smallest axes: up to their sign, the normals of discs."""
    axis = jnp.argmin(gaussians.log_scales, axis=-1)
    return jnp.take_along_axis(rotation_matrices(gaussians.quats), axis[:, None, None], axis=-1)[..., 0]


@jax.jit
def covariances(gaussians: Gaussians) -> Array:
    """`[N, 3, 3]` R S S^T R^T, world, scene units squared."""
    columns = rotation_matrices(gaussians.quats) * scales(gaussians)[:, None, :]
    return jnp.sum(columns[:, :, None, :] * columns[:, None, :, :], axis=-1)


def without_view_dependence(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians with their constant colour alone: what a surface is painted with."""
    return replace(gaussians, sh_rest=jnp.zeros_like(jnp.asarray(gaussians.sh_rest)))


def rgb_to_sh(rgb: Array) -> Array:
    """Degree-0 coefficient whose colour is `rgb` (0..1), any shape."""
    return (rgb - 0.5) / SH_C0


def is_alive(gaussians: Gaussians) -> Array:
    """`[N]` bool: which rows hold a Gaussian."""
    return gaussians.logit_opacities > 0.5 * DEAD_LOGIT


def take(gaussians: Gaussians, index: Array | np.ndarray | slice) -> Gaussians:
    """The rows that `index` (integers, a boolean mask or a slice) names."""
    return jax.tree.map(lambda x: x[index], gaussians)


def concatenate(parts: Sequence[Gaussians]) -> Gaussians:
    """All rows of several, numpy; harmonics of the same degree, one pixel filter."""
    return jax.tree.map(lambda *leaves: np.concatenate([np.asarray(leaf) for leaf in leaves]), *parts)


def rotation_matrices(quats: Array) -> Array:
    """`[..., 3, 3]` rotations of `[..., 4]` quaternions (w, x, y, z) of any length; the columns are the axes.

    A zero quaternion gives the identity, with zero gradient.
    """
    squared = jnp.sum(quats * quats, axis=-1, keepdims=True)
    is_zero = squared < 1e-24
    unit = quats * jax.lax.rsqrt(jnp.where(is_zero, 1.0, squared))
    identity = jnp.array([1.0, 0.0, 0.0, 0.0], quats.dtype)
    w, x, y, z = jnp.moveaxis(jnp.where(is_zero, identity, unit), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)
