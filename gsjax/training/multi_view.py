"""A view against a neighbour: the same surface must stand at the same place (PGSR's geometric consistency).

The step draws the neighbour from a short list that every view brings along, and renders its depth too. Without the term
there is neither list nor second render.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax import cameras, depth, render
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians
from gsjax.images import reads_within, sample_bilinear
from gsjax.numerics import masked_mean
from gsjax.render import Neighbor, View
from gsjax.views import Batch, Views
from rasterizer import DepthMode

NEAREST = 8  # views that a neighbour is drawn from (PGSR),
WIDEST = 30.0  # degrees between their axes (PGSR),
APART = (0.003, 0.5)  # of the camera extent: least and most distance. PGSR's .01 and 1.5 units, without a unit.
ROUNDING = 1e-3  # pixels: that near to its start, it is there
HOME = 1.0  # pixels from where it started that a pixel may land to count; beyond, something stands in between (PGSR)


def multi_view(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean of exp(-e) e, where e is how many pixels from home a pixel lands that goes to the neighbour and back.

    It goes to its rendered depth, into the neighbour, to the depth that is rendered there, and back. Only pixels count
    that come home within `HOME`: the others met something else on the way. The weight exp(-e) carries no gradient
    (PGSR). e itself is differentiable to both depths; within `ROUNDING` of home it is zero, without a gradient.
    """
    del gaussians
    assert view.depth is not None and view.neighbor is not None, "the term compares two rendered depths"
    camera = batch.camera
    y, x = jnp.meshgrid(*(jnp.arange(n, dtype=camera.K.dtype) + 0.5 for n in view.depth.shape), indexing="ij")
    there_and_back = partial(_there_and_back, camera=camera, neighbor=view.neighbor)
    off, returns = jax.vmap(jax.vmap(there_and_back))(jnp.stack([x, y], -1), view.depth)
    kept = batch.valid & (view.depth > 0) & returns & (off < HOME)
    return masked_mean(jax.lax.stop_gradient(jnp.exp(-off)) * off, kept)


def _there_and_back(pixel: Array, here: Array, camera: Camera, neighbor: Neighbor) -> tuple[Array, Array]:
    """How far from one pixel position `[2]` of depth `here` it lands, pixels, and whether it met a surface twice."""
    turn = jnp.sum(cameras.rotation(neighbor.camera)[:, None] * cameras.rotation(camera)[None], -1)
    shift = neighbor.camera.viewmat[:3, 3] - jnp.sum(turn * camera.viewmat[:3, 3], -1)
    point, in_front = _in_front(jnp.sum(turn * _point(pixel, here, camera), -1) + shift)
    seen_at = cameras.project(point, neighbor.camera)
    there = _point(seen_at, sample_bilinear(neighbor.depth, seen_at), neighbor.camera)
    again, in_front_again = _in_front(jnp.sum(turn * (there - shift)[:, None], 0))
    squared = jnp.sum(jnp.square(cameras.project(again, camera) - pixel))
    moved = squared > ROUNDING**2  # A root has no slope at zero.
    off = jnp.where(moved, jnp.sqrt(jnp.where(moved, squared, 1)), 0)
    return off, in_front & reads_within(neighbor.depth > 0, seen_at) & in_front_again


def _point(pixel: Array, at: Array, camera: Camera) -> Array:
    """`[3]` camera-frame point of one pixel position and its depth."""
    return jnp.append((pixel - camera.K[:2, 2]) / jnp.stack([camera.K[0, 0], camera.K[1, 1]]) * at, at)


def _in_front(point: Array) -> tuple[Array, Array]:
    """A camera-frame point, or a harmless one where it is not in front of the camera; and whether it is."""
    in_front = point[2] > 0
    return jnp.where(in_front, point, jnp.array([0, 0, 1], point.dtype)), in_front


def rendered(gaussians: Gaussians, camera: Camera, capacity: int, depth_mode: DepthMode) -> Neighbor:
    """What the term needs of the second view."""
    splats = render.splat(gaussians, camera, capacity, depth_mode=depth_mode)
    return Neighbor(camera, depth.expected(splats)[0], splats.pairs)


def drawn(neighbors: tuple[Camera, Array | None], key: Array) -> tuple[Camera, Array | None]:
    """One of the stacked cameras, each as likely, and which photo it took."""
    index = jax.random.randint(key, (), 0, neighbors[0].viewmat.shape[0])
    return jax.tree.map(lambda stacked: stacked[index], neighbors)


def with_neighbors(views: Views, extent: float) -> Views:
    """The same views, each with the cameras of `NEAREST` neighbours; where there are fewer, they repeat.

    Args:
        views: The photos.
        extent: Camera extent, scene units.
    """
    every = [(Camera(target.viewmat, target.K, *views.size), target.photo) for target in views.targets]
    chosen = nearest(np.stack([camera.viewmat for camera, _ in every]), extent)
    stacked = [jax.tree.map(lambda *leaves: np.stack(leaves), *(every[index] for index in row)) for row in chosen]
    rows = zip(views.targets, stacked, strict=True)
    return Views(tuple(replace(t, neighbors=cameras, neighbor_photos=photos) for t, (cameras, photos) in rows))


def nearest(viewmats: np.ndarray, extent: float) -> np.ndarray:
    """`[V, NEAREST]` indices of each view's neighbours among `[V, 4, 4]` viewmats, the nearest first, repeated.

    Neighbours look the same way to within `WIDEST` and stand `APART`. A view without any is its own neighbour: its
    pixels come home exactly, which asks for nothing.
    """
    axes, rotations = viewmats[:, 2, :3], viewmats[:, :3, :3]
    centers = -np.einsum("vij,vi->vj", rotations, viewmats[:, :3, 3])
    angles = np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1)))
    distances = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
    least, most = (share * extent for share in APART)
    rows = []
    for view, (angle, distance) in enumerate(zip(angles, distances, strict=True)):
        usable = (angle < WIDEST) & (distance > least) & (distance < most)
        by_distance = [index for index in np.argsort(distance, kind="stable") if usable[index]]
        rows.append(np.resize(by_distance[:NEAREST] or [view], NEAREST))
    return np.stack(rows)
