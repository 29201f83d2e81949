"""Exposure and white balance: photos of one scene that differ by a factor in every channel."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects import simulation
from gsjax.effects.kinds import EffectKind, Evidence, Findings, Rate, StartInputs, unknown
from gsjax.effects.simulation import LIMIT, Effect
from gsjax.scene.batches import Batch

THRESHOLD = 0.05  # EV, of the exposure's or the white balance's standard deviation: 0.26 dB of PSNR at 30 dB
HELD_OUT = 0.95  # Gains must lower the error of points that they were not fitted to at least to this share,
SPATIAL = 0.6  # and both halves of the scene must give the same ones: a correlation.
RATE, RATE_KNOWN = simulation.RATE, 5e-4  # Adam's learning rate of gains; of those that tracks have told


def judge(findings: Findings) -> Evidence:
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


def simulate(inputs: StartInputs, rate: Rate) -> Effect:
    """The effect of a run, from what the tracks imply. Near its start, it explains less of what a scene lacks yet."""
    names, trained, start_gains = inputs.names, inputs.trained, gains_of_tracks(inputs)

    def report(numbers: Array) -> dict[str, Any]:
        # No pixel of a held-out photo has been used but its keypoints.
        gains = start_gains.copy()
        gains[trained] = np.asarray(log_gains(jnp.asarray(numbers)))
        return {"log_gains": dict(zip(names, gains.tolist(), strict=True))}

    peak = RATE_KNOWN if inputs.observations.tracked else RATE
    return make_effect(start_gains[trained], rate(peak=peak))._replace(report=report)


def gains_of_tracks(inputs: StartInputs) -> np.ndarray:
    """`[V, 3]` float32 logarithms of the photos' factors, mean zero over the photos that are trained on."""
    gains, trained = inputs.fit.gains, inputs.trained
    has_gain = np.bincount(inputs.light.photo, minlength=len(trained)) > 0
    if not (has_gain & trained).any():
        return np.zeros((len(trained), 3), np.float32)
    return np.where(has_gain[:, None], gains - gains[has_gain & trained].mean(0), 0.0).astype(np.float32)


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


EFFECT = EffectKind(judge, simulate, on_evidence=True, per_photo=True)
