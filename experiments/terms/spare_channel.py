"""One more number a Gaussian, trained beside the others, and two terms that read it.

The library's Gaussians have no such field. The first coefficient of their highest band of harmonics lends it, in runs
whose ramp of degrees never shows that band; whoever draws them afterwards takes the band away (`without`).
"""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jax import Array

from gsjax import render
from gsjax.gaussians import Gaussians
from gsjax.normals.sdf import DOUBT, misaligned, misalignment, pixel_depth_map
from gsjax.numerics import masked_mean, safe_divide
from gsjax.render import MIN_COVERAGE, View
from gsjax.render.depth import expected_depth
from gsjax.targets import Batch

GAIN = 10.0  # of the number over its coefficient, whose learning rate is small


def spare(gaussians: Gaussians) -> Any:
    """`[N]` the number, 0 where training begins."""
    first = gaussians.sh_degree**2 - 1
    return GAIN * gaussians.sh_rest[:, first, 0]


def without(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians (numpy) without the band that lent the number."""
    return replace(gaussians, sh_rest=np.asarray(gaussians.sh_rest)[:, : gaussians.sh_degree**2 - 1])


def as_geometry(gaussians: Gaussians) -> Gaussians:
    """The Gaussians (numpy) whose opacities are those that geometry is read with."""
    return replace(without(gaussians), logit_opacities=np.asarray(gaussians.logit_opacities) + spare(gaussians))


def own_opacity(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """R at every pixel, of a depth that is composited with opacities of its own: log-odds plus the number.

    Opacities that colours are composited with have no gradient from it.
    """
    compensations = view.splats.projection.compensations
    opacities = jax.nn.sigmoid(jax.lax.stop_gradient(gaussians.logit_opacities) + spare(gaussians))
    if compensations is not None:
        opacities = opacities * compensations[0]
    depth, alphas = expected_depth(replace(view.splats, opacities=opacities), "front")
    covered = batch.valid & (jax.lax.stop_gradient(alphas) > MIN_COVERAGE)
    directions = pixel_depth_map(gaussians, view._replace(depth=depth), batch.camera)
    return misalignment(directions, batch.normals, covered)  # pyright: ignore[reportArgumentType]


def believed(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """R at every pixel, weighed by a composited confidence w, less `DOUBT` times its logarithm: w e - DOUBT log w.

    The least of that is at w = min(1, DOUBT / e), so a pixel whose misalignment e stays large is believed less.
    """
    covered = batch.valid & (jax.lax.stop_gradient(view.alphas) > MIN_COVERAGE)
    directions = pixel_depth_map(gaussians, view, batch.camera)
    error, weight = misaligned(directions, batch.normals, covered)  # pyright: ignore[reportArgumentType]
    image, alphas = render.features(view.splats, spare(gaussians)[:, None])
    logit = 2 + safe_divide(image[..., 0], alphas, covered)
    return masked_mean(jax.nn.sigmoid(logit) * error - DOUBT * jax.nn.log_sigmoid(logit), weight)
