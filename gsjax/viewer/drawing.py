"""Pictures for the page: Gaussians seen from one camera, with one program a size."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rasterizer
from gsjax import rendering
from gsjax.errors import InputError, is_out_of_memory
from gsjax.gaussians import Gaussians
from gsjax.normals.from_depth import depth_normals
from gsjax.rendering import DepthReading, backdrop
from gsjax.scene.cameras import Camera

HEADROOM = 1.5  # How much longer the pair buffer is than this view needs: the next one needs more.


class Drawing(NamedTuple):
    """One view, numpy. Depth and normals are None where they were not asked for."""

    colors: np.ndarray  # [H, W, 3] float32 0..1, over the background
    depth: np.ndarray | None  # [H, W] float32 expected camera z, 0 where nothing is
    normals: np.ndarray | None  # [H, W, 3] float32 camera axes, 0 where there is none


class Drawer:
    """Draws views of Gaussians, and remembers for every size how long the pair buffer was made.

    A view that needs more is drawn again with more; no picture is ever made of a buffer that was too short.
    """

    def __init__(self, depth_mode: DepthReading = "plane"):
        """Draw with depth as `gsjax.rendering` has it."""
        self._depth_mode: DepthReading = depth_mode
        self._capacities: dict[tuple[int, int], int] = {}

    def draw(
        self, gaussians: Gaussians, camera: Camera, background: np.ndarray, *, with_surface: bool = False
    ) -> Drawing:
        """Draw one view.

        Args:
            gaussians: jax or numpy; another number of them is another program.
            camera: The view; its size chooses the program.
            background: As `gsjax.rendering.backdrop` has it; one of another shape is another program.
            with_surface: Whether depth and normals are drawn too: another program.

        Returns:
            `Drawing`.

        Raises:
            InputError: The device has no room for what this view shows.
        """
        size = camera.width, camera.height
        camera = Camera(jnp.asarray(camera.viewmat), jnp.asarray(camera.K), *size)
        capacity = self._capacities.get(size) or _room(int(_needed(gaussians, camera)), size)
        while True:
            try:
                shown, needed = _drawn(
                    gaussians,
                    camera,
                    jnp.asarray(background, jnp.float32),
                    capacity=capacity,
                    with_surface=with_surface,
                    depth_mode=self._depth_mode,
                )
                needed = int(needed)
            except jax.errors.JaxRuntimeError as error:
                if not is_out_of_memory(error):
                    raise
                raise _too_much(size) from error
            if needed <= capacity:
                self._capacities[size] = capacity
                return Drawing(*(None if part is None else np.asarray(part) for part in shown))
            capacity = _room(needed, size)


def _room(needed: int, size: tuple[int, int]) -> int:
    """Pairs to make room for where a view needs so many."""
    try:
        return rasterizer.capacity_bucket(int(HEADROOM * needed))
    except ValueError as error:
        raise _too_much(size) from error


def _too_much(size: tuple[int, int]) -> InputError:
    return InputError(f"there is no room for what this view shows at {size[0]}x{size[1]}; step back or draw it smaller")


def bare_background(background: np.ndarray, camera: Camera) -> np.ndarray:
    """`[H, W, 3]` float32 0..1: what a camera sees where there are no Gaussians."""
    camera = Camera(jnp.asarray(camera.viewmat), jnp.asarray(camera.K), camera.width, camera.height)
    seen = _behind(jnp.asarray(background, jnp.float32), camera)
    return np.broadcast_to(np.clip(np.asarray(seen), 0, 1), (camera.height, camera.width, 3))


_needed, _behind = jax.jit(rendering.needed_capacity), jax.jit(backdrop.color_behind)


@partial(jax.jit, static_argnames=("capacity", "with_surface", "depth_mode"))
def _drawn(
    gaussians: Gaussians,
    camera: Camera,
    background: jax.Array,
    *,
    capacity: int,
    with_surface: bool,
    depth_mode: DepthReading,
) -> tuple[Drawing, jax.Array]:
    under = backdrop.color_behind(background, camera)
    view = rendering.render(
        gaussians, camera, capacity=capacity, background=under, with_depth=with_surface, depth_mode=depth_mode
    )
    normals = depth_normals(view.depth, camera) if view.depth is not None else None
    assert view.splats.pairs is not None, "a capacity is given"
    return Drawing(jnp.clip(view.colors, 0, 1), view.depth, normals), view.splats.pairs.needed
