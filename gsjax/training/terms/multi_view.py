"""A view against a neighbour: the same surface must be at the same place and look the same (PGSR's consistencies).

Every step has a neighbour of its view with it, drawn from a short list, and renders its depth too. Without the terms
there is neither list nor second render.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax import rendering
from gsjax.gaussians import Gaussians
from gsjax.numerics import masked_mean, mean_channel, safe_divide, times
from gsjax.rendering import DepthReading, Neighbor, View, depth
from gsjax.rendering.sampling import reads_within, sample_bilinear
from gsjax.scene import cameras
from gsjax.scene.batches import Batch, Batches
from gsjax.scene.cameras import Camera
from rasterizer.similarity import window_means

NEAREST = 8  # views that a neighbour is drawn from (PGSR),
WIDEST = 30.0  # degrees between their axes (PGSR),
APART = (0.003, 0.5)  # of the camera extent: least and most distance. PGSR's .01 and 1.5 units, without a unit.
ROUNDING = 1e-3  # pixels: that near to its start, it is there
UNLIKE = 0.9  # 1 - NCC from which two windows show different things (PGSR)
NOISE = 2 / 255  # standard deviation of a window's grey levels that tells nothing
FILLED = 0.2  # of a window's weight, what must count for it to be compared; the corner of a photo has a third
HOME = 1.0  # pixels from where it started that a pixel may land to count; beyond, something is in between (PGSR)


def multi_view(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean of exp(-e) e, where e is how many pixels from home a pixel lands that goes to the neighbour and back.

    It goes to its rendered depth, into the neighbour, to the depth that is rendered there, and back. Only pixels count
    that come home within `HOME`: the others met something else on the way. The weight exp(-e) carries no gradient
    (PGSR). e itself is differentiable to both depths; within `ROUNDING` of home it is zero, without a gradient.
    """
    del gaussians
    _, off, is_home = _journeys(view, batch)
    return masked_mean(jax.lax.stop_gradient(jnp.exp(-off)) * off, is_home)


