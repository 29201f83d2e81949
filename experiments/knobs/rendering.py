"""Thresholds and tiles of the rasterizer: one picture of the base run, forward and backward."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import rasterizer
from gsjax.gaussians import opacities, scales, sh_coefficients
from knobs.knob import Knob, Measured, Place
from rasterizer import GSPLAT

REPEATS = 5
PAIRS = 1 << 20  # of splats and tiles, most


def _measure(place: Place, options: dict[str, Any], round_: int) -> Measured:
    """Median seconds of the picture and its gradient, and both."""
    del round_
    function, arguments = _program(place, tuple(sorted(options.items())))
    outcome, seconds = jax.block_until_ready(function(*arguments)), []
    for _ in range(REPEATS):
        started = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        seconds.append(time.perf_counter() - started)
    (_, (picture, overflowed)), gradient = jax.tree.map(np.asarray, outcome)
    assert not overflowed, "PAIRS is too small for this picture"
    return Measured(float(np.median(seconds)), (picture, np.concatenate([leaf.ravel() for leaf in gradient])))


@cache
def _program(place: Place, options: tuple[tuple[str, Any], ...]) -> tuple[Callable, tuple]:
    gaussians, camera = place.result.gaussians, place.result.cameras[0]
    fields = gaussians.means, gaussians.quats, scales(gaussians), opacities(gaussians), sh_coefficients(gaussians)
    arguments = tuple(jnp.asarray(np.asarray(field), jnp.float32) for field in fields)
    viewmats, Ks = (jnp.asarray(np.asarray(matrix), jnp.float32)[None] for matrix in (camera.viewmat, camera.K))
    towards = jnp.asarray(np.random.default_rng(0).normal(size=(camera.height, camera.width, 3)), jnp.float32)

    def picture(*arguments: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        colors, _, info = rasterizer.rasterization(
            *arguments,
            viewmats,
            Ks,
            camera.width,
            camera.height,
            sh_degree=gaussians.sh_degree,
            capacity=PAIRS,
            **dict(options),
        )
        return jnp.mean(colors[0] * towards), (colors[0], info["overflowed"])

    return jax.jit(jax.value_and_grad(picture, argnums=tuple(range(5)), has_aux=True)), arguments


def _errors(outcome: Any, best: Any) -> dict[str, float]:
    (picture, gradient), (best_picture, best_gradient) = outcome, best
    off = np.linalg.norm(gradient - best_gradient) / np.linalg.norm(best_gradient)
    return {
        "mean pixel, /255": 255 * float(np.abs(picture - best_picture).mean()),
        "largest pixel, /255": 255 * float(np.abs(picture - best_picture).max()),
        "gradient, %": 100 * float(off),
    }


def _rules(name: str, *values: float) -> Knob:
    return Knob({f"{value:.3g}": {"rules": replace(GSPLAT, **{name: value})} for value in values}, _measure, _errors)


KNOBS: dict[str, Knob] = {
    "alpha cut": _rules("alpha_min", 1 / 4096, 1 / 1024, 1 / 255, 1 / 64, 1 / 16),
    "alpha clamp": _rules("alpha_max", 0.9999, 0.999, 0.99, 0.95, 0.9),
    "transmittance stop": _rules("transmittance_min", 1e-7, 1e-4, 1e-3, 1e-2, 1e-1),
    "extents, deviations": _rules("extent_sigmas", 6.0, 3.33, 3.0, 2.5, 2.0),
    "tile size": Knob({str(side): {"tile_size": side} for side in (8, 4, 16, 32)}, _measure, _errors),
}
