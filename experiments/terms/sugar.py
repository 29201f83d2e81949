"""SuGaR's regularisers (Guedon and Lepetit, CVPR 2024), which the paper replaces: baselines with their constants.

Points are drawn about the Gaussians of the view. At each, the density of the nearest Gaussians is compared with the one
that a surface would make there, and the normal of the Gaussian that it was drawn from with those around it. They know
no photo and no normal map. What differs from the authors' code is in docs/deviations.md.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import Gaussians, rotation_matrices, scales, smallest_axes
from gsjax.meshing import density_field
from gsjax.meshing.density_field import Kernels
from gsjax.normals import sdf
from gsjax.normals.sdf import face_camera
from gsjax.numerics import masked_mean, safe_normalize
from gsjax.rendering import View
from gsjax.scene import cameras
from gsjax.scene.batches import Batch
from gsjax.scene.cameras import Camera
from terms.surroundings import Around

SPREAD = 1.5  # standard deviations of the points drawn about a Gaussian, in its own
MOST_SAMPLES = 1_000_000  # points in a step; no more than there are Gaussians
CLOSE = 2.0  # standard deviations towards the camera between a mean and the rendered depth, to be drawn from (sdf)
FACTOR = 1 / 16  # of the density (sdf), so that its level 1 is beyond what 16 neighbours can make
EXTENTS = 10.0  # an error of the distance counts in this part of the camera extent (sdf)
FAINTEST = 1e-16  # density that still counts
THINNEST = 1e-6  # standard deviation, scene units, and least sum of weights
CHUNK = 16_384  # points at once
ON_LEVEL = 1e-6  # -2 log(density) under which a root has no slope to speak of


class Sample(NamedTuple):
    """A point drawn about one Gaussian, and what is around it."""

    point: Array  # [3] world
    mean: Array  # [3] of its Gaussian
    normal: Array  # [3] of its Gaussian: the smallest axis, of either sign
    nearby: Kernels  # [K] its Gaussian's nearest, itself first
    beta: Array  # [] mean of their smallest standard deviations


Misfit = Callable[[Sample], tuple[Array, Array]]
"""Sample -> `[]` how far the density is from a surface's there, and `[]` bool whether that counts."""


def sugar_sdf(gaussians: Gaussians, view: View, batch: Batch, around: Around) -> Array:
    """Mean of | f(x) - |D(pi(x)) - z(x)| | over a tenth of the extent, and of the normals' disagreement.

    f = beta sqrt(-2 log d) is the distance of the density d. Points are drawn from the Gaussians close to
    the rendered depth, and count where they read one.

    Differentiable to means, rotations, scales, opacities and the depth; not through who is drawn from.
    """
    assert view.depth is not None, "the term compares density with depth"
    depth, camera, unit = view.depth, batch.camera, around.extent / EXTENTS

    def misfit(sample: Sample) -> tuple[Array, Array]:
        reads = sdf.reads_depth(sample.point, depth > 0, camera)
        point = jnp.where(reads, sample.point, jax.lax.stop_gradient(sample.mean))
        to_depth = jnp.abs(sdf.depth_sdf(point, depth, camera))
        return jnp.abs(_distance(FACTOR * density_field.density(point, sample.nearby), sample.beta) - to_depth), reads

    value, disagreement = _means(misfit, gaussians, around, _close_to_depth(gaussians, view, depth, camera))
    return value / unit + disagreement


def sugar_density(gaussians: Gaussians, view: View, batch: Batch, around: Around) -> Array:
    """Mean of | d(x) - exp(-((x - mu) . n)^2 / (2 beta^2)) |, and of the normals' disagreement.

    The target is the density of a flat Gaussian at the distance of x from the plane of the one that it was drawn from:
    it needs no depth. Points are drawn from all visible Gaussians.

    Differentiable to means, rotations, scales and opacities; not through who is drawn from.
    """
    del batch

    def misfit(sample: Sample) -> tuple[Array, Array]:
        density = density_field.density(sample.point, sample.nearby)
        density = density / jnp.maximum(jax.lax.stop_gradient(density), 1)  # 1 where it is more, and still with a slope
        deviations = jnp.sum((sample.point - sample.mean) * sample.normal) / jnp.maximum(sample.beta, THINNEST)
        deviations = jnp.clip(deviations, -density_field.MAX_DISTANCE, density_field.MAX_DISTANCE)
        return jnp.abs(density - jnp.exp(-0.5 * deviations * deviations)), jnp.array(True)

    value, disagreement = _means(misfit, gaussians, around, view.splats.projection.visible[0])
    return value + disagreement


