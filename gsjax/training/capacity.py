"""How long the pair buffer of a step must be. The jnp engine sorts every slot in every step, used or not."""

import jax
from jax import Array

from gsjax import render, targets
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians
from gsjax.targets import Targets
from rasterizer.engines import resolve

GROWTH = 2.0  # how much longer the pair buffer is than needed while Gaussians multiply,
STILL = 1.25  # and while they do not: a view that needs more costs another compilation
FREE_GROWTH, FREE_STILL = 8.0, 2.0  # the same of the native loops, which write no slot that nobody needs


def headroom(*, grows: bool) -> float:
    """How much longer than needed to make the pair buffer of a phase."""
    if resolve("auto") == "native":
        return FREE_GROWTH if grows else FREE_STILL
    return GROWTH if grows else STILL


def largest_need(gaussians: Gaussians, data: Targets) -> int:
    """Pair capacity that serves every one of the views."""
    return int(_largest_need(gaussians, targets.stack_cameras(data)))


def chosen_capacity(gaussians: Gaussians, data: Targets, *, headroom: float = 1.25) -> int:
    """Pair capacity that holds every view with room to grow; tighter than the buckets of the front door."""
    return rounded_capacity(largest_need(gaussians, data), headroom)


def rounded_capacity(needed: int, headroom: float) -> int:
    """`needed` times `headroom`, up to the next multiple of 4096."""
    return -(-int(needed * headroom + 1) // 4096) * 4096


@jax.jit
def _largest_need(gaussians: Gaussians, cameras: Camera) -> Array:
    return jax.lax.map(lambda camera: render.needed_capacity(gaussians, camera), cameras).max()
