"""Small moves of cameras, and which of them change no photo: those of all cameras together with the world.

A twist is six numbers: a turn about the camera's centre (a rotation vector, radians) and a shift of that centre, both
along the axes of the world. So a move of the whole world, to first order, gives every camera the same turn, and a shift
that is linear in its place.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.scene import cameras
from gsjax.scene.cameras import Camera

_SMALL = 1e-6  # of a squared angle, below which sines are their series: to 14 digits


def apply_twist(camera: Camera, twist: Array, unit: float) -> Camera:
    """The camera after a twist `[6]` with shifts in `unit`s. Differentiable everywhere, at zero and at half turns too.

    A twist of zero gives back the same numbers: what is added to the camera's own is zero.
    """
    change = _less_identity(-twist[:3])  # of the world as the camera sees it
    before = cameras.rotation(camera)
    turned = jnp.sum(before[:, :, None] * change[None], axis=1)  # what is added to it
    passed = jnp.sum(turned * cameras.center(camera)[None] + (before + turned) * (unit * twist[3:])[None], axis=-1)
    added = jnp.concatenate([turned, -passed[:, None]], axis=1)
    viewmat = camera.viewmat + jnp.concatenate([added, jnp.zeros((1, 4), added.dtype)])
    return Camera(viewmat, camera.K, camera.width, camera.height)


def gauge(centers: np.ndarray, unit: float) -> np.ndarray:
    """`[6 V, G]` orthonormal float32: the twists of V cameras that turn, shift and scale the world, and nothing else.

    Seven for cameras in general; fewer where those are not independent: six of one camera, which can only be moved so.
    `centers` are `[V, 3]`; shifts are in `unit`s.
    """
    offsets = (centers - centers.mean(0)).astype(np.float64) / unit
    modes = np.zeros((len(centers), 6, 7))
    modes[:, :3, :3] = np.eye(3)
    modes[:, 3:, :3] = np.stack([np.cross(axis, offsets) for axis in np.eye(3)], axis=-1)
    modes[:, 3:, 3:6] = np.eye(3)
    modes[:, 3:, 6] = offsets
    left, sizes, _ = np.linalg.svd(modes.reshape(-1, 7), full_matrices=False)
    return left[:, sizes > 1e-6 * sizes[0]].astype(np.float32)


def _less_identity(turn: Array) -> Array:
    """`[3, 3]` rotation by a rotation vector `[3]`, less the identity (Rodrigues).

    Without cancellation: of a small angle it is small to the same number of digits.
    """
    squared = jnp.sum(jnp.square(turn))
    small = squared < _SMALL
    angle = jnp.sqrt(jnp.maximum(squared, _SMALL))
    half = jnp.sin(0.5 * angle) / (0.5 * angle)
    sine = jnp.where(small, 1 - squared / 6, jnp.sin(angle) / angle)
    cosine = 0.5 * jnp.where(small, 1 - squared / 12, jnp.square(half))  # (1 - cos) / angle²
    x, y, z = turn
    zero = jnp.zeros_like(x)
    cross = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    return sine * cross + cosine * (turn[:, None] * turn[None] - squared * jnp.eye(3, dtype=turn.dtype))
