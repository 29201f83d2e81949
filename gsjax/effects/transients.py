"""Things that some photos show and others do not: evidence from tracks, and masks of pixels that training ignores.

A pixel shows the scene where the render, in most of the pixels about it, is not off by far more than usual (after
RobustNeRF, Sabour et al. 2023, and SpotLessSplats for Gaussians). Nothing is learned but what is usual, a quantile of
the residuals of all photos: one that shows nothing foreign keeps nearly all of its pixels.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects.kinds import EffectKind, Evidence, Findings, unknown
from gsjax.effects.simulation import Effect
from gsjax.numerics import masked_mean
from gsjax.scene.batches import Batch
from gsjax.settings import Density

THRESHOLD = 0.25  # of the observations
FLOOR = 0.14  # what still scenes reach by sheen, shadows and wrong matches
OUTLIER = 4  # standard deviations
QUANTILE = 0.8  # of the residuals of all photos
REACH = 4.0  # times it: edges that are a little off are no strangers
WINDOW = 5  # pixels across, of which most must agree
LATER = 0.5  # of the time of densification, by which it is delayed
RATE = 0.02  # Adam's learning rate of the logarithm: from 1 to a twentieth in 150 steps


def judge(findings: Findings) -> Evidence:
    """Judge by the colours along tracks. Movers that left no tracks are not detected: tracks hold what matched."""
    gains = findings.gains
    if gains is None or not len(gains.fit.residuals):
        return unknown("share of observations", THRESHOLD, "needs points that three photos see")
    size = np.sqrt(np.square(gains.fit.residuals).mean(1))
    value = float((size > OUTLIER * gains.fit.sigma).mean())
    note = "colours off by 4 sigma after gains; sheen and shadows count too: give masks where something moved"
    return Evidence(value > THRESHOLD, value, "share of observations", FLOOR, THRESHOLD, note)


def make_effect(rate: optax.Schedule) -> Effect:
    """Pixels that are far off are left out of the loss, and out of what new Gaussians are made for.

    The logarithm of the quantile starts at 0, a difference of 1, which no pixel exceeds, and sinks to where it belongs:
    masks set in as the scene takes shape.
    """
    return Effect(np.float32(0), rate, trusts=trusts)


def delay_densification(density: Density, steps: int) -> Density:
    """Densification that starts once the masks have formed, and ends as much later (RobustSplat, Fu et al. 2025).

    Earlier, Gaussians would densify in front of a camera to show a transient, and no other photo would remove them.
    It ends within the `steps` of the phases that densify.
    """
    wait = round(LATER * max(min(density.stop, steps) - density.start, 0))
    stop = max(density.stop, min(density.stop + wait, steps))
    return replace(density, start=density.start + wait, stop=stop)


def trusts(log_quantile: Array, colors: Array, batch: Batch) -> tuple[Array, Array]:
    """Which pixels show the scene `[H, W]` bool, and zero, whose gradient leads the quantile to its place."""
    off = residuals(colors, batch.image)
    slope = masked_mean(jnp.where(off > jnp.exp(log_quantile), -QUANTILE, 1 - QUANTILE), batch.valid)
    still = jax.lax.stop_gradient(log_quantile)
    return trusted_pixels(still, colors, batch.image), jax.lax.stop_gradient(slope) * (log_quantile - still)


def trusted_pixels(log_quantile: Array, colors: Array, image: Array) -> Array:
    """`[H, W]` bool: most pixels of the window about it are near enough to the photo."""
    near = residuals(colors, image) <= REACH * jnp.exp(log_quantile)
    votes, voters = (
        jax.lax.reduce_window(each, np.float32(0), jax.lax.add, (WINDOW, WINDOW), (1, 1), "SAME")
        for each in (near.astype(jnp.float32), jnp.ones(near.shape, jnp.float32))
    )
    return 2 * votes > voters


def residuals(colors: Array, image: Array) -> Array:
    """`[H, W]` mean absolute difference of the channels; no gradient."""
    return jax.lax.stop_gradient(jnp.mean(jnp.abs(jnp.clip(colors, 0, 1) - image), axis=-1))


EFFECT = EffectKind(
    judge, lambda inputs, rate: make_effect(rate(peak=RATE, hold=0, final=1.0)), delay_densification=delay_densification
)
