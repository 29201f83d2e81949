"""Which free Gaussians show what a mesh does not: those that are to stay when others are bound to it."""

from collections.abc import Iterable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax import render, views
from gsjax.gaussians import Gaussians
from gsjax.render import DepthReading
from gsjax.training.capacity import chosen_capacity
from gsjax.views import Target, Views

SAME_SURFACE = 0.05  # Share of its depth by which the mesh may lie before or behind a Gaussian that it replaces.


def beyond_mesh(
    gaussians: Gaussians, data: Views, mesh_depths: Iterable[np.ndarray], *, depth_mode: DepthReading = "plane"
) -> np.ndarray:
    """Gaussians that shine mostly where there is no mesh.

    A Gaussian's light is the sum of its blending weights over all pixels that may be used. The mesh accounts for it
    where a pixel's ray meets the mesh within `SAME_SURFACE` of the depth of the Gaussian, or of the depth that all
    Gaussians together show there. One of which it accounts for less than half stays. So a thin haze over a surface
    goes, and a surface behind a thick one; what lies beyond the mesh's rim, behind a hole or in the open before it
    stays, whatever its size.

    Args:
        gaussians: N of them.
        data: The views to look from.
        mesh_depths: `[H, W]` camera z of the mesh a view, of the size of `data`, 0 where there is none; looked at one
            by one.
        depth_mode: What a splat's depth is, see `gsjax.render.view`.

    Returns:
        `[N]` bool, numpy. False for those that no pixel sees.
    """
    gaussians, light = jax.tree.map(jnp.asarray, gaussians), np.zeros((gaussians.num_gaussians, 2))
    capacity = chosen_capacity(gaussians, data)
    for target, mesh_depth in zip(data.targets, mesh_depths, strict=True):
        light += np.asarray(_light(gaussians, target, mesh_depth, capacity=capacity, depth_mode=depth_mode))
    beyond, total = light.T
    return beyond > 0.5 * total


@partial(jax.jit, static_argnames=("capacity", "depth_mode"))
def _light(
    gaussians: Gaussians, target: Target, mesh_depth: Array, *, capacity: int, depth_mode: DepthReading
) -> Array:
    """`[N, 2]` light in one view: that for which the mesh does not account, and all."""
    black = jnp.zeros(3, jnp.float32)
    batch = views.batch(target, black)

    def shown(probe: Array) -> tuple[Array, tuple[Array, Array]]:
        view = render.view(
            gaussians,
            batch.camera,
            capacity=capacity,
            background=black,
            with_depth=True,
            depth_mode=depth_mode,
            extra=probe,
        )
        assert view.extra is not None and view.depth is not None  # as asked for
        return view.extra, (view.depth, view.splats.projection.depths[0])

    # The image is linear in the probe, and blending weights times whatever a pixel holds are its gradient.
    nothing = jnp.zeros((gaussians.num_gaussians, 4), jnp.float32)
    _, summed, (depth, own_depths) = jax.vjp(shown, nothing, has_aux=True)
    has_mesh = batch.valid & (mesh_depth > 0)
    differs = has_mesh & (jnp.abs(depth - mesh_depth) > SAME_SURFACE * mesh_depth)
    pixels = [batch.valid, batch.valid & ~has_mesh, differs, jnp.where(differs, mesh_depth, 0)]
    total, bare, off, off_depth = summed(jnp.stack([p.astype(jnp.float32) for p in pixels], -1))[0].T
    # `off_depth / off` is the mesh's depth there, weighted by the Gaussian's light.
    is_near = jnp.abs(own_depths * off - off_depth) <= SAME_SURFACE * off_depth
    return jnp.stack([bare + jnp.where(is_near, 0, off), total], -1)