def _means(misfit: Misfit, gaussians: Gaussians, around: Around, among: Array) -> tuple[Array, Array]:
    """`[]` mean misfit where it counts, `[]` mean disagreement of normals: over points drawn `among` `[N]`."""
    who, how = jax.random.split(around.key)
    count = min(MOST_SAMPLES, gaussians.num_gaussians)
    owners = choose_rows(who, among, count)
    noise = jax.random.normal(how, (count, 3), gaussians.means.dtype)
    axes, deviations, normals = rotation_matrices(gaussians.quats), scales(gaussians), smallest_axes(gaussians)
    thickness, field = deviations.min(-1), density_field.kernels(gaussians)

    def of_one(owner: Array, noise: Array) -> tuple[Array, Array, Array]:
        ids = around.table[owner]
        point = gaussians.means[owner] + SPREAD * rotate(axes[owner], noise * deviations[owner])
        nearby = _kernels_around(field, ids)
        sample = Sample(point, gaussians.means[owner], normals[owner], nearby, jnp.mean(thickness[ids]))
        return *misfit(sample), _disagreement(sample, normals[ids], thickness[ids])

    misfits, counts, disagreements = _at_each(of_one, owners, noise)
    any_drawn = jnp.any(among)
    return masked_mean(misfits, counts & any_drawn), jnp.where(any_drawn, jnp.mean(disagreements), 0)


def _disagreement(sample: Sample, normals: Array, thickness: Array) -> Array:
    """`[]` squared distance of a normal from the mean of those around it, `[K, 3]` of Gaussians `[K]` thick.

    The weights are those with which flat Gaussians make the density's gradient, and carry no gradient themselves.
    """
    normals = face_camera(normals, sample.normal[None])
    constant = jax.lax.stop_gradient
    off_plane = constant(jnp.abs(jnp.sum((sample.point[None] - sample.nearby.means) * normals, axis=-1)))
    density = constant(density_field.contributions(sample.point, sample.nearby))
    weights = density * off_plane / constant(jnp.maximum(thickness, THINNEST)) ** 2
    weights = weights / jnp.maximum(jnp.sum(weights), THINNEST)
    return jnp.sum(jnp.square(sample.normal - jnp.sum(weights[:, None] * normals, axis=0)))


def _kernels_around(field: Kernels, ids: Array) -> Kernels:
    """The kernels of a row of `nearest_table`, `[k]` ids whose first is its own; that one again means none."""
    again = (ids == ids[0]).at[0].set(False)
    nearby = density_field.take(field, ids)
    return replace(nearby, opacities=jnp.where(again, 0, nearby.opacities))


def _at_each(function: Callable[..., Any], *rows: Array) -> Any:
    """`function` of each row of some arrays of `[M, ...]`, stacked: `CHUNK` rows at a time, twice for the gradient.

    So a sum over k neighbours takes memory for `CHUNK` times k of them, however many rows there are.
    """
    count = len(rows[0])
    return jax.lax.map(jax.checkpoint(lambda row: function(*row)), rows, batch_size=min(CHUNK, count))


def _distance(density: Array, beta: Array) -> Array:
    """`[]` distance from a plane at which a flat Gaussian `beta` thick has so much density; 0 from 1 on."""
    level = -2 * jnp.log(jnp.clip(density, FAINTEST, 1))
    is_off = level > ON_LEVEL
    return beta * jnp.where(is_off, jnp.sqrt(jnp.maximum(level, ON_LEVEL)), 0)


def _close_to_depth(gaussians: Gaussians, view: View, depth: Array, camera: Camera) -> Array:
    """`[N]` bool: visible, and the rendered `depth` `[H, W]` is within `CLOSE` standard deviations of the mean."""
    means = gaussians.means
    reads = jax.vmap(sdf.reads_depth, in_axes=(0, None, None))(means, depth > 0, camera)
    apart = jnp.abs(jax.vmap(sdf.depth_sdf, in_axes=(0, None, None))(means, depth, camera))
    towards = safe_normalize(cameras.center(camera)[None] - means)
    along = rotate(jnp.swapaxes(rotation_matrices(gaussians.quats), 1, 2), towards)
    deviation = jnp.sqrt(jnp.sum(jnp.square(scales(gaussians) * along), axis=-1))
    return jax.lax.stop_gradient(view.splats.projection.visible[0] & reads & (apart < CLOSE * deviation))


def choose_rows(key: Array, among: Array, count: int) -> Array:
    """`[count]` int32 rows where `among` `[N]` holds, each as likely, with replacement; any, where it never does."""
    ends = jnp.cumsum(among, dtype=jnp.int32)
    draws = jax.random.randint(key, (count,), 0, jnp.maximum(ends[-1], 1), jnp.int32)
    return jnp.minimum(jnp.searchsorted(ends, draws, side="right").astype(jnp.int32), len(among) - 1)


def rotate(rotations: Array, vectors: Array) -> Array:
    """`[..., 3]` vectors turned by `[..., 3, 3]` rotations."""
    return jnp.sum(rotations * vectors[..., None, :], axis=-1)