def photometric(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean of exp(-e) (1 - NCC): how little the photo resembles its neighbour's, seen through the rendered depth.

    NCC is the correlation of grey levels in a window about the pixel, blind to gain and offset; the neighbour's are
    read where each pixel of the window lands; e as in `multi_view`. Windows without contrast, or of `UNLIKE` or more,
    are left out (PGSR; there they are 7 x 7 pixels, warped by the plane at their middle; here those of SSIM, each of
    their pixels at its own depth).

    Differentiable to the depth of this view alone: it says where the neighbour's photo is read.
    """
    del gaussians
    assert view.neighbor is not None and view.neighbor.image is not None and view.neighbor.valid is not None
    seen_at, off, usable = _journeys(view, batch)
    usable &= jax.vmap(jax.vmap(partial(reads_within, view.neighbor.valid)))(seen_at)
    grey, others = (mean_channel(image) for image in (batch.image, view.neighbor.image))
    unlike = 1 - correlation(grey, jax.vmap(jax.vmap(partial(sample_bilinear, others)))(seen_at), usable)
    return masked_mean(jax.lax.stop_gradient(jnp.exp(-off)) * unlike, usable & (unlike < UNLIKE))


def correlation(a: Array, b: Array, mask: Array) -> Array:
    """`[H, W]` normalised cross-correlation of two grey images `[H, W]` in the window about every pixel.

    Pixels outside `mask` `[H, W]` count for nothing. Zero, without a gradient, where either window has no more contrast
    than `NOISE`, or less than `FILLED` of it counts.
    """
    counted = mask.astype(a.dtype)
    a, b = (jnp.where(mask, image, 0) for image in (a, b))
    sums: list[Array] = [window_means(each, 1) for each in (counted, a, b, a * a, b * b, a * b)]
    share, *sums = sums
    mean_a, mean_b, aa, bb, ab = (safe_divide(each, share, share > FILLED) for each in sums)
    of_a, of_b = aa - mean_a * mean_a, bb - mean_b * mean_b
    tells = (of_a > NOISE**2) & (of_b > NOISE**2)
    return jnp.where(tells, (ab - mean_a * mean_b) * jax.lax.rsqrt(jnp.where(tells, of_a * of_b, 1)), 0)


def _journeys(view: View, batch: Batch) -> tuple[Array, Array, Array]:
    """Where pixels land in the neighbour `[H, W, 2]`, how far from home they come back `[H, W]`, and which do."""
    assert view.depth is not None and view.neighbor is not None, "the term compares two rendered depths"
    camera = batch.camera
    y, x = jnp.meshgrid(*(jnp.arange(n, dtype=camera.K.dtype) + 0.5 for n in view.depth.shape), indexing="ij")
    there_and_back = partial(_there_and_back, camera=camera, neighbor=view.neighbor)
    seen_at, off, returns = jax.vmap(jax.vmap(there_and_back))(jnp.stack([x, y], -1), view.depth)
    return seen_at, off, batch.valid & (view.depth > 0) & returns & (off < HOME)


def _there_and_back(pixel: Array, here: Array, camera: Camera, neighbor: Neighbor) -> tuple[Array, Array, Array]:
    """Where one pixel position `[2]` of depth `here` is seen, and how far from it it lands on its way back, pixels.

    Thirdly whether it met a surface twice.
    """
    turn = jnp.sum(cameras.rotation(neighbor.camera)[:, None] * cameras.rotation(camera)[None], -1)
    shift = neighbor.camera.viewmat[:3, 3] - jnp.sum(turn * camera.viewmat[None, :3, 3], -1)
    point, in_front = _in_front(times(turn, _point(pixel, here, camera)) + shift)
    seen_at = cameras.project(point, neighbor.camera)
    there = _point(seen_at, sample_bilinear(neighbor.depth, seen_at), neighbor.camera)
    again, in_front_again = _in_front(times(turn.T, there - shift))
    squared = jnp.sum(jnp.square(cameras.project(again, camera) - pixel))
    moved = squared > ROUNDING**2  # A root has no slope at zero.
    off = jnp.where(moved, jnp.sqrt(jnp.maximum(squared, ROUNDING**2)), 0)
    return seen_at, off, in_front & reads_within(neighbor.depth > 0, seen_at) & in_front_again


def _point(pixel: Array, at: Array, camera: Camera) -> Array:
    """`[3]` camera-frame point of one pixel position and its depth."""
    return jnp.append((pixel - camera.K[:2, 2]) / jnp.stack([camera.K[0, 0], camera.K[1, 1]]) * at, at)


def _in_front(point: Array) -> tuple[Array, Array]:
    """A camera-frame point, or a harmless one where it is not in front of the camera; and whether it is."""
    in_front = point[2] > 0
    return jnp.where(in_front, point, jnp.array([0, 0, 1], point.dtype)), in_front


def render_neighbor(gaussians: Gaussians, neighbor: Batch, capacity: int, depth_mode: DepthReading) -> Neighbor:
    """What the terms need of the second view."""
    splats = rendering.splat(gaussians, neighbor.camera, capacity, depth_mode=rendering.splat_depth_mode(depth_mode))
    neighbor_depth, _ = depth.expected_depth(splats, depth_mode)
    return Neighbor(neighbor.camera, neighbor_depth, splats.pairs, neighbor.image, neighbor.valid)


def draw_neighbor(neighbors: np.ndarray, seed: int, step: int) -> int:
    """One of a view's `[M]` neighbours, each as likely: a function of (seed, step) alone."""
    return int(np.random.default_rng((seed, step, 1)).choice(neighbors))


def with_neighbors(views: Batches, extent: float, shares: np.ndarray | float = 1.0) -> Batches:
    """The same views, each with its `NEAREST` neighbours; where there are fewer, they repeat.

    `shares`, `[V]` or one for all, are of the steps that a view has a neighbour in, 0..1. In the others it is its own,
    which requires nothing. The nearest ones stay. `extent` is that of the cameras, scene units.
    """
    neighbors = nearest_views(np.stack([target.camera.viewmat for target in views.views]), extent)
    own = np.arange(len(neighbors))
    others = np.rint(NEAREST * np.broadcast_to(shares, own.shape))
    alone = np.arange(NEAREST) >= others[:, None]
    return replace(views, neighbors=np.where(alone, own[:, None], neighbors))


def nearest_views(viewmats: np.ndarray, extent: float) -> np.ndarray:
    """`[V, NEAREST]` indices of each view's neighbours among `[V, 4, 4]` viewmats, the nearest first, repeated.

    Neighbours look the same way to within `WIDEST` and are `APART`. A view without any is its own neighbour: its
    pixels come home exactly, which requires nothing.
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
