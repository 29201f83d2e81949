"""Gaussians as a browser draws them by itself: without harmonics, filters or depth, but at once."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.gaussians import SH_C0, Gaussians, covariances, opacities
from gsjax.training.growth.adaptive import is_alive


class BrowserSplats(NamedTuple):
    """The arrays that viser takes, numpy float32, of the Gaussians that are alive."""

    centers: np.ndarray  # [N, 3] world
    covariances: np.ndarray  # [N, 3, 3] world, scene units squared
    rgbs: np.ndarray  # [N, 3] 0..1, degree 0
    opacities: np.ndarray  # [N, 1] 0..1


def browser_splats(gaussians: Gaussians) -> BrowserSplats:
    """What a browser needs of Gaussians; free rows of a training's buffers are left out."""
    alive, *arrays = (np.asarray(x) for x in _linear(gaussians))
    return BrowserSplats(*(array[alive] for array in arrays))


@jax.jit
def _linear(gaussians: Gaussians) -> tuple[jax.Array, ...]:
    """For the whole buffer, so that one program serves however many rows are alive."""
    rgbs = jnp.clip(SH_C0 * gaussians.sh_dc[:, 0] + 0.5, 0, 1)
    return is_alive(gaussians), gaussians.means, covariances(gaussians), rgbs, opacities(gaussians)[:, None]
