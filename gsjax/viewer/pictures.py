"""Pictures of Gaussians for the page, and of what is behind them."""

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.errors import InputError, is_out_of_memory
from gsjax.gaussians import Gaussians
from gsjax.rendering import DepthReading, backdrop, gallery
from gsjax.report.pictures import depth_picture, surface_picture
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes

KINDS = COLOR, DEPTH, NORMALS = "colour", "depth", "normals"


def draw_picture(
    kind: str,
    gaussians: Gaussians,
    camera: Camera,
    background: np.ndarray,
    depth_mode: DepthReading = "plane",
) -> np.ndarray:
    """Draw `[H, W, 3]` uint8 of a kind in `KINDS`, over a background of `gsjax.rendering.backdrop`.

    Another number of Gaussians is another program, and so is another size of the picture.

    Raises:
        InputError: The view does not fit the device.
    """
    try:
        (picture,) = gallery.pictures(gaussians, [camera], background, depth_mode)
    except (jax.errors.JaxRuntimeError, ValueError) as error:  # ValueError: of a pair buffer longer than int32 counts.
        if not (isinstance(error, ValueError) or is_out_of_memory(error)):
            raise
        size = f"{camera.width}x{camera.height}"
        raise InputError(
            f"there is no room for what this view shows at {size}; step back or draw it smaller"
        ) from error
    if kind == COLOR:
        return to_bytes(picture.colors)
    return depth_picture(picture.depth) if kind == DEPTH else surface_picture(picture.depth, camera)


def bare_background(background: np.ndarray, camera: Camera) -> np.ndarray:
    """`[H, W, 3]` uint8: what a camera sees where there are no Gaussians."""
    camera = Camera(jnp.asarray(camera.viewmat), jnp.asarray(camera.K), camera.width, camera.height)
    colors = np.asarray(_behind(jnp.asarray(background, jnp.float32), camera))
    return np.broadcast_to(to_bytes(np.clip(colors, 0, 1)), (camera.height, camera.width, 3))


_behind = jax.jit(backdrop.color_behind)
