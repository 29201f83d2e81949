"""Which free Gaussians show what a mesh does not: those that are to stay when others are bound to it."""

from collections.abc import Iterable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial import KDTree

from gsjax import rendering
from gsjax.gaussians import Gaussians
from gsjax.rendering import DepthReading
from gsjax.scene import batches
from gsjax.scene.batches import Batch, Batches
from gsjax.training.capacity import chosen_capacity

AT_BORDER = 2.0  # Standard deviations within which a Gaussian reaches over a border of the mesh.
OVER_BORDER = 0.05  # Share of the light of such a one, past the mesh, above which it stays.
SAME_SURFACE = 0.05  # Share of its depth by which the mesh may be before or behind a Gaussian that it replaces.


def uncovered_gaussians(
    gaussians: Gaussians,
    data: Batches,
    mesh_depths: Iterable[np.ndarray],
    border: np.ndarray,
    *,
    depth_mode: DepthReading = "plane",
) -> np.ndarray:
    """Gaussians that shine where there is no mesh.

    A Gaussian's light is the sum of its blending weights over all pixels that may be used. The mesh accounts for it
    where a pixel's ray meets the mesh within `SAME_SURFACE` of the depth of the Gaussian, or of the depth that all
    Gaussians together show there. One of which it accounts for less than half stays. So a thin haze over a surface
    goes, and a surface behind a thick one; what is beyond the mesh's rim, behind a hole or in the open before it
    stays, whatever its size. One that reaches over an open border stays if more than `OVER_BORDER` of its light meets
    no mesh: the mesh ends where points thin out, and little light is past that.

    Args:
        gaussians: N of them.
        data: The views to look from.
        mesh_depths: `[H, W]` camera z of the mesh a view, of the size of `data`, 0 where there is none; read one
            by one.
        border: `[B, 3]` vertices at which the mesh ends, see `gsjax.meshing.connectivity.border`; B may be 0.
        depth_mode: What a splat's depth is, see `gsjax.rendering`.

    Returns:
        `[N]` bool, numpy. False for those that no pixel sees.
    """
    gaussians, light = jax.tree.map(jnp.asarray, gaussians), np.zeros((gaussians.num_gaussians, 3))
    capacity = chosen_capacity(gaussians, data)
    for target, mesh_depth in zip(data.views, mesh_depths, strict=True):
        light += np.asarray(_light(gaussians, target, mesh_depth, capacity=capacity, depth_mode=depth_mode))
    bare, elsewhere, total = light.T
    over_border = _at_border(gaussians, border) & (bare > OVER_BORDER * total)
    return (bare + elsewhere > 0.5 * total) | over_border


def _at_border(gaussians: Gaussians, border: np.ndarray) -> np.ndarray:
    """`[N]` whether the longest axis of a Gaussian could reach a border."""
    if not len(border):
        return np.zeros(gaussians.num_gaussians, bool)
    reach = AT_BORDER * np.exp(np.asarray(gaussians.log_scales).max(axis=1))
    return KDTree(border).query(np.asarray(gaussians.means), workers=-1)[0] <= reach


@partial(jax.jit, static_argnames=("capacity", "depth_mode"))
def _light(gaussians: Gaussians, target: Batch, mesh_depth: Array, *, capacity: int, depth_mode: DepthReading) -> Array:
    """`[N, 3]` light in one view: on rays that meet no mesh, on those that meet it elsewhere, and all."""
    black = jnp.zeros(3, jnp.float32)
    batch = batches.decode(target, black)

    def probed_view(probe: Array) -> tuple[Array, tuple[Array, Array]]:
        view = rendering.render(
            gaussians,
            batch.camera,
            capacity=capacity,
            background=black,
            with_depth=True,
            depth_mode=depth_mode,
            probes=probe,
        )
        assert view.probes is not None and view.depth is not None
        return view.probes, (view.depth, view.splats.projection.depths[0])

    # The image is linear in the probe, and blending weights times whatever a pixel holds are its gradient.
    nothing = jnp.zeros((gaussians.num_gaussians, 4), jnp.float32)
    _, summed, (depth, own_depths) = jax.vjp(probed_view, nothing, has_aux=True)
    has_mesh = batch.valid & (mesh_depth > 0)
    differs = has_mesh & (jnp.abs(depth - mesh_depth) > SAME_SURFACE * mesh_depth)
    pixels = [batch.valid, batch.valid & ~has_mesh, differs, jnp.where(differs, mesh_depth, 0)]
    total, bare, off, off_depth = summed(jnp.stack([p.astype(jnp.float32) for p in pixels], -1))[0].T
    # `off_depth / off` is the mesh's depth there, weighted by the Gaussian's light.
    is_near = jnp.abs(own_depths * off - off_depth) <= SAME_SURFACE * off_depth
    return jnp.stack([bare, jnp.where(is_near, 0, off), total], -1)
