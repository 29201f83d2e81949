"""Vignetting: photos that are darker towards their corners."""

import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects.kinds import EffectKind, Evidence, Findings, Rate, StartInputs, unknown
from gsjax.effects.observations import Observations
from gsjax.effects.photo_gains import Fit, Gains, Table, fit, project
from gsjax.effects.simulation import LIMIT, Effect
from gsjax.scene.batches import Batch
from gsjax.scene.cameras import Camera

THRESHOLD = 0.1  # EV at the corner
SIGNIFICANT = 5  # standard errors
FEWEST_IN_HALF = 6  # photos, by which a change over time is judged
_GROUPS = 20  # of radii in a picture


def slope_on(radii2: np.ndarray, data: Table, solution: Fit) -> tuple[float, float]:
    """Slope of the logarithms on squared radii `[O]`, and its standard error.

    On `Observations.radii2` it is the light at half a diagonal from the principal point against the middle's, EV.
    What photos and points explain is taken out of both first: what counts is one point nearer to the middle in one
    photo than in another. Observations of a photo count as one in the error, since what the model leaves of it is
    shared.
    """
    weights = solution.weights
    across = project(radii2[data.rows][:, None], data, weights)[1][:, 0]
    light = solution.residuals.mean(1)
    leverage = max(float(weights @ np.square(across)), 1e-12)
    slope = float(weights @ (across * light)) / leverage
    scores = np.bincount(data.photo, weights * across * (light - slope * across), data.num_photos)
    return slope, float(np.sqrt(np.square(scores).sum()) / leverage)


def profile(observations: Observations, gains: Gains) -> tuple[np.ndarray, np.ndarray, float]:
    """For a picture: squared radii `[B]`, the light there against the middle's `[B]` in EV, and the corner's."""
    data, weights = gains.data, gains.fit.weights
    radii = observations.radii2[data.rows]
    across = project(radii[:, None], data, weights)[1][:, 0]
    slope, _ = slope_on(observations.radii2, data, gains.fit)
    light = gains.fit.residuals.mean(1) + slope * (radii - across)
    groups = np.array_split(np.argsort(radii), min(_GROUPS, len(radii)))
    means = [(radii[rows].mean(), light[rows].mean()) for rows in groups]
    return *np.array(means).T, slope  # pyright: ignore[reportReturnType]


def halves(observations: Observations, gains: Gains) -> list[tuple[float, float]]:
    """`slope_on` radii of the earlier and of the later photos, by the order of their names; empty where too few."""
    half = len(observations.frames) // 2
    if half < FEWEST_IN_HALF:
        return []
    early = gains.data.photo < half
    corners = []
    for rows in (early, ~early):
        part = gains.data.only(rows)
        if len(np.unique(part.photo)) < FEWEST_IN_HALF:
            return []
        corners.append(slope_on(observations.radii2[gains.data.rows[rows]], part, fit(part)))
    return corners


def judge(findings: Findings) -> Evidence:
    """Judge whether corners are darker, in all photos or in one half of them, by more than noise."""
    observations, gains = findings.observations, findings.gains
    if gains is None:
        return unknown("EV", THRESHOLD, "needs points that three photos see")
    slope, error = slope_on(observations.radii2, gains.data, gains.fit)
    note = f"how much darker a corner is than the middle; needs {SIGNIFICANT} standard errors, has"
    note += f" {-slope / max(error, 1e-6):.0f}"
    parts = halves(observations, gains)
    if parts and abs(parts[0][0] - parts[1][0]) > max(THRESHOLD, SIGNIFICANT * np.hypot(parts[0][1], parts[1][1])):
        slope, error = min(parts)
        note += f"; changes over time: earlier photos {-parts[0][0]:.2f} EV, later ones {-parts[1][0]:.2f}"
        note += "; one fall-off cannot describe both halves"
    on = -slope > max(THRESHOLD, SIGNIFICANT * error)
    return Evidence(bool(on), -slope, "EV", error, THRESHOLD, note)


def simulate(inputs: StartInputs, rate: Rate) -> Effect:
    """The effect of a run: the fall-off that the tracks imply of all cameras together, then of each its own."""
    names, camera = inputs.names, inputs.camera
    start_numbers = np.tile(np.array([_slope(inputs), 0.0]), (camera.max() + 1, 1))
    return make_effect(start_numbers, camera[inputs.trained], rate())._replace(
        report=lambda numbers: {"falloff": dict(zip(names, np.asarray(numbers)[camera].tolist(), strict=True))}
    )


def explain(inputs: StartInputs) -> np.ndarray:
    """`[O, 1]` logarithm of light that the fall-off explains, by the tracks."""
    return _slope(inputs) * inputs.observations.tangents2[:, None]


def _slope(inputs: StartInputs) -> float:
    if not len(inputs.light.photo):
        return 0.0
    return min(slope_on(inputs.observations.tangents2, inputs.light, inputs.fit)[0], 0.0)


def make_effect(initial: np.ndarray, camera: np.ndarray, rate: optax.Schedule) -> Effect:
    """Every camera's light falls off by a polynomial of the squared tangent of the angle to its axis.

    `initial` are `[C, 2]` coefficients of the logarithm, of the tangent squared and to the fourth; `camera` `[V]` says
    whose camera took which photo, 0..C-1.
    """
    whose = np.asarray(camera, np.int32)

    def light(numbers: Array, colors: Array, batch: Batch) -> Array:
        return colors * jnp.exp(falloff(numbers[jnp.asarray(whose)[batch.photo]], batch.camera))[..., None]

    return Effect(np.asarray(initial, np.float32), rate, light=light)


def falloff(numbers: Array, camera: Camera) -> Array:
    """`[H, W]` logarithm of what is left of the light, of `[2]` coefficients; zero on the optical axis."""
    x = (jnp.arange(camera.width, dtype=jnp.float32) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    y = (jnp.arange(camera.height, dtype=jnp.float32) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    tangent2 = jnp.square(y)[:, None] + jnp.square(x)[None, :]
    return jnp.clip(numbers[0] * tangent2 + numbers[1] * jnp.square(tangent2), -LIMIT, LIMIT)


EFFECT = EffectKind(judge, simulate, explain)
