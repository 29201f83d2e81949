"""Exposure and white balance: photos of one scene that differ by a factor in every channel."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects import simulation
from gsjax.effects.evidence import Evidence, unknown
from gsjax.effects.observations import Observations
from gsjax.effects.photo_gains import Fit, Table, fit, held_out_ratio, table
from gsjax.effects.simulation import LIMIT, Effect
from gsjax.scene.batches import Batch
from gsjax.scene.colors import srgb_to_linear

if TYPE_CHECKING:
    from gsjax.effects.appearance import Start
    from gsjax.effects.diagnosis import Findings

THRESHOLD = 0.05  # EV, of the exposure's or the white balance's standard deviation: 0.26 dB of PSNR at 30 dB
HELD_OUT = 0.95  # Gains must lower the error of points that they were not fitted to at least to this share,
SPATIAL = 0.6  # and both halves of the scene must give the same ones: a correlation.
RATE, RATE_KNOWN = simulation.RATE, 5e-4  # Adam's learning rate of gains; of those that tracks have told
_FEWEST = 20  # observations of a photo in each half of the scene, to be compared


class Gains(NamedTuple):
    """What tracks imply of the photos' exposure."""

    data: Table  # log2 of linear light
    fit: Fit  # gains in EV, red, green, blue
    noise: float  # EV, of a photo's exposure
    held_out_ratio: float
    agreement: tuple[float, float]  # correlation of both halves of the scene: exposures, white balances


def estimate(observations: Observations) -> Gains | None:
    """Gains of the photos, and how far they can be trusted; None without tracks that say anything."""
    light = np.log2(srgb_to_linear(observations.colors))
    data = table(light, observations.photo, observations.point, len(observations.frames))
    if len(np.unique(data.photo)) < 2:
        return None
    half = np.random.default_rng(0).random(int(data.point.max()) + 1) < 0.5
    first, second = (data.only(side[data.point]) for side in (half, ~half))
    one, other = fit(first), fit(second)
    a, b = _common(one, other, first, second, fewest=1)
    noise = 0.5 * float(np.sqrt(np.mean(np.square((a - b).mean(1))))) if a.size else 0.0
    ratio = held_out_ratio(second, one.gains) if len(second.photo) else 1.0
    return Gains(data, fit(data), noise, ratio, _agreement(observations, data))


def judge(findings: "Findings") -> Evidence:
    """On where photos differ by more than noise, alike all over the scene, and gains predict unseen points."""
    observations, gains = findings.observations, findings.gains
    if gains is None:
        why = "no point is seen in three photos" if observations.tracked else "these photos have no tracks"
        return unknown("EV", THRESHOLD, why)
    has_gain = np.bincount(gains.data.photo, minlength=len(observations.frames)) > 0
    values = gains.fit.gains[has_gain]
    spread = float(values.mean(1).std())
    balance = float(max((values[:, channel] - values[:, 1]).std() for channel in (0, 2)))
    exposure_agrees, balance_agrees = gains.agreement
    differ = spread > THRESHOLD, balance > THRESHOLD
    is_consistent = exposure_agrees > SPATIAL, balance_agrees > SPATIAL
    on = gains.held_out_ratio < HELD_OUT and any(d and a for d, a in zip(differ, is_consistent, strict=True))
    note = (
        f"white balance {balance:.2f} EV; error of unseen points x{gains.held_out_ratio:.2f} (below {HELD_OUT});"
        f" correlation of halves {exposure_agrees:.2f}, in white balance {balance_agrees:.2f} (above {SPATIAL})"
    )
    if any(differ) and not on:
        note += "; photos differ, but not by one gain each"
    return Evidence(bool(on), spread, "EV", gains.noise, THRESHOLD, note)


def simulate(start_values: "Start", rate: Callable[..., optax.Schedule]) -> Effect:
    """The effect of a run: where it starts, and its schedule by `peak`, `hold`, `share` and `final`."""
    # Near its start, an effect explains less of what a scene lacks yet.
    peak = RATE_KNOWN if start_values.tracked else RATE
    return make_effect(start_values.log_gains[start_values.trained], rate(peak=peak))


def make_effect(initial: np.ndarray, rate: optax.Schedule) -> Effect:
    """Every photo multiplies the display-coded channels by its own factors, of logarithms `[V, 3]` of mean zero.

    A factor of light is a factor of display-coded values to the power 1 / 2.2, up to toe and clipping. The mean is
    taken off the numbers as they are used, so the scene is that of the mean photo whatever an optimiser does.
    """

    def light(numbers: Array, colors: Array, batch: Batch) -> Array:
        return colors * jnp.exp(log_gains(numbers)[batch.photo])[None, None]

    return Effect(np.asarray(initial, np.float32), rate, light=light)


def log_gains(numbers: Array) -> Array:
    """`[V, 3]` logarithms of the photos' factors, of the numbers that are optimised."""
    return jnp.clip(numbers - jnp.mean(numbers, axis=0, keepdims=True), -LIMIT, LIMIT)


def _agreement(observations: Observations, data: Table) -> tuple[float, float]:
    """Correlations of the photos' gains from the two halves of the scene, cut across its longest axis."""
    points = observations.points[data.origins]
    offsets = points - np.median(points, axis=0)
    side = offsets @ np.linalg.svd(offsets, full_matrices=False)[2][0] > 0
    first, second = (data.only(half[data.point]) for half in (side, ~side))
    one, other = _common(fit(first), fit(second), first, second, fewest=_FEWEST)
    luminance = _correlation(one.mean(1), other.mean(1))
    colors = _correlation(*((gains[:, [0, 2]] - gains[:, 1:2]).ravel() for gains in (one, other)))
    return luminance, colors


def _correlation(one: np.ndarray, other: np.ndarray) -> float:
    if one.size < 3 or one.std() == 0 or other.std() == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def _common(one: Fit, other: Fit, first: Table, second: Table, *, fewest: int) -> tuple[np.ndarray, np.ndarray]:
    """Gains `[v, 3]`, mean zero, of the photos that both tables see often enough."""
    counts = [np.bincount(part.photo, minlength=part.num_photos) for part in (first, second)]
    both = np.minimum(*counts) >= fewest
    if not both.any():
        return np.empty((0, 3)), np.empty((0, 3))
    return one.gains[both] - one.gains[both].mean(0), other.gains[both] - other.gains[both].mean(0)
