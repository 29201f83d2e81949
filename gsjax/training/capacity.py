"""How long the pair buffer of a step must be: every slot is sorted in every step, used or not."""

import jax
from jax import Array

from gsjax import render, targets
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians
from gsjax.targets import Views


def largest_need(gaussians: Gaussians, data: Views) -> int:
    """Pair capacity that serves every one of the views."""
    return int(_largest_need(gaussians, targets.cameras(data)))


def chosen_capacity(gaussians: Gaussians, data: Views, *, headroom: float = 1.25) -> int:
    """Pair capacity that holds every view with room to grow; tighter than the buckets of the front door."""
    return rounded_capacity(largest_need(gaussians, data), headroom)


def rounded_capacity(needed: int, headroom: float) -> int:
    """`needed` times `headroom`, up to the next multiple of 4096."""
    return -(-int(needed * headroom + 1) // 4096) * 4096


@jax.jit
def _largest_need(gaussians: Gaussians, cameras: Camera) -> Array:
    return jax.lax.map(lambda camera: render.needed_capacity(gaussians, camera), cameras).max()
