"""Many views of finished Gaussians as numpy pictures, with one compilation for all of them."""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rasterizer
from gsjax import rendering
from gsjax.gaussians import Gaussians
from gsjax.rendering import DepthReading, backdrop
from gsjax.scene.cameras import Camera
from rasterizer.engines import resolve

# Of engines that do not touch the slots that nobody needs: how many times longer than needed a pair buffer is made, and
# may be.
ROOM = {"native": (2, 16), "pallas": (4, 16)}
LONG = 2**28  # slots, a gibibyte: a pair buffer is made no longer than that to spare a program


class Picture(NamedTuple):
    """One rendered view, numpy."""

    colors: np.ndarray  # [H, W, 3] float32, clipped to 0..1, over the background
    depth: np.ndarray  # [H, W] float32 camera z, 0 where little covers the pixel
    alphas: np.ndarray  # [H, W] float32
    owners: np.ndarray | None = None  # [H, W] int32, who was hit: in whom half of a pixel's light is gone; -1: none


def pictures(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    background: np.ndarray,
    depth_mode: DepthReading = "plane",
    *,
    with_owners: bool = False,
) -> Iterator[Picture]:
    """Render every camera over a background (see `gsjax.rendering.backdrop`); sizes may differ, as the cameras do.

    Depth is as `depth_mode` says, see `gsjax.rendering`. Owners cost another pass over the pairs.
    """
    gaussians = jax.tree.map(jnp.asarray, gaussians)
    width, height = max(c.width for c in cameras), max(c.height for c in cameras)
    padded = [Camera(jnp.asarray(c.viewmat), jnp.asarray(c.K), width, height) for c in cameras]
    capacity = _capacity(rendering.largest_need(gaussians, padded))
    for camera, own in zip(padded, cameras, strict=True):
        color = jnp.asarray(background, jnp.float32)
        maps = _picture_maps(
            gaussians, camera, color, capacity=capacity, depth_mode=depth_mode, with_owners=with_owners
        )
        yield Picture(*(np.asarray(x)[: own.height, : own.width] for x in maps))


def mask_pictures(pictures: Iterable[Picture], valid: Iterable[np.ndarray | None]) -> Iterator[Picture]:
    """The same pictures with nothing in them, in colour, depth, coverage and owners, where their photos say nothing.

    Both are read one by one. `valid` is `[H, W]` bool a view, False where its photo must not be used; None: all is.
    """
    for picture, usable in zip(pictures, valid, strict=True):
        if usable is None:
            yield picture
        else:
            colors = np.where(usable[..., None], picture.colors, 0)
            depth, alphas = np.where(usable, picture.depth, 0), np.where(usable, picture.alphas, 0)
            owners = None if picture.owners is None else np.where(usable, picture.owners, -1)
            yield Picture(colors, depth, alphas, owners)


_compiled: set[int] = set()  # Pair buffers that this process has drawn with.


def _capacity(needed: int) -> int:
    """The length of a pair buffer that holds so many: the shortest that a program is compiled for, or a new one."""
    lengths = (max(needed, min(needed * times, LONG)) for times in ROOM.get(resolve("auto"), (1, 1)))
    new, longest = map(rasterizer.capacity_bucket, lengths)
    # A copy: other threads may draw, too.
    capacity = min((each for each in tuple(_compiled) if needed <= each <= longest), default=new)
    _compiled.add(capacity)
    return capacity


@partial(jax.jit, static_argnames=("capacity", "depth_mode", "with_owners"))
def _picture_maps(
    gaussians: Gaussians,
    camera: Camera,
    background: jax.Array,
    *,
    capacity: int,
    depth_mode: DepthReading,
    with_owners: bool,
) -> tuple[jax.Array, ...]:
    under = backdrop.color_behind(background, camera)
    view = rendering.render(
        gaussians, camera, capacity=capacity, background=under, with_depth=True, depth_mode=depth_mode
    )
    assert view.depth is not None  # as asked for
    maps = jnp.clip(view.colors, 0, 1), view.depth, view.alphas
    return (*maps, rendering.owners(view.splats)) if with_owners else maps
